# SPDX-License-Identifier: Apache-2.0
"""docs/tutorial.md and pages of docs/how-to: their commands and their Python code run."""

import os
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas
import pytest
from geometry_msgs.msg import WrenchStamped
from node_process import ENVIRONMENT, NODE, NodeProcess, output_of, push_command, python
from scipy.integrate import solve_ivp
from sensor_msgs.msg import Imu, JointState

from liegroup_core import Simulation
from liegroup_core.scene.load import scene_from_text
from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.recording.read import read_recording

SOURCE = Path(__file__).resolve().parents[2]
PAGE = (SOURCE / "docs" / "how-to" / "control.md").read_text()
COMMANDS = re.findall(r"^    sim_node (--ros-args .*)$", PAGE, re.MULTILINE)
SCRIPT = "\n".join(re.findall(r"^```python\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL))


def test_the_page_contains_commands_and_python_code():
    assert len(COMMANDS) == 5 and SCRIPT.count("import rclpy\n") == 1


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.volume(1)
def test_a_command_of_the_page_starts_a_node(client, tmp_path, command):
    command = command.replace("config/", f"{SOURCE / 'config'}/").replace("run.mcap", str(tmp_path / "run.mcap"))
    if "continue_from" in command:
        assert main(["run", "heavy_top", "--duration", "1", "--out", str(tmp_path / "run.mcap")]) == 0
    namespace = re.search(r"__ns:=(\S+)", command)
    events = client.events(f"{namespace[1] if namespace else ''}/sim_node")
    process = python(NODE, *shlex.split(command))
    try:
        client.until(lambda: events)
        process.send_signal(signal.SIGINT)
        output_of(process)
    finally:
        process.kill()


def test_the_python_code_of_the_page_runs(tmp_path):
    path = tmp_path / "run.mcap"
    with NodeProcess({"scene": "heavy_top", "record": path}) as process:
        script = python(SCRIPT)
        output = output_of(script)
        process.end()
    lines = output.splitlines()
    assert len(lines) == 11 and lines[0].startswith("paused at")
    assert lines[6].startswith("saved 'before the push' at")
    assert all(line.startswith("snapshot 'before the push' at") for line in lines[7:9])
    assert [line.partition(",")[0] for line in lines[1:4]] == ["10 steps"] * 3
    assert lines[9].startswith("wrench on top for 0.3 s")
    assert lines[10].startswith("double_pendulum at")
    assert {"pause", "step", "reset", "speed", "resume", "save", "state"} <= {
        event.name for event in read_recording(path).events
    }


REACTIONS = (SOURCE / "docs" / "how-to" / "reactions.md").read_text()


def test_the_commands_of_the_page_on_reactions_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"^```sh\n(.*?)^```$", REACTIONS, re.MULTILINE | re.DOTALL)
    lines = [shlex.split(line) for line in "".join(blocks).replace("\\\n", "").splitlines()]
    for program, *arguments in lines:
        assert program == "liegroup_sim" and main(arguments) == 0, arguments
    assert [line[1] for line in lines] == ["run", "analyze", "sweep", "run", "describe"]
    assert "elbow.effort [N m]" in Path("torques.csv").read_text()
    assert "Reaction forces" in Path("crank.html").read_text()
    loads = pandas.read_parquet("loads.parquet")
    assert (loads["largest.shaft.fx"] > 0.0).all() and "undetermined" in capsys.readouterr().out


CONTACTS = (SOURCE / "docs" / "how-to" / "contacts.md").read_text()


def test_the_page_on_contacts_runs(tmp_path, monkeypatch):
    """Its commands run; in the end the ball rolls: 5/7 of its speed, but for what the impacts turn earlier or later."""
    monkeypatch.chdir(tmp_path)
    (text,) = re.findall(r"^```yaml\n(.*?)^```$", CONTACTS, re.MULTILINE | re.DOTALL)
    Path("skid.yaml").write_text(text)
    (block,) = re.findall(r"^```sh\n(.*?)^```$", CONTACTS, re.MULTILINE | re.DOTALL)
    for line in block.splitlines():
        program, *arguments = shlex.split(line)
        assert program == "liegroup_sim" and main(arguments) == 0, arguments
    assert "floor" in Path("skid.html").read_text()
    simulation = Simulation(scene_from_text(text), quiet=True)
    simulation.advance_to(3.0)
    assert np.linalg.norm(simulation.sample().twist[0, 3:]) == pytest.approx(5.0 / 7.0, abs=1e-6)


LAWS = (SOURCE / "docs" / "how-to" / "laws.md").read_text()


def test_the_page_on_laws_runs(tmp_path, monkeypatch):
    """Its commands run. Its forces, alone and together, move the pendulum as SciPy does: to the default accuracy.

    The sampled one is constant between the instants at which its outputs start.
    """
    monkeypatch.chdir(tmp_path)
    follower, bearing, sampled = re.findall(r"^```yaml\n(.*?)^```$", LAWS, re.MULTILINE | re.DOTALL)
    Path("follower.yaml").write_text(follower)
    (block,) = re.findall(r"^```sh\n(.*?)^```$", LAWS, re.MULTILINE | re.DOTALL)
    for line in block.replace("\\\n", "").splitlines():
        program, *arguments = shlex.split(line)
        assert program == "liegroup_sim" and main(arguments) == 0, arguments
    assert "Law pd" in Path("run.html").read_text()
    assert pandas.read_parquet("gains.parquet")["pd.miss"].abs().between(0.001, 0.2).all()

    def torques(t, q, w):
        size = 0.3 + (0.5 - 0.3) * np.exp(-((w / 0.1) ** 2))
        follows = np.clip(60 * (0.5 * np.sin(2 * t) - q) - 6 * w, -20, 20)
        return follows, -size * np.tanh(w / 0.01) - 0.02 * w

    head, pd = follower.split("  - name: pd\n")
    entries = "  - name: pd\n" + pd, bearing, sampled
    for acting in ([0], [1], [2], [0, 1, 2]):
        simulation = Simulation(scene_from_text(head + "".join(entries[k] for k in acting)), quiet=True)
        simulation.advance_to(3.0)
        y, total, held, late = np.zeros(2), 0.0, 0.0, 0.0
        for k in range(600 if 2 in acting else 1):
            begin, end = (0.01 * (k // 2) + 0.004 * (k % 2), 0.01 * ((k + 1) // 2) + 0.004 * ((k + 1) % 2))
            if k % 2:
                held = late
            elif 2 in acting:
                miss = 0.3 - y[0]
                late, total = 30 * miss + 80 * total - 4 * y[1], total + 0.01 * miss

            def slope(t, y, held=held, acting=acting):
                effort = held + sum(torques(t, *y)[k] for k in acting if k < 2)
                return [y[1], (effort - 1.2 * 9.81 * 0.4 * np.sin(y[0])) / (0.1 + 1.2 * 0.4**2)]

            span = (begin, end) if 2 in acting else (0.0, 3.0)
            y = solve_ivp(slope, span, y, "Radau", rtol=1e-8, atol=1e-10, max_step=0.01).y[:, -1]
        assert simulation.sample().joint_coordinates["hinge"][0] == pytest.approx(y[0], abs=1e-4)
        assert acting == [1] or abs(y[0]) > 0.01


STOPS = (SOURCE / "docs" / "how-to" / "stops.md").read_text()


def test_the_page_on_stops_runs_and_prints_what_it_shows(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    robot = (SOURCE / "docs" / "how-to" / "robot.md").read_text()
    (arm,) = re.findall(r"^```xml\n(<robot.*?)^```$", robot, re.MULTILINE | re.DOTALL)[:1]
    Path("arm.urdf").write_text(arm)
    blocks = re.findall(r"^```sh\n(.*?)^```$", STOPS, re.MULTILINE | re.DOTALL)
    for line in "".join(blocks).splitlines():
        program, *arguments = shlex.split(line)
        assert program == "liegroup_sim" and main(arguments) == 0, arguments
    capsys.readouterr()
    code, more = re.findall(r"^```python\n(.*?)^```$", STOPS, re.MULTILINE | re.DOTALL)
    names = {}
    exec(compile(code, "stops.md", "exec"), names)
    said = capsys.readouterr().out
    shown = re.search(r"^```$\n\n((?:    .*\n)+)", STOPS[STOPS.index(code) :], re.MULTILINE)[1]
    for line in shown.splitlines():
        assert line.strip() == "..." or line.strip() in said
    exec(compile(more, "stops.md", "exec"), names)
    assert capsys.readouterr().out.startswith("0.80409362")


def test_the_sensors_of_the_page_on_reactions_run(tmp_path, monkeypatch, capsys, client):
    monkeypatch.chdir(tmp_path)
    scene, code = (
        re.findall(rf"^```{kind}\n(.*?)^```$", REACTIONS, re.MULTILINE | re.DOTALL)[0] for kind in ("yaml", "python")
    )
    Path("rod.yaml").write_text(scene)
    exec(compile(code, "reactions.md", "exec"), {})
    said = capsys.readouterr().out
    assert all(name in said for name in ("imu", "disc", "bearing"))
    (command,) = re.findall(r"^    sim_node (--ros-args .*)$", REACTIONS, re.MULTILINE)
    process = python(NODE, *shlex.split(command.replace("rod.yaml", str(tmp_path / "rod.yaml"))))
    try:
        heard = [
            client.listen(f"/sim_node/{topic}", kind)
            for topic, kind in (
                ("imu/imu", Imu),
                ("disc/joint_state", JointState),
                ("bearing/wrench", WrenchStamped),
                ("hinge/wrench", WrenchStamped),
            )
        ]
        client.until(lambda: all(heard), "a message of each sensor")
        process.send_signal(signal.SIGINT)
        output_of(process)
    finally:
        process.kill()


# The scene and commands of the tutorial run as printed, in the order of the page.


TUTORIAL_PAGE = (Path(__file__).resolve().parents[2] / "docs" / "tutorial.md").read_text()
[SCENE] = re.findall(r"```yaml\n(.*?)```", TUTORIAL_PAGE, re.DOTALL)
TUTORIAL_COMMANDS = re.findall(r"```sh\n(.*?)\n```", TUTORIAL_PAGE, re.DOTALL)
LINES = [shlex.split(line) for block in TUTORIAL_COMMANDS for line in block.splitlines()]


@pytest.mark.turn(2)
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
