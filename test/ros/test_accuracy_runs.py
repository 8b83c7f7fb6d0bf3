# SPDX-License-Identifier: Apache-2.0
"""Runs to an accuracy: of the node over DDS and in this process, and of `liegroup_sim run`."""

import dataclasses
import json
import math
import re
from pathlib import Path

import jsonschema
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from made_run import record
from node_process import NodeProcess, figures_of
from rclpy.qos import DurabilityPolicy, QoSProfile
from scene_files import text_of
from scene_runs import Run

from liegroup_core import Simulation, load_scene
from liegroup_core.accuracy import METHOD
from liegroup_core.forces.commands import EFFORT, TARGET, Command
from liegroup_core.running_error import PART
from liegroup_sim_ros.analysis.analyse import analyse
from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.messages import events as events_of_runs
from liegroup_sim_ros.messages.commands import Point
from liegroup_sim_ros.node.scene_run import PART_STEPS
from liegroup_sim_ros.playback.resimulate import resimulate
from liegroup_sim_ros.recording.attachments import commands_in
from liegroup_sim_ros.recording.read import read_recording
from liegroup_sim_ros.report.plots import make_plots
from liegroup_sim_ros.serving import real_time
from liegroup_sim_ros.serving.trajectory import Waypoints

SOURCE = Path(__file__).resolve().parents[2]
LATE = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
# What a run reports about its accuracy, besides the event `accuracy`.
REPORTS = {"accuracy", "inaccurate", "unpredictable"}


def repeats(path):
    """Recording of a file, after checking that a repeated run is bit-identical."""
    recording = read_recording(path)
    assert recording.complete and recording.lost == {}
    figures = resimulate(recording)
    assert figures["stopped"] is None and figures["missing_samples"] == 0
    assert figures["identical"] == figures["samples"] > 0, (path, figures["first_difference"])
    return recording


@pytest.mark.turn(3)
def test_a_node_with_nothing_but_a_scene_keeps_its_accuracy_and_says_so(client, tmp_path):
    """Through pushes, a pause, single steps and a reset; the recording repeats bit for bit."""
    path = tmp_path / "run.mcap"
    poses = client.listen("/accurate/top/pose", PoseStamped)
    states = client.listen("/accurate/state", DiagnosticArray)
    with NodeProcess({"scene": "heavy_top", "record": path}, remap=["__node:=accurate"]) as process:
        push = client.pusher("/accurate")
        client.until(lambda: len(poses) > 30, "poses")
        push("top", force=(0.0, 50.0, 0.0), torque=(0.0, 0.0, 0.3))
        client.pass_time(poses, 0.3)
        assert client.call("/accurate/pause").success
        push("top", force=(0.0, 0.0, 20.0))
        assert client.set("/accurate", step_count=7).successful
        assert client.call("/accurate/step").success
        assert client.call("/accurate/resume").success
        client.pass_time(poses, 0.5)
        push("top", force=(10.0, 0.0, 0.0))
        client.pass_time(poses, 0.05)
        reset = client.command("/accurate/reset")
        client.until_stamp(reset, poses)
        client.pass_time(poses, 0.3)
        push("top", force=(0.0, -50.0, 0.0))
        client.pass_time(poses, 1.5)
        errors = process.end()
    assert "heavy_top: 1 body, accuracy 0.0001 in 60 s, running" in errors, errors
    figures = figures_of(states[-1])
    assert float(figures["accuracy"]) == 1e-4 and float(figures["accuracy_horizon_s"]) == 60.0
    assert figures["method"] == "rkmk853"
    assert figures["accurate_until_s"] == figures["predictable_until_s"] == "inf"
    assert 0.0 <= float(figures["position_error_m"]) < 1e-4
    assert float(figures["integration_share_of_core"]) > 0.0
    documented = (SOURCE / "docs" / "reference" / "node.md").read_text()
    assert [key for key in figures if f"`{key}`" not in documented and "_refused_" not in key] == []
    recording = repeats(path)
    names = [event.name for event in recording.events if event.name != "slow"]  # on a busy machine
    assert names == ["start", "pause", "step", "resume", "reset", "stop"]
    assert recording.settings["method"] == METHOD and recording.settings["step"] == 0.01
    assert len(recording.inputs) >= 4
    found = analyse(recording).figures
    assert found["problems"] == [] and len(found["pushes"]) >= 4
    promise = found["promise"]
    assert promise["kept"] is True and promise["beyond"] is False
    assert (promise["accuracy"], promise["horizon"]) == (1e-4, 60.0)
    assert promise["error"] < 1e-4 and promise["seconds"] > 1.5
    assert "the accuracy of 0.0001 in 60 s is kept" in found["verdict"]


