# SPDX-License-Identifier: Apache-2.0
"""docs/how-to/control.md: its commands start a node, and its Python code controls one."""

import re
import shlex
import signal
from pathlib import Path

import pytest
from node_process import COMPILING, NODE, NodeProcess, python
from rcl_interfaces.msg import Log
from rclpy.qos import DurabilityPolicy, QoSProfile

from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.recording.read import read_recording

SOURCE = Path(__file__).resolve().parents[2]
PAGE = (SOURCE / "docs" / "how-to" / "control.md").read_text()
COMMANDS = re.findall(r"^    sim_node (--ros-args .*)$", PAGE, re.MULTILINE)
SCRIPT = "\n".join(re.findall(r"^```python\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL))


def test_the_page_contains_commands_and_python_code():
    assert len(COMMANDS) == 6 and SCRIPT.count("import rclpy\n") == 1


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_of_the_page_starts_a_node(client, tmp_path, command):
    command = command.replace("config/", f"{SOURCE / 'config'}/").replace(
        "run.mcap", str(tmp_path / "run.mcap")
    )
    if "continue_from" in command:
        assert (
            main(["run", "heavy_top", "--duration", "1", "--out", str(tmp_path / "run.mcap")]) == 0
        )
    namespace = re.search(r"__ns:=(\S+)", command)
    events = client.listen(
        f"{namespace[1] if namespace else ''}/sim_node/events",
        Log,
        QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL),
    )
    process = python(NODE, *shlex.split(command))
    try:
        client.until(lambda: events, COMPILING)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=30)
        assert process.returncode == 0, errors
    finally:
        process.kill()


def test_the_python_code_of_the_page_runs(tmp_path):
    path = tmp_path / "run.mcap"
    with NodeProcess({"scene": "heavy_top", "record": path}) as process:
        script = python(SCRIPT.replace('"run.mcap"', repr(str(path))))
        output, errors = script.communicate(timeout=COMPILING)
        assert script.returncode == 0, errors
        process.send(signal.SIGINT)
        assert process.wait()[0] == 0
    lines = output.splitlines()
    assert len(lines) == 13 and lines[0].startswith("paused at")
    assert lines[6].startswith("saved 'before the push' at")
    assert all(line.startswith("snapshot 'before the push' at") for line in lines[7:9])
    assert [line.partition(",")[0] for line in lines[1:4]] == ["10 steps"] * 3
    assert lines[9].startswith("wrench on top for 0.3 s")
    assert lines[10].startswith("double_pendulum at") and lines[11].startswith("it is ")
    assert "'/sim_node/top/pose'" in lines[12]
    assert {"pause", "step", "reset", "speed", "resume", "save", "state"} <= {
        event.name for event in read_recording(path).events
    }
