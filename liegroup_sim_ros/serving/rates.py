# SPDX-License-Identifier: Apache-2.0
"""Times at which the outputs of a simulation are due: each at its own rate, in whole ns."""

from collections.abc import Callable
from typing import NamedTuple

from liegroup_core.forces.instants import NS, nearest_whole

IDLE_RATE = 100.0  # Hz of simulated time at which a simulation without outputs advances


class Output(NamedTuple):
    """Function that is called at a rate."""

    rate: float  # Hz of simulated time
    send: Callable  # function (stamp in ns, sample)
    of_state: bool = True  # False: the sample may be None
    answers: bool = True  # whether it is called at once after an input


def following(rate, now):
    """First multiple, in whole ns, of the period of a rate in Hz after a time in ns: no error accumulates."""
    parts, unit = rate.as_integer_ratio()
    number, found = now * parts // (unit * NS), now
    while found <= now:
        number += 1
        found = nearest_whole(number * unit * NS, parts)
    return found


def is_multiple(rate, now):
    """Whether a time in ns is a multiple of the period of a rate in Hz."""
    return following(rate, now - 1) == now


class _Multiples:
    """The next one of the multiples of the period of a rate."""

    def __init__(self, rate):
        self._rate = rate
        self.next = -1

    def go_on(self, now):
        """Set `next` to the first one after a time in ns."""
        self.next = following(self._rate, now)


class Rates:
    """Outputs that are due.

    outputs : [Output] in the order of their calls
    """

    def __init__(self, outputs):
        self._times = {output.rate: _Multiples(output.rate) for output in outputs}
        self._outputs = [(output, self._times[output.rate]) for output in outputs]
        self._sent = [None] * len(outputs)  # stamp of the last message of each
        self._times = self._times or {IDLE_RATE: _Multiples(IDLE_RATE)}

    def restart(self):
        """Begin again at any time, after a state was set."""
        for each in self._times.values():
            each.next = -1

    def after(self, now):
        """Time in ns since step 0 at which the first output after `now` is due."""
        for each in self._times.values():
            if each.next <= now:
                each.go_on(now)
        return min([each.next for each in self._times.values()])

    def sent_at(self, stamp_ns):
        """Outputs that were sent with a stamp."""
        return [output for (output, _), sent in zip(self._outputs, self._sent) if sent == stamp_ns]

    def need_state(self, now):
        """Whether an output that is due at a time sends a state."""
        return any(output.of_state and times.next == now for output, times in self._outputs)

    def due(self, now, stamp_ns, everything=False):
        """Outputs that are due at a time, or all; without those that were sent with this stamp already.

        Call `after` with an earlier time before.
        """
        found = []
        for k, (output, times) in enumerate(self._outputs):
            if (everything or times.next == now) and self._sent[k] != stamp_ns:
                self._sent[k] = stamp_ns
                found.append(output)
        return found
