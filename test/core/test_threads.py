# SPDX-License-Identifier: Apache-2.0
"""Threads: BLAS gets one while a model is built, and compiled steps leave the others running."""

import threading
import time

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from liegroup_core import Simulation, load_scene
from liegroup_core.compiling import compiled
from liegroup_core.engine import Engine
from liegroup_core.scene import assembly


def blas_threads():
    return [found["num_threads"] for found in threadpool_info() if found["user_api"] == "blas"]


def test_a_model_is_built_with_one_blas_thread(monkeypatch):
    seen, assembled = [], assembly.assembled

    def watched(*arguments):
        seen.append(blas_threads())
        return assembled(*arguments)

    monkeypatch.setattr(assembly, "assembled", watched)
    with threadpool_limits(2, "blas"):
        before = blas_threads()
        Engine(load_scene("four_bar"), quiet=True)
        assert blas_threads() == before
    assert seen and all(set(threads) == {1} for threads in seen)


# Steps are taken without the interpreter lock: other threads of the process keep running.


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
