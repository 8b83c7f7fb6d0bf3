# SPDX-License-Identifier: Apache-2.0
"""docs/how-to/controller.md and tests.md: their code runs, with and without ROS to the same numbers."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from node_process import ENVIRONMENT

from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.recording.read import read_recording

SOURCE = Path(__file__).resolve().parents[2]


def blocks(page):
    text = (SOURCE / "docs" / "how-to" / page).read_text()
    return re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def test_the_pages_control_with_and_without_ros(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (without, with_ros), (test,) = blocks("controller.md"), blocks("tests.md")
    Path("pd.py").write_text(without)
    exec(compile(without, "controller.md", "exec"), {"__name__": "__main__"})
    angle = float(capsys.readouterr().out.split()[0])
    assert f"approx({angle}, abs=1e-6)" in test
    arguments = ["double_pendulum", "--duration", "2", "--step", "1e-3", "--rate", "10", "--control", "pd.py:setup"]
    assert main(["run", *arguments, "--out", "run.mcap"]) == 0
    assert len(read_recording("run.mcap").inputs) == 2000
    Path("hold.py").write_text(with_ros)
    Path("test_hold.py").write_text(test)
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    found = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_hold.py"],
        env=ENVIRONMENT | {"PATH": path, "PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path))},
        capture_output=True,
        text=True,
    )
    assert found.returncode == pytest.ExitCode.OK, found.stdout + found.stderr
