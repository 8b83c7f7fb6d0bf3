# SPDX-License-Identifier: Apache-2.0
"""Recordings simulated again, bit-identical with every method and event; those of laws that have states."""

import json

import numpy as np
import pytest
from made_run import record
from scene_files import text_of
from scene_runs import Run

from liegroup_core import Simulation, load_scene
from liegroup_core.methods.table import METHODS
from liegroup_core.scene.load import scene_from_text
from liegroup_sim_ros.analysis.analyse import analyse
from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.messages.codecs import PoseStampedCodec, TwistStampedCodec, WrenchStampedCodec
from liegroup_sim_ros.node.parameters import RATES
from liegroup_sim_ros.playback.branch import Branches
from liegroup_sim_ros.playback.resimulate import report, resimulate
from liegroup_sim_ros.recording import attachments
from liegroup_sim_ros.recording.read import RecordingError, read_recording
from liegroup_sim_ros.recording.write import Recorder

STEP = 1e-3
# What all methods can simulate: a top on a ball joint, with a centre of mass off its frame's
# origin, and a free body.
TOP = text_of("top_resimulate.yaml")
FREE = text_of("free_resimulate.yaml")


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.volume(5)
def test_resimulation_is_bit_identical_with_every_method(ros_node, tmp_path, method):
    given = dict.fromkeys(RATES, 0.0) | {"publish_rate": 1.0 / (2 * STEP), "clock_rate": 1.0 / (5 * STEP)}
    given |= {"record": tmp_path / "run.mcap", "record_split_duration": 0.05, "real_time_factor": 2.0}
    with Run(ros_node, Simulation(scene_from_text(TOP), method, STEP), **given) as run:
        run.pass_time(0.03)
        run.push("top", (0.3, 0, 0.1, 0, 2.0, 0))
        run.push("top", (0, 0, 0, 1.0, 0, 0), source="other", axes="world", ahead=0.0130002)
        run.push("top", (0, 0, 0, 0, 2.0, 1.0), 0.08, "end", "world", 0.0130002, (0.1, 0.2, 0.3))
        run.pass_time(0.06)
        run.call("pause")
        run.call("step", 7)  # ends between two samples
        run.call("speed", 0.0)
        run.call("resume")
        run.pass_time(0.04)
        run.push("top", (0, 0.2, 0, 0, 0, 1.0), None, "lasting")
        run.call("speed", 5.0)
        run.pass_time(0.08)
        run.call("reset")  # while a wrench acts
        run.push("top", (0, 0, 0.1, 0, 0, 0), 0.01)
        run.pass_time(0.06)
        run.call("hold")
        reloaded = Run(ros_node, Simulation(scene_from_text(FREE), method, STEP), run, **given)
    with reloaded as run:
        run.push("box", (0.1, 0, 0, 0, 0, 3.0), 0.02)
        run.pass_time(0.06)
    files = [read_recording(path) for path in tmp_path.glob("*.mcap")]
    names = {event.name for recording in files for event in recording.events}
    assert {"start", "pause", "resume", "reset", "step", "speed", "stop"} <= names
    assert {recording.settings["scene"] for recording in files} == {"top", "free"}
    assert len(files) > 3
    samples = resets = 0
    for recording in files:
        assert recording.complete and recording.lost == {}
        figures = resimulate(recording)
        assert figures["identical"] == figures["samples"] > 0, recording.path.name
        assert figures["must_be_equal"] and figures["missing_samples"] == 0
        samples, resets = samples + figures["samples"], resets + figures["resets"]
    assert samples > 80 and resets <= 1
    pushed = [command.name for recording in files for command in recording.inputs if any(command.values)]
    assert pushed.count("top") > 3 and "box" in pushed


LAWS = text_of("laws_of_a_top.yaml")


