# SPDX-License-Identifier: Apache-2.0
"""Numbers of a scene, and derivatives by them: differences between scenes at the same state of their joints."""

import numpy as np

from liegroup_core.errors import SceneError, SimulationError
from liegroup_core.scene.assembly import assembled
from liegroup_core.scene.load import scene_as_written
from liegroup_core.scene.parameters import changed, parameters, path_of
from liegroup_core.simulation import Simulation

from .differences import ROUND_OFF
from .probe import Probe

CHANGE = 5e-4  # of a number, relative; of one that is zero, in SI units


class OtherStructure(SimulationError):
    """The change of a number gives the mechanism other joints of its tree, other rows, or other times of inputs.

    path : of the number
    """

    def __init__(self, path):
        super().__init__(f"{path} changes the structure of the mechanism")
        self.path = path


class Numbers:
    """Numbers of a scene.

    names  : as `liegroup_sim sweep --vary` takes them
    paths, values : of the q numbers
    scales : (q,) magnitudes of the values, 1 for zero
    Raises ParameterError for unknown names, SceneError for numbers without a value.
    """

    def __init__(self, scene, names):
        self.scene, self._written = scene, scene_as_written(scene.text, scene.source)
        if isinstance(names, str):
            raise SceneError(f"numbers must be a list of names, got the text {names!r}")
        self.paths, known = tuple(path_of(self._written, name) for name in names), parameters(self._written)
        if twice := [path for path in self.paths if self.paths.count(path) > 1]:
            raise SceneError(f"{twice[0]} is given twice")
        if missing := [path for path in self.paths if known[path] is None]:
            raise SceneError(f"the scene has no value of {missing[0]}: give it there")
        self.values = np.array([known[path] for path in self.paths], dtype=float)
        self.scales = np.where(self.values != 0.0, np.abs(self.values), 1.0)

    def __len__(self):
        return len(self.paths)

    def scene_at(self, values):
        """Scene with other values (q,). Raises SceneError."""
        scene = assembled(changed(self._written, dict(zip(self.paths, values))))
        scene._source = self.scene.source
        return scene

    def refused(self, k, error):
        """SceneError for a number that cannot be changed to both sides."""
        path, value = self.paths[k], self.values[k]
        return SceneError(f"{path} = {value:g} has no values on both sides, so that it has no derivative: {error}")

    def beside(self, k, s):
        """Scene with number k changed by s scales. Raises SceneError."""
        values = self.values.copy()
        values[k] += s * self.scales[k]
        return self.scene_at(values)


class Sides:
    """Derivatives by numbers of the scene of a run, at states of the run: differences between scenes.

    numbers  : Numbers
    run      : Simulation of their scene at its start
    settings : of the Simulations of the other scenes
    Derivatives are by value / scale. Raises OtherStructure, SceneError.
    """

    def __init__(self, numbers, run, settings):
        self._numbers, self._run, self._settings, self._sides = numbers, run, settings, {}
        self._own = Probe(run, in_space=True)
        for k in range(len(numbers)):
            self.at(k, CHANGE)

    def __len__(self):
        return len(self._numbers)

    def at(self, k, s):
        """(Simulation, Probe) of the scene with number k changed by s scales."""
        if (k, s) not in self._sides:
            try:
                other = Simulation(self._numbers.beside(k, s), quiet=True, **self._settings)
            except SceneError as error:
                raise self._numbers.refused(k, error) from None
            other.inputs.commands = self._run.inputs.commands
            probe = Probe(other, in_space=True)
            if not probe.has_structure_of(self._own) or _times(other.layout) != _times(self._run.layout):
                raise OtherStructure(self._numbers.paths[k])
            self._sides[k, s] = other, probe
        return self._sides[k, s]

    def at_start(self, outputs):
        """(q, p) derivatives of OutputChannels of the start states, and their errors."""
        return _derivatives(self._values(lambda other, _: outputs.of(other.sample())))

    def of_outputs(self, probe, outputs):
        """(q, p) derivatives of OutputChannels with the same state of the joints as a Probe, and their errors."""
        base = outputs.of(probe.neighbour())

        def values(_, near):
            near.follow(probe)
            own = type(outputs)(near, outputs.names, outputs.turns)
            return outputs.apart(own.of(near.neighbour()), base)

        return _derivatives(self._values(values))

    def of_equations(self, probe):
        """(q, f + 2 m) derivatives of the accelerations, the position residuals and J V, and their errors."""
        probe.closed()
        with probe.holding():
            return _derivatives(self._values(lambda _, near: near.equations(probe)))

    def _values(self, function):
        """(2, 2, q, p) values at changes of CHANGE, -CHANGE, and of twice as much."""
        found = [function(*self.at(k, step * CHANGE)) for step in (1, -1, 2, -2) for k in range(len(self))]
        return np.array(found).reshape(2, 2, len(self), -1)


def _derivatives(values):
    """Differences of order four, and their errors.

    If the terms of Taylor's series decrease like a geometric sequence, the error of order two is its ratio, and that of
    order four four times the square.
    """
    near, far = (values[:, 0] - values[:, 1]) / CHANGE
    found = near * (2.0 / 3.0) - far / 12.0
    last = np.abs(found - 0.5 * near)
    size = np.nan_to_num(np.abs(found)).max(axis=1, initial=0.0, keepdims=True) + np.finfo(float).tiny
    return found, last * np.minimum(4.0 * last / size, 1.0) + ROUND_OFF * np.abs(values[0, 0]) / CHANGE


def _times(layout):
    """Times at which inputs of a scene change."""
    wrenches = [(force.start, force.end) for force in layout.scene.forces if force.type == "applied_wrench"]
    return wrenches, [rows[:, 0].tolist() for rows in layout.motions.values()]
