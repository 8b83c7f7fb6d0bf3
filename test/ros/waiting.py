# SPDX-License-Identifier: Apache-2.0
"""Waiting for a condition: no test expects anything within a time of the wall clock.

Machines differ in speed by a factor of five, and any process may be stopped for a while.
"""

import time

PATIENCE = 300.0  # s; only a defect makes a test wait that long


def wait_for(condition, what="what was waited for", turn=lambda: time.sleep(0.005)):
    """Value of condition() once it is true; turn() is called between two checks."""
    end = time.monotonic() + PATIENCE
    while not (result := condition()):
        assert time.monotonic() < end, f"{what} did not happen within {PATIENCE:g} s"
        turn()
    return result
