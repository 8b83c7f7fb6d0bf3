# SPDX-License-Identifier: Apache-2.0
"""Wrench commands: what a WrenchStamped on ~/wrench means, and which ones are refused.

frame_id names the body. Force and torque are components in that body's axes, the torque about its
frame's origin. A zero stamp, or one that is past, means the next step; a stamp to come means that
simulated time. A message is taken whole or refused whole; refusals are counted by reason.
"""
import math

# A stamp further ahead than this is a sender that does not run on simulated time.
FARTHEST = 3600 * 10**9                     # ns


class Refusal(Exception):
    """A message that is not applied.

    reason : one of REASONS, for counting
    first  : True if it is the first one for this reason
    """

    def __init__(self, reason, text, first):
        super().__init__(f"wrench refused: {text} (said once; /diagnostics has the count)")
        self.reason = reason
        self.first = first


REASONS = ("not_finite", "no_frame", "unknown_frame", "stamp_too_far")


class WrenchInput:
    """Reads and counts wrench messages.

    bodies : names of the bodies
    """

    def __init__(self, bodies):
        self._bodies = tuple(bodies)
        self.accepted = 0
        self.refused = dict.fromkeys(REASONS, 0)

    def read(self, message, now_ns):
        """(body, (torque, force), start_ns) of a WrenchStamped; start_ns 0 is the next step.

        now_ns : the present stamp
        raises Refusal
        """
        body = message.header.frame_id
        torque, force = message.wrench.torque, message.wrench.force
        wrench = (torque.x, torque.y, torque.z, force.x, force.y, force.z)
        stamp = message.header.stamp
        start_ns = stamp.sec * 10**9 + stamp.nanosec
        if not body:
            self._refuse("no_frame", "frame_id is empty; it must name the body, one of: "
                         + self._names())
        if body not in self._bodies:
            self._refuse("unknown_frame", f"frame_id {body[:60]!r} is not a body; it must be one "
                         f"of: {self._names()}")
        if not all(map(math.isfinite, wrench)):
            self._refuse("not_finite", f"for {body}: a component is NaN or infinite")
        if start_ns > now_ns + FARTHEST:
            self._refuse("stamp_too_far", f"for {body}: its stamp {start_ns / 1e9:.9g} s is more "
                         f"than {FARTHEST // 10**9} s ahead of the simulated time "
                         f"{now_ns / 1e9:.9g} s; leave the stamp zero, or stamp with simulated "
                         "time (use_sim_time)")
        self.accepted += 1
        return body, wrench, start_ns if start_ns > now_ns else 0

    def _refuse(self, reason, text):
        self.refused[reason] += 1
        raise Refusal(reason, text, first=self.refused[reason] == 1)

    def _names(self):
        shown = ", ".join(self._bodies[:8])
        return shown if len(self._bodies) <= 8 else f"{shown}, ... ({len(self._bodies)} bodies)"
