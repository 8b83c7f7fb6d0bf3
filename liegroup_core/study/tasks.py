# SPDX-License-Identifier: Apache-2.0
"""Parallel execution of independent tasks on the cores of this machine or on a Dask cluster.

Each worker is a process with one thread. If a worker is killed, another one repeats its task, so no
result is lost (test/core/test_tasks.py).

Workers on this machine get their tasks through unnamed pipes, which no other process can open. Without
TLS, anyone who can reach a port of Dask can execute code there.

Own code: workers of concurrent.futures, loky and pebble share a pipe, so the run hangs if one is killed
while it sends a result, and the first two also repeat the tasks of all other workers.
"""

import logging
import multiprocessing
import os
import pickle
import signal
import threading
from collections import Counter, deque
from contextlib import contextmanager, suppress
from multiprocessing import connection, resource_tracker
from multiprocessing.pool import ExceptionWithTraceback

from liegroup_core.errors import LieGroupSimError

try:  # a dependency of Dask; it can also pickle nested functions
    from cloudpickle import dumps
except ImportError:
    from pickle import dumps

log = logging.getLogger("liegroup_core")

CONNECTING = 10  # s
# Number of workers that may die in the same task before the task counts as the cause.
MOST_DEATHS = 5
ENDING = 5  # s to wait for the end of a worker without a task
THREADS = "OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"


class TasksError(LieGroupSimError):
    """Tasks cannot be distributed, or crash their workers; one line of text, exit code 2."""


def run(function, items, scheduler=None, workers=None, expand=None):
    """Call function(item) for every item; yields (k, result) in order of completion.

    k         : number of the item
    function  : must be picklable, like items and results; an exception in it ends the run
    scheduler : address of a Dask scheduler, such as tls://host:8786; its workers must have this
                package. Certificates are those of Dask's configuration (distributed.comm.tls).
                None: this machine
    workers   : number of processes on this machine; None: one for each core. With one worker, the items
                run in this process, one after the other. Worker processes import the main script, so
                it needs `if __name__ == "__main__"`
    expand    : function(k, result) that returns further items, which get the next numbers
    raises TasksError
    """
    items = list(items)
    workers = min(workers or os.cpu_count() or 1, len(items))
    if scheduler is not None:
        with _cluster(scheduler) as client:
            yield from _on(client, function, items, expand)
    elif workers <= 1:
        yield from _here(function, items, expand)
    else:
        with _Team(function, workers) as team:
            yield from team.results(items, expand)


def _here(function, items, expand):
    waiting, count = deque(enumerate(items)), len(items)
    while waiting:
        k, item = waiting.popleft()
        result = function(item)
        if expand is not None:
            for more in expand(k, result):
                # Next, not last: related items finish together.
                waiting.appendleft((count, more))
                count += 1
        yield k, result


def _on(client, function, items, expand):
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
            if expand is not None:
                for more in expand(k, result):
                    running.add(submit(more))
            future.release()
            yield k, result
    except KilledWorker:
        raise TasksError(
            f"{MOST_DEATHS} workers died in the same task: check the memory, or use fewer workers"
        ) from None
    except (CancelledError, CommClosedError):
        raise TasksError("the connection to the dask scheduler is lost; finished results are saved") from None


