# SPDX-License-Identifier: Apache-2.0
"""States between two samples of a recording, integrated from the first one with what acts there."""

import numpy as np

from liegroup_core import Simulation, SimulationError
from liegroup_core.accuracy import METHOD
from liegroup_core.methods.table import METHODS
from liegroup_sim_ros.playback.rerun import WorkLimit

PARTS = 64  # of a recorded step
COARSE, FINE = 4, 1  # of these parts apart: states of the first attempt, and of the second one
AT_END = 1e-9  # s: stamps are rounded to ns
MOST_STEPS = 2_000_000  # steps and substeps for a whole recording


class Between:
    """Integrates from samples on, with error control.

    The simulation is made when it is first needed.
    """

    def __init__(self, scene, settings):
        self._scene, self._settings = scene, settings
        self._simulation, self._work = None, WorkLimit(MOST_STEPS)

    def _made(self):
        settings = self._settings
        method = settings["method"] if METHODS[settings["method"]].controlled else METHOD
        group, step = settings["group"], settings["step"] / PARTS
        return Simulation(self._scene, method=method, group=group, step=step, estimate=False, quiet=True)

    def states(self, stretch, start, end, apart):
        """States inside an interval, without its ends: times, poses, twists, angles.

        None : it cannot be integrated, or an input changes in it
        start : (time in s, pose (n, 12), twist (n, 6), angles) of the body frames;  end : s
        apart : PARTS between two of the states
        """
        try:
            simulation = self._simulation = self._simulation or self._made()
            time, pose, twist, angles = start
            parts, step = PARTS / stretch.step, time / stretch.step
            commands, modes = list(stretch.acting_at(step)), stretch.modes_at(step)
            if commands != list(stretch.acting_at((end - AT_END) / stretch.step)):
                return None
            simulation.set_state(
                *simulation.layout.offsets.to_centres(pose, twist),
                round(time * parts),
                angles if len(angles) else None,
                None if modes is None else modes[:, 3],
            )
            for command in commands:
                command._replace(start_ns=0, end_ns=None).repeat(simulation)
            found = []
            for k in range(apart, round((end - time) * parts), apart):
                self._work.advance(simulation, apart)
                state = [part.copy() for part in simulation.here()[:3]]
                found.append((time + k / parts, *simulation.layout.offsets.to_bodies(*state[:2]), state[2]))
        except (SimulationError, ValueError, TypeError):
            return None
        return tuple(np.array(part) for part in zip(*found)) if found else None
