# SPDX-License-Identifier: Apache-2.0
"""Bodies without inertia about an axis: point masses, rods without thickness.

Only relative coordinates integrate them: there a body needs inertia along the freedoms of its joints
only. On SE(3)^n every body needs inertia about all axes.
"""

import numpy as np

# Principal moments up to this part of the largest are zero: eigenvalues of a 3x3 matrix have errors of
# a few 1e-16. A rod of diameter d and length L has the ratio (d / L)^2, above 1e-12.
NO_INERTIA = 1e-12


def axes_without_inertia(body):
    """(k, 3) orthonormal axes, body axes, about which a body of a scene has no inertia."""
    moments, axes = np.linalg.eigh(body.inertia_matrix)
    return axes.T[moments <= NO_INERTIA * moments[2]]


def invertible_inertia(body, reach=1.0):
    """Inertia (3, 3) of a body, with that of its mass at `reach`, m, about axes without inertia."""
    axes = axes_without_inertia(body)
    if not len(axes):
        return body.inertia_matrix
    moment = max(np.trace(body.inertia_matrix), body.mass * reach**2)
    return body.inertia_matrix + moment * axes.T @ axes


def lack_of_inertia(scene):
    """Text that names the first body without inertia about an axis, or "" without one."""
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
