# SPDX-License-Identifier: Apache-2.0
"""Bodies without inertia about an axis: point masses, rods without thickness.

They require relative coordinates: there a body needs inertia only along the degrees of freedom of its
joints. On SE(3)^n every body needs inertia about all axes.
"""

import numpy as np

# A principal moment below this fraction of the largest one counts as zero: eigenvalues of a 3x3 matrix have
# relative errors of a few 1e-16. A rod of diameter d and length L has the ratio (d / L)^2, above 1e-12.
NO_INERTIA = 1e-12


def axes_without_inertia(body):
    """(k, 3) orthonormal axes, body axes, about which a body of a scene has no inertia."""
    moments, axes = np.linalg.eigh(body.inertia_matrix)
    return axes.T[moments <= NO_INERTIA * moments[2]]


def invertible_inertia(body, reach=1.0):
    """Invertible inertia (3, 3): about axes without inertia, that of the body's mass at the distance `reach`, m."""
    axes = axes_without_inertia(body)
    if not len(axes):
        return body.inertia_matrix
    moment = max(np.trace(body.inertia_matrix), body.mass * reach**2)
    return body.inertia_matrix + moment * axes.T @ axes


def lack_of_inertia(scene):
    """Text with the first body that has no inertia about an axis, "" if there is none."""
    for i, body in enumerate(scene.bodies):
        axes = axes_without_inertia(body)
        if len(axes):
            return f'bodies[{i}] "{body.name}" has no inertia about {written(axes)}'
    return ""


def written(axes):
    """Text of orthonormal axes (k, 3) in body axes."""
    if len(axes) == 3:
        return "any axis"
    axes = np.where(np.abs(axes) < 1e-9, 0.0, axes)
    texts = []
    for axis in axes:
        axis = axis * np.sign(axis[np.flatnonzero(axis)[0]]) + 0.0
        texts.append("(" + ", ".join(f"{x:.4g}" for x in axis) + ")")
    return ("its axis " if len(axes) == 1 else "its axes ") + " and ".join(texts)