@pytest.mark.turn(3)
def test_a_node_says_when_its_motion_cannot_be_known_any_more(client, tmp_path):
    """A double pendulum is chaotic: the events and times in ~/state are those of the run."""
    path = tmp_path / "run.mcap"
    events = client.events("/chaotic")
    states = client.listen("/chaotic/state", DiagnosticArray)
    parameters = {"scene": "double_pendulum", "real_time_factor": 0.0, "record": path}
    with NodeProcess(parameters, remap=["__node:=chaotic"]) as process:
        client.until(lambda: events, "the start")
        client.until(lambda: any(e.name == "unpredictable" for e in events), what="the event")
        client.until(lambda: figures_of(states[-1])["predictable_until_s"] != "inf")
        errors = process.end()
    said = r"the estimated error is 0\.0001\d* of the mechanism's size or rad, above the accuracy"
    assert re.search(said, errors), errors
    recording = repeats(path)
    told = {event.name: event for event in recording.events}
    assert "the last time before the estimated error exceeds the accuracy of 0.0001" in told["inaccurate"].text
    assert "too large for the motion to be known" in told["unpredictable"].text
    simulation = Simulation(load_scene("double_pendulum"), step=0.01)
    while simulation.predictable_until > simulation.time:
        simulation.advance()
    figures = figures_of(states[-1])
    for name, since, key in (
        ("inaccurate", simulation.accurate_until, "accurate_until_s"),
        ("unpredictable", simulation.predictable_until, "predictable_until_s"),
    ):
        assert float(figures[key]) == pytest.approx(since, rel=1e-9)
        assert events_of_runs.number(told[name].text) == pytest.approx(since, rel=1e-8)
        # The stamp is that of the first tick after the error was found, at the next look or checkpoint.
        assert -1e-9 <= told[name].stamp_ns * 1e-9 - since < PART * 60.0 + 0.01
    found = analyse(recording, reference_seconds=told["inaccurate"].stamp_ns * 1e-9 + 1.0).figures
    assert found["promise"]["kept"] is True and found["promise"]["beyond"] is True
    for name in ("inaccurate", "unpredictable"):
        assert f"the run reported: {told[name].text}" in found["warnings"]
    assert found["promise"]["seconds"] == pytest.approx(simulation.accurate_until, rel=1e-9)
    assert "Then the run itself reports a larger error" in found["verdict"]


