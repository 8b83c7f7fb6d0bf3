# SPDX-License-Identifier: Apache-2.0
"""Motion in a recording: blocks of samples between two resets or states that were set.

Memory is bounded.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy

from liegroup_core.forces.commands import EFFORT, MOTION, TARGET, Command
from liegroup_sim_ros.messages import events

from .attachments import commands_in
from .errors import RecordingError
from .input_track import FOREVER, KINDS, InputTrack
from .tracks import ModeTrack

# Samples kept for plots: the limit for all bodies together, and the smallest limit per body.
KEPT, LEAST_KEPT = 40_000, 2000
LATEST = 2**62  # ns; larger stamps are invalid
ON_GRID = 1e-3  # periods by which stamps may be early: they are rounded to ns


class Changes(NamedTuple):
    """Values of joints from some times on: wanted ones of servos (position, velocity), or motions of driven joints."""

    joints: tuple  # in the order of the values; () without a layout
    times: np.ndarray  # (p,) s since step 0
    values: np.ndarray  # (p, joints, numbers)


@dataclass(eq=False)
class Stretch:
    """Section of a run that begins with its start, a reset or a state that was set; n bodies.

    steps, rotation, position, twist, errors and angles are those of k kept samples, evenly
    distributed.
    """

    begin_ns: int  # stamp of the event that begins it; for the first stretch base_ns
    base_ns: int  # stamp of step 0
    end_ns: float  # stamp of the event that ends it, or infinity
    step: float  # s
    bodies: tuple  # names
    is_first: bool  # begins with the file
    start: int  # number of its first step
    state: dict | None  # state that was set, see attachments.state; None: that of the file or the scene
    inputs: InputTrack  # wrenches and efforts, those that act in its first state before the others
    inherited: int  # number of these in its first state
    efforts_on: dict  # {joint: names of the bodies on which an effort acts}
    joint_modes: ModeTrack | None  # of the whole recording
    changes: dict  # {TARGET: Changes of all servos, MOTION: Changes of all driven joints}
    accuracies: list  # [(step, accuracy)] from which on another accuracy holds
    inaccurate_from: float  # s since step 0, up to which the requested accuracy was kept; inf: always
    samples: int = 0  # number of all samples
    first_step: int = 0  # of a sample
    last_step: int = 0
    kept: list = field(default_factory=list, repr=False)

    def __getattr__(self, name):
        if name not in _KEPT:
            raise AttributeError(name)
        parts = [getattr(part, name) for part in self.kept]
        whole = None if parts[0] is None else np.concatenate(parts)
        self.__dict__.update({name: whole})
        return self.__dict__[name]

    @property
    def times(self):
        """(k,) s since step 0."""
        return self.steps * self.step

    @property
    def log_times(self):
        """(k,) s of the recording."""
        return self.base_ns * 1e-9 + self.times

    def seconds_of(self, times_ns):
        """[s] of times in ns since step 0, computed as those of samples if they are at a step; FOREVER is infinity."""
        seconds = self.in_steps(times_ns * 1e-9) * self.step
        return np.where(times_ns == FOREVER, np.inf, seconds).tolist()

    def in_steps(self, times):
        """Times in s since step 0 in steps; whole numbers within the rounding of stamps to ns."""
        steps = times / self.step
        whole = np.rint(steps)
        return np.where(np.abs(steps - whole) * self.step <= 0.6e-9, whole, steps)

    @property
    def seconds(self):
        """Time from the first to the last sample, s."""
        return (self.last_step - self.first_step) * self.step

    def pushes_on(self, body):
        """(p, 2) first and end step of the intervals in which a wrench or an effort acts on a body.

        They end with the stretch; that of the last stretch may be infinite. Steps have a fraction where a wrench
        starts or ends inside a step.
        """
        return self._intervals(
            [
                k
                for k, (kind, name) in enumerate(self._pushing)
                if body in (self.efforts_on.get(name, ()) if kind == EFFORT else (name,))
            ]
        )

    def _intervals(self, mine):
        """(p, 2) first and end step of the intervals in which any of the spans with these numbers acts."""
        start, end, _ = self._spans
        start, end = self.in_steps(start[mine] * 1e-9), self.in_steps(end[mine] * 1e-9)
        end[self._spans[1][mine] == FOREVER] = np.inf
        begun, over = self.start, np.inf
        if self.end_ns < np.inf:
            over = self.in_steps((self.end_ns - self.base_ns) * 1e-9)
        start, end = np.maximum(start, begun), np.minimum(end, over)
        start, end = start[start < end], end[start < end]
        if not len(start):
            return np.empty((0, 2))
        reached = np.maximum.accumulate(end)
        first = np.concatenate([[True], start[1:] > reached[:-1]])  # spans that do not meet an earlier one
        last = np.concatenate([first[1:], [True]])
        return np.column_stack([start[first], reached[last]])

    def acting_at(self, step):
        """[Command] of what acts at a step: wrenches, efforts, targets of servos and motions."""
        start, end, numbers = self._spans
        time = step * self.step
        found = [self.inputs[k] for k in numbers[(start * 1e-9 <= time) & (time < end * 1e-9)].tolist()]
        for kind, (joints, times, values) in self.changes.items():
            known = np.flatnonzero(self.in_steps(times) <= step)
            if len(known):
                rows = zip(joints, values[known[-1]].tolist())
                found += [Command(kind, joint, tuple(row), 0) for joint, row in rows if np.isfinite(row[0])]
        return found

    def modes_at(self, step):
        """(k, 5) as Sample.switching; None without joints with stops or friction, or before the first message."""
        stamp = self.base_ns + round(step * self.step * 1e9)
        return None if self.joint_modes is None else self.joint_modes.switching(stamp)

    @cached_property
    def _spans(self):
        return self.inputs.spans()

    @cached_property
    def _pushing(self):
        """[(kind, name of a body or joint)] of the spans."""
        return self.inputs.names(self._spans[2])

    @property
    def pushed(self):
        """[(first step, end step, kind, name)] intervals with a wrench on a body or an effort at a joint, by time."""
        numbers = {}
        for k, each in enumerate(self._pushing):
            numbers.setdefault(each, []).append(k)
        return sorted((*pair, *each) for each, mine in numbers.items() for pair in self._intervals(mine).tolist())

    def free(self, bodies):
        """(m, 2) first and last step of intervals in which no wrench acts on any of the bodies.

        The state at the step where a wrench begins is not yet affected by it; the state at the step
        where it ends is the first of the next interval.
        """
        pushes = np.concatenate([self.pushes_on(body) for body in bodies])
        pushes = pushes[np.argsort(pushes[:, 0], kind="stable")]
        since = np.maximum.accumulate(np.concatenate([[-1.0], pushes[:, 1]]))
        intervals = np.column_stack([since, np.append(pushes[:, 0], np.inf)])
        return intervals[intervals[:, 1] > intervals[:, 0]]

    def free_seconds(self, bodies):
        """Time between the first and last sample without a wrench on any of the bodies, s."""
        inside = np.clip(self.free(bodies), self.first_step, self.last_step)
        return float((inside[:, 1] - inside[:, 0]).sum() * self.step)


class Block(NamedTuple):
    """k successive samples of one stretch, all with finite numbers; n bodies."""

    stretch: Stretch
    steps: np.ndarray  # (k,) step number of each sample, with a fraction between steps
    rotation: np.ndarray  # (k, n, 3, 3) body -> world
    position: np.ndarray  # (k, n, 3) m, world
    quaternion: np.ndarray  # (k, n, 4) as recorded
    twist: np.ndarray  # (k, n, 6) rad/s, m/s; body axes
    errors: np.ndarray | None  # (k, n, 4) estimated; NaN: unknown, None: no estimate
    laws: np.ndarray | None = None  # (k, s, 1) states of laws; None: there are none

    @property
    def times(self):
        """(k,) s since step 0."""
        return self.steps * self.stretch.step

    @property
    def log_times(self):
        """(k,) s of the recording."""
        return self.stretch.base_ns * 1e-9 + self.times

    @property
    def pose(self):
        """(k, n, 12) in the layout of the core."""
        k, n = self.position.shape[:2]
        return np.concatenate([self.rotation.reshape(k, n, 9), self.position], axis=2)


class _Kept(NamedTuple):
    steps: np.ndarray
    rotation: np.ndarray
    position: np.ndarray
    twist: np.ndarray
    errors: np.ndarray | None  # (k, n, 4)
    angles: np.ndarray  # (k, t) rad, of the torsional springs


_KEPT = _Kept._fields


class RecordedMotion:
    """All stretches of a recording, and the samples missing in it; `blocks` reads it once.

    layout : Layout of the scene, which knows the joints of inputs; None: they are not looked at

    all              : all stretches, without samples
    stretches        : stretches with samples, as far as they are read
    samples          : number of complete samples: pose and twist of all bodies
    missing          : number of samples missing between the first and the last one
    gaps, largest_gap_s, largest_gap_at_s : intervals with missing samples
    not_finite, first_not_finite : omitted samples with NaN, infinity or a zero quaternion; s of
                       the recording
    """

    def __init__(self, recording, layout=None):
        self._recording = recording
        self._efforts_on, joints = {}, ((), ())
        if layout is not None:
            joints = tuple(layout.servos), tuple(layout.motions)
            units = layout.unit_efforts.items()
            self._efforts_on = {joint: [layout.body_names[i] for i, _ in on] for joint, on in units}
        targets, motions = recording.servo_targets, recording.motions
        self._values = [  # (kind, joints, track, its values)
            (TARGET, joints[0], targets, targets and np.stack([targets.position, targets.velocity], axis=2)),
            (MOTION, joints[1], motions, motions and motions.motion),
        ]
        self.stretches = []
        self.samples = self.missing = self.gaps = self.not_finite = 0
        self.first_not_finite = None
        self.largest_gap_s, self.largest_gap_at_s = 0.0, None
        settings, state = recording.settings, recording.initial_state
        step = settings.get("step")
        topic = settings["topics"]["pose"][recording.bodies[0]] if recording.bodies else None
        self.expected = recording.topics.get(topic, 0)
        n = max(1, len(recording.bodies))
        self.every = max(1, -(-self.expected // max(LEAST_KEPT, KEPT // n)))
        start = state.get("steps", 0)
        stamp = state.get("stamp_ns", 0)
        if not all(isinstance(value, int) and abs(value) < LATEST for value in (start, stamp)):
            raise RecordingError(f"{recording.path}: its initial state has no valid step and stamp")
        # A part continues a run: its first stamp is later than that of step 0.
        starts = [(stamp - round(start * step * 1e9), start, None)]
        for event in recording.events:
            if event.name == "reset":
                starts.append((event.stamp_ns, 0, None))
            elif event.name == "state":
                state = self._state(event.text)
                starts.append((event.stamp_ns, state["steps"], state))
        begins = [begin for begin, _, _ in starts]
        if any(b <= a for a, b in zip(begins, begins[1:])):
            raise RecordingError(f"{recording.path}: the stamps of its resets do not increase")
        self.all = [
            self._stretch(*each, end, step, k == 0) for k, (each, end) in enumerate(zip(starts, [*begins[1:], np.inf]))
        ]
        self.first = self.all[0]
        self._begins = np.array(begins, dtype=np.int64)

    def _state(self, text):
        """State in the text of an event. Raises RecordingError."""
        try:
            state = events.state_of(text)
            if not (isinstance(state["steps"], int) and 0 <= state["steps"] < LATEST):
                raise ValueError
        except (ValueError, KeyError, RecursionError):
            raise RecordingError(f"{self._recording.path}: an event state has no valid state: {text!r:.60}") from None
        return state

    def _stretch(self, begin, start, state, end, step, is_first):
        base = begin if is_first else begin - round(start * step * 1e9)
        before = self._commands_in(self._recording.initial_state if is_first else state)
        inputs = self._recording.inputs.between(begin, end, base, before)
        return Stretch(
            begin,
            base,
            end,
            step,
            self._recording.bodies,
            is_first,
            start,
            state,
            inputs,
            len(before),
            self._efforts_on,
            self._recording.joint_modes,
            self._changes(begin, base, end),
            *self._accuracies(begin, base, end, step),
        )

    def _commands_in(self, state):
        """Wrenches and efforts that act or wait in the entries of a state. Raises RecordingError."""
        try:
            commands = commands_in(state).as_they_end
        except ValueError as error:
            raise RecordingError(f"{self._recording.path}: {error}") from None
        return [c for part in commands for c in part if c.kind in KINDS]

    def _changes(self, begin, base, end):
        """{kind: Changes} between two stamps."""
        found = {}
        for kind, joints, track, values in self._values:
            found[kind] = Changes(joints, np.empty(0), np.empty((0, 0, 0)))
            if track is not None:
                inside = (track.stamp_ns >= begin) & (track.stamp_ns < end)
                found[kind] = Changes(joints, (track.stamp_ns[inside] - base) * 1e-9, values[inside])
        return found

    def _accuracies(self, begin, base, end, step):
        """Changes of the accuracy, and the first time in s at which it was not kept, or changed without a request."""
        changes, ended, changed = [], np.inf, -np.inf
        for event in self._recording.events:
            if not begin <= event.stamp_ns < end:
                continue
            since = (event.stamp_ns - base) * 1e-9
            if event.name not in ("accuracy", "inaccurate"):
                continue
            try:
                number = events.number(event.text)
            except ValueError:
                raise RecordingError(
                    f"{self._recording.path}: an event {event.name} does not begin with a number: {event.text!r}"
                ) from None
            if event.name == "accuracy":
                changes.append((round(since / step), number))
                number, changed = np.inf if events.is_requested(event.text) else since, since
            ended = min(ended, max(number, changed))  # earlier versions gave a time before the change
        return changes, ended

    def blocks(self, angles=None):
        """Generator of Blocks. Raises RecordingError if settings contradict the messages.

        angles : function Block -> (k, t) numbers to keep with the samples
        """
        since = None  # index of the next kept sample
        for samples in self._recording.samples():
            if abs(int(samples.stamp_ns[0])) > LATEST or abs(int(samples.stamp_ns[-1])) > LATEST:
                raise RecordingError(f"{self._recording.path}: its stamps are out of range")
            number = np.searchsorted(self._begins, samples.stamp_ns, "right") - 1
            edges = [0, *(np.flatnonzero(np.diff(number)) + 1).tolist(), len(number)]
            for a, b in zip(edges, edges[1:]):
                if number[a] < 0:
                    continue
                block = self._block(self.all[number[a]], samples, slice(a, b))
                if block is None:
                    continue
                since = since or 0
                values = angles(block) if angles else np.empty((len(block.steps), 0))
                pick = slice(since % self.every, None, self.every)
                since = (since - len(block.steps)) % self.every
                if len(block.steps[pick]):
                    block.stretch.kept.append(
                        _Kept(
                            *(
                                part if part is None else part[pick].copy()
                                for part in (
                                    block.steps,
                                    block.rotation,
                                    block.position,
                                    block.twist,
                                    block.errors,
                                    values,
                                )
                            )
                        )
                    )
                yield block
        if not self.samples:
            raise RecordingError(
                f"{self._recording.path}: contains no complete sample: the run ended before one was written"
            )
        self.stretches = [stretch for stretch in self.stretches if stretch.kept]

    def _block(self, stretch, samples, part):
        """Block of the finite samples of a part, or None; counts missing and non-finite ones."""
        stamps = samples.stamp_ns[part]
        unit, since = stretch.step * 1e9, stamps - stretch.base_ns
        steps = np.rint(since / unit).astype(np.int64)
        # Stamps are rounded to ns from the step count.
        off = np.abs(np.rint(steps * unit) - since) > 1.0
        if off.any():
            if isinstance(self._recording.settings["steps_per_sample"], int):
                raise RecordingError(f"{self._recording.path}: its stamps do not lie on steps of {stretch.step:g} s")
            steps = np.where(off, since / unit, steps)
        self._count(stretch, steps)
        given = (values if values is None else values[part] for values in samples[1:])
        position, quaternion, twist, errors, laws = given
        norm = np.linalg.norm(quaternion, axis=2)
        finite = (
            np.isfinite(position).all(axis=(1, 2))
            & np.isfinite(twist).all(axis=(1, 2))
            & (np.isfinite(norm) & (norm > 0.0)).all(axis=1)
        )
        if not finite.all():
            self.not_finite += int((~finite).sum())
            if self.first_not_finite is None:
                self.first_not_finite = float(stamps[~finite][0] * 1e-9)
            if not finite.any():
                return None
            steps, position = steps[finite], position[finite]
            quaternion, twist = quaternion[finite], twist[finite]
            errors, laws = (each if each is None else each[finite] for each in (errors, laws))
        if not stretch.samples:
            self.stretches.append(stretch)
            stretch.first_step = steps[0].item()
        stretch.samples += len(steps)
        stretch.last_step = steps[-1].item()
        turn = scipy.spatial.transform.Rotation.from_quat(quaternion.reshape(-1, 4)).as_matrix()
        rotation = turn.reshape(*position.shape[:2], 3, 3)
        return Block(stretch, steps, rotation, position, quaternion, twist, errors, laws)

    def _count(self, stretch, steps):
        """Count samples, and missing ones on the grid between them."""
        self.samples += len(steps)
        per_sample = self._recording.settings["steps_per_sample"]
        if per_sample is None:
            return  # samples at given times
        before = getattr(self, "_last", None)
        if before is not None and before[0] is stretch:
            steps = np.concatenate([before[1:], steps])
        self._last = (stretch, steps[-1])
        absent = np.diff(np.floor(steps / per_sample + ON_GRID)) - 1
        if (absent > 0).any():
            self.missing += int(absent[absent > 0].sum())
            self.gaps += int((absent > 0).sum())
            widths = np.where(absent > 0, np.diff(steps), 0) * stretch.step
            if widths.max() > self.largest_gap_s:
                self.largest_gap_s = float(widths.max())
                at = steps[widths.argmax()]
                self.largest_gap_at_s = float(stretch.base_ns * 1e-9 + at * stretch.step)
