# SPDX-License-Identifier: Apache-2.0
"""Wrong arguments and files of every subcommand: one line on stderr, exit code 2, nothing written or replaced."""

import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from made_run import PAIR, record
from robot_texts import ARM_URDF
from scene_files import ROOT, text_of

from liegroup_core.scene.load import scene_from_text
from liegroup_core.study import tasks
from liegroup_sim_ros.commands.main import main

TABLE = yaml.safe_load(Path(__file__).with_name("wrong_commands.yaml").read_text())
COLUMN = "time,ground_crank.position\n"
FILES = {
    "empty.csv": "time\n",
    "text.csv": f"{COLUMN}0,1\n1,x\n2,1\n",
    "back.csv": f"{COLUMN}0,1\n1,1\n1,1\n",
    "other.csv": "time,elbow.position\n0,1\n1,1\n2,1\n",
    "short.csv": f"{COLUMN}0,1\n1\n2,1\n",
    "twice.csv": "time,time\n0,1\n1,1\n",
    "large.csv": f"{COLUMN}0,1e200\n1,1\n",
    "few.csv": "\ufefftime,ground_crank.position,left.position\n0,0,0\n1,0.1,0\n2,0.2,0\n",
    "wheel.csv": "time,left.position\n" + "".join(f"{k},0\n" for k in range(8)),
    "far.csv": f"{COLUMN}0,0\n1,2\n2,4\n",
    "degrees.csv": "time [s],ground_crank.position [deg]\n0,0\n1,2\n2,4\n",
    "fast.csv": "time,ground_crank.position [rad],ground_crank.velocity [ rad/s ]\n"
    + "".join(f"{0.1 * k:g},{0.1 * k:g},5\n" for k in range(8)),
    "two.csv": "time,shoulder.position,elbow.position\n" + "".join(f"{k},0,0\n" for k in range(8)),
    **{f"taken.{kind}": "mine" for kind in ("npz", "mcap", "parquet")},
    "fall.yaml": text_of("fall.yaml"),
    "rover.urdf": text_of("rover.urdf"),
    "bad.urdf": ARM_URDF.replace('"upper"/>', '"uper"/>', 1),
    "arm.urdf": (ROOT / "docs" / "how-to" / "robot.md").read_text().split("```xml\n")[1].split("```")[0],
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Folder with the files that the command lines name."""
    folder = tmp_path_factory.mktemp("wrong")
    for name, text in FILES.items():
        (folder / name).write_text(text)
    (folder / "binary.csv").write_bytes(b"\xff\xfe\x00time")
    (folder / "folder.mcap").mkdir()
    record(folder / "run.mcap", scene_from_text(PAIR), 2000)
    return folder


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


@pytest.mark.parametrize("command", TABLE)
def test_every_wrong_command_line_has_one_line_and_exit_code_2(command, folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    monkeypatch.setattr(tasks, "CONNECTING", 1)  # s instead of 10: nothing listens on that port
    before = contents(folder)
    for line, says in TABLE[command]:
        try:
            code = main([command, *shlex.split(line)])
        except SystemExit as stop:
            code = stop.code
        out, err = capsys.readouterr()
        *progress, said = err.splitlines()
        assert (code, out) == (2, "") and says in err and said.startswith("liegroup_sim"), (line, says, err)
        assert all(" 0/" in each for each in progress), (line, err)
    assert contents(folder) == before


def test_keys_prints_the_tables_of_a_word(capsys):
    assert main(["keys", "servo", "couplings"]) == 0
    printed = capsys.readouterr().out
    assert "effort_limit" in printed and "backlash" in printed and "quadratic" not in printed


def test_a_signal_ends_a_command_at_once_with_one_line():
    """SIGTERM while another thread has work for an hour, which Python would wait for."""
    script = """
import os, signal, sys, threading, time
from concurrent.futures import ThreadPoolExecutor
from liegroup_sim_ros.commands import identify, main
def run(args):
    ThreadPoolExecutor(1).submit(time.sleep, 3600)
    print("before")
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(3600)
identify.run = run
sys.exit(main.main())
"""
    command = [sys.executable, "-c", script, "identify", "scene.yaml", "bag", "--vary", "gravity.2"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "before\n", "liegroup_sim: interrupted\n")