@pytest.mark.parametrize("scene, body", [("heavy_top", "top"), ("double_pendulum", "lower"), ("hinge_chain", "rod5")])
@pytest.mark.volume(1)
def test_parts_of_a_run_to_an_accuracy_repeat_alone(ros_node, tmp_path, monkeypatch, scene, body):
    """With wrenches that span parts. Each begins where the two runs of the estimate meet."""
    monkeypatch.setattr(real_time, "SHARE", math.inf)
    given = {"record": tmp_path / "run.mcap", "record_split_duration": 0.43, "clock_rate": 50.0}
    with Run(ros_node, scene, real_time_factor=10.0, **given) as run:
        run.push(body, (0.2, 0.1, 0, 0, 5.0, 0), None, "lasting")
        run.push(body, (0, 0, 0, 1.0, 0, 3.0), 1.333333, "other", "world")
        run.pass_time(1.6)
        run.call("pause")
        run.call("step", 4)
        run.call("resume")
        run.pass_time(0.5)
        run.push(body, (0.0,) * 6, None, "lasting")
        run.pass_time(0.5)
        run.call("reset")
        run.push(body, (0, 0, 0.1, 0, 0, 0))
        run.pass_time(0.6)
    recordings = [repeats(path) for path in tmp_path.glob("*.mcap")]
    assert len(recordings) > 5
    assert PART_STEPS % run.simulation._running.ours == 0
    assert {each.initial_state["steps"] % PART_STEPS for each in recordings} == {0}
    # A wrench that acts is part of the state at the start of a part.
    assert any(commands_in(each.initial_state).acting for each in recordings)


def test_an_accuracy_that_changes_between_states_of_one_step_repeats(ros_node, tmp_path):
    """The states after the change have it, also those within the step that begins there."""
    given = {"record": tmp_path / "run.mcap", "publish_rate": 333.0}
    simulation = Simulation(load_scene("four_bar"), step=0.1, accuracy=1e-7)
    with Run(ros_node, simulation, **given) as run:
        run.pass_time(0.35)
        run.call("accuracy", 1e-3)
        run.pass_time(0.35)
    recording = repeats(tmp_path / "run.mcap")
    assert [event.name for event in recording.events].count("accuracy") == 1
    assert not simulation.is_halted and 0.0 < simulation.largest_error < 1e-3  # the last state can be read


ARM = (
    text_of("arm_servos.yaml")
    + """  - {name: drive, type: servo, joint: hinge, stiffness: 90, damping: 8, effort_limit: 9}
  - {name: pull, type: linear_servo, joint: slide, stiffness: 300, damping: 20}
"""
)


@pytest.mark.turn(3)
def test_parts_with_joint_commands_repeat_alone(ros_node, tmp_path, monkeypatch):
    """Efforts, targets and a trajectory that span parts, a limit that is reached, a reset."""
    monkeypatch.setattr(real_time, "SHARE", math.inf)
    (tmp_path / "arm.yaml").write_text(ARM)
    given = {"record": tmp_path / "run.mcap", "record_split_duration": 0.23, "clock_rate": 50.0}
    points = [Point((0.3, 0.1), (0.5, 0.0), (), (), 400_000_000), Point((-0.2, 0.0), (0.0, 0.0), (), (), 900_000_000)]
    with Run(ros_node, tmp_path / "arm.yaml", real_time_factor=5.0, **given) as run:
        run.server.push([Command(TARGET, "hinge", (-0.4, 0.0)), Command(EFFORT, "slide", (3.0,), source="test")], None)
        run.pass_time(0.6)
        start = run.server.stamp_ns + 123_456_789
        run.server.follow(Waypoints(["hinge", "slide"], points, start))
        run.until(lambda: run.server.stamp_ns >= start + points[0].time_ns)
        run.server.push([Command(TARGET, "slide", (0.05, 0.0))], 0.3)
        run.call("reset")
        run.pass_time(0.3)
        run.server.push([Command(EFFORT, "hinge", (1.0,), source="test")], 0.1)
        run.pass_time(0.3)
    recordings = [repeats(path) for path in tmp_path.glob("*.mcap")]
    assert len(recordings) > 5
    starts = [
        each.servo_targets.stamp_ns[0] == each.initial_state["stamp_ns"]
        for each in recordings
        if each.servo_targets is not None
    ]
    assert sum(starts) > 2
    assert sum(len(each.servo_targets.stamp_ns) for each in recordings if each.servo_targets) > 100
    assert "saturated" in {event.name for each in recordings for event in each.events}


