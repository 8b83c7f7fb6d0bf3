# SPDX-License-Identifier: Apache-2.0
"""Repetition of a recorded run from its initial state and wrenches, compared bit for bit."""

import numpy as np
from scipy.spatial.transform import Rotation

from liegroup_core import Simulation, SimulationError
from liegroup_core.accuracy import METHOD
from liegroup_core.errors import LieGroupSimError
from liegroup_core.model.build import initial_state as state_of_scene
from liegroup_core.observables.along import quaternions
from liegroup_core.reference import Trajectory, distance
from liegroup_sim_ros.recording.attachments import restore
from liegroup_sim_ros.recording.read import RecordingError

# Limit on the number of steps, for damaged files; a step takes at least about 1 us.
MOST_STEPS = 10**9
# Tolerance, in steps, when samples are matched to whole steps of another step size.
ROUNDING = 1e-6


class ReplayError(LieGroupSimError):
    """The run cannot be repeated like this; one line of text, exit code 2."""


def make_simulation(scene, settings, **other):
    """Simulation with the settings of a recording; other : settings that replace recorded ones.

    With a method it carries no estimate of the error, unless `other` says so.
    Raises ValueError, one line, for settings that this version cannot simulate.
    """
    options, promise = settings.get("options") or {}, settings.get("promise")
    if other.get("method") == settings["method"]:
        del other["method"]  # the recorded accuracy stays
    chosen = {
        "step": settings["step"],
        "group": settings["group"],
        "stabilisation": settings.get("stabilisation") or "none",
        "baumgarte_time": settings.get("baumgarte_time"),
    }
    if "method" in other:  # without options of the recorded method
        return Simulation(scene, quiet=True, **(chosen | {"estimate": False} | other))
    if promise and settings["method"] == METHOD:
        chosen |= {name: promise[name] for name in ("accuracy", "horizon")}
        options = {name: options[name] for name in options.keys() - {"rtol", "atol"}}
    else:
        chosen |= {"method": settings["method"], "estimate": False}
    return Simulation(scene, quiet=True, **(chosen | options | other))


