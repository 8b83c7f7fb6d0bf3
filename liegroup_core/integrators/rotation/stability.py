# SPDX-License-Identifier: Apache-2.0
"""Stability limit of a rotation method: the step size beyond which its errors grow exponentially.

Methods that are explicit in the forces have such a limit: h omega = 2 for KICKED ones, omega the
fastest oscillation of the bodies on their springs or in gravity, and about h c = 2 for dampers of
rate c. Beyond it the energy grows without bound, while all numbers stay finite for long: a body
tumbles. The limit is checked at the start of a run. The derivative of one step with respect to the
state is compared with that of the same method in many parts of the step, both by differences in
world axes, where free bodies have constant attitudes and momenta. Errors that grow only in the
first are those of the method. The check does not cover other states of the motion.
"""

import numpy as np

from liegroup_core.lie.groups import SO3

# Bounds on the growth of an error in one step, relative to the motion: of one with alternating
# sign, as in oscillations, and of any. Far from an equilibrium a step has some growth by itself.
OSCILLATING, ANY = 1.05, 1.2
# Parts of a step for the motion: a constant, and a number per unit of h times the largest rate.
# Beyond the maximum no explicit method is stable.
PARTS, PARTS_BY_RATE, MOST_PARTS = 16, 4, 2000
DIFFERENCE = 1e-6  # rad, m, and times the fastest motion or 1 rad/s, m/s
# rad; if a body rotates by more within a step, growth need not be that of an oscillation.
LARGEST_TURN = 0.5 * np.pi
MOST_BODIES = 30  # the cost grows with the square of their number and more
HALVINGS = 6


def stability_limit(step, spinners, h, pose, twist):
    """Largest stable step, s, if h is beyond it; else None.

    step     : function (h, steps, pose, twist) -> (pose, twist) at the end, or None if it fails
    spinners : (n,) records of bodies.SPINNER
    """
    if len(pose) > MOST_BODIES or h * np.linalg.norm(twist[:, :3], axis=1).max() > LARGEST_TURN:
        return None
    if not _grows(step, spinners, h, pose, twist):
        return None
    good, bad = 0.5 * h, h
    while _grows(step, spinners, good, pose, twist) and good > 1e-6 * h:
        good, bad = 0.5 * good, good
    for _ in range(HALVINGS):
        middle = 0.5 * (good + bad)
        if _grows(step, spinners, middle, pose, twist):
            bad = middle
        else:
            good = middle
    return good


def _grows(step, spinners, h, pose, twist):
    """True if errors grow in a step but not in the motion."""
    values = _eigenvalues(step, spinners, h, 1, pose, twist)
    sizes = np.abs(values)
    growth = max(
        sizes.max(initial=0.0) / ANY, sizes[values.real < 0.0].max(initial=0.0) / OSCILLATING
    )
    if growth <= 1.0:
        return False
    tiny = 1e-4 * h
    rates = (_eigenvalues(step, spinners, tiny, 1, pose, twist) - 1.0) / tiny
    parts = max(PARTS, int(PARTS_BY_RATE * h * np.abs(rates).max(initial=0.0)))
    if parts > MOST_PARTS:
        return True
    motion = np.abs(_eigenvalues(step, spinners, h, parts, pose, twist))
    return len(motion) > 0 and growth > max(1.0, motion.max())


def _eigenvalues(step, spinners, h, parts, pose, twist):
    """Eigenvalues of the derivative of a step, taken in parts; empty if it fails."""
    size = DIFFERENCE * max(1.0, np.abs(twist).max())
    columns = []
    for i, spinner in enumerate(spinners):
        for kind in (
            ("turn", "momentum") if spinner["held"] else ("turn", "momentum", "place", "velocity")
        ):
            for axis in size * np.eye(3):
                ends = [
                    step(h / parts, parts, *_displaced(spinners, pose, twist, i, kind, sign * axis))
                    for sign in (1, -1)
                ]
                if None in ends:
                    return np.zeros(0)
                columns.append(_difference(spinners, *ends) / (2.0 * size))
    return np.linalg.eigvals(np.array(columns))


def _displaced(spinners, pose, twist, i, kind, by):
    """State with one component of body i perturbed, in world axes."""
    pose, twist, spinner = pose.copy(), twist.copy(), spinners[i]
    inertia = spinner["inertia"].reshape(3, 3)
    rotation = pose[i, :9].reshape(3, 3)
    momentum, velocity = rotation @ inertia @ twist[i, :3], rotation @ twist[i, 3:]
    if kind == "turn":
        rotation = SO3.exp(by) @ rotation
        pose[i, :9] = rotation.ravel()
    elif kind == "momentum":
        momentum = momentum + inertia.trace() / 3.0 * by
    elif kind == "place":
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
    """Difference of two close states in the same components."""
    found = []
    for spinner, pose, twist, pose_2, twist_2 in zip(spinners, *one, *other):
        inertia = spinner["inertia"].reshape(3, 3)
        R, S = pose[:9].reshape(3, 3), pose_2[:9].reshape(3, 3)
        turn = R @ S.T
        found += [
            (turn - turn.T)[[2, 0, 1], [1, 2, 0]] / 2.0,
            (R @ inertia @ twist[:3] - S @ inertia @ twist_2[:3]) * 3.0 / inertia.trace(),
        ]
        if not spinner["held"]:
            found += [pose[9:] - pose_2[9:], R @ twist[3:] - S @ twist_2[3:]]
    return np.concatenate(found)
