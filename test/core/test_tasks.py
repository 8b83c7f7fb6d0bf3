# SPDX-License-Identifier: Apache-2.0
"""Parallel work: no result is lost or duplicated, even if workers are killed.

Functions are defined inside the tests, so that they are sent to the workers by value.
"""

import errno
import os
import signal
from multiprocessing.context import SpawnProcess

import pytest

from liegroup_core.study import tasks


def square(x):
    return x * x


@pytest.mark.parametrize("workers", [1, 2])
def test_results_can_add_new_items(workers):
    """Items that follow from results; a worker is killed once, and its item is repeated."""

    def halve(x):
        return x // 2

    results = dict(tasks.run(halve, [8, 5], workers=workers, expand=lambda k, result: [result] if result else []))
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
    import psutil

    def blocks_sigint(x):
        return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])

    assert dict(tasks.run(blocks_sigint, [1, 2], workers=2)) == {0: True, 1: True}
    started, start = [], SpawnProcess.start

    def interrupted(process):
        start(process)
        os.kill(os.getpid(), signal.SIGINT)
        started.append(process)

    monkeypatch.setattr(SpawnProcess, "start", interrupted)
    # Shells start background processes with SIGINT ignored.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            list(tasks.run(square, [1, 2], workers=2))
        assert len(started) == 1
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler and not blocks_sigint(0)
    finally:
        signal.signal(signal.SIGINT, before)
    started[0].join(60)
    assert not [child for child in psutil.Process().children() if "spawn_main" in " ".join(child.cmdline())]


def test_workers_that_cannot_start_are_an_error(monkeypatch):
    def fail(process):
        raise OSError(errno.ENOMEM, "Cannot allocate memory")

    monkeypatch.setattr(SpawnProcess, "start", fail)
    with pytest.raises(tasks.TasksError, match="2 workers could not be started.*check the memory"):
        list(tasks.run(square, [1, 2], workers=2))


def test_workers_that_die_at_once_are_an_error():
    """Before they are ready: their function cannot even be read."""

    class Deadly:
        def __reduce__(self):
            return os._exit, (1,)

        def __call__(self, item):
            """Never called."""

    with pytest.raises(tasks.TasksError, match="2 workers .* died immediately.*check the memory"):
        list(tasks.run(Deadly(), [1, 2], workers=2))


def test_a_killed_worker_without_a_task_is_replaced():
    """One item kills all other workers: the one that waits, and later its successor."""

    def kill_others(parent):
        import time

        import psutil

        if parent is None:
            return True
        time.sleep(0.2)  # the other worker has its item, which takes no time
        for child in psutil.Process(parent).children():
            if child.pid != os.getpid():
                try:
                    if "spawn_main" in " ".join(child.cmdline()):
                        os.kill(child.pid, signal.SIGKILL)
                except psutil.Error:  # it is just being replaced
                    pass
        return True

    def follow(k, result):
        return [parent] if len(items) < 3 and not items.append(k) else []

    parent, items = os.getpid(), []
    found = dict(tasks.run(kill_others, [parent, None], workers=2, expand=follow))
    assert found == dict.fromkeys(range(5), True)


def test_workers_open_no_port():
    """No process of the run listens: neither at a port nor at a socket with a name."""

    def listening(parent):
        import time

        import psutil

        processes = [psutil.Process(parent), *psutil.Process(parent).children(recursive=True)]
        held = set()
        for process in processes:
            for number in os.listdir(f"/proc/{process.pid}/fd"):
                try:
                    held.add(os.readlink(f"/proc/{process.pid}/fd/{number}"))
                except FileNotFoundError:
                    pass
        found = []
        for kind in ("tcp", "tcp6", "udp", "udp6", "unix"):
            for line in open(f"/proc/net/{kind}").read().splitlines()[1:]:
                entry = line.split()
                inode = entry[6] if kind == "unix" else entry[9]
                named = kind != "unix" or len(entry) > 7
                if f"socket:[{inode}]" in held and named:
                    found.append(line)
        time.sleep(0.2)  # so that the other worker has its item
        return os.getpid(), len(processes), found

    before = listening(os.getpid())[2]
    found = dict(tasks.run(listening, [os.getpid()] * 4, workers=2))
    assert len({pid for pid, _, _ in found.values()}) == 2
    assert all(count >= 3 and new == before for _, count, new in found.values())


@pytest.mark.parametrize("encrypted", [False, True])
def test_a_cluster_without_tls_gives_one_warning(caplog, tmp_path, encrypted):
    """Certificates are those of Dask's configuration. Without them nobody reaches the scheduler."""
    import dask
    from dask.distributed import Client, LocalCluster
    from distributed.security import Security

    security = Security()
    if encrypted:
        pytest.importorskip("cryptography")
        security = Security.temporary()
    cluster = LocalCluster(
        n_workers=1,
        threads_per_worker=1,
        processes=False,
        dashboard_address=None,
        protocol="tls" if encrypted else "tcp",
        host="127.0.0.1",
        security=security,
    )
    settings = {}
    if encrypted:
        files = {"ca": security.tls_ca_file, "cert": security.tls_client_cert}
        for name, text in (files | {"key": security.tls_client_key}).items():
            (tmp_path / name).write_text(text)
        settings = {
            "distributed.comm.tls.ca-file": str(tmp_path / "ca"),
            "distributed.comm.tls.client.cert": str(tmp_path / "cert"),
            "distributed.comm.tls.client.key": str(tmp_path / "key"),
        }
    with cluster:
        with dask.config.set(settings):
            found = list(tasks.run(square, [3], scheduler=cluster.scheduler_address))
        assert found == [(0, 9)]
        said = [each.getMessage() for each in caplog.records if each.name == "liegroup_core"]
        assert len(said) == (not encrypted)
        if encrypted:
            with pytest.raises((OSError, TypeError)):  # a client without certificates
                Client(cluster.scheduler_address, timeout=2)
        else:
            assert f"{cluster.scheduler_address} is used without TLS" in said[0]


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


def test_a_worker_killed_while_it_sends_its_result_loses_nothing(tmp_path):
    """Workers that shared a pipe would wait for the rest of its message."""
    died = tmp_path / "died"

    def die_sending(x):
        import sys
        import threading

        def kill():
            while True:
                for frame in sys._current_frames().values():
                    while frame and frame.f_code.co_name != "_send":
                        frame = frame.f_back
                    if frame:
                        os.kill(os.getpid(), signal.SIGKILL)

        if x == 3 and not died.exists():
            died.touch()
            threading.Thread(target=kill, daemon=True).start()
            return bytes(2**26)
        return x

    results = list(tasks.run(die_sending, range(8), workers=2))
    assert died.exists() and sorted(results) == [(x, x) for x in range(8)]
