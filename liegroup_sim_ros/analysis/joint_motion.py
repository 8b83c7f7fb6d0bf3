# SPDX-License-Identifier: Apache-2.0
"""Positions, velocities, efforts and powers of the joints with one coordinate, along a recorded run."""

import numpy as np

from .acting import Acting, sample_of

MOST_NUMBERS, LEAST_TIMES, MOST_TIMES = 24_000, 200, 1000  # of all curves; of one


def joint_motion(layout, motion):
    """(times (m,) s of the recording, {joint: (m, 4) position, velocity, effort, power}); gaps (NaN) between stretches.

    The effort is that of motors, servos, springs and dampers at the joint, of its drive and of commands, without
    friction and stops; NaN for a joint without these.
    """
    names, stretches = layout.coordinates.names, motion.stretches
    if not names:
        return np.empty(0), {}
    most = min(MOST_TIMES, max(LEAST_TIMES, MOST_NUMBERS // (2 * len(names))))
    every = -(-sum(len(stretch.steps) for stretch in stretches) // most)
    acting = Acting(layout, stretches[0].step)
    times, rows = [], []
    for stretch in stretches:
        for k in range(0, len(stretch.steps), every):
            times.append(stretch.log_times[k])
            rows.append(_of_sample(layout, stretch, k, acting))
        times.append(np.nan)
        rows.append(np.full((len(names), 4), np.nan))
    values = np.array(rows[:-1])
    return np.array(times[:-1]), {name: values[:, j] for j, name in enumerate(names)}


def _of_sample(layout, stretch, k, acting):
    """(joints, 4) at kept sample k of a stretch."""
    sample = sample_of(layout, stretch, k)
    acting.complete(sample, stretch)
    efforts = {**sample.joint_efforts}
    found = sample.force_efforts.items() if layout.joint_forces.names else ()
    for joint, effort in [*sample.drive_efforts.items(), *((layout.joint_forces.joints[f], e) for f, e in found)]:
        efforts[joint] = efforts.get(joint, 0.0) + effort
    moves = sample.joint_coordinates
    return np.array(
        [
            (*moves[name], effort, effort * moves[name][1])
            for name in layout.coordinates.names
            for effort in [efforts.get(name, np.nan)]
        ]
    )
