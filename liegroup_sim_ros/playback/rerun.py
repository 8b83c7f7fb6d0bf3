# SPDX-License-Identifier: Apache-2.0
"""Simulation that repeats parts of a recording, from a recorded state and with the recorded inputs."""

import numpy as np

from liegroup_core import Simulation, SimulationError
from liegroup_core.accuracy import METHOD
from liegroup_core.errors import LieGroupSimError
from liegroup_core.forces.commands import MOTION, TARGET, Command
from liegroup_core.forces.instants import NS
from liegroup_core.mechanism.body_model import initial_state as state_of_scene
from liegroup_core.methods.table import METHODS
from liegroup_core.settings import OF_ENGINE
from liegroup_sim_ros.recording.attachments import restore
from liegroup_sim_ros.recording.read import RecordingError

# Limit on the number of steps, for damaged files; a step takes at least about 1 us.
MOST_STEPS = 10**9
# Steps between two checks of the limit: where a step may take 1e5 substeps, and where it is one.
AT_ONCE, ALIKE_AT_ONCE = 8, 1000


MISMATCH = {TARGET: "servo targets do not match the servos", MOTION: "motions do not match the driven joints"}


class ReplayError(LieGroupSimError):
    """The run cannot be repeated like this; one line of text, exit code 2."""


class WorkLimit:
    """Limit of the work of repeated simulations, because damaged files may require any amount.

    most : steps, or attempted substeps of steps with error control
    """

    def __init__(self, most=MOST_STEPS):
        self._most = self._left = most

    def advance(self, simulation, steps):
        """Call the `advance` of a simulation. Raises SimulationError, also beyond the limit."""
        if steps > self._left:
            self._end()
        is_one = not (METHODS[simulation.method].controlled or simulation.layout.switches)
        while steps > 0:
            some = min(steps, ALIKE_AT_ONCE if is_one else AT_ONCE)
            before = simulation.substeps[1]
            simulation.advance(some)
            steps -= some
            self._left -= max(some, simulation.substeps[1] - before)
            if self._left < 0:
                self._end()

    def _end(self):
        self._left = -1
        raise SimulationError(f"needs more than {self._most:.7g} steps, with their substeps")


def make_simulation(scene, settings, quiet=True, **other):
    """Simulation with the settings of a recording; other : settings that replace recorded ones.

    With a method it has no error estimate, unless `other` requests one.
    quiet : True: log no warnings
    Raises ValueError, one line, for settings that this version cannot simulate.
    """
    options, promise = settings.get("options") or {}, settings.get("promise")
    if other.get("method") == settings["method"]:
        del other["method"]  # the recorded accuracy stays
    older = {"stabilisation": "none", "baumgarte_time": None} | settings
    chosen = {name: older[name] for name in OF_ENGINE}
    if "method" in other:  # without options of the recorded method
        return Simulation(scene, quiet=quiet, **(chosen | {"estimate": False} | other))
    if promise and settings["method"] == METHOD:
        chosen |= {name: promise[name] for name in ("accuracy", "horizon")}
        options = {name: options[name] for name in options.keys() - {"rtol", "atol"}}
    else:
        chosen |= {"method": settings["method"], "estimate": False}
    return Simulation(scene, quiet=quiet, **(chosen | options | other))


