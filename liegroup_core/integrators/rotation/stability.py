# SPDX-License-Identifier: Apache-2.0
"""Stability limit of a rotation method: the step size beyond which its errors grow exponentially.

Methods that are explicit in the forces have such a limit. For KICKED methods it is h omega = 2, with
omega the fastest oscillation of the bodies on their springs or in gravity, and about h c = 2 for
dampers of rate c. Beyond the limit the energy grows without bound and a body tumbles, but all
numbers stay finite for long.

The limit is checked at the start of a run; other states of the motion are not checked. The
derivative of one step with respect to the state is compared with that of many substeps of the same
method. Both come from finite differences in world axes, where free bodies have constant attitudes
and momenta. Errors that grow in one step but not in the substeps are those of the method.
"""

import numpy as np

from liegroup_core.lie.groups import SO3

# Bounds on the growth of an error in one step: of errors with alternating sign, as in oscillations,
# and of any error. Far from an equilibrium the motion itself has some growth.
OSCILLATING, ANY = 1.05, 1.2
# Substeps that represent the motion: at least SUBSTEPS, and SUBSTEPS_PER_RATE times h times the
# largest rate. If that exceeds MAX_SUBSTEPS, no explicit method is stable.
SUBSTEPS, SUBSTEPS_PER_RATE, MAX_SUBSTEPS = 16, 4, 2000
# Perturbation: rad and m, times the largest component of a twist or 1.
DIFFERENCE = 1e-6
# rad; if a body rotates by more within a step, growth need not be that of an oscillation.
LARGEST_ROTATION = 0.5 * np.pi
MAX_BODIES = 30  # the cost grows faster than the square of their number
BISECTIONS = 6


def stability_limit(step, spinners, h, pose, twist):
    """Largest stable step in s if h is beyond it, else None.

    step     : function (h, steps, pose, twist) -> (pose, twist) at the end, or None on failure
    spinners : (n,) records of bodies.SPINNER
    """
    if len(pose) > MAX_BODIES or h * np.linalg.norm(twist[:, :3], axis=1).max() > LARGEST_ROTATION:
        return None
    if not _grows(step, spinners, h, pose, twist):
        return None
    stable, unstable = 0.5 * h, h
    while _grows(step, spinners, stable, pose, twist) and stable > 1e-6 * h:
        stable, unstable = 0.5 * stable, stable
    for _ in range(BISECTIONS):
        middle = 0.5 * (stable + unstable)
        if _grows(step, spinners, middle, pose, twist):
            unstable = middle
        else:
            stable = middle
    return stable


def _grows(step, spinners, h, pose, twist):
    """True if errors grow in one step but not in many substeps."""
    values = _eigenvalues(step, spinners, h, 1, pose, twist)
    sizes = np.abs(values)
    growth = max(
        sizes.max(initial=0.0) / ANY, sizes[values.real < 0.0].max(initial=0.0) / OSCILLATING
    )
    if growth <= 1.0:
        return False
    short = 1e-4 * h
    rates = (_eigenvalues(step, spinners, short, 1, pose, twist) - 1.0) / short
    substeps = max(SUBSTEPS, int(SUBSTEPS_PER_RATE * h * np.abs(rates).max(initial=0.0)))
    if substeps > MAX_SUBSTEPS:
        return True
    motion = np.abs(_eigenvalues(step, spinners, h, substeps, pose, twist))
    return len(motion) > 0 and growth > max(1.0, motion.max())


def _eigenvalues(step, spinners, h, substeps, pose, twist):
    """Eigenvalues of the derivative of a step that is taken in substeps; empty on failure."""
    size = DIFFERENCE * max(1.0, np.abs(twist).max())
    columns = []
    for i, spinner in enumerate(spinners):
        for kind in (
            ("rotation", "momentum")
            if spinner["held"]
            else ("rotation", "momentum", "position", "velocity")
        ):
            for axis in size * np.eye(3):
                ends = [
                    step(
                        h / substeps,
                        substeps,
                        *_displaced(spinners, pose, twist, i, kind, sign * axis),
                    )
                    for sign in (1, -1)
                ]
                if None in ends:
                    return np.zeros(0)
                columns.append(_difference(spinners, *ends) / (2.0 * size))
    return np.linalg.eigvals(np.array(columns))


def _displaced(spinners, pose, twist, i, kind, by):
    """State with one quantity (`kind`) of body i changed by the world vector `by`."""
    pose, twist, spinner = pose.copy(), twist.copy(), spinners[i]
    inertia = spinner["inertia"].reshape(3, 3)
    rotation = pose[i, :9].reshape(3, 3)
    momentum, velocity = rotation @ inertia @ twist[i, :3], rotation @ twist[i, 3:]
    if kind == "rotation":
        rotation = SO3.exp(by) @ rotation
        pose[i, :9] = rotation.ravel()
    elif kind == "momentum":
        momentum = momentum + inertia.trace() / 3.0 * by
    elif kind == "position":
        pose[i, 9:] += by
    else:
        velocity = velocity + by
    twist[i, :3] = np.linalg.solve(inertia, rotation.T @ momentum)
    twist[i, 3:] = rotation.T @ velocity
    if spinner["held"]:
        pose[i, 9:] = spinner["pivot"] + rotation @ spinner["arm"]
        twist[i, 3:] = np.cross(twist[i, :3], spinner["arm"])
    return pose, twist


def _difference(spinners, one, other):
    """Difference of two close states, in the components that `_displaced` changes."""
    components = []
    for spinner, pose, twist, pose_2, twist_2 in zip(spinners, *one, *other):
        inertia = spinner["inertia"].reshape(3, 3)
        R, S = pose[:9].reshape(3, 3), pose_2[:9].reshape(3, 3)
        rotation = R @ S.T
        components += [
            (rotation - rotation.T)[[2, 0, 1], [1, 2, 0]] / 2.0,
            (R @ inertia @ twist[:3] - S @ inertia @ twist_2[:3]) * 3.0 / inertia.trace(),
        ]
        if not spinner["held"]:
            components += [pose[9:] - pose_2[9:], R @ twist[3:] - S @ twist_2[3:]]
    return np.concatenate(components)
