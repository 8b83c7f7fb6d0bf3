# SPDX-License-Identifier: Apache-2.0
"""Checkpoints: exact states along a recording, from which any instant of it is reached in a short time.

A checkpoint is an attachment with the entries of initial_state.json, named after its stamp in ns.
One is added when the run has used CPU since the last one: repeating the run between them takes about as
long. There is at most one per SPACING, and at most MOST in a file.
"""

import json
import time

from . import attachments

PREFIX, SUFFIX = "checkpoint_", ".json"
CPU = 0.08  # s of CPU time of the thread that simulates
SPACING = 10**9  # ns of simulated time
MOST = 4096


class Checkpoints:
    """Checkpoints of a simulation in a Recorder; all calls from the thread that simulates."""

    def __init__(self, recorder, simulation):
        self._recorder, self._simulation = recorder, simulation
        self._first_ns = None

    def add_if_due(self, stamp_ns):
        """Add a checkpoint with the present state, whose stamp is given, if one is due."""
        if self._first_ns is None:
            self._first_ns = stamp_ns
        elif (
            stamp_ns - self._last_ns < SPACING
            or (stamp_ns - self._last_ns) * MOST < stamp_ns - self._first_ns
            or time.thread_time() - self._used < CPU
        ):
            return
        else:
            state = attachments.state(self._simulation, stamp_ns)
            self._recorder.add_attachment(f"{PREFIX}{stamp_ns}{SUFFIX}", "application/json", json.dumps(state).encode())
        self._last_ns, self._used = stamp_ns, time.thread_time()


def stamp_of(name):
    """Stamp in ns from the name of a checkpoint's attachment, or None for other attachments."""
    number = name.removeprefix(PREFIX).removesuffix(SUFFIX)
    is_one = name == f"{PREFIX}{number}{SUFFIX}" and number.isdecimal() and len(number) < 20
    return int(number) if is_one else None
