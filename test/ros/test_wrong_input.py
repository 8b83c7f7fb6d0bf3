# SPDX-License-Identifier: Apache-2.0
"""Wrong parameters and files of the node and of every subcommand: one line on stderr, and exit code 2."""

import json
import resource
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from made_run import PAIR, record
from node_process import output_of, python, refusal
from robot_texts import ARM_URDF
from scene_files import ROOT, text_of

from liegroup_core.scene.load import scene_from_text
from liegroup_core.study import tasks
from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.node.parameters import TABLE

# Runs the node's entry point for every argument list on stdin, with the file descriptor of stderr
# caught, for ROS's libraries write there, too.
BATCH = """
import json, os, sys, tempfile
from liegroup_sim_ros.node.entry import main
answers, stderr = [], os.dup(2)
for arguments in json.load(open(sys.argv[1])):
    with tempfile.TemporaryFile() as caught:
        os.dup2(caught.fileno(), 2)
        try:
            code = main(["sim_node", "--ros-args", *arguments])
        except BaseException as error:
            code = repr(error)
        sys.stderr.flush()
        os.dup2(stderr, 2)
        caught.seek(0)
        answers.append([code, caught.read().decode()])
print(json.dumps(answers))
"""

SCENE = yaml.safe_load(text_of("rig_wrong_input.yaml"))
NEEDED = {
    "name",
    "gravity",
    "bodies",
    "mass",
    "inertia",
    "type",
    "parent",
    "child",
    "stiffness",
    "radius",
    "parent_frame",
}
NO_NUMBER = st.sampled_from([float("nan"), float("inf"), "wide", {"a": 1}, None, [[]], True])
NO_TEXT = st.sampled_from([3.5, {"a": 1}, None, ["a"], True, ""])
WORD = st.from_regex(r"[a-z]{3,8}_[0-9]{3}", fullmatch=True)  # none of them means anything


def places(node, path=()):
    """Paths of all mappings, lists and values in a scene."""
    yield path
    items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, value in items:
        yield from places(value, (*path, key))


PLACES = list(places(SCENE))


def at(scene, path):
    for key in path:
        scene = scene[key]
    return scene


@st.composite
def wrong_scene(draw):
    """Text of a scene with one error."""
    scene = json.loads(json.dumps(SCENE))
    kind = draw(st.sampled_from(["unknown key", "wrong value", "key missing", "cut", "bytes"]))
    if kind == "unknown key":
        path = draw(st.sampled_from([p for p in PLACES if isinstance(at(SCENE, p), dict)]))
        at(scene, path)[draw(WORD)] = 1
    elif kind == "wrong value":
        path = draw(st.sampled_from([p for p in PLACES if p and not isinstance(at(SCENE, p), (dict, list))]))
        numeric = isinstance(at(SCENE, path), float)
        at(scene, path[:-1])[path[-1]] = draw(NO_NUMBER if numeric else NO_TEXT)
    elif kind == "key missing":
        path = draw(st.sampled_from([p for p in PLACES if p and p[-1] in NEEDED]))
        del at(scene, path[:-1])[path[-1]]
    elif kind == "bytes":
        return draw(st.binary(min_size=1, max_size=200))
    text = yaml.dump(scene, default_flow_style=True, width=10**6)
    # The last brace closes the first one: whatever is cut off, it is missing.
    return (text[: draw(st.integers(1, len(text) - 3))] if kind == "cut" else text).encode()


@st.composite
def wrong_parameters(draw):
    """Text of a parameter file with one wrong parameter."""
    kind = draw(st.integers(0, 9))
    if kind == 0:
        return draw(st.binary(min_size=1, max_size=100))
    if kind == 1:
        given = {"scene": "heavy_top"}
        return yaml.dump(
            draw(
                st.sampled_from(
                    [
                        given,
                        {"/**": given},
                        {"ros__parameters": given},
                        {"/**": {draw(WORD): given}},
                        {draw(WORD): {"ros__parameters": given}},
                        {"/**": {"ros__parameters": [given]}},
                        [{"/**": {"ros__parameters": given}}],
                    ]
                )
            )
        ).encode()
    if kind < 4:
        name = draw(WORD) if kind == 2 else f"{draw(st.sampled_from(TABLE)).name}.{draw(WORD)}"
        value = draw(st.sampled_from([1, 1.5, "text", True, [], [[]], "x" * 5000]))
    else:
        entry = draw(st.sampled_from(TABLE))
        name = entry.name
        values = [[1.0, 2.0], [True], [], [[]], [draw(WORD)]]
        if type(entry.default) is not str or entry.choices:
            values += [draw(WORD), "x" * 5000]
        if type(entry.default) is float:
            values += [float("nan"), float("inf"), -1.0, entry.high * 10.0, True]
            values += [entry.low / 2.0 or 5e-324]
        elif type(entry.default) is int:
            values += [entry.low - 1, entry.high + 1, 1.5, True]
        elif type(entry.default) is bool:
            values += [1, 0.0]
        else:
            values += [1, 2.5, False]
        value = draw(st.sampled_from(values))
    return yaml.dump({"/**": {"ros__parameters": {"scene": "heavy_top", name: value}}}).encode()