def whatever_it_helps(monkeypatch):
    """Let a run that needs more time raise its accuracy, and keep it."""
    monkeypatch.setattr(real_time, "WORTH", 0.0)
    monkeypatch.setattr(real_time, "MAIN", 0.0)
    monkeypatch.setattr(real_time, "helps", lambda *costs: True)


@pytest.mark.turn(3)
def test_real_time_that_does_not_allow_the_accuracy_raises_it(ros_node, tmp_path, monkeypatch, caplog):
    """By ten, with an event and a warning; a reset returns to the accuracy asked for."""
    sent, wanted = [], 2

    def raised():
        return [given for given in sent if given[1] == "accuracy"]

    def hear(*given):
        """Called in the thread of the simulation, so that not one more is raised, however busy the machine is."""
        sent.append(given)
        if len(raised()) >= wanted:
            monkeypatch.setattr(real_time, "SHARE", math.inf)
        event(*given)

    def accuracy():
        return run.call("sample") and run.simulation.promise["accuracy"]

    given = {"accuracy": 1e-9, "record": tmp_path / "run.mcap", "record_split_duration": 2.5}
    monkeypatch.setattr(real_time, "SHARE", math.inf)
    monkeypatch.setattr(real_time, "SHARE_OF_ALL", math.inf)
    with Run(ros_node, "double_pendulum", real_time_factor=3.0, **given) as run:
        event = run.outputs.event
        monkeypatch.setattr(run.outputs, "event", hear)
        run.call("pause")
        monkeypatch.setattr(real_time, "SHARE", 0.0)
        whatever_it_helps(monkeypatch)
        run.call("resume")
        run.until(lambda: len(raised()) == wanted)
        run.push("lower", (0, 0, 0, 0, 5.0, 0), 0.1)
        assert accuracy() == pytest.approx(1e-9 * 10.0**wanted, rel=1e-12)
        run.until((tmp_path / "run_part3.mcap").exists)
        assert len(raised()) == wanted
        run.call("reset")
        assert accuracy() == 1e-9
        wanted += 1
        monkeypatch.setattr(real_time, "SHARE", 0.0)
        run.until(lambda: len(raised()) == wanted)
        run.pass_time(0.1)
    text = raised()[0][2]
    assert text.startswith("1e-08 is the accuracy from t = ") and ": 1e-09 takes " in text
    assert re.search(r"takes \d+ % of a core in real time, messages \d+ %$", text)
    assert text in caplog.text
    recordings = [repeats(path) for path in sorted(tmp_path.glob("*.mcap"))]
    assert len(recordings) >= 3
    assert sum(e.name == "accuracy" for r in recordings for e in r.events) == len(raised())
    # Every part has what was asked for; the state has what holds.
    assert {r.settings["promise"]["accuracy"] for r in recordings} == {1e-9}
    found = analyse(recordings[0]).figures
    late = "too slow: ", "more than 0.1 s behind "  # a busy machine
    assert [each for each in found["problems"] if not each.startswith(late)] == []
    assert found["promise"]["kept"] is True and found["promise"]["beyond"] is True
    # At half the step too, the accuracy changes when it did.
    other = resimulate(recordings[0], step=0.5 * recordings[0].settings["step"])
    assert other["stopped"] is None and max(other["largest_difference"].values()) < 1e-5
    later = analyse(recordings[1]).figures["promise"]
    assert later["kept"] is later["seconds"] is None