@pytest.mark.parametrize("given", [{"accuracy": 1e-6}, {"method": "radau5", "step": STEP}], ids=["accuracy", "radau5"])
def test_resimulation_of_laws_is_bit_identical(ros_node, tmp_path, given):
    """Laws of the time, of signals of other laws and of a table, with wrenches, single steps and a reset."""
    path = tmp_path / "run.mcap"
    rates = dict.fromkeys(RATES, 0.0) | {"publish_rate": 100.0, "record": path, "real_time_factor": 0.0}
    with Run(ros_node, Simulation(scene_from_text(TOP + LAWS), **given), **rates) as run:
        run.pass_time(0.1)
        run.push("top", (0.3, 0, 0.1, 0, 2.0, 0), 0.0303)
        run.pass_time(0.1)
        run.call("pause")
        run.call("step", 7)
        run.call("resume")
        run.push("top", (0, 0.2, 0, 0, 0, 1.0), None, "lasting", "world", 0.0130002)
        run.pass_time(0.2)
        run.call("reset")
        run.push("top", (0, 0, 0.1, 0, 0, 0), 0.01)
        run.pass_time(0.1)
    figures = resimulate(read_recording(path))
    assert figures["identical"] == figures["samples"] > 30 and figures["must_be_equal"]
    assert figures["resets"] == 1 and figures["missing_samples"] == 0


def test_a_flipped_bit_fails_and_a_changed_setting_is_compared(tmp_path, capsys):
    """One flipped bit gives exit code 1; another step size gives a difference with a limit."""

    def flip(topic, k, data):
        last = data[:-8] + bytes([data[-8] ^ 1]) + data[-7:]
        return last if topic.endswith("pose") and k == 30 else data

    good = record(tmp_path / "good.mcap", load_scene("heavy_top"), 400)
    wrong = record(tmp_path / "wrong.mcap", load_scene("heavy_top"), 400, spoil=flip)
    assert main(["replay", str(good), "--resimulate"]) == 0
    assert "bit-identical in 41 of 41 samples" in capsys.readouterr().out
    assert main(["replay", str(wrong), "--resimulate"]) == 1
    assert "are those of the recording: the file or the source" in capsys.readouterr().err
    # Half the step: the error of order 4 of the run itself, 8e-6 rad within 6 s (test_analyze.py).
    assert main(["replay", str(good), "--resimulate", "--step", "1e-3"]) == 0
    assert main(["replay", str(good), "--resimulate", "--step", "1e-3", "--bound", "1e-5"]) == 0
    assert main(["replay", str(good), "--resimulate", "--step", "1e-3", "--bound", "1e-12"]) == 1
    # Samples between steps of 3 ms: 16 times 1.5^4 the error.
    assert main(["replay", str(good), "--resimulate", "--step", "3e-3", "--bound", "1e-3"]) == 0
    capsys.readouterr()
    for arguments, said in ((["--method", "none"], "unknown method"), (["--step", "nan"], "a number from")):
        assert main(["replay", str(good), "--resimulate", *arguments]) == 2
        assert said in (err := capsys.readouterr().err) and err.count("\n") == 1
    assert main(["replay", str(good), "--method", "rkmk8"]) == 2
    assert "require --resimulate" in capsys.readouterr().err


def test_bit_identity_is_not_required_across_platforms(tmp_path):
    recording = read_recording(record(tmp_path / "a.mcap", load_scene("heavy_top"), 40))
    recording.settings["versions"]["numpy"] = "1.0"
    figures = resimulate(recording)
    assert figures["platform"]["numpy"][0] == "1.0" and not figures["must_be_equal"]
    figures["identical"] -= 1
    assert report(figures)[1] is None
    assert report(figures | {"must_be_equal": True})[1] is not None


# Recordings up to version 0.2: total wrenches on ~/applied_wrench are read as commands and repeat the run.


