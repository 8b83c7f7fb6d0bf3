# SPDX-License-Identifier: Apache-2.0
"""Branches: a run goes on from any instant of a recording, in Python and in a node."""

import json
import re
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from node_process import PUSH, NodeProcess, output_of, python, stamp_ns

from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.playback.branch import Branches
from liegroup_sim_ros.playback.rerun import ReplayError
from liegroup_sim_ros.recording import checkpoints
from liegroup_sim_ros.recording.errors import RecordingError
from liegroup_sim_ros.recording.read import read_recording

REACHED = 0.03  # part of the CPU time of a run of an hour, for any of its instants


def run(path, *arguments):
    assert main(["run", *map(str, arguments), "--out", str(path)]) == 0
    return read_recording(path)


def check_branch(recording, branches, at, seconds=0.5, end_ns=np.inf):
    """An unedited branch is bit-identical with the recording's samples from there on."""
    simulation, stamp_ns = branches.at(at, inputs=True)
    body = recording.bodies[-1]
    track, twists = recording.pose[body], recording.twist[body]
    rows = np.flatnonzero((track.stamp_ns >= stamp_ns) & (track.stamp_ns <= min(stamp_ns + seconds * 1e9, end_ns)))
    assert len(rows) > 0
    base_ns = stamp_ns - simulation.time_ns
    for row in rows.tolist():
        steps = round((int(track.stamp_ns[row]) - base_ns) * 1e-9 / simulation.step)
        if steps > simulation.steps:
            simulation.advance(steps - simulation.steps)
        sample = simulation.sample()
        assert np.array_equal(sample.positions[body], track.position[row])
        assert np.array_equal(sample.quaternions[body], track.quaternion[row])
        assert np.array_equal(sample.twists[body], twists.twist[row])
    return simulation, stamp_ns


@pytest.fixture
def many_checkpoints(monkeypatch):
    """A checkpoint every 0.2 s of simulated time."""
    monkeypatch.setattr(checkpoints, "CPU", 0.0)
    monkeypatch.setattr(checkpoints, "SPACING", 2 * 10**8)


