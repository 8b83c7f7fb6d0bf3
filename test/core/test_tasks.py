# SPDX-License-Identifier: Apache-2.0
"""Parallel work: no result is lost or duplicated, even if workers are killed.

Functions are defined inside the tests, so that they are sent to the workers by value.
"""

import os
import signal

import pytest

from liegroup_core.study import tasks


def square(x):
    return x * x


@pytest.mark.parametrize("workers", [1, 2])
def test_results_can_add_new_items(workers):
    """Items that follow from results; a worker is killed once, and its item is repeated."""

    def halve(x):
        return x // 2

    results = dict(
        tasks.run(
            halve, [8, 5], workers=workers, follow=lambda k, result: [result] if result else []
        )
    )
    # 8 leads to items 4, 2, 1 and 5 to items 2, 1: seven calls in any order.
    assert sorted(results) == list(range(7)) and (results[0], results[1]) == (4, 2)
    assert sorted(results.values()) == [0, 0, 1, 1, 2, 2, 4]


def test_a_killed_worker_loses_nothing(tmp_path):
    died, parent = tmp_path / "died", os.getpid()

    def square_or_die(x):
        if x == 3 and not died.exists():
            died.touch()
            assert os.getpid() != parent
            os.kill(os.getpid(), signal.SIGKILL)
        return x * x

    results = list(tasks.run(square_or_die, range(8), workers=2))
    assert died.exists()
    assert sorted(results) == [(x, x * x) for x in range(8)]


def test_a_task_that_kills_every_worker_is_an_error(monkeypatch):
    monkeypatch.setattr(tasks, "MOST_DEATHS", 1)

    def die(x):
        os.kill(os.getpid(), signal.SIGKILL)

    with pytest.raises(tasks.TasksError, match="workers died in the same task"):
        list(tasks.run(die, [1, 2], workers=2))


def test_an_interrupt_during_worker_start_ends_the_run_after_the_start(monkeypatch):
    """Workers ignore this and later interrupts."""
    import dask.distributed
    import psutil

    class Interrupted(dask.distributed.LocalCluster):
        def __init__(self, **arguments):
            super().__init__(**arguments)
            os.kill(os.getpid(), signal.SIGINT)
            self.up = True

    def blocks_sigint(x):
        return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])

    assert dict(tasks.run(blocks_sigint, [1, 2], workers=2)) == {0: True, 1: True}
    monkeypatch.setattr(dask.distributed, "LocalCluster", Interrupted)
    # Shells start background processes with SIGINT ignored.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            list(tasks.run(square, [1, 2], workers=2))
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler and not blocks_sigint(
            0
        )
    finally:
        signal.signal(signal.SIGINT, before)
    assert not [
        child for child in psutil.Process().children() if "spawn_main" in " ".join(child.cmdline())
    ]


def test_workers_that_cannot_start_are_an_error(monkeypatch):
    import dask.distributed

    def failing_cluster(**arguments):
        raise RuntimeError("Nanny failed to start.")

    monkeypatch.setattr(dask.distributed, "LocalCluster", failing_cluster)
    with pytest.raises(tasks.TasksError, match="2 workers could not be started.*check the memory"):
        list(tasks.run(square, [1, 2], workers=2))


def test_an_exception_in_the_function_ends_the_run():
    def fail(x):
        raise KeyError(x)

    for workers in (1, 2):
        with pytest.raises(KeyError):
            list(tasks.run(fail, [1, 2], workers=workers))


@pytest.mark.slow
def test_a_missing_scheduler_is_a_one_line_error(monkeypatch):
    monkeypatch.setattr(tasks, "CONNECTING", 1)  # s instead of 10: nothing listens on that port
    with pytest.raises(tasks.TasksError, match="no dask scheduler at tcp://127.0.0.1:9") as error:
        list(tasks.run(square, [1], scheduler="tcp://127.0.0.1:9"))
    assert "\n" not in str(error.value)
