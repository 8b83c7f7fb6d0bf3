# SPDX-License-Identifier: Apache-2.0
"""Counts of accepted and refused messages, and checks that all inputs of the node share."""

import time

from liegroup_core.fields.values import LARGEST_NUMBER
from liegroup_sim_ros.messages.codecs import MessageError

# A stamp further ahead indicates a publisher that does not use simulated time.
FARTHEST = 3600 * 10**9  # ns
# Largest number of commands that act now or start later. Bounds the memory of the node.
MOST = 10_000
LONGEST_NAME = 64  # characters of a name that are shown
# s of wall time in which at most SEVERAL refusals with one reason are logged, each text once.
QUIET, SEVERAL = 10.0, 4


_is_below = LARGEST_NUMBER.__ge__


def bounded(numbers):
    """True if all numbers are finite and within the limit for numbers of a scene."""
    return all(map(_is_below, map(abs, numbers)))


class Refusal(Exception):
    """A message is refused.

    reason : key of its counter
    is_told : True if it is logged
    """

    def __init__(self, what, reason, text, is_told):
        of_all = f"at most {SEVERAL} of a kind are logged in {QUIET:g} s; /diagnostics has the count"
        super().__init__(f"{what} refused: {text} ({of_all})")
        self.reason = reason
        self.is_told = is_told


class CountedInput:
    """Counter of the messages of one kind of input; a subclass decodes them.

    what    : noun for a message in log texts
    counted : prefix of the names of its figures
    reasons : possible reasons of refusals
    accepted, refused : number of messages; {reason: number of messages}
    """

    def __init__(self, what, counted, reasons):
        self._what, self._counted = what, counted
        self.accepted = 0
        self.refused = dict.fromkeys(reasons, 0)
        self._told = {}  # {reason: (s of wall time of the first one in QUIET s, texts)}

    def refuse(self, reason, text):
        """Count and raise a Refusal; text : function that returns its text, called if it is logged."""
        self.refused[reason] += 1
        now = time.monotonic()
        since, texts = self._told.get(reason, (-QUIET, []))
        if now - since >= QUIET:
            since, texts = self._told[reason] = now, []
        said = text() if len(texts) < SEVERAL else reason
        is_told = len(texts) < SEVERAL and said not in texts
        if is_told:
            texts.append(said)
        raise Refusal(self._what, reason, said, is_told)

    def decoded(self, decode, *arguments):
        """Result of a function that decodes a message. Raises Refusal for a damaged one."""
        try:
            return decode(*arguments)
        except MessageError as error:
            text = str(error)
            self.refuse("damaged", lambda: text)

    def refuse_far_stamp(self, start_ns, now_ns, target):
        """Refuse a stamp too far ahead. Raises Refusal."""
        if start_ns > now_ns + FARTHEST:
            self.refuse(
                "stamp_too_far",
                lambda: (
                    f"for {target}: its time stamp {start_ns / 1000000000.0:.9g} s is more than "
                    f"{FARTHEST // 10**9} s ahead of the simulated time "
                    f"{now_ns / 1000000000.0:.9g} s; use a zero stamp, or simulated time "
                    "(use_sim_time)"
                ),
            )

    def refuse_too_many(self, held, target):
        """Refuse a message if MOST commands act or wait. Raises Refusal."""
        if held >= MOST:
            self.refuse("too_many", lambda: f"for {target}: {held} commands already act or are scheduled")

    def figures(self):
        """{name: number} for the diagnostics."""
        return {
            f"{self._counted}_accepted": self.accepted,
            f"{self._counted}_refused": sum(self.refused.values()),
            **{f"{self._counted}_refused_{reason}": n for reason, n in self.refused.items()},
        }
