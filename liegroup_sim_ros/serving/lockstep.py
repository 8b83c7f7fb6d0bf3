# SPDX-License-Identifier: Apache-2.0
"""Lockstep: at its due times a simulation waits for a message of each topic that has the time stamp of the state.

A topic is due at the multiples of its period, in time stamps. The state is published, then all due topics must
answer it. Answers act from that state on, in the order of the topics, whatever the order of their arrival.
"""

import math
import struct
import threading
import time
from fractions import Fraction
from typing import NamedTuple

from liegroup_core.forces.instants import NS, exact_step
from liegroup_sim_ros.messages.codecs import MessageError

from .counted_input import CountedInput
from .rates import following, is_multiple

REASONS = ("late", "early", "repeated", "damaged")
# s of wall time: a longer wait is logged; between two looks for new listeners, which need the state once more; how
# long after a new one it is repeated, because the two sides of DDS discover each other up to 2.5 s apart. On a loaded
# machine that takes longer, and a process that was stopped may have lost a message, so it is repeated every LONG, too.
LONG, LOOK, DISCOVERY = 0.5, 0.1, 3.0


class Asked(NamedTuple):
    """State that a topic must answer."""

    stamp_ns: int
    hold: float  # s, how long the answer acts: up to the next due time, rounded to whole ns where it acts


class _Topic:
    """What a topic must answer, and has answered."""

    def __init__(self):
        self.asked = self.give = self.payload = None
        self.is_open = self.has_answered = False


def _common_period(rates):
    """Shortest time in whole ns that is a multiple of the periods of all rates in Hz."""
    return math.lcm(*((Fraction(NS) / exact_rate(rate)).numerator for rate in rates))


def exact_rate(rate):
    """Rate in Hz as the simplest fraction within the rounding of the float."""
    return Fraction(NS) / Fraction(*exact_step(1.0 / rate))


def fitting_step(rates, longest):
    """Longest step in s, not above `longest`, of which the periods of all rates in Hz are multiples."""
    exact = [exact_rate(rate) for rate in rates]
    steps = Fraction(math.lcm(*(rate.numerator for rate in exact)), math.gcd(*(rate.denominator for rate in exact)))
    return float(1 / (steps * math.ceil(1 / (steps * Fraction(longest)) - Fraction(1, 10**9))))


def unfitting(rates, step):
    """First topic of {topic: Hz} whose period is not a multiple of a step in s, or None."""
    size = Fraction(*exact_step(step))
    return next((topic for topic, rate in rates.items() if (NS / exact_rate(rate) / size).denominator > 1), None)


def aligned(rates, stamp_ns, time_ns):
    """First stamp not before `stamp_ns` of a state at a time in ns, such that due times are multiples as stamps, too.

    rates : Hz
    """
    return stamp_ns + (time_ns - stamp_ns) % (_common_period(rates) if rates else 1)


