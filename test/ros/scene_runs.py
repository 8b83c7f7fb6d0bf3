# SPDX-License-Identifier: Apache-2.0
"""SceneRun of the node's own parts in this process, with its thread, topics, pacing and recorder, for the tests."""

from types import SimpleNamespace

from waiting import PATIENCE, wait_for

from liegroup_core import Simulation, load_scene
from liegroup_core.forces.commands import WRENCH, Command
from liegroup_sim_ros.node.parameters import RATES, TABLE, fitting_step
from liegroup_sim_ros.node.scene_run import SceneRun


def node_values(**parameters):
    """Parameters of a node, those that are not given as usual."""
    values = SimpleNamespace(**{entry.name: entry.usual for entry in TABLE} | parameters, qos=[])
    values.record = str(values.record)
    values.rates = {name: getattr(values, name) for name in RATES}
    return values


class Run:
    """Run of a simulation, or of a scene to an accuracy, that a `with` block starts and closes.

    before : paused Run that this one replaces
    """

    def __init__(self, ros_node, simulation, before=None, **parameters):
        values = node_values(**parameters)
        if not isinstance(simulation, Simulation):
            scene = load_scene(simulation)
            step = fitting_step(values)
            simulation = Simulation(scene, step=step, accuracy=values.accuracy, horizon=values.accuracy_horizon)
        self.simulation = simulation
        self._run = SceneRun(ros_node, values, simulation, before and before._run, values.start_paused)
        self.server, self.outputs = self._run.server, self._run.outputs

    def __enter__(self):
        self._run.start()
        return self

    def __exit__(self, *_):
        self._run.close()

    def call(self, *command):
        """Result of a command of the server."""
        return self.server.call(*command).result(PATIENCE)

    def push(self, body, wrench, duration=0.05, source="test", axes="body", ahead=0.0, point=None):
        """Apply a wrench, from now on or `ahead` of the present stamp by a time in s."""
        start = self.server.stamp_ns + round(ahead * 1e9) if ahead else None
        self.server.push([Command(WRENCH, body, tuple(map(float, wrench)), start, None, source, axes, point)], duration)

    def until(self, condition, what="what was waited for"):
        """Wait until condition() is true."""
        wait_for(lambda: condition() or not self.server.is_alive(), what)
        assert self.server.failure is None, self.server.failure

    def pass_time(self, seconds):
        """Wait for simulated time in s."""
        end = self.server.stamp_ns + seconds * 1e9
        self.until(lambda: self.server.stamp_ns >= end, f"{seconds} s of simulated time")