@pytest.mark.turn(3)
def test_restarts_do_not_end_an_accuracy(ros_node, tmp_path):
    """A reset begins anew. What continues a snapshot is not checked, and no larger error either."""
    with Run(ros_node, "heavy_top", record=tmp_path / "run.mcap") as run:
        for command, *given in (
            ("pause",),
            ("reset",),
            ("step", 100),
            ("save", "one"),
            ("step", 50),
            ("restore", "one"),
            ("step", 40),
            ("reset",),
            ("step", 70),
        ):
            run.call(command, *given)
    recording = repeats(tmp_path / "run.mcap")
    assert REPORTS.isdisjoint(event.name for event in recording.events)
    figures = analyse(recording).figures
    promise = figures["promise"]
    assert promise["kept"] is True and promise["beyond"] is False
    assert promise["restarts"] == 2 and promise["unchecked_s"] == pytest.approx(0.4)
    before = recording.events[1].stamp_ns * 1e-9  # the pause
    assert promise["seconds"] == pytest.approx(before + 1.5 + 0.7)
    assert "larger error" not in figures["verdict"]
    assert "that follow the start and 2 resets (0.4 s that continue an" in figures["verdict"]


def test_the_accuracy_is_raised_at_most_to_a_tenth(ros_node, tmp_path, monkeypatch):
    monkeypatch.setattr(real_time, "SHARE", 0.0)
    whatever_it_helps(monkeypatch)
    monkeypatch.setattr(real_time, "SHARE_PERIOD", 0.02)
    with Run(ros_node, "heavy_top", accuracy=3e-3, record=tmp_path / "run.mcap") as run:
        run.until(lambda: run.simulation.promise["accuracy"] == real_time.COARSEST)
        run.pass_time(0.2)
    changes = [e.text for e in repeats(tmp_path / "run.mcap").events if e.name == "accuracy"]
    assert [text.split()[0] for text in changes] == ["0.03", "0.1"]


@pytest.mark.parametrize(
    "accuracy, factor, publish_rate",
    [
        (1e-2, 3.0, 100.0),  # one substep per step already
        (1e-12, 1000.0, 1000.0),  # the messages alone take more than a core
    ],
)
@pytest.mark.turn(3)
def test_an_accuracy_is_not_given_away_if_that_does_not_help(
    ros_node, tmp_path, monkeypatch, caplog, accuracy, factor, publish_rate
):
    """The run says once that it is too slow, and with what."""
    monkeypatch.setattr(real_time, "SHARE", 0.0)
    monkeypatch.setattr(real_time, "SLOW", 1.1)
    given = {"accuracy": accuracy, "real_time_factor": factor, "publish_rate": publish_rate}
    with Run(ros_node, "heavy_top", record=tmp_path / "run.mcap", **given) as run:
        run.until(lambda: " is the real-time factor at t = " in caplog.text)
        run.pass_time(2.0)
        assert run.simulation.promise["accuracy"] == accuracy
    recording = repeats(tmp_path / "run.mcap")
    (text,) = [event.text for event in recording.events if event.name == "slow"]
    assert re.search(
        rf"of {factor:g}: in real time the integration takes up to \d+ % of a core at the accuracy of "
        rf"{accuracy:g}, messages \d+ %; [a-z]",
        text,
    )
    assert 0.0 < events_of_runs.number(text) < 1.1 * factor
    assert caplog.text.count(text) == 1
    assert "accuracy" not in {event.name for event in recording.events}


def test_as_fast_as_possible_has_no_share_of_real_time(ros_node, tmp_path, monkeypatch):
    monkeypatch.setattr(real_time, "SHARE", 0.0)
    with Run(ros_node, "heavy_top", record=tmp_path / "run.mcap", real_time_factor=0.0) as run:
        run.pass_time(2.0)
    assert REPORTS.isdisjoint(event.name for event in repeats(tmp_path / "run.mcap").events)