OLD_INPUTS_STEP, STEPS, EVERY = 1e-3, 200, 20
POINT, FORCE, TORQUE = np.array([0.1, -0.02, 0.3]), np.array([0.0, 50.0, 8.0]), np.array([0.3, 0.0, 0.0])
BODY, WORLD = (0.0, 0.0, 0.1, 9.0, 0.0, 0.0), np.array([0.1, 0.0, 0.0, 0.0, 0.0, 3.0])
# (stamp in ns, frame_id, total): the push at POINT from 30.1234 to 90.1234 ms, then WORLD from 41 to 141 ms is added,
# BODY acts from 40 to 90 ms.
PUSH = np.concatenate([TORQUE, FORCE])
TOTALS = [
    (30_123_400, "world/top", PUSH),
    *((30_123_400, f"world_{k}/top", (0, 0, 0, *(p * FORCE))) for k, p in zip("xyz", POINT)),
    (40_000_000, "top", BODY),
    (41_000_000, "world/top", PUSH + WORLD),
    (90_000_000, "top", (0,) * 6),
    (90_123_400, "world/top", WORLD),
    *((90_123_400, f"world_{k}/top", (0,) * 6) for k in "xyz"),
    (141_000_000, "world/top", (0,) * 6),
]


def record_old_inputs(path, method, totals=TOTALS):
    """Recording in the old format of a run with the commands."""
    simulation = Simulation(load_scene("heavy_top"), method, OLD_INPUTS_STEP, estimate=False)
    simulation.apply_wrench("top", PUSH, 0.0301234, 0.06, "fan", "world", POINT)
    simulation.apply_wrench("top", BODY, 0.04, 0.05, "other")
    simulation.apply_wrench("top", WORLD, 0.041, 0.1, "third", "world")
    topics = {kind: {"top": f"/sim_node/top/{kind}"} for kind in ("pose", "twist")}
    topics |= {"applied_wrench": "/sim_node/applied_wrench", "events": "/e", "clock": None, "diagnostics": "/d"}
    start = Simulation(load_scene("heavy_top"), method, OLD_INPUTS_STEP, estimate=False)
    files = attachments.at_start(start, "/sim_node", "world", EVERY, topics)
    state = json.loads(files["initial_state.json"][1])
    del state["state"]
    files["initial_state.json"] = attachments.as_json(state | {"memory": ""})
    codecs = {"pose": PoseStampedCodec("world"), "twist": TwistStampedCodec("top")}
    with Recorder(path, files) as recorder:
        channel = {kind: recorder.add_channel(topics[kind]["top"], codec.TYPE) for kind, codec in codecs.items()}
        wrench = recorder.add_channel(topics["applied_wrench"], WrenchStampedCodec.TYPE)
        for stamp, frame, total in totals:
            recorder.write(wrench, stamp, WrenchStampedCodec(frame).encode(stamp, total))
        for _ in range(STEPS // EVERY + 1):
            sample = simulation.sample()
            stamp = sample.time_ns
            pose = sample.positions["top"].tolist(), sample.quaternions["top"].tolist()
            recorder.write(channel["pose"], stamp, codecs["pose"].encode(stamp, *pose))
            recorder.write(channel["twist"], stamp, codecs["twist"].encode(stamp, sample.twists["top"].tolist()))
            simulation.advance(EVERY)
    return read_recording(path)


@pytest.mark.parametrize("method", ["rkmk4", "constrained_rattle"])
def test_a_recording_of_totals_repeats_to_the_bit_and_its_reference_has_the_forces_at_points(tmp_path, method):
    recording = record_old_inputs(tmp_path / "old.mcap", method)
    figures = resimulate(recording)
    assert figures["identical"] == figures["samples"] == STEPS // EVERY + 1
    assert Branches(recording).at(0.1, inputs=True)[0].steps == 100
    figures = analyse(recording).figures
    # rkmk4 at 1 ms under pushes of 50 N: some 1e-9 m; constrained_rattle is of second order.
    assert figures["reference"]["position"]["max"] < {"rkmk4": 1e-8, "constrained_rattle": 1e-4}[method]
    (push,) = figures["pushes"]
    assert (push["from_s"], push["to_s"]) == pytest.approx((0.0301234, 0.141))


def test_a_wrench_on_what_is_no_body_is_refused(tmp_path):
    with pytest.raises(RecordingError, match="a wrench acts on 'world_q/top', which is not a body of the scene"):
        record_old_inputs(tmp_path / "old.mcap", "rkmk4", [(0, "world_q/top", (0,) * 6)])


PID = text_of("pendulum_laws.yaml") + text_of("pid.yaml")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("laws")
    scene, path = folder / "controlled.yaml", folder / "run.mcap"
    scene.write_text(PID)
    common = ["--method", "rkmk4", "--step", "1e-3", "--duration", "2", "--every", "2"]
    assert main(["run", str(scene), *common, "--out", str(path)]) == 0
    return scene, path


def test_the_states_are_in_the_samples(recorded):
    scene, path = recorded
    recording, simulation = read_recording(path), Simulation(load_scene(scene), "rkmk4", 1e-3, quiet=True)
    assert recording.settings["laws"] == ["pid.i", "pid.a"]
    found = np.concatenate([samples.laws for samples in recording.samples()])[:, :, 0]
    for row in found[:200]:
        assert row.tolist() == [simulation.sample().signals[name] for name in recording.settings["laws"]]
        simulation.advance(2)


def test_the_work_of_the_law_closes_the_balance_and_the_replay_has_the_same_bits(recorded):
    """The integral of the power between samples has an error of 1e-9 J, which it states."""
    figures = analyse(read_recording(recorded[1])).figures
    balance = figures["balance"]
    assert abs(balance["work_J"]["laws"]) > 0.1
    assert balance["largest_J"] < 1e-8 and balance["quadrature_J"] < 1e-8
    assert figures["repeat"]["identical"] == figures["repeat"]["samples"] == 1001
    assert figures["problems"] == []


SAMPLED = PID.replace(
    "  states: {i: {rate: e}, a: {start: 0.2, rate: (kp*e + ki*i - kd*w - a)/0.05}}\n",
    "  period: 0.02\n  delay: 0.05\n  states: {i: {update: i + 0.02*e}, a: {update: kp*e + ki*i - kd*w}}\n",
)


def test_a_sampled_law_is_recorded_and_its_balance_closes(tmp_path):
    """Samples have what acts; its power is smooth between its instants, at which every tenth sample is.

    The integral of smooth powers over 10 samples by splines of degree 5 has an error of 1e-9 J, which it states.
    """
    scene, path = tmp_path / "sampled.yaml", tmp_path / "run.mcap"
    scene.write_text(SAMPLED)
    assert main(["run", str(scene), "--method", "rkmk4", "--step", "1e-3", "--duration", "2", "--out", str(path)]) == 0
    recording, simulation = read_recording(path), Simulation(load_scene(scene), "rkmk4", 1e-3, quiet=True)
    names = recording.settings["laws"]
    assert names[:4] == ["pid.i", "pid.a", "pid.e", "pid.outputs[0].effort"] and len(names) == 7
    found = np.concatenate([samples.laws for samples in recording.samples()])[:, :, 0]
    for row in found[:200]:
        sample = simulation.sample()
        assert row[:3].tolist() == [sample.signals[name] for name in names[:3]]
        assert row[3] == sample.law_efforts["hinge"]
        simulation.advance()
    figures = analyse(recording).figures
    balance = figures["balance"]
    assert abs(balance["work_J"]["laws"]) > 0.1
    assert balance["largest_J"] < 1e-8 and balance["quadrature_J"] < 1e-8
    assert figures["repeat"]["identical"] == figures["repeat"]["samples"] == 2001
    reference = figures["reference"]
    assert reference["kind"] == "integration" and reference["seconds"] == 2.0 and reference["stopped"] is None
    assert figures["problems"] == []
