# SPDX-License-Identifier: Apache-2.0
"""Compiling that is interrupted, or whose cache cannot be written, leaves nothing behind.

Each time, the kernels of the self-check are compiled under another name, in a process of their own
with an empty cache folder: `check` raises unless the results are right.
"""

import os
import subprocess
import sys

import pytest

from liegroup_core.compiling import backend, compiled

pytestmark = pytest.mark.skipif(
    not compiled() or backend.chosen().cache() is None, reason="nothing is compiled or kept"
)

FRESH = """
import _thread, ctypes, importlib.util, os, random, signal, sys, threading, time
from contextlib import suppress
from liegroup_core.compiling import backend, check, undisturbed

def fresh(name):
    name = f"liegroup_core.compiling.check_{name}"
    module = importlib.util.module_from_spec(importlib.util.spec_from_file_location(name, check.__file__))
    sys.modules[name] = module
    module.__spec__.loader.exec_module(module)
    return module

def seconds(name):
    start = time.perf_counter()
    fresh(name).check()
    return time.perf_counter() - start

def interrupt(number, frame):
    raise KeyboardInterrupt

backend.chosen()
signal.signal(signal.SIGALRM, interrupt)
random.seed(1)
"""
BY_SIGNAL = """
def disturbed(module, after):
    signal.setitimer(signal.ITIMER_REAL, max(after, 1e-6))
    try:
        module.check()
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
"""
# As libraries for timeouts do it: in another thread than the main one too. Without the module threading,
# whose own locks such an exception may leave taken.
FROM_OUTSIDE = """
def disturbed(module, after):
    failure = []
    def work():
        with suppress(KeyboardInterrupt):  # it may arrive when the thread is about to end
            try:
                module.check()
            except BaseException as error:
                failure.append(error)
    thread = _thread.start_new_thread(work, ())
    time.sleep(after)
    ctypes.pythonapi.PyThreadState_SetAsyncExc(
        ctypes.c_ulong(thread), ctypes.py_object(KeyboardInterrupt)
    )
    while thread in sys._current_frames():
        time.sleep(1e-3)
    if failure:
        raise failure[0]
"""
ROUNDS = """
counts = {"compiled": 0, "loaded": 0}
whole, loading = seconds("whole"), seconds("whole")
for k in range(24):
    for kind, longest in (("compiled", whole), ("loaded", loading)):
        module = fresh(k)
        try:
            disturbed(module, random.uniform(0.0, longest))
        except KeyboardInterrupt:
            counts[kind] += 1
        module.check()
print(min(counts.values()))
"""


def run(code, cache, ends=0):
    done = subprocess.run(
        [sys.executable, "-c", FRESH + code],
        capture_output=True,
        text=True,
        timeout=300,
        env={**os.environ, "LIEGROUP_CACHE_DIR": str(cache)},
    )
    assert done.returncode == ends, done.stderr
    return done.stdout, done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("interrupted", [BY_SIGNAL, FROM_OUTSIDE], ids=["signal", "asynchronous"])
@pytest.mark.volume(1)
@pytest.mark.turn(3)
def test_after_an_interrupt_at_any_time_kernels_work(tmp_path, interrupted):
    """While they are compiled, and while they are loaded from the cache."""
    out, _ = run(interrupted + ROUNDS, tmp_path)
    assert int(out) >= 5


def test_threads_that_need_a_kernel_at_once_get_it(tmp_path):
    out, err = run(
        """
module, failed = fresh("shared"), []
def work():
    try:
        module.check()
    except Exception as error:
        failed.append(error)
threads = [threading.Thread(target=work) for _ in range(6)]
for each in threads: each.start()
for each in threads: each.join()
print(failed, len(module._steps.dispatcher.overloads))
""",
        tmp_path,
    )
    assert out.split() == ["[]", "1"] and err == ""


FAILING = """
from liegroup_core.compiling import inlining
def fail(*arguments):
    raise MemoryError
inlining.write = fail
fresh("kept").check()
print("done")
"""
DYING = """
os.replace = lambda *arguments: os._exit(9)
fresh("kept").check()
"""


@pytest.mark.skipif(backend.chosen().name != "inlining", reason="plain Numba writes its own cache")
@pytest.mark.turn(3)
def test_a_cache_that_was_not_written_is_written_later(tmp_path):
    """Without memory for it, and by a process that dies before it has written a file."""
    out, err = run(FAILING, tmp_path)
    assert out == "done\n" and err.count("Compiled kernels cannot be cached") == 1
    assert "out of memory" in err and len(err.splitlines()) == 1
    run(DYING, tmp_path, ends=9)
    report = "module = fresh('kept'); module.check(); print(module._steps.dispatcher.stats.cache_misses)"
    again = [run(report, tmp_path)[0] for _ in range(2)]
    assert again[0] != "Counter()\n" and again[1] == "Counter()\n"


@pytest.mark.turn(3)
def test_the_process_ends_soon_after_an_interrupt(tmp_path):
    """The work that continues is waited for only up to the next function."""
    out, err = run(
        BY_SIGNAL
        + """
whole = seconds("whole")
try:
    disturbed(fresh("interrupted"), 0.3 * whole)
except KeyboardInterrupt:
    print("interrupted", len(undisturbed._working))
""",
        tmp_path,
    )
    assert out == "interrupted 1\n" and err == ""


@pytest.mark.turn(3)
def test_the_first_use_of_the_compiler_may_be_any(tmp_path):
    """The address of a Struct, and a kernel that is called while its module is imported."""
    (tmp_path / "calls.py").write_text("from liegroup_core.compiling.check import check\ncheck()\nprint('checked')\n")
    address = "Inner(matrix=np.zeros((2, 2)), shift=1.0).address > 0"
    for k, code in enumerate((f"from liegroup_core.compiling.check import *; print({address})", "import calls")):
        done = subprocess.run(
            [sys.executable, "-c", f"import sys; sys.path.append({str(tmp_path)!r}); {code}"],
            capture_output=True,
            text=True,
            timeout=300,
            env={**os.environ, "LIEGROUP_CACHE_DIR": str(tmp_path / str(k))},
        )
        assert done.stdout == ("True\n", "checked\n")[k], done.stderr
