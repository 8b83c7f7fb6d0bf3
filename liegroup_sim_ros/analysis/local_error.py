# SPDX-License-Identifier: Apache-2.0
"""Error of a single step by step halving, and the observed order of convergence.

Starting from states of the recording, one step h is compared with two steps h/2. For a method of order
p, the difference is 1 - 2^-p times the error of the step. Over LENGTH steps, the differences between
successive runs at 4 h, 2 h, h, h/2 and h/4 decrease by a factor 2^p each, down to round-off.
Source: Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, II.4.
"""

import numpy as np

from liegroup_core import SimulationError
from liegroup_core.engine import BAUMGARTE_STEPS
from liegroup_core.methods.table import METHODS
from liegroup_sim_ros.playback.rerun import WorkLimit, make_simulation

WINDOWS = 8  # states of the recording at which the error is estimated
LENGTH = 16  # steps
RUNGS = (4.0, 2.0, 1.0, 0.5, 0.25)  # step sizes, relative to the recorded step
MOST_STEPS = 500_000  # steps, or substeps, of all runs together
# Smaller differences count as round-off of LENGTH / 0.25 steps, each with a few units of 2^-53.
FLOOR = 500 * np.finfo(float).eps


def local_error(scene, recording, motion, layout):
    """Figures of the error of one step and of the observed order. Raises ValueError."""
    settings = recording.settings
    size = layout.size
    more = {}
    if settings.get("stabilisation") == "baumgarte" and settings.get("baumgarte_time") is None:
        more["baumgarte_time"] = BAUMGARTE_STEPS * settings["step"]

    def made(rungs):
        return {rung: make_simulation(scene, settings, step=rung * settings["step"], **more) for rung in rungs}

    simulations, work = made((1.0, 0.5)), WorkLimit(MOST_STEPS)
    method = METHODS[settings["method"]]
    if not method.controlled:  # tolerances have no order
        simulations |= made(RUNGS)
    largest, orders, windows, failure = np.zeros(2), [], 0, None
    for stretch, row in _windows(motion):
        try:
            one, two = (_advance(work, simulations[rung], stretch, row, 1) for rung in (1.0, 0.5))
            apart = _apart(one, two)
        except SimulationError as error:
            failure = str(error)
            continue
        largest = np.maximum(largest, apart)
        windows += 1
        order = None if method.controlled else _order(work, simulations, stretch, row, size)
        if order is not None:
            orders.append(order)
    share = 1.0 - 0.5**method.order
    remark = None
    if method.controlled:
        remark = "its error depends on the tolerances, not on the step"
    elif not windows:
        remark = failure
    elif not orders:
        remark = "differences are at round-off, or not yet proportional to a power of the step"
    elif largest.max() < FLOOR:
        remark = "at round-off"
    return {
        "windows": windows,
        "position_m": float(largest[0] / share) if windows else None,
        "angle_rad": float(largest[1] / share) if windows else None,
        "order": float(np.median(orders)) if orders else None,
        "order_expected": method.order,
        "remark": remark,
    }


def _windows(motion):
    """Yield (stretch, row of a kept sample) for samples evenly distributed over the recording."""
    counts = [len(stretch.steps) for stretch in motion.stretches]
    starts = np.concatenate([[0], np.cumsum(counts)])
    for k in np.unique(np.linspace(0, starts[-1] - 1, WINDOWS).astype(int)).tolist():
        number = int(np.searchsorted(starts, k, "right")) - 1
        yield motion.stretches[number], k - int(starts[number])


def _advance(work, simulation, stretch, row, length):
    """State (pose, twist) after `length` recorded steps from a sample, with constant inputs.

    The start time, which the scene's applied wrenches depend on, is rounded to a multiple of the step.
    """
    rung, step = simulation.step / stretch.step, round(stretch.steps[row])
    n = len(stretch.bodies)
    pose = np.concatenate([stretch.rotation[row].reshape(n, 9), stretch.position[row]], axis=1)
    angles = stretch.angles[row] if stretch.angles.shape[1] else None
    modes = stretch.modes_at(step)
    simulation.set_state(
        *simulation.layout.offsets.to_centres(pose, stretch.twist[row]),
        round(step / rung),
        angles,
        None if modes is None else modes[:, 3],
    )
    for command in stretch.acting_at(step):
        command._replace(start_ns=0, end_ns=None).repeat(simulation)
    work.advance(simulation, max(1, round(length / rung)))
    return simulation.state()


def _apart(one, other):
    """Largest distance in position (m) and attitude (rad) between two states."""
    turn = np.einsum("nji,njk->nik", one[0][:, :9].reshape(-1, 3, 3), other[0][:, :9].reshape(-1, 3, 3))
    # For a small angle, the sine is free of cancellation; 1 - cosine is not.
    sine = 0.5 * np.stack(
        [turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]], axis=1
    )
    cosine = 0.5 * (np.trace(turn, axis1=1, axis2=2) - 1.0)
    angle = np.arctan2(np.linalg.norm(sine, axis=1), cosine)
    return np.array([np.linalg.norm(one[0][:, 9:] - other[0][:, 9:], axis=1).max(), angle.max()])


def _order(work, simulations, stretch, row, size):
    """Observed order at a sample, from the finest steps with differences above round-off; None if there are none."""
    states = []
    for rung in RUNGS:
        try:
            states.append(_advance(work, simulations[rung], stretch, row, LENGTH))
        except SimulationError:
            states.append(None)
    gaps = [
        None if one is None or two is None else max(_apart(one, two) / (size, 1.0))
        for one, two in zip(states, states[1:])
    ]
    for coarse, fine in zip(gaps[-2::-1], gaps[:0:-1]):
        if coarse is not None and fine is not None and fine > FLOOR and coarse > fine:
            return float(np.log2(coarse / fine))
    return None