class Lockstep(CountedInput):
    """Topics that must answer.

    wake    : function that wakes the simulation thread
    rates   : {topic: Hz of simulated time}
    timeout : s of wall time after which a missing answer ends the wait; 0: never. The first answer of a topic, also
              after such an end, has no limit, because its controller has to be started

    missing : topics that have not answered the present state
    """

    def __init__(self, wake=lambda: None, rates=None, timeout=0.0):
        super().__init__("answer", "answers", REASONS)
        self._wake, self._lock = wake, threading.Lock()
        self._topics, self.rates, self.missing, self.timeout = {}, {}, [], timeout
        self._listeners, self._changed = None, -math.inf
        self.forget_wait()
        self.set(rates or {})

    def set(self, rates):
        """Change the topics, in the simulation thread; those that stay keep what they were asked."""
        with self._lock:
            self._topics = {topic: self._topics.get(topic) or _Topic() for topic in rates}
            self.rates = rates
            self._count()

    # In the thread of the topics:

    def receive(self, topic, payload, read):
        """Take a serialized message; read(payload, Asked) returns the function that gives its commands.

        Raises Refusal.
        """
        mine = self._topics.get(topic)
        if mine is None or payload == mine.payload:
            return  # the topic was removed just now, or this answers a state that was repeated
        stamp_ns, asked = self.decoded(_stamp_ns, payload), mine.asked
        if asked is None or stamp_ns != asked.stamp_ns:
            now_ns = 0 if asked is None else asked.stamp_ns
            reason, where = ("late", "before") if stamp_ns < now_ns else ("early", "after")
            self.refuse(
                reason,
                lambda: (
                    f"on ~/{topic}: its time stamp {stamp_ns / NS:.9f} s is {where} {now_ns / NS:.9f} s, the stamp "
                    f"of the last state that it must answer; every {1.0 / self.rates.get(topic, math.inf):g} s, "
                    "answer with the time stamp of the state"
                ),
            )
        if not mine.is_open:
            self.refuse(
                "repeated",
                lambda: f"on ~/{topic}: a second one, with other content, to {stamp_ns / NS:.9f} s; the first one acts",
            )
        give = read(payload, asked)
        with self._lock:
            if mine.asked is asked and mine.is_open:
                mine.give, mine.payload, mine.is_open, mine.has_answered = give, payload, False, True
                self.accepted += 1
                self._count()
        if not self.missing:
            self._wake()

    # In the simulation thread:

    def ask(self, topic, stamp_ns, time_ns):
        """Wait from now on for the answer of a topic to the state with this stamp, at a time in ns."""
        mine, rate = self._topics[topic], self.rates[topic]
        if mine.asked is not None and mine.asked.stamp_ns == stamp_ns or not is_multiple(rate, time_ns):
            return
        with self._lock:
            mine.asked = Asked(stamp_ns, (following(rate, time_ns) - time_ns) / NS)
            mine.is_open, mine.give = True, None
            self._count()
        self.forget_wait()

    def take(self):
        """Functions that give the commands of the answers, each once, in the order of the topics."""
        found = [mine.give for mine in self._topics.values() if mine.give is not None]
        for mine in self._topics.values():
            mine.give = None
        return found

    def discard(self):
        """Forget all answers, because a state was set."""
        with self._lock:
            for mine in self._topics.values():
                mine.asked = mine.give = None
                mine.is_open = False
            self._count()

    def _count(self):
        self.missing = [topic for topic, mine in self._topics.items() if mine.is_open]

    def forget_wait(self):
        """Begin the wait again: the limit, and what was logged of it."""
        self._waited, self._said, self._repeats = 0.0, False, 0

    def wait(self, sleep, longest, listeners):
        """Wait for the missing answers, at most `longest` s and not for long.

        sleep     : function of seconds, which `wake` ends
        listeners : function that returns the numbers of subscribers of the state
        returns (line to log or "", whether the wait has ended, what must be published again: "", "clock" or "state").
        Nodes with use_sim_time subscribe to /clock without reliability, so one message may be lost
        """
        began = time.monotonic()
        sleep(min(longest, LOOK))
        now, missing = time.monotonic(), self.missing
        self._waited += min(now - began, LOOK)  # the rest is a delay, or a stop, of this process
        waited = self._waited
        if not missing or waited < LOOK:
            return "", False, ""
        if self.timeout and waited >= self.timeout and any(self._topics[topic].has_answered for topic in missing):
            for topic in missing:
                self._topics[topic].has_answered = False  # its controller may have to be started again
            self.forget_wait()
            return f"{self._text(missing)} within {self.timeout:g} s: paused; ~/resume waits without limit", True, ""
        text = ""
        if not self._said and waited >= min(LONG, self.timeout or LONG):
            self._said, text = True, f"{self._text(missing)} for {waited:.2g} s: waiting"
        before, self._listeners = self._listeners, listeners()
        if self._listeners != before:
            self._changed = now
        before, self._repeats = self._repeats, int(waited / LONG)
        return text, False, "state" if now - self._changed < DISCOVERY or self._repeats > before else "clock"

    def _text(self, missing):
        stamp_ns = max(mine.asked.stamp_ns for mine in map(self._topics.get, missing) if mine and mine.asked)
        return f"no answer on ~/{', ~/'.join(missing)} to the state at {stamp_ns / NS:.9f} s"

    def figures(self):
        """As of CountedInput, and the topics that are missing; nothing without topics."""
        return {"answers_missing": " ".join(self.missing), **super().figures()} if self.rates else {}


def _stamp_ns(payload):
    """Stamp in ns of a serialized message that begins with a header."""
    if len(payload) < 12:
        raise MessageError("it has no time stamp")
    seconds, ns = struct.unpack_from("<iI" if payload[1] & 1 else ">iI", payload, 4)
    return seconds * NS + ns
