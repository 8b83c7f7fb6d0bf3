# SPDX-License-Identifier: Apache-2.0
"""Steps are taken without the interpreter lock: other threads of the process keep running."""

import threading
import time

import pytest

from liegroup_core import Simulation, load_scene
from liegroup_core.compiling import compiled


@pytest.mark.slow
@pytest.mark.skipif(not compiled(), reason="nothing is compiled")
def test_other_threads_run_during_compiled_steps():
    """If the GIL were held, this thread would block for the whole duration of the steps.

    The longest observed pause must stay below half of it.
    """
    simulation = Simulation(load_scene("heavy_top"), "rkmk4", estimate=False)
    steps, span = 500_000, []  # half a second in one compiled call

    def advance():
        start = time.perf_counter()
        simulation.advance(steps)
        span.append(time.perf_counter() - start)

    thread = threading.Thread(target=advance)
    thread.start()
    longest, last = 0.0, time.perf_counter()
    while not span:
        now = time.perf_counter()
        longest, last = max(longest, now - last), now
    thread.join()
    assert simulation.steps == steps
    assert longest < 0.5 * span[0]
