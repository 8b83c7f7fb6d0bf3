# SPDX-License-Identifier: Apache-2.0
"""What the processes of all tests have in common."""

import json
import os
import signal
from pathlib import Path

import pytest
from volume import has_turn, some  # imports no NumPy

# One thread for BLAS, before any test loads NumPy: more make small solves slower.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Commands share their work out to one process for each core: to start others takes longer than the work of most tests.
os.cpu_count = lambda: 1
# A shell starts a process in the background with SIGINT ignored, and so would be the Ctrl-C of the tests.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def mjcf_here(monkeypatch, tmp_path):
    """MuJoCo's compiler in this process: to start and confine another one takes longer than most tests of its result.

    What it refuses goes to the confined process. That both have the same result: test_robot_errors.py.
    """
    from liegroup_core.robots import mjcf

    confined = mjcf.run_apart

    def compiled(tool, path, *rest, **keys):
        try:
            from liegroup_core.robots.mjcf_model import arrays_of

            return json.dumps(arrays_of(str(Path(path).resolve())))
        except Exception:
            return confined(tool, path, *rest, **keys)

    monkeypatch.setattr(mjcf, "run_apart", compiled)
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log into the working folder


def pytest_collection_modifyitems(config, items):
    """What `make test` leaves to other commits, see volume.py; a case or test that is named runs.

    Files with slow tests come first, so that no worker is left with one of them at the end.
    """
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)
    if any("::" in argument for argument in config.args):
        return
    cases, left = {}, []
    for item in items:
        volume, turn = (item.get_closest_marker(name) for name in ("volume", "turn"))
        if volume is not None:
            cases.setdefault((item.nodeid.partition("[")[0], *volume.args), []).append(item)
        if turn is not None and not has_turn(item.nodeid.partition("[")[0], *turn.args):
            left.append(item)
    kept = {item for (_, count), found in cases.items() for item in some(found, count)}
    left += [item for found in cases.values() for item in found if item not in kept]
    if left:
        gone = set(left)
        items[:] = [item for item in items if item not in gone]
        config.hook.pytest_deselected(items=left)
