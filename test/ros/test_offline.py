# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim run` and `describe`: exact, self-describing files, and one-line errors."""

import csv
import json
import re
import subprocess
import sys

import numpy as np
import pytest
from golden import few_steps
from mcap.reader import make_reader
from scene_files import text_of
from volume import VERIFY

from liegroup_core import Simulation, load_scene
from liegroup_sim_ros.analysis.analyse import analyse
from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.messages import topics
from liegroup_sim_ros.messages.codecs import WrenchStampedCodec
from liegroup_sim_ros.messages.sensors import sensors
from liegroup_sim_ros.numbers import counted
from liegroup_sim_ros.playback.resimulate import resimulate
from liegroup_sim_ros.recording.read import read_recording
from liegroup_sim_ros.report.plots import make_plots


def test_a_csv_table_has_the_exact_numbers(tmp_path, capsys):
    path = tmp_path / "a.csv"
    given = ["run", "double_pendulum", "--duration", "0.095", "--method", "rkmk4", "--no-estimate"]
    given += ["--out", str(path)]
    assert main(given) == 0 and main(given) == 2
    assert "the file already exists" in capsys.readouterr().err
    with open(path, encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    assert len(rows) == 96 and len(set(header)) == len(header) == 1 + 2 * 13 + 2 * 2 + 2
    found = [dict(zip(header, map(float, row))) for row in rows]
    simulation = Simulation(load_scene("double_pendulum"), "rkmk4", 1e-3)
    for row in found:
        simulation.advance(round(row["time [s]"] / 1e-3) - simulation.steps)
        sample = simulation.sample()
        assert row["time [s]"] == sample.time and row["energy [J]"] == sample.energy
        assert row["lower.z [m]"] == sample.positions["lower"][2]
        assert row["lower.qw"] == sample.quaternions["lower"][3]
        assert row["upper.wx [rad/s]"] == sample.twists["upper"][0]
        assert row["upper.vz [m/s]"] == sample.twists["upper"][5]
        for joint, (position, velocity) in sample.joint_coordinates.items():
            assert row[f"{joint}.position [rad]"] == position
            assert row[f"{joint}.velocity [rad/s]"] == velocity


def test_every_file_has_the_estimated_errors_if_they_are_carried(tmp_path, capsys):
    given = ["run", "double_pendulum", "--method", "rkmk4", "--duration", "0.095", "--every", "1"]
    for suffix in ("npz", "csv", "mcap"):
        assert main([*given, "--out", str(tmp_path / f"a.{suffix}")]) == 0
        assert main([*given, "--no-estimate", "--out", str(tmp_path / f"b.{suffix}")]) == 0
    arrays = np.load(tmp_path / "a.npz")
    with open(tmp_path / "a.csv", encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    recording = read_recording(tmp_path / "a.mcap")
    assert np.array_equal(recording.errors.stamp_ns, recording.pose["lower"].stamp_ns)
    (piece,) = recording.samples()
    frame = recording.to_pandas("errors")
    assert frame.shape == (96, 8) and (frame.index == recording.errors.time).all()
    simulation = Simulation(load_scene("double_pendulum"), "rkmk4")
    for k in range(96):
        errors = simulation.sample().errors
        assert np.isnan(errors).all() == (k in (1, 2, 3))
        assert arrays["errors"][k].tobytes() == errors.tobytes()
        assert recording.errors.errors[k].tobytes() == piece.errors[k].tobytes() == errors.tobytes()
        for body, values in zip(("upper", "lower"), errors):
            parts = frame[body][["position", "attitude", "velocity", "angular_velocity"]]
            assert parts.iloc[k].to_numpy().tobytes() == values.tobytes()
            for name, value in zip(
                (
                    "position_error [m]",
                    "attitude_error [rad]",
                    "velocity_error [m/s]",
                    "angular_velocity_error [rad/s]",
                ),
                values,
            ):
                assert np.array_equal(float(rows[k][f"{body}.{name}"]), value, equal_nan=True)
        simulation.advance()
    assert "errors" not in np.load(tmp_path / "b.npz")
    without = read_recording(tmp_path / "b.mcap")
    assert without.errors is None and "errors" not in without.settings["topics"]
    assert not any("_error" in name for name in (tmp_path / "b.csv").read_text().split("\n")[0].split(","))
    assert analyse(without, reference=False).figures["estimate"] is None


def test_a_run_that_is_too_short_for_an_estimate_says_from_when_on_there_is_one(tmp_path, capsys):
    def said(duration):
        out = str(tmp_path / f"{duration}.npz")
        method = ["--method", "rkmk8", "--step", "0.01"]
        assert main(["run", "double_pendulum", *method, "--duration", duration, "--out", out]) == 0
        return capsys.readouterr().out

    first = re.search(r"; the error is not estimated before t = (\S+) s\n", said("0.02"))[1]
    assert "estimated error at the end" in said(first)


@pytest.mark.parametrize("method", [[], ["--method", "rkmk4", "--step", "0.01"], ["--method", "radau5"]])
def test_samples_of_any_rate_lie_at_whole_ns_and_repeat(tmp_path, method):
    log, arrays = tmp_path / "a.mcap", tmp_path / "a.npz"
    for out in (log, arrays):
        assert main(["run", "four_bar", *method, "--duration", "0.505", "--rate", "333", "--out", str(out)]) == 0
    recording = read_recording(log)
    stamps = [*(round(k * 1e9 / 333) for k in range(169)), 505_000_000]
    times = recording.pose["crank"].time
    assert np.rint(times * 1e9).tolist() == stamps
    assert np.load(arrays)["time"] == pytest.approx(times, abs=1e-12)
    assert np.array_equal(np.load(arrays)["poses"][:, 0, :3, 3], recording.pose["crank"].position)
    figures = resimulate(recording)
    assert figures["identical"] == figures["samples"] == 170 and figures["missing_samples"] == 0


def test_samples_at_given_times(tmp_path, capsys):
    times, table, log = (tmp_path / name for name in ("times.txt", "a.csv", "a.mcap"))
    times.write_text("# s\n0\n0.1\n\n0.3333333\n")
    for out in (table, log):
        assert main(["run", "heavy_top", "--times", str(times), "--out", str(out)]) == 0
    rows = list(csv.DictReader(table.read_text().splitlines()))
    assert [row["time [s]"] for row in rows] == ["0.0", "0.1", "0.3333333"]
    assert resimulate(read_recording(log))["identical"] == 3
    capsys.readouterr()
    for text, said in (("0.1\n0.1", "line 2: times must"), ("x", "line 1: expected a time"), ("0", "no time after")):
        times.write_text(text)
        assert main(["run", "heavy_top", "--times", str(times), "--out", str(tmp_path / "b.csv")]) == 2
        assert said in capsys.readouterr().err
    for wrong in (["--rate", "0"], ["--rate", "10", "--every", "2"], ["--rate", "1e9", "--duration", "1e3"], []):
        duration = [] if not wrong or "--duration" in wrong else ["--duration", "1"]
        assert main(["run", "heavy_top", *wrong, *duration, "--out", str(tmp_path / "b.csv")]) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1 and not (tmp_path / "b.csv").exists()


@pytest.mark.parametrize(
    "given, shown",
    [
        (["--accuracy", "2e-5", "--horizon", "7"], "rkmk853, accuracy 2e-05 in 7 s, step "),
        (["--method", "rkmk4"], "rkmk4, step "),
    ],
)
def test_info_shows_what_a_recording_was_made_to(tmp_path, capsys, monkeypatch, given, shown):
    monkeypatch.setenv("COLUMNS", "200")
    path = str(tmp_path / "a.mcap")
    assert main(["run", "double_pendulum", *given, "--duration", "0.02", "--out", path]) == 0
    capsys.readouterr()
    assert main(["info", path]) == 0
    assert f"double_pendulum, {shown}" in capsys.readouterr().out


def test_one_of_a_kind_has_no_plural(tmp_path, capsys):
    path = str(tmp_path / "a.mcap")
    for command in (
        ["run", "free_body", "--duration", "0.01", "--step", "0.01", "--out", path],
        ["describe", "free_body"],
        ["info", path],
        ["analyze", path],
        ["replay", path, "--resimulate"],
    ):
        assert main(command) == 0
    shown = capsys.readouterr().out
    assert "in 1 step, 2 samples" in shown and "in 2 of 2 samples" in shown
    assert not re.search(r"\b(?<![.])1 (bodies|(step|sample|topic|message|run|byte|tick)s)\b", shown)
    assert [counted(k, "body") for k in range(3)] == ["0 bodies", "1 body", "2 bodies"]


def test_npz_arrays_equal_those_of_the_simulation(tmp_path, capsys):
    path = tmp_path / "a.npz"
    command = (
        "run double_pendulum --duration 0.095 --every 10 --step 1e-3 --method rkmk8 --group so3xr3 "
        f"--stabilisation projection --out {path}"
    )
    assert main(command.split()) == 0
    assert capsys.readouterr().out.startswith(f"{path}: 0.095 s in 95 steps, 11 samples")
    found = np.load(path)
    assert found["steps"].tolist() == [*range(0, 91, 10), 95]
    simulation = Simulation(load_scene("double_pendulum"), "rkmk8", 1e-3, "so3xr3", "projection")
    for k, step in enumerate(found["steps"]):
        simulation.advance(int(step) - simulation.steps)
        sample = simulation.sample()
        assert found["time"][k] == sample.time and found["energy"][k] == sample.energy
        assert np.array_equal(found["poses"][k], sample.pose_matrices)
        assert np.array_equal(found["twists"][k], sample.twist)
        assert found["residual"][k] == sample.constraint_residual
    assert found["bodies"].tolist() == ["upper", "lower"]
    settings = json.loads(str(found["settings"]))
    assert (settings["method"], settings["stabilisation"]) == ("rkmk8", "projection")
    assert settings["stopped"] is None and settings["steps_per_sample"] == 10
    assert str(found["scene"]) == load_scene("double_pendulum").text


@pytest.mark.parametrize(
    "more",
    [
        ["--method", "rkmk54", "--rtol", "1e-9", "--atol", "1e-9"],
        [*("--method", "rkmk4", "--group", "so3xr3"), *("--stabilisation", "baumgarte", "--baumgarte-time", "0.05")],
    ],
)
def test_an_offline_recording_is_analysed_like_one_of_the_node(tmp_path, more):
    """Simulating it again from the settings in the file is bit-identical."""
    path = tmp_path / "a.mcap"
    assert main(["run", "heavy_top", "--duration", "0.5", "--every", "10", "--out", str(path), *more]) == 0
    recording = read_recording(path)
    assert recording.complete and recording.lost == {}
    assert [event.name for event in recording.events] == ["start", "stop"]
    analysis = analyse(recording, reference=False)
    assert analysis.figures["problems"] == []
    repeat = analysis.figures["repeat"]
    assert (repeat["samples"], repeat["identical"]) == (51, 51)
    assert repeat["stopped"] is repeat["first_difference"] is None
    assert set(repeat["largest_difference"].values()) == {0.0}
    assert analysis.figures["sim_seconds"] == pytest.approx(0.5)
    assert main(["analyze", str(path), "--no-reference", "--html", str(tmp_path / "a.html")]) == 0


@pytest.mark.turn(3)
def test_a_recording_with_arrays_has_the_same_motion(tmp_path, monkeypatch):
    """Poses and twists of all bodies in two topics, as in large scenes, or in two topics for each body."""
    given = ["run", "four_bar", "--method", "rkmk4", "--step", "0.002", "--duration", "0.5", "--out"]
    assert main([*given, str(tmp_path / "own.mcap")]) == 0
    monkeypatch.setattr(topics, "MOST_OWN", 2)
    assert main([*given, str(tmp_path / "all.mcap")]) == 0
    own, arrays = (read_recording(tmp_path / f"{name}.mcap") for name in ("own", "all"))
    names = {topic.rpartition("/")[2] for topic in arrays.topics}
    assert {"poses", "twists", "errors"} <= names and not {"pose", "twist"} & names
    assert arrays.complete and own.bodies == arrays.bodies
    for body in own.bodies:
        for kind in ("pose", "twist"):
            for one, other in zip(getattr(own, kind)[body], getattr(arrays, kind)[body], strict=True):
                assert len(one) == 251 and one.tobytes() == other.tobytes()
    (one,), (other,) = own.samples(), arrays.samples()
    assert one.laws is other.laws is None
    assert all(np.array_equal(*pair, equal_nan=True) for pair in zip(one[:-1], other[:-1], strict=True))
    assert own.to_pandas().equals(arrays.to_pandas())
    figures = [analyse(recording).figures for recording in (own, arrays)]
    same = ("bodies", "invariants", "reference", "estimate", "local_error", "problems", "samples")
    assert len(figures[0].keys() & set(same)) > 3
    assert all(figures[0].get(key) == figures[1].get(key) for key in same)
    assert resimulate(arrays)["identical"] == 251


@pytest.mark.parametrize("suffix", ["npz", "mcap"])
def test_a_failed_run_leaves_the_samples_before_the_failure(tmp_path, capsys, suffix):
    """The top rotates by 15 rad in a step of 0.1 s, beyond the limit 2 pi."""
    path = tmp_path / f"a.{suffix}"
    assert main([*"run lagrangian_top --method rkmk4 --duration 1 --step 0.1 --every 1 --out".split(), str(path)]) == 1
    said = capsys.readouterr().err.splitlines()[-1]
    assert said.startswith("liegroup_sim: stopped at t = 0 s") and "smaller step" in said
    if suffix == "npz":
        found = np.load(path)
        assert found["steps"].tolist() == [0]
        assert "smaller step" in json.loads(str(found["settings"]))["stopped"]
    else:
        recording = read_recording(path)
        assert [event.name for event in recording.events] == ["start", "fault", "stop"]
        assert analyse(recording, reference=False).figures["faults"]


@pytest.mark.turn(3)
def test_a_recording_needs_interface_packages_but_not_rclpy(tmp_path):
    """One line if the packages are missing; with them, rclpy is not imported."""

    def run(prelude, name):
        return subprocess.run(
            [
                sys.executable,
                "-P",
                "-c",
                "import sys\n" + prelude + "\n"
                "from liegroup_sim_ros.commands.main import main\n"
                f"code = main(['run', 'heavy_top', '--duration', '0.01', '--out', {str(name)!r}])\n"
                "assert 'rclpy' not in sys.modules\nsys.exit(code)",
            ],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    assert run("", tmp_path / "a.mcap").returncode == 0
    hidden = (
        "import importlib.util as u; find = u.find_spec\n"
        "u.find_spec = lambda name, *a: None if name.endswith('_msgs') else find(name, *a)"
    )
    refused = run(hidden, tmp_path / "b.mcap")
    assert refused.returncode == 2 and "geometry_msgs" in refused.stderr
    assert "Traceback" not in refused.stderr and not (tmp_path / "b.mcap").exists()
    assert run(hidden, tmp_path / "b.npz").returncode == 0


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ((), "2 touches, 2 leavings, 0 slips of contact, 0 press at the end"),
        (("--method", "rkmk4"), "events of contacts unknown with fixed steps, 0 press at the end"),
    ],
)
def test_the_summary_of_a_run_has_the_events_of_contacts(tmp_path, capsys, settings, said):
    """An elastic ball that falls by 0.2 m lands after sqrt(2 h / g) = 0.2 s, and again after three times as long."""
    scene = tmp_path / "ball.yaml"
    scene.write_text(
        "name: ball\ngravity: [0, 0, -9.81]\n"
        "bodies: [{name: ball, shape: {type: sphere, radius: 0.1, mass: 2}, position: [0, 0, 0.3]}]\n"
        "forces: [{name: floor, type: contact, body: ball, sinks: 1.0e-4, damping: 0}]\n"
    )
    assert main(["run", str(scene), "--duration", "0.9", "--out", str(tmp_path / "ball.mcap"), *settings]) == 0
    assert f", {said}" in capsys.readouterr().out


@pytest.mark.turn(3)
def test_describe_says_that_a_mechanism_is_planar(capsys):
    for scene, expected in (("four_bar", True), ("bricard", False)):
        assert main(["describe", scene]) == 0
        lines = capsys.readouterr().out.splitlines()
        assert any(line.split()[:2] == ["planar", "across"] for line in lines) is expected


def test_describe_prints_a_summary(capsys):
    assert main(["describe", "heavy_top"]) == 0
    out = capsys.readouterr().out
    for text in ("3 degrees of freedom", "spherical", "angular momentum about", "rkmk8"):
        assert text in out
    assert main(["describe", "heavy_top", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["degrees_of_freedom"] == 3
    # A step costs its machine something, and twelve stages more than four.
    assert 0.0 < facts["cost"]["rkmk4"]["step_us"] < facts["cost"]["rkmk8"]["step_us"]
    assert main(["describe", "nope"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.turn(3)
def test_figures(tmp_path, capsys, monkeypatch):
    """The rotation figures with few steps, as in test_rotation.py."""
    pytest.importorskip("matplotlib")
    if not VERIFY:
        monkeypatch.setattr("liegroup_sim_ros.chapter.rotation_figures.PANELS", few_steps())
        monkeypatch.setattr("liegroup_sim_ros.chapter.rotation_figures.TOP_INTEGRALS", {})
    assert main(["figures", "--out", str(tmp_path)]) == 0
    for name in ("fig_6_2", "fig_6_4", "fig_6_5"):
        data = (tmp_path / f"{name}.png").read_bytes()
        assert data.startswith(b"\x89PNG") and len(data) > 20_000
    assert "here" in capsys.readouterr().out


@pytest.mark.turn(3)
def test_a_run_writes_the_reactions_on_request(tmp_path, capsys):
    """The same numbers in all three files, those of a simulation with the same settings."""
    arguments = ["run", "four_bar", "--method", "rkmk4", "--step", "1e-3", "--every", "50"]
    arguments += ["--duration", "0.1", "--no-estimate", "--reactions", "--out"]
    for name in ("run.npz", "run.csv", "run.mcap"):
        assert main([*arguments, str(tmp_path / name)]) == 0
    simulation = Simulation(load_scene("four_bar"), "rkmk4", 1e-3, estimate=False)
    simulation.advance(50)
    expected = np.array(list(simulation.sample().reactions.values()))
    arrays = np.load(tmp_path / "run.npz")
    joints = [joint.name for joint in simulation.scene.joints]
    assert arrays["joints"].tolist() == joints and np.isnan(expected).any()
    assert np.array_equal(arrays["reactions"][1], expected, equal_nan=True)
    with open(tmp_path / "run.csv", newline="") as file:
        row = list(csv.DictReader(file))[1]
    columns = [f"t{axis} [N m]" for axis in "xyz"] + [f"f{axis} [N]" for axis in "xyz"]
    written = [[float(row[f"{joint}.{column}"]) for column in columns] for joint in joints]
    assert np.array_equal(written, expected, equal_nan=True)
    with open(tmp_path / "run.mcap", "rb") as file:
        messages = [
            (channel.topic, WrenchStampedCodec.decode_one(message.data))
            for _, channel, message in make_reader(file).iter_messages()
            if channel.topic.endswith("/wrench")
        ]
    recorded = {topic: wrench for topic, (ns, _, wrench) in messages if ns == 50_000_000}
    found = [recorded[f"/sim_node/{joint}/wrench"] for joint in joints]
    assert np.array_equal(found, expected, equal_nan=True)
    recording = read_recording(tmp_path / "run.mcap")
    track = recording.reactions["crank_coupler"]
    assert track.time[1] == 0.05 and np.array_equal(track.wrench[1], expected[1], equal_nan=True)
    frame = recording.to_pandas("reactions")
    assert frame.iloc[1]["crank_coupler", "fx"] == expected[1, 3]
    plots = {title: plot for title, _, plot in make_plots(analyse(recording))}
    curves = {trace["name"]: trace["y"] for trace in plots["Reaction forces"]["data"]}
    determined = expected[1, 3:][~np.isnan(expected[1, 3:])]
    # A page has seven digits.
    size = np.linalg.norm(determined)
    assert curves["crank_coupler"][1] == pytest.approx(size, rel=1e-6)


def test_a_run_writes_the_efforts_of_forces_at_joints_beside_the_reactions(tmp_path):
    scene = tmp_path / "driven.yaml"
    scene.write_text(text_of("driven_offline.yaml"))
    arguments = ["run", str(scene), "--method", "rkmk4", "--step", "1e-3", "--every", "100"]
    for name in ("run.npz", "run.csv", "run.mcap"):
        out = ["--duration", "0.1", "--reactions", "--out", str(tmp_path / name)]
        assert main([*arguments, *out]) == 0
    arrays = np.load(tmp_path / "run.npz")
    assert arrays["forces"].tolist() == ["drive", "spring"]
    assert arrays["efforts"][0].tolist() == [2.0, 5.0] and arrays["efforts"][1, 1] < 5.0
    with open(tmp_path / "run.csv", newline="") as file:
        row = list(csv.DictReader(file))[1]
    written = [float(row["drive.effort [N m]"]), float(row["spring.effort [N]"])]
    assert written == arrays["efforts"][1].tolist()
    recorded = read_recording(tmp_path / "run.mcap").reactions
    assert set(recorded) == {"hinge", "rail", "drive", "spring"}
    assert recorded["drive"].wrench[1].tolist() == [0, 0, written[0], 0, 0, 0]
    assert recorded["spring"].wrench[1].tolist() == [0, 0, 0, 0, 0, written[1]]


def test_a_run_writes_the_impulses_of_all_joints_at_impacts(tmp_path):
    """Arrays, table and recording have those of a repeated simulation, bit by bit."""
    scene = load_scene("door")
    settings = {"method": "rkmk4", "step": 1e-3}
    simulation = Simulation(scene, **settings, quiet=True)
    assert simulation.drain_impacts() == []
    simulation.advance(3000)
    impacts = simulation.drain_impacts()
    assert len(impacts) == 2 and np.abs(impacts[0].array).max() > 10.0
    arguments = ["run", "door", "--method", "rkmk4", "--step", "1e-3", "--every", "100"]
    for name in ("run.npz", "run.csv", "run.mcap"):
        out = ["--duration", "3", "--reactions", "--out", str(tmp_path / name)]
        assert main([*arguments, *out]) == 0
    arrays = np.load(tmp_path / "run.npz")
    assert arrays["impact_time"].tolist() == [impact.time for impact in impacts]
    expected = np.array([impact.array for impact in impacts])
    assert np.array_equal(arrays["impulses"], expected, equal_nan=True)
    joint = scene.joints[0].name
    recording = read_recording(tmp_path / "run.mcap")
    track = recording.impulses[joint]
    assert track.stamp_ns.tolist() == [impact.time_ns for impact in impacts]
    assert np.array_equal(track.impulse, expected[:, 0], equal_nan=True)
    frame = recording.to_pandas("impulses")
    assert frame[joint, "fx"].tolist() == expected[:, 0, 3].tolist()
    assert list(recording.reactions) == [joint]  # impulses are not among them
    figures = resimulate(recording)
    assert figures["identical"] == figures["samples"] == 31
    with open(tmp_path / "run.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    hits = [row for row in rows if float(row[f"{joint}.impulse_fx [N s]"]) != 0.0]
    assert len(rows) == 31 and len(hits) == 2
    for row, impulse in zip(hits, expected[:, 0]):
        names = [name for name in row if ".impulse_" in name]
        assert [float(row[name]) for name in names] == impulse.tolist()
    assert main([*arguments, "--duration", "1", "--out", str(tmp_path / "plain.npz")]) == 0
    assert "impulses" not in np.load(tmp_path / "plain.npz")


SENSED = text_of("sensed_offline.yaml")


def test_a_run_writes_the_sensors_of_the_scene(tmp_path):
    """The bytes of the node's topics, at every sample; arrays with the same numbers."""
    scene = tmp_path / "sensed.yaml"
    scene.write_text(SENSED)
    arguments = ["run", str(scene), "--duration", "0.2", "--every", "5", "--out"]
    for name in ("run.npz", "run.mcap"):
        assert main([*arguments, str(tmp_path / name)]) == 0
    simulation, arrays = Simulation(load_scene(scene)), np.load(tmp_path / "run.npz")
    encoders = sensors(simulation.layout, "world")
    with open(tmp_path / "run.mcap", "rb") as file:
        recorded = {
            (channel.topic, message.log_time): (schema.name, message.data)
            for schema, channel, message in make_reader(file).iter_messages()
        }
    assert [topic for topic, _, _ in encoders] == [
        *("~/imu/imu", "~/disc/joint_state", "~/bearing/wrench"),
        *("~/tip/odometry", "~/wire/distance"),
    ]
    assert arrays["steps"].tolist() == [0, 5, 10, 15, 20]
    for k in range(5):
        sample = simulation.sample()
        for topic, message_type, encode in encoders:
            found = recorded.pop((f"/sim_node{topic[1:]}", sample.time_ns))
            assert found == (message_type, encode(sample.time_ns, sample))
        for name, numbers in sample.sensors.items():
            assert np.array_equal(arrays[f"sensors/{name}"][k], numbers)
        simulation.advance(5)
    left = {topic.split("/")[2] for topic, _ in recorded}
    assert not left & set(sample.sensors)


def test_a_joint_with_the_name_of_a_body_has_another_topic(tmp_path, capsys):
    """~/BODY/wrench is an input of the node."""
    scene = tmp_path / "one.yaml"
    text = (
        "name: one\ngravity: [0, 0, -9.81]\nbodies: [{name: arm, mass: 1, inertia: [1, 1, 1]}MORE]\n"
        "joints: [{name: arm, type: revolute, parent: world, child: arm, child_frame: {}}]\n"
    )
    scene.write_text(text.replace("MORE", ""))
    common = ["run", str(scene), "--duration", "0.1", "--reactions", "--out"]
    assert main([*common, str(tmp_path / "run.mcap")]) == 0
    recording = read_recording(tmp_path / "run.mcap")
    topics = [channel.topic for channel in recording.channels.values()]
    assert "/sim_node/arm_reaction/wrench" in topics
    assert recording.reactions["arm"].wrench[0, 5] == pytest.approx(9.81, rel=1e-12)
    scene.write_text(text.replace("MORE", ", {name: arm_reaction, mass: 1, inertia: [1, 1, 1]}"))
    assert main([*common, str(tmp_path / "more.mcap")]) == 2
    assert "give arm_reaction another name" in capsys.readouterr().err


def test_a_recording_has_the_efforts_of_driven_joints(tmp_path):
    path = tmp_path / "a.mcap"
    assert main(["run", "driven_arm", "--duration", "0.2", "--out", str(path)]) == 0
    recording = read_recording(path)
    states, simulation = recording.joint_states, Simulation(load_scene("driven_arm"))
    columns = [states.names.index(joint) for joint in ("shoulder", "elbow")]
    for k, time in enumerate(states.time):
        simulation.advance(round(time / simulation.step) - simulation.steps)
        efforts = simulation.sample().drive_efforts
        assert states.effort[k, columns].tolist() == [efforts["shoulder"], efforts["elbow"]]
    frame = recording.to_pandas("joints")
    assert frame["elbow"].effort.iloc[-1] == efforts["elbow"] != 0.0
    assert recording.to_pandas("motions").empty