CASES = {
    "accuracy": ["four_bar", "--accuracy", "1e-5"],
    "relative": ["double_pendulum", "--method", "rkmk4", "--step", "0.001"],
    "implicit": ["four_bar", "--method", "generalized_alpha", "--step", "0.001"],
    "se3": ["bricard", "--method", "rkmk4", "--step", "0.001", "--group", "se3"],
    "controlled": ["heavy_top", "--method", "rkmk54", "--step", "0.01"],
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.volume(2)
def test_an_unedited_branch_is_bit_identical(tmp_path, many_checkpoints, case):
    recording = run(tmp_path / "run.mcap", *CASES[case], "--duration", "2")
    assert len(recording.checkpoints) in (9, 10)
    branches = Branches(recording)
    for at in (1.3337, 0.0, 0.2, 0.19, 1.0):
        check_branch(recording, branches, at)


def test_another_input_gives_another_motion_and_a_branch_can_be_taken_again(tmp_path, many_checkpoints):
    recording = run(tmp_path / "run.mcap", *CASES["accuracy"], "--duration", "2")
    branches = Branches(recording)
    simulation, _ = branches.at(1.1)
    simulation.apply_wrench("crank", [0.0, 0.0, 5.0, 0.0, 0.0, 0.0], duration=0.2)
    simulation.advance(round(0.3 / simulation.step))
    edited = simulation.sample().positions["rocker"]
    track = recording.pose["rocker"]
    row = int(np.searchsorted(track.stamp_ns, simulation.time_ns))
    assert np.abs(edited - track.position[row]).max() > 1e-3
    check_branch(recording, branches, 1.1)


def test_the_code_of_the_page_runs(tmp_path, monkeypatch):
    page = (Path(__file__).parents[2] / "docs" / "reference" / "recording.md").read_text()
    (code,) = re.findall(r"^```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    monkeypatch.chdir(tmp_path)
    run("run.mcap", "heavy_top", "--duration", "13")
    names = {}
    exec(code, names)
    assert names["stamp_ns"] == 12_500_000_000
    assert names["simulation"].steps == 1350


def test_an_instant_outside_the_recording_is_refused(tmp_path):
    branches = Branches(run(tmp_path / "run.mcap", *CASES["relative"], "--duration", "2"))
    for at in (-0.1, 2.5, 1e300, float("nan"), float("inf")):
        with pytest.raises(ReplayError, match=r"is not in the recording, which is from 0 to 2 s"):
            branches.at(at)


def test_a_damaged_checkpoint_is_one_line(tmp_path, many_checkpoints):
    recording = run(tmp_path / "run.mcap", *CASES["relative"], "--duration", "1")
    stamp = recording.checkpoints[-1]
    state = recording.checkpoint(stamp)
    data = json.dumps(state).encode()
    path = tmp_path / "run.mcap"
    text = path.read_bytes()
    for change, said in (
        (data.replace(b'"pose": [[', b'"pose": [[["'), "is damaged"),
        (data.replace(b'"steps"', b'"staps"'), "invalid initial state"),
    ):
        changed = change[: len(data)].ljust(len(data))
        at = text.index(data)
        broken = bytearray(text)
        broken[at : at + len(data)] = changed
        broken[at + len(data) : at + len(data) + 4] = bytes(4)  # no check sum
        path.write_bytes(broken)
        with pytest.raises((ReplayError, RecordingError)) as error:
            Branches(read_recording(path)).at(stamp * 1e-9)
        assert said in str(error.value) and "\n" not in str(error.value)


@pytest.mark.turn(3)
def test_any_instant_of_an_hour_is_reached_at_once(tmp_path):
    """The median of CPU times, so that other processes and single pauses do not matter."""
    start = time.process_time()
    recording = run(
        tmp_path / "hour.mcap",
        *["heavy_top", "--method", "rkmk4", "--step", "0.002", "--no-estimate"],
        *["--every", "100", "--duration", "3600"],
    )
    allowed = REACHED * (time.process_time() - start)
    branches = Branches(recording)
    branches.at(1.0)
    rng, spent = np.random.default_rng(0), []
    for at in [*rng.uniform(0.0, 3600.0, 30), 3600.0]:
        start = time.process_time()
        simulation, stamp_ns = branches.at(float(at))
        spent.append(time.process_time() - start)
        assert abs(at * 1e9 - stamp_ns) <= 0.5 and simulation.time_ns == stamp_ns
    assert np.median(spent) <= allowed
    check_branch(recording, branches, 3590.0, 9.0)


@pytest.fixture(scope="module")
def recorded(client, scene, tmp_path_factory):
    """Recording of a node: a push that acts on, one with a stamp, a reset, a push after it."""
    path = tmp_path_factory.mktemp("branch") / "run.mcap"
    given = client.given("/original")
    parameters = {"scene": scene, "start_paused": True, "record": path, "wrench_timeout": 0.35}
    with NodeProcess(parameters, ["__node:=original"]) as process:

        def step(count):
            assert client.set("/original", step_count=count).successful
            assert client.call("/original/step").success

        persistent = client.pusher("/original", "wrench/persistent")
        push = client.pusher("/original")
        step(10)
        assert client.call("/original/reset").success
        step(17)
        persistent("puck", force=(0.3, 0.0, 0.0))
        push("cube", torque=(0.0, 0.2, 0.1), stamp_ns=1_234_567_891)
        client.until(lambda: client.call("/original/step").success and given)
        now = given[0].start
        step(50)
        push("puck", force=(0.0, 2.0, 0.0))
        client.until(lambda: client.call("/original/step").success and len(given) > 2)
        step(200)
        process.end()
    assert now < 1_000_000_000
    return path


def equal_samples(one, other, first_ns, last_ns):
    """Number of poses with equal stamps in two recordings; they must be bit-identical."""
    counts = []
    for body in one.bodies:
        mine, theirs = one.pose[body], other.pose[body]
        common, rows, others = np.intersect1d(mine.stamp_ns, theirs.stamp_ns, True, return_indices=True)
        inside = (common >= first_ns) & (common <= last_ns)
        rows, others = rows[inside], others[inside]
        assert np.array_equal(mine.position[rows], theirs.position[others])
        assert np.array_equal(mine.quaternion[rows], theirs.quaternion[others])
        assert np.array_equal(one.twist[body].twist[rows], other.twist[body].twist[others])
        counts.append(len(rows))
    return min(counts)


@pytest.mark.turn(3)
def test_every_instant_of_a_run_with_wrenches_is_reached(recorded):
    recording = read_recording(recorded)
    branches = Branches(recording)
    (reset,) = (event.stamp_ns for event in recording.events if event.name == "reset")
    for at in np.arange(0.0, recording.last_ns * 1e-9 - 0.3, 0.0713):
        end = reset - 1 if at * 1e9 < reset else np.inf
        check_branch(recording, branches, float(at), 0.25, end)
    simulation, _ = branches.at(0.5)
    assert simulation.inputs.commands.acting
    simulation.advance(1)
    assert not simulation.inputs.commands.acting


@pytest.mark.parametrize("at", [0.05, 0.61, 1.3])
@pytest.mark.volume(1)
def test_a_node_goes_on_from_an_instant(client, recorded, tmp_path, capsys, at):
    path, name = tmp_path / "branch.mcap", f"/branch_{round(100 * at)}"
    poses = client.listen(f"{name}/puck/pose", PoseStamped)
    original = read_recording(recorded)
    parameters = {
        "continue_from": recorded,
        "continue_at": at,
        "continue_inputs": True,
        "real_time_factor": 20.0,
        "record": path,
    }
    with NodeProcess(parameters, [f"__node:={name[1:]}"]) as process:
        client.until(lambda: poses and stamp_ns(poses[-1].header.stamp) > original.last_ns)
        # A reset goes to the start of the scene, a reload to the instant again.
        assert client.call(f"{name}/pause").success
        answer = client.call(f"{name}/reload")
        assert answer.success and answer.message.endswith(", paused")
        process.end()
    branch = read_recording(path)
    begin_ns = branch.initial_state["stamp_ns"]
    assert 0 <= at * 1e9 - begin_ns < 10_000_000
    # The reset of the original ends an unedited branch: its stamps go on from another state.
    reset = next(event.stamp_ns for event in original.events if event.name == "reset")
    last = reset - 1 if begin_ns < reset else original.last_ns
    assert equal_samples(original, branch, begin_ns, last) >= (last - begin_ns) // 10_000_000
    for file in (path, tmp_path / "branch_part2.mcap"):
        assert main(["replay", str(file), "--resimulate"]) == 0
        assert ": bit-identical in" in capsys.readouterr().out


@pytest.mark.turn(3)
def test_replay_from_an_instant_starts_a_node(client, recorded, tmp_path):
    path = tmp_path / "what_if.mcap"
    arguments = ["replay", recorded, "--from", "0.5", "--start-paused", "--record", path]
    process = python(f"import sys; sys.argv = ['liegroup_sim', *sys.argv[1:]]\n{PUSH}", *arguments)
    try:
        push = client.pusher("/sim_node", "wrench/persistent")
        push("puck", force=(-5.0, 0.0, 0.0))
        assert client.set("/sim_node", step_count=30).successful
        assert client.call("/sim_node/step").success
        process.send_signal(signal.SIGINT)
        output_of(process)
    finally:
        process.kill()
    branch, original = read_recording(path), read_recording(recorded)
    assert branch.initial_state["stamp_ns"] == 500_000_000
    assert equal_samples(original, branch, 500_000_000, 500_000_000) == 1
    row = int(np.searchsorted(original.pose["puck"].stamp_ns, 800_000_000))
    assert branch.pose["puck"].stamp_ns[-1] == 800_000_000
    apart = branch.pose["puck"].position[-1] - original.pose["puck"].position[row]
    assert apart[0] < -0.1
    assert main(["replay", str(path), "--resimulate"]) == 0
