# SPDX-License-Identifier: Apache-2.0
"""Contents of a recording as arrays: tracks of bodies and joints, wrenches, events."""

from typing import NamedTuple

import numpy as np

from liegroup_sim_ros.messages import joint_modes


def _time(track):
    """(n,) s of simulated time."""
    return track.stamp_ns * 1e-9


class PoseTrack(NamedTuple):
    """Poses of one body."""

    stamp_ns: np.ndarray  # (n,) int64, ns
    position: np.ndarray  # (n, 3) m, world
    quaternion: np.ndarray  # (n, 4) x, y, z, w, body -> world
    time = property(_time)


class TwistTrack(NamedTuple):
    """Twists of one body."""

    stamp_ns: np.ndarray  # (n,) int64, ns
    twist: np.ndarray  # (n, 6) (omega, v), rad/s and m/s, body axes
    time = property(_time)


class ErrorTrack(NamedTuple):
    """Estimated errors of all bodies, as in Sample.errors."""

    stamp_ns: np.ndarray  # (m,) int64, ns
    errors: np.ndarray  # (m, n, 4) of n bodies: m, rad, m/s, rad/s; NaN: not known yet, inf: unknown
    time = property(_time)


class ReactionTrack(NamedTuple):
    """Reactions of one joint, as in Sample.reactions."""

    stamp_ns: np.ndarray  # (n,) int64, ns
    wrench: np.ndarray  # (n, 6) (torque, force), N m and N; NaN: undetermined
    time = property(_time)


class ImpulseTrack(NamedTuple):
    """Impulses of one joint at impacts, as in Engine.drain_impacts."""

    stamp_ns: np.ndarray  # (m,) int64, ns, of the impacts
    impulse: np.ndarray  # (m, 6) (torque, force), N m s and N s; NaN: undetermined
    time = property(_time)


class MotionTrack(NamedTuple):
    """Commanded motions of all driven joints; see liegroup_core/joints/motion.py."""

    stamp_ns: np.ndarray  # (k,) from each stamp on
    names: tuple  # of the joints
    motion: np.ndarray  # (k, d, 7); an infinite origin means the motion of the scene


class ModeTrack(NamedTuple):
    """Modes of the joints with stops or friction from each stamp on; see messages/joint_modes.py."""

    stamp_ns: np.ndarray  # (m,) int64, ns
    names: tuple  # of k joints
    values: np.ndarray  # (m, k, 6) mode, slip, coordinate; impulse and energy of impacts; effort
    time = property(_time)

    def switching(self, stamp_ns):
        """(k, 5) of a sample with this stamp, for Sample.switching; None before the first message."""
        last = np.searchsorted(self.stamp_ns, stamp_ns, "right") - 1
        return joint_modes.switching(self.values[last]) if last >= 0 else None


class JointTrack(NamedTuple):
    """Coordinates of the joints that have one."""

    stamp_ns: np.ndarray  # (n,) int64, ns
    names: tuple  # of k joints
    position: np.ndarray  # (n, k) rad or m
    velocity: np.ndarray  # (n, k) rad/s or m/s
    effort: np.ndarray  # (n, k) N m or N; NaN: none
    time = property(_time)


class Samples(NamedTuple):
    """k successive samples of all n bodies."""

    stamp_ns: np.ndarray  # (k,) int64, ns
    position: np.ndarray  # (k, n, 3) m, world
    quaternion: np.ndarray  # (k, n, 4) x, y, z, w
    twist: np.ndarray  # (k, n, 6) (omega, v), body axes
    errors: np.ndarray | None = None  # (k, n, 4) as in ErrorTrack; None without an estimate
    laws: np.ndarray | None = None  # (k, s, 1) states of laws; NaN: not recorded, None: there are none


class Event(NamedTuple):
    stamp_ns: int
    name: str  # "start", "pause", "resume", "reset", "step", "fault", "stop", ...
    text: str