@pytest.mark.parametrize("stabilised", [[], ["--stabilisation", "none"]])
@pytest.mark.volume(1)
def test_a_run_to_an_accuracy_is_checked_by_analyze(tmp_path, capsys, stabilised):
    log, document = tmp_path / "a.mcap", tmp_path / "a.json"
    arguments = ["run", "four_bar", "--accuracy", "1e-6", "--horizon", "0.5", "--duration", "1.5"]
    assert main([*arguments, *stabilised, "--out", str(log)]) == 0
    # A fiftieth of the horizon.
    assert "1.5 s in 150 steps, 151 samples" in capsys.readouterr().out
    recording = repeats(log)
    promise = recording.settings["promise"]
    assert promise["accuracy"] == 1e-6 and promise["horizon"] == 0.5
    assert recording.settings["stabilisation"] == ("none" if stabilised else "projection")
    assert main(["analyze", str(log), "--json", str(document)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "the accuracy of 1e-06 in 0.5 s is kept:" in said and "in the first 1.5 s" in said
    schema = json.loads((SOURCE / "config" / "analysis.schema.json").read_text())
    found = json.loads(document.read_text())
    jsonschema.Draft202012Validator(schema).validate(found)
    (figures,) = found["logs"]
    assert figures["problems"] == [] and figures["promise"]["kept"] is True
    # It may grow by as much in each further horizon.
    assert 0.0 < figures["promise"]["error"] < 3e-6
    # With the options that would make the same run.
    assert main(["replay", str(log), "--resimulate", "--method", METHOD]) == 0
    assert "bit-identical in 151 of 151 samples" in capsys.readouterr().out
    other = ["--method", "rkmk8", "--step", "1e-3", "--bound", "1e-5"]
    assert main(["replay", str(log), "--resimulate", *other]) == 0


@pytest.mark.turn(3)
def test_a_run_reports_that_its_error_exceeds_the_accuracy(tmp_path):
    """The event is at the first sample after that; what follows does not violate the accuracy."""
    log = tmp_path / "a.mcap"
    arguments = ["run", "double_pendulum", "--duration", "30", "--every", "10", "--out", str(log)]
    assert main(arguments) == 0
    recording = repeats(log)
    _, event, later, _ = recording.events
    assert (event.name, later.name) == ("inaccurate", "unpredictable")
    assert re.search(r"exceeds the accuracy of 0.0001: errors grow tenfold in about [23]\.\d s: with", event.text)
    simulation = Simulation(load_scene("double_pendulum"), step=0.01)
    simulation.advance(3000)
    since = simulation.accurate_until
    assert 0.0 <= event.stamp_ns * 1e-9 - since < 0.1 + PART * 60.0
    assert events_of_runs.number(event.text) == pytest.approx(since, rel=1e-8)
    assert 0.0 <= later.stamp_ns * 1e-9 - simulation.predictable_until < 0.1 + PART * 60.0
    found = analyse(recording).figures["promise"]
    assert found["kept"] is True and found["beyond"] is True
    assert since - 0.1 <= found["seconds"] <= since + 1e-9


@pytest.mark.parametrize(
    "first, text, kept, seconds, warned",
    [
        (1e-2, events_of_runs.accuracy_requested(1e-6, 0.3), False, 0.6, False),
        (1e-6, events_of_runs.accuracy_requested(1e-2, 0.01), True, 0.6, False),
        (1e-2, events_of_runs.accuracy_requested(1e-3, 0.3), True, 0.6, False),
        (1e-2, events_of_runs.accuracy(1e-1, 0.3, 1e-2, 0.9, 0.1), True, 0.3, True),
    ],
)
@pytest.mark.turn(3)
def test_each_period_is_judged_by_its_accuracy(tmp_path, first, text, kept, seconds, warned):
    """The error of this run is from 1e-6 to 1e-3 after 0.02 s. Real time ends a guarantee, a request does not."""
    promise = {"accuracy": first, "horizon": 60.0, "length": 0.5}
    log = record(tmp_path / "a.mcap", load_scene("heavy_top"), 60, step=1e-2, per_sample=1, promise=promise)
    recording = read_recording(log)
    asked = float(text.partition("t = ")[2].split()[0])
    event = recording.events[0]._replace(name="accuracy", text=text, stamp_ns=round(asked * 1e9))
    found = analyse(dataclasses.replace(recording, events=[*recording.events[:1], event, *recording.events[1:]]))
    promise = found.figures["promise"]
    assert promise["kept"] is kept and promise["seconds"] == pytest.approx(seconds) and promise["beyond"] is warned
    assert ["as requested" not in text, bool(promise["changes"])] == [warned, not warned]
    assert any("is the accuracy" in each for each in found.figures["warnings"]) is warned
    assert ("the run itself reports" in found.figures["verdict"]) is warned
    (plot,) = [plot for title, _, plot in make_plots(found) if title == "Accuracy"]
    lines = {trace["name"]: trace for trace in plot["data"]}
    assert lines.keys() == {"true error", "accuracy"}
    if not warned:
        later = float(text.split()[0])
        for x, y in zip(lines["accuracy"]["x"], lines["accuracy"]["y"], strict=True):
            assert y == (first if x <= asked + 1e-9 else later), x


@pytest.mark.parametrize("since", [0.25, 0.3])
@pytest.mark.turn(3)
def test_a_finer_accuracy_is_not_judged_before_it_was_requested(tmp_path, monkeypatch, since):
    """Also where the event gives the last checkpoint before the change, as those of earlier versions do."""
    promise = {"accuracy": 1e-2, "horizon": 60.0, "length": 0.5}
    log = record(tmp_path / "a.mcap", load_scene("heavy_top"), 60, step=1e-2, per_sample=1, promise=promise)
    recording = read_recording(log)
    start, *others = recording.events
    change = start._replace(name="accuracy", text=events_of_runs.accuracy_requested(1e-6, 0.3), stamp_ns=300_000_000)
    told = start._replace(name="inaccurate", text=events_of_runs.inaccurate(since, 1e-6, ""), stamp_ns=310_000_000)
    changed = dataclasses.replace(recording, events=[start, change, told, *others])
    figures = analyse(changed).figures
    found = figures["promise"]
    assert (found["kept"], found["beyond"]) == (True, True) and found["seconds"] == pytest.approx(0.3)
    assert found["changes"] == [{"from_s": pytest.approx(0.3), "accuracy": 1e-6}]
    said = "the accuracy of 0.01 in 60 s (1e-06 from 0.3 s on, as requested) is kept in the first 0.3 s"
    assert said in figures["verdict"] and "Then the run itself reports" in figures["verdict"]
    assert "the last time before the estimated error exceeds the accuracy of 1e-06" in figures["warnings"][0]
    recorded = pytest.importorskip("liegroup_sim_ros.view.recorded")
    monkeypatch.setattr(recorded, "read_recording", lambda path: changed)
    frames = recorded.Recorded(log).history.frames
    assert {frame.bound[1] for frame in frames if frame.time <= 0.3 + 1e-9} == {1e-2}
    assert {frame.bound[1] for frame in frames if frame.time > 0.3 + 1e-9} == {1e-6}


@pytest.mark.parametrize("push, kept, seconds", [(None, False, 0.6), (25, False, 0.6), (0, False, 0.6)])
@pytest.mark.turn(3)
def test_a_missed_accuracy_is_reported_as_a_problem(tmp_path, push, kept, seconds):
    """With a much too large step of a method; wrenches do not end the accuracy."""
    pushes = [] if push is None else [(push, ("top", (0.0, 0.0, 1.0, 0.0, 0.0, 0.0)))]
    log = record(
        tmp_path / "a.mcap",
        load_scene("heavy_top"),
        60,
        step=1e-2,
        per_sample=1,
        pushes=pushes,
        promise={"accuracy": 1e-6, "horizon": 0.5, "length": 0.5},
    )
    figures = analyse(read_recording(log)).figures
    found = figures["promise"]
    assert found["kept"] is kept and found["beyond"] is False
    assert found["seconds"] == pytest.approx(seconds) and found["error"] > 1e-6
    assert any("is not kept" in text for text in figures["problems"])
    assert "the accuracy of 1e-06 in 0.5 s is not kept" in figures["verdict"]
