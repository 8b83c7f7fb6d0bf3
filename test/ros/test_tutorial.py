# SPDX-License-Identifier: Apache-2.0
"""The scene and commands of the tutorial run as printed, in the order of the page."""

import re
import shlex
from pathlib import Path

from node_process import NodeProcess, push_command

from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.recording import read_recording

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "tutorial.md").read_text()
[SCENE] = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
COMMANDS = re.findall(r"```sh\n(.*?)\n```", PAGE, re.DOTALL)
LINES = [shlex.split(line) for block in COMMANDS for line in block.splitlines()]


def test_all_tutorial_commands_without_ros(tmp_path, monkeypatch, capsys):
    (tmp_path / "crane.yaml").write_text(SCENE)
    monkeypatch.chdir(tmp_path)
    done = []
    for program, *arguments in LINES:
        if program == "liegroup_sim" and arguments[0] != "push":
            assert main(arguments) == 0, arguments
            done.append(arguments[0])
    assert done == ["describe", "run", "run", "analyze", "run", "analyze", "trade", "run"]
    said = " ".join(capsys.readouterr().out.split())
    assert "crane: 2 degrees of freedom" in said and "none redundant" in said
    assert said.count("re-simulation bit-identical") == 2
    for accuracy in ("0.0001", "1e-08"):
        assert f"the accuracy of {accuracy} in 60 s is kept" in said
    assert {path.name for path in tmp_path.glob("crane.*")} == {
        f"crane.{kind}" for kind in ("yaml", "npz", "mcap", "html")
    }


def test_the_node_runs_the_tutorial_scene_with_a_wrench(client, tmp_path):
    scene, live = tmp_path / "crane.yaml", tmp_path / "live.mcap"
    scene.write_text(SCENE)
    assert ["sim_node", "--ros-args", "-p", "scene:=crane.yaml", "-p", "record:=live.mcap"] in LINES
    [push] = [line[2:] for line in LINES if line[:2] == ["liegroup_sim", "push"]]
    with NodeProcess({"scene": scene, "record": live}) as process:
        assert push_command(*push) == 0
        process.end()
    recording = read_recording(live)
    assert recording.complete and max(command.values[3] for command in recording.inputs) == 100.0
