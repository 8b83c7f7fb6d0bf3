# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim demo` with a real node and a real wrench, leaving no processes behind."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import PATIENCE, wait_for

DEMO = "import sys; from liegroup_sim_ros.commands.main import main; sys.exit(main(sys.argv[1:]))"


def start(*arguments):
    # What runs in the background of a shell has SIGINT ignored, and hands that on.
    return subprocess.Popen(
        [sys.executable, "-c", DEMO, "demo", *map(str, arguments)],
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def running(out):
    """IDs of the processes whose command line contains this folder."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            if os.fsencode(out) in path.read_bytes():
                found.append(int(path.parent.name))
        except OSError:  # ended in the meantime
            continue
    return found


@pytest.mark.turn(2)
def test_demo(tmp_path):
    """Recording, report and figures of a run with a wrench that repeats bit for bit."""
    out = tmp_path / "out"
    out.mkdir()
    (out / "demo.mcap").write_text("of an earlier demo")
    demo = start("--seconds", 4, "--out", out)
    said, errors = demo.communicate(timeout=PATIENCE)
    assert demo.returncode == 0, errors
    assert running(out) == []
    (figures,) = json.loads((out / "demo.json").read_text())["logs"]
    assert figures["scene"] == "heavy_top" and figures["complete"]
    # One push; on a machine that stalls for longer than the wrench's hold time it has a gap.
    assert figures["pushes"] and figures["pushes"][-1]["to_s"] is not None
    assert figures["repeat"]["identical"] == figures["repeat"]["samples"] > 200
    assert not figures["lost_messages"] and not figures["missing_samples"]
    # The default accuracy, in the first 60 s and through the push.
    assert figures["promise"]["kept"] is True and figures["promise"]["beyond"] is False
    assert figures["reference"]["attitude"]["max"] < 1e-4
    for name in ("demo.mcap", "demo.html", "demo.json"):
        assert str(out / name) in said
    assert "applied from" in said and (out / "demo.html").stat().st_size > 1_000_000


@pytest.mark.turn(3)
def test_an_interrupted_demo_leaves_no_processes(tmp_path):
    out = tmp_path / "out"
    demo = start("--seconds", 60, "--out", out)
    try:
        wait_for(lambda: demo.poll() is not None or (out / "demo.mcap").exists() and len(running(out)) == 2)
        os.kill(demo.pid, signal.SIGINT)
        _, errors = demo.communicate(timeout=PATIENCE)
    finally:
        left = running(out)
        for process in left:
            os.kill(process, signal.SIGKILL)
    assert left == [] and demo.returncode == 130
    assert errors == "liegroup_sim: interrupted\n"