def answers(folder, files, arguments):
    """[(file text, exit code, stderr)] of one process that handles all files in turn."""
    cases = []
    for i, text in enumerate(files):
        path = folder / f"{i}.yaml"
        path.write_bytes(text)
        cases.append([part.format(path) for part in arguments])
    batch = folder / "batch.json"
    batch.write_text(json.dumps(cases))
    process = python(BATCH, batch)
    return zip(files, *zip(*json.loads(output_of(process))), strict=True)


BATCHES = settings(max_examples=3, deadline=None, phases=[Phase.generate], suppress_health_check=list(HealthCheck))


@BATCHES
@given(st.lists(wrong_scene(), min_size=40, max_size=40))
@pytest.mark.turn(3)
def test_an_invalid_scene_gives_one_line(tmp_path_factory, files):
    folder = tmp_path_factory.mktemp("scenes")
    for text, code, errors in answers(folder, files, ["-p", "scene:={}"]):
        assert code == 2 and errors.count("\n") == 1 and errors.startswith("sim_node: "), (text, code, errors)
        assert ".yaml" in errors and len(errors) < 1000


@BATCHES
@given(st.lists(wrong_parameters(), min_size=40, max_size=40))
@pytest.mark.turn(3)
def test_an_invalid_parameter_file_gives_one_line(tmp_path_factory, files):
    folder = tmp_path_factory.mktemp("parameters")
    for text, code, errors in answers(folder, files, ["--params-file", "{}"]):
        assert code == 2 and errors.count("\n") == 1 and errors.startswith("sim_node: "), (text, code, errors)
        assert len(errors) < 1000


@pytest.mark.turn(3)
def test_every_wrong_parameter_gives_one_line_before_anything_is_recorded(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    record(tmp_path / "run.mcap", scene_from_text(PAIR), 200)
    for name in ("two_bodies.yaml", "arm_node_trajectory.yaml"):
        (tmp_path / name).write_text(text_of(name))
    for parameters, says in yaml.safe_load(Path(__file__).with_name("wrong_parameters.yaml").read_text()):
        assert says in refusal(capfd, {"record": tmp_path / "new.mcap", **parameters}), parameters
        assert not (tmp_path / "new.mcap").exists(), parameters


COMMANDS = yaml.safe_load(Path(__file__).with_name("wrong_commands.yaml").read_text())
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


@pytest.mark.parametrize("command", COMMANDS)
def test_every_wrong_command_line_has_one_line_and_exit_code_2(command, folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    monkeypatch.setattr(tasks, "CONNECTING", 1)  # s instead of 10: nothing listens on that port
    before = contents(folder)
    for line, says in COMMANDS[command]:
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


def test_a_signal_ends_a_step_of_many_seconds(tmp_path):
    """A step of sixteen stiff hulls takes 17 s of CPU time in one call of a kernel; SIGTERM comes after 3 s.

    On slow machines that is before the step, where a halt has nothing to end, but stays.
    """
    points = np.random.default_rng(0).normal(size=(64, 3))
    points *= 0.1 / np.linalg.norm(points, axis=1)[:, None]
    hull = {"type": "contact", "shape": {"type": "hull", "points": points.tolist()}, "stiffness": 1e11, "damping": 0.1}
    ball = {"shape": {"type": "sphere", "radius": 0.1, "mass": 1}}
    bodies = [ball | {"name": f"b{k}", "position": [k, 0, 0.09]} for k in range(16)]
    forces = [hull | {"name": f"c{k}", "body": f"b{k}"} for k in range(16)]
    path, script = (
        tmp_path / "stiff.yaml",
        """
import os, signal, sys, threading, time
from liegroup_sim_ros.commands import main
def end():
    while time.process_time() < 3.0:
        time.sleep(0.01)
    os.kill(os.getpid(), signal.SIGTERM)
threading.Thread(target=end, daemon=True).start()
sys.exit(main.main())
""",
    )
    path.write_text(yaml.safe_dump({"name": "stiff", "gravity": [0, 0, -9.81], "bodies": bodies, "forces": forces}))
    arguments = ["--method", "rkmk54", "--step", "10", "--duration", "10", "--out", tmp_path / "run.npz"]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    ended = subprocess.run([sys.executable, "-c", script, "run", path, *arguments], capture_output=True, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert ended.returncode == 130 and "interrupted at t = 0 s" in ended.stderr
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 8.0
