# SPDX-License-Identifier: Apache-2.0
"""docs/how-to/design.md: trim, LQR, the closed loop in simulated time and over DDS, the check of its recording."""

import re
import shlex
import signal
from pathlib import Path

import numpy as np
import pytest
from node_process import NODE, PUSH, output_of, python
from scene_runs import Run
from sensor_msgs.msg import JointState

from liegroup_core import Simulation, load_scene
from liegroup_core.forces.commands import EFFORT, WRENCH, Command
from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.recording import read_recording

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "how-to" / "design.md").read_text()
FILES = dict(re.findall(r"^`(\w+\.\w+)`[^`\n]*:\n\n```\w+\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL))
COMMANDS = [
    shlex.split(line)
    for line in re.findall(r"^    ((?:sim_node|python|liegroup_sim) .*)$", PAGE.replace("\\\n", ""), re.MULTILINE)
]
PERIOD = 2e-3  # s, of the joint states


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Folder with the files of the page."""
    folder = tmp_path_factory.mktemp("page")
    assert list(FILES) == ["cart_pole.yaml", "design.py", "controller.py", "check.py"]
    for name, text in FILES.items():
        (folder / name).write_text(text)
    return folder


@pytest.fixture(scope="module")
def designed(folder):
    """Names of design.py after it ran."""
    pytest.importorskip("control")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        exec(compile(FILES["design.py"], "design.py", "exec"), names := {})
    return names


def control_into(publish):
    """Function of controller.py that takes a JointState, with another publisher."""
    exec(compile(FILES["controller.py"].partition("rclpy.init()")[0], "controller.py", "exec"), names := {})
    names["publisher"] = type("Publisher", (), {"publish": staticmethod(publish)})
    return names["control"]


def test_the_page_shows_the_trim_and_the_poles(folder, designed, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    (block,) = re.findall(r"^```sh\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    (command,) = [shlex.split(line) for line in block.splitlines()]
    assert command[0] == "liegroup_sim" and main(command[1:]) == 0
    printed = capsys.readouterr().out
    shown = re.search(r"^```$\n\n((?:    .*\n)+)", PAGE[PAGE.index(block) :], re.MULTILINE)[1]
    assert len(shown.splitlines()) == 4 and all(line.strip() in printed for line in shown.splitlines())

    unstable, real, imaginary = map(
        float, re.search(r"pole at ([\d.]+)/s is unstable.* are ([-\d.]+) ± ([\d.]+)i", PAGE, re.DOTALL).groups()
    )
    assert designed["plant"].poles().real.max() == pytest.approx(unstable, abs=5e-3)
    assert designed["found"].system.states == ("rail", "pivot", "rail.rate", "pivot.rate")  # x of controller.py
    assert max(designed["poles"], key=lambda p: (p.real, p.imag)) == pytest.approx(complex(real, imaginary), abs=7e-3)


@pytest.mark.turn(3)
def test_the_controller_of_the_page_has_the_designed_poles(folder, designed, monkeypatch, capsys, ros_node):
    """In simulated time: an effort acts 2 ms after the state that it follows from, as in the median over DDS."""
    import control

    monkeypatch.chdir(folder)
    efforts = [designed["found"].inputs["rail.effort"]]
    control_by = control_into(lambda message: efforts.extend(message.effort))
    simulation = Simulation(load_scene("cart_pole.yaml"), "rkmk4", 1e-3, estimate=False)
    given = {"start_paused": True, "estimate": False, "joint_state_rate": 1.0 / PERIOD, "record": "run.mcap"}
    with Run(ros_node, simulation, **given) as run:
        for k in range(round(10.0 / PERIOD)):
            commands = [Command(EFFORT, "rail", (efforts[-1],), source="controller")]
            for at, force in ((5.0, 5.0), (5.2, 0.0)):  # s, N: the push of the page
                if k == round(at / PERIOD):
                    commands.append(Command(WRENCH, "cart", (0.0, 0.0, 0.0, force, 0.0, 0.0), source="push"))
            names, coordinates = zip(*simulation.sample().joint_coordinates.items())
            position, velocity = zip(*coordinates)
            control_by(JointState(name=names, position=position, velocity=velocity))
            run.server.push(commands, None)
            run.call("step", 2)

    exec(compile(FILES["check.py"], "check.py", "exec"), names := {})
    said = capsys.readouterr().out
    assert re.search(r"deviation .* at the end: .*\nslowest poles: .* designed: .*\n", said), said
    sampled = control.c2d(designed["plant"], PERIOD)
    loop = np.block([[sampled.A, sampled.B], [-designed["K"], np.zeros((1, 1))]])  # of the state and the last effort
    expected = np.sort_complex(np.log(np.linalg.eigvals(loop) + 0j) / PERIOD)[-2:]
    slowest = np.sort_complex(names["measured"])[-2:]
    # Terms of second order: half of the largest angle, relative to those of the linear system.
    np.testing.assert_allclose(slowest, expected, rtol=0.5 * np.abs(names["x"][:, 1]).max())
    np.testing.assert_allclose(slowest, np.sort_complex(designed["poles"])[-2:], rtol=0.03)  # "within 3 %"
    states = read_recording("run.mcap").joint_states
    x = np.hstack([states.position, states.velocity]) - names["design"]["x"]
    assert states.names == ("rail", "pivot") and np.abs(x[0]).max() == pytest.approx(0.0997, abs=1e-4)
    assert np.abs(x[states.time > names["end"]]).max() > 0.2 and np.abs(x[-1]).max() < 0.01


@pytest.mark.turn(3)
def test_the_commands_of_the_page_close_the_loop(folder, designed, monkeypatch, client):
    """Three processes over DDS. How late an effort is depends on the machine; which state it follows from does not."""
    monkeypatch.chdir(folder)
    (_, *node), (_, script), (_, *push) = COMMANDS
    simulation = python(NODE, *node[:-1], "record:=live.mcap")
    controller = python(Path(script).read_text())
    assert node[-1] == "record:=run.mcap"
    given = client.given("/sim_node")
    try:
        client.until(lambda: sum(order.kind == "effort" for order in given) > 100, "efforts of the controller")
        output_of(python(PUSH, *push))
        for process in (simulation, controller):
            process.send_signal(signal.SIGINT)
            output_of(process)
    finally:
        simulation.kill()
        controller.kill()

    recording, design = read_recording("live.mcap"), np.load("design.npz")
    states = recording.joint_states
    follow = design["u"] - (np.hstack([states.position, states.velocity]) - design["x"]) @ design["K"][0]
    efforts = [command for command in recording.inputs if command.kind == "effort"]
    pushed = [command.values[3] for command in recording.inputs if command.kind == "wrench"]
    assert len(efforts) > 100 and 5.0 in pushed
    for command in efforts:
        before = states.time < command.start + 1e-6
        assert np.abs(follow[before] - command.values[0]).min() < 1e-9, command