class Repeat:
    """Repetition of a recorded simulation that compares every number of every sample.

    simulation : Simulation with the recorded settings, or with other settings to measure their effect
    """

    def __init__(self, recording, simulation):
        self._simulation = simulation
        self._starts = Starts(recording, simulation.layout)
        self._recorded = recording.initial_state
        self._same_method = all(
            recording.settings.get(key) == getattr(simulation, key)
            for key in ("method", "group", "step")
        )
        self._ratio = recording.settings["step"] / simulation.step
        self._stretch = None
        self._steps = self._samples = self._identical = 0
        self._first, self._stopped = None, None
        self._largest = np.zeros(4)  # m, rad, rad/s, m/s

    def add(self, block):
        """Simulate and compare the samples of a Block."""
        if block.stretch is not self._stretch:
            self._begin(block.stretch)
        self._samples += len(block.steps)
        if self._broken:
            return
        pose, twist = self._states(block)
        k = len(pose)
        offsets = self._simulation.layout.offsets
        if not offsets.none:  # sample by sample, as in the recorded run: same round-off
            for row in range(k):
                pose[row], twist[row] = offsets.to_bodies(pose[row], twist[row])
        quaternion = quaternions(pose)
        same = (
            _same(quaternion, block.quaternion[:k])
            & _same(pose[..., 9:], block.position[:k])
            & _same(twist, block.twist[:k])
        )
        identical = same.all(axis=1)
        self._identical += int(identical.sum())
        if identical.all():
            return
        if self._first is None:
            row = int(np.argmin(identical))
            self._first = {
                "at_s": float(block.log_times[row]),
                "body": block.stretch.bodies[int(np.argmin(same[row]))],
            }
        rotation = Rotation.from_quat(quaternion.reshape(-1, 4)).as_matrix()
        apart = distance(
            Trajectory(None, rotation.reshape(k, -1, 3, 3), pose[..., 9:], twist),
            Trajectory(None, block.rotation[:k], block.position[:k], block.twist[:k]),
        )
        self._largest = np.maximum(
            self._largest,
            [part.max() for part in (apart.position, apart.angle, apart.angular, apart.linear)],
        )

    def _begin(self, stretch):
        self._stretch, self._broken, self._next, self._next_target = stretch, False, 0, 0
        if stretch.targets.size and stretch.targets.shape[1] != len(self._simulation.layout.servos):
            raise ReplayError("its servo targets are not those of the servos of its scene")
        self._accuracies = [
            (round(step * self._ratio), accuracy)
            for step, accuracy in stretch.accuracies
            if self._simulation.promise
        ]
        start = stretch.start * self._ratio
        if start != round(start):
            raise ReplayError(
                "the start of the recording is not a whole number of steps of "
                f"{self._simulation.step:g} s"
            )
        try:
            recorded = self._recorded if stretch.is_first else stretch.state
            if recorded and "memory" in recorded and self._same_method:
                restore(self._simulation, recorded)
            else:
                pose, twist, angles = self._starts.of(stretch)
                self._simulation.set_state(pose, twist, round(start), angles)
        except (ValueError, KeyError, TypeError, OverflowError) as error:
            raise ReplayError(f"invalid initial state in the recording: {error}") from None

    def _states(self, block):
        """States of the simulation at the samples of a block, (k, n, 12) and (k, n, 6)."""
        simulation, stretch = self._simulation, block.stretch
        exact_steps = block.steps * self._ratio
        steps = np.rint(exact_steps).astype(np.int64)
        if np.abs(exact_steps - steps).max() > ROUNDING * max(1.0, self._ratio):
            raise ReplayError(
                f"the samples do not lie on steps of {simulation.step:g} s: their "
                "period must be a whole number of steps"
            )
        n = len(stretch.bodies)
        pose, twist = np.empty((len(steps), n, 12)), np.empty((len(steps), n, 6))
        done = 0
        try:
            for step in steps.tolist():
                self._steps += step - simulation.steps
                if self._steps > MOST_STEPS:
                    raise SimulationError(f"needs more than {MOST_STEPS} steps")
                self._change_accuracy(step)
                self._apply_changes(step * simulation.step)
                # Never advance by zero steps: that restarts a method whose memory depends on the
                # wrenches.
                if step > simulation.steps:
                    simulation.advance(step - simulation.steps)
                pose[done], twist[done] = simulation.state()
                done += 1
        except SimulationError as error:
            self._stopped = self._stopped or str(error)
            self._broken = True
        return pose[:done], twist[:done]

    def _change_accuracy(self, until):
        """Advance to recorded changes of the accuracy up to a step, and repeat them."""
        while self._accuracies and self._accuracies[0][0] < until:
            step, accuracy = self._accuracies.pop(0)
            self._apply_changes(step * self._simulation.step)
            if step > self._simulation.steps:
                self._simulation.advance(step - self._simulation.steps)
            self._simulation.set_accuracy(accuracy)

    def _apply_changes(self, until):
        """Apply the recorded changes of wrenches and of wanted values of servos up to a time."""
        stretch = self._stretch
        upto = int(np.searchsorted(stretch.change_times, until, "right"))
        for k in range(self._next, upto):
            axes = "world" if stretch.change_in_world[k] else "body"
            self._simulation.apply_wrench(
                stretch.bodies[stretch.change_bodies[k]],
                stretch.change_wrenches[k],
                float(stretch.change_times[k]),
                source=axes,
                axes=axes,
            )
        self._next = max(self._next, upto)
        upto = int(np.searchsorted(stretch.target_times, until, "right"))
        for time, targets in zip(
            stretch.target_times[self._next_target : upto].tolist(),
            stretch.targets[self._next_target : upto].tolist(),
        ):
            for joint, target in zip(self._simulation.layout.servos, targets):
                self._simulation.command_servo(joint, *target, time)
        self._next_target = max(self._next_target, upto)

    def figures(self):
        """Number of bit-identical samples, and the largest differences of the others."""
        return {
            "samples": self._samples,
            "identical": self._identical,
            "first_difference": self._first,
            "stopped": self._stopped,
            "largest_difference": dict(
                zip(
                    ("position_m", "angle_rad", "angular_rad_s", "linear_m_s"),
                    map(float, self._largest),
                )
            ),
        }


def _same(one, other):
    """(k, n) bool: whether all numbers of a body are bit-identical."""
    return (
        np.ascontiguousarray(one).view(np.int64) == np.ascontiguousarray(other).view(np.int64)
    ).all(axis=2)


class Starts:
    """Initial states of stretches: that of the file or of an event, or after a reset of the scene.

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
            f"{recording.path}: its initial state is not 12 and 6 numbers for each of {n} bodies"
        ) from None
    return pose, twist, angles