class Rerun:
    """Repetition of the stretches of a recording, see motion.Stretch.

    simulation : Simulation with the recorded settings, or with other settings to measure their effect
    ratio      : number of its steps per recorded step
    work       : limit of its steps, see WorkLimit
    """

    def __init__(self, recording, simulation, work=None):
        self.simulation = simulation
        self._joints = {TARGET: simulation.layout.servos, MOTION: simulation.layout.motions}
        self._work = work or WorkLimit()
        self._starts = Starts(recording, simulation.layout)
        self._recorded = recording.initial_state
        self._same_method = all(
            recording.settings.get(key) == getattr(simulation, key) for key in ("method", "group", "step")
        )
        self.ratio = recording.settings["step"] / simulation.step

    def begin(self, stretch, checkpoint=None):
        """Set the state at the first step of a Stretch, or at a checkpoint in it.

        checkpoint : entries of the checkpoint. Raises ReplayError
        """
        simulation = self.simulation
        for kind, (_, _, values) in stretch.changes.items():
            if values.size and values.shape[1] != len(self._joints[kind]):
                raise ReplayError(f"its {MISMATCH[kind]} of its scene")
        recorded = checkpoint or (self._recorded if stretch.is_first else stretch.state)
        try:
            start = (recorded["steps"] if checkpoint else stretch.start) * self.ratio
            if start != round(start):
                raise ReplayError(f"the start of the recording is not a whole number of steps of {simulation.step:g} s")
            pose, twist, angles = self._starts.of(stretch)
            entries = {"pose": pose, "twist": twist, "angles": angles}
            entries = (recorded or {}) | ({} if checkpoint else entries) | {"steps": round(start)}
            restore(simulation, entries, self._same_method)
        except (ValueError, KeyError, TypeError, OverflowError) as error:
            raise ReplayError(f"invalid initial state in the recording: {error}") from None
        # What was commanded up to a checkpoint is in its state, if that has commands.
        since = simulation.time if checkpoint and "state" in checkpoint else -np.inf
        self._stretch = stretch
        self._next = stretch.inherited + self._number(self._given, since)
        self._next_of = {kind: self._number(times, since) for kind, (_, times, _) in stretch.changes.items()}
        # A change of the accuracy at the stamp of a checkpoint comes after it.
        self._accuracies = [
            (step, accuracy)
            for recorded_step, accuracy in stretch.accuracies
            if simulation.promise and (step := round(recorded_step * self.ratio)) >= start
        ]

    def advance_to(self, step, beyond=False):
        """Advance to a step with the recorded wrenches. Raises SimulationError.

        beyond : True: a change of the accuracy at this step acts, too, as it does on states after it
        """
        simulation = self.simulation
        while self._accuracies and self._accuracies[0][0] < step + beyond:
            at, accuracy = self._accuracies.pop(0)
            self._go(at)
            simulation.set_accuracy(accuracy)
        self._go(step)

    def _go(self, step):
        self.apply_changes(step * self.simulation.step)
        # For zero steps WorkLimit makes no call: it would restart a method whose memory depends on wrenches.
        self._work.advance(self.simulation, step - self.simulation.steps)

    def apply_changes(self, until):
        """Give the recorded commands up to a time in s, and the targets and motions that act up to then."""
        stretch, inputs = self._stretch, self._stretch.inputs
        upto = stretch.inherited + int(np.searchsorted(self._given, until, "right"))
        for k in range(self._next, upto):
            inputs[k].repeat(self.simulation)
        self._next = max(self._next, upto)
        for kind, (_, times, values) in stretch.changes.items():
            upto = int(np.searchsorted(times, until, "right"))
            for k in range(self._next_of[kind], upto):
                for joint, row in zip(self._joints[kind], values[k].tolist()):
                    if np.isfinite(row[0]):
                        Command(kind, joint, tuple(row), round(float(times[k]) * NS)).repeat(self.simulation)
            self._next_of[kind] = max(self._next_of[kind], upto)

    @property
    def _given(self):
        """(m,) s since step 0 at which the commands of the stretch were given, without inherited ones."""
        inputs = self._stretch.inputs
        return (inputs.stamp_ns[self._stretch.inherited :] - inputs.base_ns) * 1e-9

    @staticmethod
    def _number(times, since):
        return int(np.searchsorted(times, since, "left"))


class Starts:
    """Initial states of stretches: from the file, from an event, or from the scene after a reset.

    `of(stretch)` is pose (n, 12), twist (n, 6) of the frames at the centres of mass, and angles
    (t,) of the torsional springs or None. Raises RecordingError.
    """

    def __init__(self, recording, layout):
        self._recording = recording
        self._first = self._later = initial_state(recording)
        if recording.initial_state.get("steps"):
            self._later = *state_of_scene(layout.centred), None

    def of(self, stretch):
        if stretch.state is not None:
            return _arrays(self._recording, stretch.state)
        return self._first if stretch.is_first else self._later


def initial_state(recording):
    """Pose (n, 12), twist (n, 6) and angles of torsional springs (or None) at the start.

    Raises RecordingError.
    """
    return _arrays(recording, recording.initial_state)


def _arrays(recording, state):
    """Pose, twist and angles of the entries of a state, see `initial_state`."""
    n = len(recording.bodies)
    try:
        pose = np.array(state["pose"], dtype=float).reshape(n, 12)
        twist = np.array(state["twist"], dtype=float).reshape(n, 6)
        angles = state.get("angles")
        if angles is not None:
            angles = np.array(angles, dtype=float).reshape(-1)
        if not all(np.isfinite(part).all() for part in (pose, twist, angles) if part is not None):
            raise ValueError
    except (KeyError, TypeError, ValueError, OverflowError):
        raise RecordingError(
            f"{recording.path}: its initial state must have 12 and 6 numbers for each of {n} bodies"
        ) from None
    return pose, twist, angles