class _Team:
    """Worker processes on this machine, each with a pipe; they end at the end of the `with` block."""

    def __init__(self, function, workers):
        self._function, self._workers = dumps(function), workers
        self._processes = {}  # {pipe: process}
        self._idle, self._working = [], {}  # pipes, {pipe: (k, item)}
        self._waiting = deque()  # (k, item)
        self._deaths = Counter()  # {k: number of workers that died in item k; None: during their start}
        self._begun = False  # True once a worker has been ready

    def __enter__(self):
        return self

    def results(self, items, expand):
        """Yield (k, result) in order of completion."""
        self._waiting.extend(enumerate(items))
        count = len(self._waiting)
        for _ in range(self._workers):
            self._start()
        while self._waiting or self._working:
            for pipe in connection.wait(self._processes):
                try:
                    succeeded, result = pickle.loads(pipe.recv_bytes())
                except (EOFError, OSError):
                    self._replace(pipe)
                    continue
                if not succeeded:
                    raise result
                self._begun = True
                self._idle.append(pipe)
                if pipe not in self._working:  # the first message of a worker: it is ready
                    del self._deaths[None]  # only successive deaths count
                    self._employ()
                    continue
                k, _ = self._working.pop(pipe)
                for more in () if expand is None else expand(k, result):
                    # Next, not last: related items finish together.
                    self._waiting.appendleft((count, more))
                    count += 1
                self._employ()  # first, so that workers run while the caller uses the result
                yield k, result

    def _employ(self):
        """Send the next items to the workers that wait for one."""
        while self._waiting and self._idle:
            pipe = self._idle.pop()
            self._working[pipe] = _, item = self._waiting.popleft()
            with suppress(OSError):  # the worker has died; `results` will find its pipe closed
                pipe.send_bytes(dumps(item))

    def _replace(self, pipe):
        """Start another worker for one that died, and repeat its item."""
        k, _ = work = self._working.pop(pipe, (None, None))
        if pipe in self._idle:
            self._idle.remove(pipe)
        elif k is None and not self._begun:
            raise self._no_workers("they ended")
        else:
            self._deaths[k] += 1
            if self._deaths[k] >= MOST_DEATHS:
                raise TasksError(f"{MOST_DEATHS} workers died in the same task: check the memory, or use fewer workers")
        if k is not None:
            self._waiting.appendleft(work)
        pipe.close()
        self._processes.pop(pipe).join()
        self._start()

    def _start(self):
        spawning = multiprocessing.get_context("spawn")
        try:
            pipe, theirs = spawning.Pipe()
            process = spawning.Process(target=_work, args=(theirs, self._function), daemon=True)
            with _interrupts_later(), _one_thread_each():
                process.start()
        except (OSError, RuntimeError) as error:
            raise self._no_workers(error) from None
        theirs.close()  # so that the pipe closes when the worker ends
        self._processes[pipe] = process

    def _no_workers(self, error):
        return TasksError(
            f"{self._workers} workers could not be started or died immediately ({error}): check "
            "the memory, or use fewer workers"
        )

    def __exit__(self, *_):
        for pipe, process in self._processes.items():
            pipe.close()  # ends a worker that waits for an item
            if pipe in self._working:
                process.kill()
        for process in self._processes.values():
            process.join(ENDING)
            process.kill()
            process.join()


def _work(pipe, function):
    """Worker process: answer each item with (True, result) or (False, exception)."""
    try:
        function = pickle.loads(function)
        answer = dumps((True, None))
        while True:
            pipe.send_bytes(answer)
            item = pickle.loads(pipe.recv_bytes())
            answer = dumps((True, function(item)))
    except (EOFError, BrokenPipeError):  # no further item, or the parent has ended
        return
    except Exception as error:
        answer = _failure(error)
    with suppress(OSError):
        pipe.send_bytes(answer)


def _failure(error):
    """Bytes of (False, exception); if the exception cannot be pickled, of a TasksError with its text."""
    try:
        answer = dumps((False, ExceptionWithTraceback(error, error.__traceback__)))
        pickle.loads(answer)
    except Exception:
        answer = dumps((False, TasksError(f"{type(error).__name__}: {error}")))
    return answer


@contextmanager
def _one_thread_each():
    """Processes started inside use one thread for linear algebra, because there is a process for each core."""
    new = [name for name in THREADS if name not in os.environ]
    os.environ.update(dict.fromkeys(new, "1"))
    try:
        yield
    finally:
        for name in new:
            del os.environ[name]


@contextmanager
def _interrupts_later():
    """Defer Ctrl-C to the end of the block. Processes started inside ignore it, because their parent
    handles it.
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
        raise TasksError("a scheduler needs the package distributed: pip install 'liegroup_sim_ros[many]'") from None
    try:
        client = Client(address, timeout=CONNECTING)
    except (OSError, TimeoutError, ValueError) as error:
        raise TasksError(f"no dask scheduler at {address}: {' '.join(str(error).split())[:200]}") from None
    with client:
        # The actual address: the given one may be a file, or lack the protocol.
        used = client.scheduler.address
        if used.split("://")[0] in ("tcp", "ws"):
            log.warning(
                "the dask scheduler at %s is used without TLS: anyone who can reach its port can run code "
                "there and on its workers. Start it with certificates, and give its tls:// address",
                used,
            )
        yield client
