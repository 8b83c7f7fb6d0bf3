# SPDX-License-Identifier: Apache-2.0
"""Many independent pieces of work at once: the cores of this machine, or a Dask cluster.

Every worker is a process with one thread. A piece whose worker dies is done again by another one,
so that a worker killed in the middle costs time and nothing else (test/core/test_tasks.py).
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
# So many workers may die over the same piece before it is taken to be what kills them.
MOST_DEATHS = 5


class TasksError(LieGroupSimError):
    """The work cannot be handed out, or kills its workers; one line of text, exit code 2."""


def run(function, items, scheduler=None, workers=None, follow=None):
    """Call function(item) for every item; yields (k, result) as results come, k the item's number.

    function  : can be pickled, as can items and results; what it raises ends the run
    scheduler : address of a Dask scheduler, such as tcp://host:8786; its workers must have this
                package. None: this machine
    workers   : processes on this machine; None: one for each core. With one, or without Dask, the
                work is done here, one item after the other. More of them import the main script
                anew, which must have its `if __name__ == "__main__"`
    follow    : function(k, result) that returns further items, numbered on from the last one
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
                # Next, not last: what belongs together is done together.
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
    """Client of as many processes on this machine, which end with the block."""
    import dask
    from dask.distributed import Client, LocalCluster

    # Nobody has to read that a worker was restarted, or that one ends with the whole.
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
                        dashboard_address="127.0.0.1:0",  # any port, not heard of
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
    """Ctrl-C counts at the end of the block, which it would leave half done. Processes started in
    here do not hear it: their parent minds it for them.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    pressed = []
    resource_tracker.ensure_running()  # its start would let the signal through again
    handler = signal.signal(signal.SIGINT, lambda *_: pressed.append(True))
    # What is blocked is so, too, in threads and processes that are started from here.
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
