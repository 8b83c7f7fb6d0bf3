# SPDX-License-Identifier: Apache-2.0
"""Comparison of two recordings: distance between the motions, and differences of the configuration."""

import numpy as np
import scipy

from liegroup_core.reference import Trajectory, distance
from liegroup_sim_ros.recording.read import RecordingError

from .drift import MOST_POINTS, thinned

# Compared settings. Time and machine of a run are not compared.
SETTINGS = (
    "scene",
    "method",
    "group",
    "step",
    "stabilisation",
    "baumgarte_time",
    "options",
    "steps_per_sample",
    "versions",
)
QUANTITIES = (("position", "m"), ("angle", "rad"), ("angular", "rad/s"), ("linear", "m/s"))


def compare(one, other):
    """Figures of the difference between two Recordings, see `differences`."""
    return differences(one, other)[0]


def differences(one, other):
    """Difference between two Recordings at their common time stamps.

    Bodies are matched by name. Bodies in only one of the recordings are ignored. The samples are read in
    pieces, so memory does not grow with the length of the run.

    returns figures, ((times, distance in m), (times, angle in rad)) of the most distant body
    raises RecordingError if there is nothing to compare
    """
    bodies = [body for body in one.bodies if body in other.bodies]
    if not bodies:
        raise RecordingError(f"{one.path} and {other.path} have no body name in common")
    tracks = [_Track(recording, bodies) for recording in (one, other)]
    largest = {name: {"unit": unit, "max": 0.0, "at_s": None} for name, unit in QUANTITIES}
    expected = min(
        recording.topics.get(recording.settings["topics"]["pose"][bodies[0]], 0) for recording in (one, other)
    )
    every = -(-expected // MOST_POINTS)
    curves = {"position": [], "angle": []}
    samples = identical = 0
    first = None
    while (found := _next(tracks)) is not None:
        stamps, (mine, theirs) = found
        samples += len(stamps)
        same = np.ones(len(stamps), dtype=bool)
        for a, b in zip(mine, theirs):
            same &= (np.ascontiguousarray(a).view(np.int64) == np.ascontiguousarray(b).view(np.int64)).all(axis=(1, 2))
        identical += int(same.sum())
        if not same.all() and first is None:
            first = float(stamps[np.argmin(same)] * 1e-9)
        apart = distance(*(_trajectory(part) for part in (mine, theirs)))
        for name, entry in largest.items():
            values = getattr(apart, name).max(axis=1)
            if name in curves:
                curves[name].append(thinned(stamps * 1e-9, values, every))
            at = int(values.argmax())  # a NaN counts as the maximum
            if not values[at] <= entry["max"]:
                entry["max"], entry["at_s"] = float(values[at]), float(stamps[at] * 1e-9)
    if not samples:
        raise RecordingError(f"{one.path} and {other.path} have no sample time in common")
    figures = {
        "logs": [str(one.path), str(other.path)],
        "bodies": bodies,
        "samples": samples,
        "identical": identical,
        "first_difference_s": first,
        "difference": largest,
        "same_scene": one.scene_text == other.scene_text,
        "same_wrenches": one.inputs == other.inputs
        and _same_track(one.servo_targets, other.servo_targets)
        and _same_track(one.motions, other.motions),
        "settings": {
            key: [one.settings.get(key), other.settings.get(key)]
            for key in SETTINGS
            if one.settings.get(key) != other.settings.get(key)
        },
    }
    return figures, tuple(tuple(np.concatenate(part) for part in zip(*parts)) for parts in curves.values())


def _same_track(one, other):
    """True if two JointTracks or MotionTracks are equal, or both are None."""
    if one is None or other is None:
        return one is other
    return all(map(np.array_equal, one, other))


class _Track:
    """Samples of some bodies of a recording that have not been compared yet."""

    def __init__(self, recording, bodies):
        self._pieces = recording.samples()
        self._index = [recording.bodies.index(body) for body in bodies]
        self.stamps = np.empty(0, dtype=np.int64)
        self.values = None

    def fill(self):
        """Read a piece if all samples have been compared. Returns False at the end of the recording."""
        if not len(self.stamps):
            piece = next(self._pieces, None)
            if piece is None:
                return False
            motion = piece.position, piece.quaternion, piece.twist
            self.stamps, self.values = piece.stamp_ns, [part[:, self._index] for part in motion]
        return True

    def take(self, stamps, upto):
        rows = np.searchsorted(self.stamps, stamps)
        left = np.searchsorted(self.stamps, upto, "right")
        taken = [part[rows] for part in self.values]
        self.stamps, self.values = self.stamps[left:], [part[left:] for part in self.values]
        return taken


def _next(tracks):
    """(stamps, values of both tracks) of the next common samples, or None at the end."""
    while all([track.fill() for track in tracks]):
        upto = min(track.stamps[-1] for track in tracks)
        stamps = np.intersect1d(*(track.stamps[track.stamps <= upto] for track in tracks), True)
        values = [track.take(stamps, upto) for track in tracks]
        if len(stamps):
            return stamps, values
    return None


def _trajectory(values):
    position, quaternion, twist = values
    norm = np.linalg.norm(quaternion, axis=2, keepdims=True)
    usable = np.where(np.isfinite(norm) & (norm > 0.0), quaternion, (0.0, 0.0, 0.0, 1.0))
    rotation = scipy.spatial.transform.Rotation.from_quat(usable.reshape(-1, 4)).as_matrix()
    rotation = rotation.reshape(*position.shape[:2], 3, 3)
    rotation[~(np.isfinite(norm) & (norm > 0.0))[..., 0]] = np.nan
    return Trajectory(None, rotation, position, twist)
