# SPDX-License-Identifier: Apache-2.0
"""The motion in a recording: stretches between resets, as arrays of all bodies."""
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ..recording import RecordingError


@dataclass(frozen=True, eq=False)
class Stretch:
    """The run from its start, or from a reset, to the next reset; k samples of n bodies."""

    base_ns: int            # stamp of step 0
    step: float             # s
    steps: np.ndarray       # (k,) step number of each sample
    rows: dict              # {body: ((k,) rows of its pose track, (k,) of its twist track)}
    rotation: np.ndarray    # (k, n, 3, 3) body -> world
    position: np.ndarray    # (k, n, 3) m, world
    twist: np.ndarray       # (k, n, 6) rad/s, m/s; body axes
    changes: tuple          # (step, body, wrench (6,)): the total on the body from this step on
    pushed: tuple           # (first step, end step, body): intervals with a wrench

    @property
    def times(self):
        """(k,) s since step 0."""
        return self.steps * self.step

    @property
    def log_times(self):
        """(k,) s of the recording."""
        return self.base_ns * 1e-9 + self.times

    def free(self, bodies):
        """Ranges (first, end) of samples between which no wrench acts on any of the bodies.

        The state at the step where a wrench begins is still untouched by it, the state at the step
        where it ends is the first of the next range. Ranges of one sample say nothing: left out.
        """
        ranges, since = [], -1
        for first, end, _ in sorted(p for p in self.pushed if p[2] in bodies):
            ranges.append((since, first))
            since = max(since, end)
        ranges.append((since, np.inf))
        indices = [(int(np.searchsorted(self.steps, first)),
                    int(np.searchsorted(self.steps, last, "right"))) for first, last in ranges]
        return [(a, b) for a, b in indices if b - a > 1]


@dataclass(frozen=True, eq=False)
class Motion:
    """All stretches of a recording, and what is missing in it."""

    stretches: tuple
    samples: int            # complete ones: pose and twist of all bodies
    missing: int            # samples that should lie between the first and the last one
    not_finite: int         # samples with NaN, infinity or a quaternion of no length: left out
    first_not_finite: float | None      # s of the recording


def read_motion(recording):
    """Motion in a Recording. Raises RecordingError for settings that contradict the messages."""
    step = recording.settings.get("step")
    if not (isinstance(step, (int, float)) and step > 0.0):
        raise RecordingError(f"{recording.path}: its settings have no step size")
    tracks = [recording.pose[b] for b in recording.bodies]
    tracks += [recording.twist[b] for b in recording.bodies]
    for track in tracks:
        if np.any(np.diff(track.stamp_ns) <= 0):
            raise RecordingError(f"{recording.path}: the stamps of a topic do not increase")
    stamps = tracks[0].stamp_ns
    for track in tracks[1:]:
        stamps = np.intersect1d(stamps, track.stamp_ns, assume_unique=True)
    if not len(stamps):
        raise RecordingError(f"{recording.path}: holds no complete sample: the run ended before "
                             "one was written")
    good = np.all([_usable(track, stamps) for track in tracks], axis=0)
    bases = [int(recording.initial_state["stamp_ns"])]
    bases += [event.stamp_ns for event in recording.events if event.name == "reset"]
    stretches, missing = [], 0
    for base, end in zip(bases, [*bases[1:], np.inf]):
        inside = (stamps >= base) & (stamps < end)
        if not inside.any():
            continue
        steps = np.rint((stamps[inside] - base) / (step * 1e9)).astype(np.int64)
        # Stamps are rounded to ns from the step count.
        if np.abs(base + steps * (step * 1e9) - stamps[inside]).max() > 1.0:
            raise RecordingError(f"{recording.path}: its stamps do not lie on steps of {step:g} s")
        missing += _missing(steps, recording.settings["steps_per_sample"])
        kept = stamps[inside & good]
        if len(kept):
            stretches.append(_stretch(recording, base, end, step, steps[good[inside]], kept))
    bad = stamps[~good]
    return Motion(tuple(stretches), len(stamps), missing, len(bad),
                  bad[0] * 1e-9 if len(bad) else None)


def _usable(track, stamps):
    """Which of the stamps have finite numbers in a track."""
    rows = np.searchsorted(track.stamp_ns, stamps)
    if hasattr(track, "twist"):
        return np.isfinite(track.twist[rows]).all(axis=1)
    norm = np.linalg.norm(track.quaternion[rows], axis=1)
    return np.isfinite(track.position[rows]).all(axis=1) & np.isfinite(norm) & (norm > 0.0)


def _missing(steps, per_sample):
    """Samples that are not there: those on the grid of steps_per_sample between two that are."""
    grid = steps // per_sample
    return int(np.maximum(np.diff(grid) - 1, 0).sum())


def _stretch(recording, base, end, step, steps, stamps):
    rows, rotation, position, twist = {}, [], [], []
    for body in recording.bodies:
        pose, turn = recording.pose[body], recording.twist[body]
        rows[body] = (np.searchsorted(pose.stamp_ns, stamps),
                      np.searchsorted(turn.stamp_ns, stamps))
        rotation.append(Rotation.from_quat(pose.quaternion[rows[body][0]]).as_matrix())
        position.append(pose.position[rows[body][0]])
        twist.append(turn.twist[rows[body][1]])
    changes = tuple((round((change.stamp_ns - base) / (step * 1e9)), change.body, change.wrench)
                    for change in recording.applied_wrench if base <= change.stamp_ns < end)
    return Stretch(base, step, steps, rows, np.stack(rotation, axis=1), np.stack(position, axis=1),
                   np.stack(twist, axis=1), changes, _pushed(changes))


def _pushed(changes):
    """Intervals with a wrench that is not zero; the last one may have no end."""
    intervals, since = [], {}
    for step, body, wrench in changes:
        if any(wrench):
            since.setdefault(body, step)
        elif body in since:
            intervals.append((since.pop(body), step, body))
    intervals += [(first, np.inf, body) for body, first in since.items()]
    return tuple(sorted(intervals))
