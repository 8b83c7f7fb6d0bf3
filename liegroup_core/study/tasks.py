# SPDX-License-Identifier: Apache-2.0
"""Parallel execution of independent tasks on the cores of this machine or on a Dask cluster.

Each worker is a process with one thread. If a worker is killed, another one repeats its task, so no
result is lost (test/core/test_tasks.py).
"""

import logging
import os
import signal
import threading
from collections import deque
from contextlib import ExitStack, contextmanager
from importlib import import_module
from multiprocessing import resource_tracker

from liegroup_core.errors import LieGroupSimError

CONNECTING = 10  # s
# Number of workers that may die at the same task before the task is considered the cause.
MOST_DEATHS = 5


class TasksError(LieGroupSimError):
    """Tasks cannot be distributed, or kill their workers; one line of text, exit code 2."""


def run(function, items, scheduler=None, workers=None, follow=None):
    """Call function(item) for every item; yields (k, result) in order of completion.

    k         : number of the item
    function  : must be picklable, as items and results; its exceptions end the run
    scheduler : address of a Dask scheduler, such as tcp://host:8786; its workers must have this
                package. None: this machine
    workers   : processes on this machine; None: one for each core. With one, or without Dask,
                the items run in this process, one after the other. Worker processes import the
                main script, so it needs `if __name__ == "__main__"`
    follow    : function(k, result) that returns further items; their numbers continue
    raises TasksError
    """
    items = list(items)
    workers = min(workers or os.cpu_count() or 1, len(items))
    if scheduler is None and (workers <= 1 or not _has_dask()):
        yield from _here(function, items, follow)
        return
    with ExitStack() as stack:
        client = stack.enter_context(_cluster(scheduler) if scheduler else _this_machine(workers))
        yield from _on(client, function, items, follow)


def _has_dask():
    try:
        return all(map(import_module, ("dask", "dask.distributed")))
    except ImportError:
        return False


def _here(function, items, follow):
    waiting, count = deque(enumerate(items)), len(items)
    while waiting:
        k, item = waiting.popleft()
        result = function(item)
        if follow is not None:
            for more in follow(k, result):
                # Next, not last: related items finish together.
                waiting.appendleft((count, more))
                count += 1
        yield k, result


def _on(client, function, items, follow):
    from dask.distributed import as_completed
    from distributed import CancelledError, KilledWorker
    from distributed.comm import CommClosedError

    numbers = {}

    def submit(item):
        future = client.submit(function, item, pure=False)
        numbers[future.key] = len(numbers)
        return future

    running = as_completed([submit(item) for item in items])
    try:
        for future in running:
            k, result = numbers[future.key], future.result()
            if follow is not None:
                for more in follow(k, result):
                    running.add(submit(more))
            future.release()
            yield k, result
    except KilledWorker:
        raise TasksError(
            f"{MOST_DEATHS} workers died in the same task: check the memory, or use fewer workers"
        ) from None
    except (CancelledError, CommClosedError):
        raise TasksError(
            "the connection to the dask scheduler is lost; finished results are saved"
        ) from None


@contextmanager
def _this_machine(workers):
    """Client of worker processes on this machine; they end with the block."""
    import dask
    from dask.distributed import Client, LocalCluster

    # Suppress messages about workers that restart or end.
    with ExitStack() as stack:
        stack.enter_context(
            dask.config.set(
                {
                    "distributed.scheduler.allowed-failures": MOST_DEATHS,
                    "distributed.comm.timeouts.connect": f"{CONNECTING}s",
                    "distributed.admin.log-length": 0,
                }
            )
        )
        try:
            with _interrupts_later():
                cluster = stack.enter_context(
                    LocalCluster(
                        n_workers=workers,
                        threads_per_worker=1,
                        processes=True,
                        host="127.0.0.1",
                        protocol="tcp",
                        memory_limit=0,
                        dashboard_address="127.0.0.1:0",  # any port, without a message
                        silence_logs=logging.CRITICAL,
                    )
                )
        except (OSError, RuntimeError, TimeoutError) as error:
            raise TasksError(
                f"{workers} workers could not be started or died immediately ({error}): check "
                "the memory, or use fewer workers"
            ) from None
        yield stack.enter_context(Client(cluster))


@contextmanager
def _interrupts_later():
    """Defer Ctrl-C to the end of the block. Processes started inside ignore it; their parent
    handles it for them.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    pressed = []
    resource_tracker.ensure_running()  # its start would unblock the signal
    handler = signal.signal(signal.SIGINT, lambda *_: pressed.append(True))
    # Threads and processes started here inherit the blocked signal.
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        signal.signal(signal.SIGINT, handler)
        if pressed:
            signal.raise_signal(signal.SIGINT)


@contextmanager
def _cluster(address):
    """Client of the scheduler at an address."""
    try:
        from dask.distributed import Client
    except ImportError:
        raise TasksError(
            "a scheduler needs the package distributed: pip install 'liegroup_sim_ros[many]'"
        ) from None
    try:
        client = Client(address, timeout=CONNECTING)
    except (OSError, TimeoutError, ValueError) as error:
        raise TasksError(
            f"no dask scheduler at {address}: {' '.join(str(error).split())[:200]}"
        ) from None
    with client:
        yield client
