# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim analyze`: closed forms, order, trends, limits, many logs, URLs, schema."""

import functools
import json
import math
import re
import subprocess
import sys
import threading
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import SimpleNamespace

import fsspec
import jsonschema
import numpy as np
import pytest
from made_run import PAIR, record
from scene_files import cases, text_of

from liegroup_core import Simulation, load_scene
from liegroup_core.reference.elliptic import free_body, heavy_top, to_floats
from liegroup_core.reference.trajectory import Distance
from liegroup_core.scene.load import scene_from_text
from liegroup_core.study import tasks
from liegroup_sim_ros.analysis import local_error
from liegroup_sim_ros.analysis.analyse import analyse
from liegroup_sim_ros.analysis.bounds import find_exceeded
from liegroup_sim_ros.analysis.comparison import compare
from liegroup_sim_ros.analysis.drift import Drift, thinned
from liegroup_sim_ros.analysis.estimate import Estimate
from liegroup_sim_ros.analysis.promise import Promise
from liegroup_sim_ros.commands import analyze
from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.numbers import error_text
from liegroup_sim_ros.recording import read, write_run
from liegroup_sim_ros.recording.motion import RecordedMotion
from liegroup_sim_ros.recording.read import RecordingError, read_recording
from liegroup_sim_ros.report.plots import make_plots
from liegroup_sim_ros.report.summary import headline, overview, sections

SCHEMA = Path(__file__).resolve().parents[2] / "config" / "analysis.schema.json"
FREE = text_of("free_analyze_more.yaml")
TOP = text_of("top_analyze_more.yaml")


def run(path, scene, method="rkmk4", step=2e-3, duration=1.0, every=10, spoil=lambda sample: sample, **options):
    """Record a run of the engine without pacing; `spoil` may change a sample, `first` what the run begins with."""
    first = options.pop("first", lambda simulation: None)
    simulation = Simulation(scene, method, step, **options)
    first(simulation)
    with write_run.LogFile(path, simulation, every, 0) as file:
        file.sample(spoil(simulation.sample()))
        for _ in range(round(duration / step / every)):
            simulation.advance(every)
            file.sample(spoil(simulation.sample()))
        file.finish(simulation, None, False, 1.0)
    return path


@pytest.mark.parametrize("text", [FREE, TOP], ids=["free body", "symmetric top"])
@pytest.mark.turn(3)
def test_the_error_against_the_closed_form_and_the_reference_agree(tmp_path, text):
    """Closed form and independent integration share no code."""
    recording = read_recording(run(tmp_path / "a.mcap", scene_from_text(text), step=1e-2, every=5))
    found = analyse(recording).figures["reference"]
    assert (found["kind"], found["seconds"]) == ("integration", 1.0)
    (body,) = scene_from_text(text).bodies
    angles, blocks = [], list(RecordedMotion(recording).blocks())
    for time, ours in ((at, R) for block in blocks for at, R in zip(block.times.tolist(), block.rotation[:, 0])):
        start = body.rotation, np.array(body.angular_velocity), time
        if text == FREE:
            turn, _ = free_body(body.inertia_matrix, *start)
        else:  # about the pivot, 0.2 m below the centre of mass
            turn, _ = heavy_top(0.02 + 1.0 * 0.2**2, 0.03, 0.2, (0, 0, 1), (0, 0, -9.81), *start)
        angles.append(2.0 * np.arcsin(np.linalg.norm(ours - to_floats(turn)) / np.sqrt(8.0)))
    # What the integration is not sure of, ten times, for its estimate is of a looser run.
    assert found["angle"]["max"] == pytest.approx(max(angles), abs=10.0 * found["angle"]["uncertainty"] + 1e-13)
    assert found["angle"]["max"] > 1e-9 > 1e3 * found["angle"]["uncertainty"]


@pytest.mark.parametrize("method, order, step", cases("observed_order_and_one_step_error"))
def test_observed_order_and_one_step_error(tmp_path, method, order, step):
    """The order is observed, and the error of the first step equals its estimate."""
    scene = scene_from_text(TOP)
    recording = read_recording(run(tmp_path / "a.mcap", scene, method, step, 20 * step, 1))
    figures = analyse(recording, reference=False).figures["local"]
    # Of h^p (1 + c h + ...) the next term, c h of 25 rad/s, spoils a tenth at the coarsest pair.
    assert figures["order"] == pytest.approx(order, abs=0.25)
    assert figures["order_expected"] == order
    one, fine = Simulation(scene, method, step), Simulation(scene, method, step / 32)
    one.advance(), fine.advance(32)
    true = np.linalg.norm(one.sample().positions["top"] - fine.sample().positions["top"])
    # The largest of eight places, so at least about the one at the start; 1/32^p is left out.
    assert 0.5 * true <= figures["position_m"] <= 30.0 * true


def test_the_error_of_a_step_with_error_control_takes_three_steps_a_window(tmp_path, monkeypatch):
    """One step and two halves: its error has no order, so that no other steps are needed."""
    recording = read_recording(run(tmp_path / "a.mcap", scene_from_text(TOP), None, 0.01, 0.2, 1, accuracy=1e-6))
    simulation = Simulation(scene_from_text(TOP), accuracy=1e-6, step=0.01)
    taken, advance = [], local_error.WorkLimit.advance

    def counting(self, simulation, steps):
        taken.append(steps)
        advance(self, simulation, steps)

    motion = RecordedMotion(recording, simulation.layout)
    list(motion.blocks())
    monkeypatch.setattr(local_error.WorkLimit, "advance", counting)
    figures = local_error.local_error(simulation.scene, recording, motion, simulation.layout)
    assert figures["windows"] == local_error.WINDOWS == 8 and figures["order"] is None
    assert sum(taken) == 3 * 8


def test_trend_and_curves_of_a_drift():
    """Slope of a line with noise; a wrench starts a new interval."""

    class Stretch:
        def free(self, bodies):
            return np.array([[-1.0, 400.0], [500.0, np.inf]])

    class Block:
        stretch = Stretch()

        def __init__(self, steps):
            self.steps, self.log_times = steps, steps * 0.01

    drift = Drift(1, ("a",), 1000)
    steps = np.arange(1000)
    values = 3.0 + 0.5 * steps * 0.01 + 1e-3 * (-1.0) ** steps + 100.0 * (steps > 450)
    for part in np.array_split(steps, 7):
        drift.add(Block(part), values[part, None])
    drift.close()
    assert drift.intervals == 2 and drift.seconds == pytest.approx(4.0 + 4.99)
    assert drift.trend[0] == pytest.approx(0.5, rel=1e-3) and drift.explained[0] > 0.999
    assert drift.worst[0] == pytest.approx(0.5 * 4.99, rel=2e-3)
    assert sum(len(times) for times, _ in drift.curves[0]) == 401 + 500
    times, thin = thinned(np.arange(10.0), np.array([0, 1, -5, 2, 0, 0, 7, 1, 1, -2.0]), 4)
    assert (times.tolist(), thin.tolist()) == ([2, 6, 8, 9], [-5, 7, 1, -2])


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Folder with two valid recordings, a truncated one and a file that is none."""
    folder = tmp_path_factory.mktemp("logs")
    run(folder / "a.mcap", load_scene("heavy_top"), estimate=False)
    run(folder / "b.mcap", load_scene("heavy_top"), "rkmk8", estimate=False)
    data = run(folder / "c.mcap", scene_from_text(FREE)).read_bytes()
    (folder / "c.mcap").write_bytes(data[:-3000])
    (folder / "d.mcap").write_bytes(b"no log")
    return folder


def checked(path):
    """JSON document of --json, validated by its schema."""
    document = json.loads(path.read_text(), parse_constant=pytest.fail)
    jsonschema.Draft202012Validator(json.loads(SCHEMA.read_text())).validate(document)
    return document


@pytest.mark.turn(3)
def test_the_schema_describes_every_key(tmp_path, logs, capsys):
    jsonschema.Draft202012Validator.check_schema(json.loads(SCHEMA.read_text()))
    log = record(
        tmp_path / "pair.mcap", scene_from_text(PAIR), 100, resets=(50,), pushes=[(20, ("left", (0, 0, 1.0, 0, 0, 0)))]
    )
    assert main(["analyze", str(log), "--json", str(tmp_path / "x.json"), "--compare", str(log)]) == 0
    document = checked(tmp_path / "x.json")
    assert document["comparison"]["identical"] == document["comparison"]["samples"] == 12
    assert main(["analyze", str(logs / "c.mcap"), "--json", str(tmp_path / "x.json")]) == 0
    assert not checked(tmp_path / "x.json")["logs"][0]["complete"]
    capsys.readouterr()


@pytest.mark.parametrize("way", ["dask", "without dask", "cluster"])
@pytest.mark.volume(1)
def test_many_recordings_give_one_line_each(logs, tmp_path, capsys, monkeypatch, way):
    """Unreadable recordings do not prevent the analysis of the others."""
    options = ["--json", str(tmp_path / "x.json"), "--max-error", "1e-7"]
    if way == "without dask":
        monkeypatch.setitem(sys.modules, "dask", None)
    if way == "cluster":
        from dask.distributed import LocalCluster

        cluster = LocalCluster(
            n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None, protocol="tcp", host="127.0.0.1"
        )
        options += ["--scheduler", cluster.scheduler_address]
    try:
        assert main(["analyze", str(logs / "[abd].mcap"), *options]) == 2
    finally:
        if way == "cluster":
            cluster.close()
    out, err = capsys.readouterr()
    assert [line.split()[0] for line in out.splitlines()[1:4]] == ["a.mcap", "b.mcap", "d.mcap"]
    assert err.splitlines()[-1] == f"liegroup_sim: {logs / 'd.mcap'}: not an MCAP file"
    document = checked(tmp_path / "x.json")
    assert [entry["log"] for entry in document["logs"]] == [str(logs / name) for name in ("a.mcap", "b.mcap", "d.mcap")]
    alone = analyse(read_recording(logs / "a.mcap")).figures
    assert document["logs"][0]["reference"]["angle"] == alone["reference"]["angle"]
    assert [text.split(": ")[0] for text in document["bounds"]["exceeded"]] == 2 * [
        str(logs / "a.mcap")
    ]  # rkmk8 is exact enough


@pytest.mark.turn(3)
def test_a_violated_or_unjudged_limit_fails_the_command(logs, tmp_path, capsys, monkeypatch):
    """Exit code 1 and one line, also if a limit cannot be checked; exit code 2 for wrong input."""
    log = str(logs / "a.mcap")
    assert main(["analyze", log, "--max-error", "1e-3", "--max-drift", "1e-3"]) == 0
    assert capsys.readouterr().err == ""
    assert main(["analyze", log, "--max-error", "1e-9", "--max-drift", "1e-12"]) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "error" in err and "relative drift" in err
    driven = FREE + "forces: [{name: jet, type: applied_wrench, body: box, force: [1, 2, 3]}]"
    alone = record(tmp_path / "d.mcap", scene_from_text(driven), 50)
    assert main(["analyze", str(alone), "--max-drift", "1"]) == 1
    assert "there is no drift to check" in capsys.readouterr().err
    assert main(["analyze", log, "--no-reference", "--max-error", "1"]) == 1
    assert "unknown: the comparison with a reference was not requested; no est" in capsys.readouterr().err
    assert main(["analyze", log, log, "--compare", log]) == 2
    for nothing, said in ((tmp_path / "*.none", "no file matches"), (tmp_path.parent, "the folder has no *.mcap file")):
        assert main(["analyze", str(nothing)]) == 2
        assert said in capsys.readouterr().err
    monkeypatch.setattr(tasks, "CONNECTING", 1)  # s instead of 10: nothing listens on that port
    assert main(["analyze", log, "--scheduler", "tcp://127.0.0.1:9"]) == 2
    assert "no dask scheduler" in capsys.readouterr().err


def test_the_steps_of_the_reference_are_limited(tmp_path, capsys, monkeypatch):
    """The error is known up to there. The limit is that of all stretches together. One line tells of long ones."""
    monkeypatch.setattr(analyze, "NOTICE", -1.0)
    one, two = (
        record(tmp_path / f"{len(resets)}.mcap", scene_from_text(PAIR), steps, resets=resets)
        for steps, resets in ((100, ()), (200, (100,)))
    )
    given = ["--json", str(tmp_path / "x.json"), "--max-error", "1"]

    def reference(log, steps, code):
        assert main(["analyze", str(log), *given, "--reference-steps", str(steps)]) == code
        return checked(tmp_path / "x.json")["logs"][0]["reference"]

    short = reference(one, 3, 1)
    out, err = capsys.readouterr()
    assert 0.0 < short["seconds"] < 0.2 and 0.0 < short["position"]["max"] < 1.0
    said = f"the error is known up to {short['seconds']:.3g} s only: the reference integration reached its limit of 3"
    assert short["stopped"].startswith(said) and short["stopped"] in err
    assert len(re.findall(r"^liegroup_sim: reference: \d\S* of 0.2\S* s after -1 s; ", err, re.MULTILINE)) == 1
    assert said in " ".join(out.split())
    enough = next(2**k for k in range(2, 12) if analyse_to(one, 2**k)["stopped"] is None)
    assert reference(one, enough, 0)["seconds"] == pytest.approx(0.2)
    both = reference(two, enough, 1)
    assert 0.2 <= both["seconds"] < 0.4 and both["stopped"]


def analyse_to(log, steps):
    """Figures of the error by at most a number of steps of the reference."""
    return analyse(read_recording(log), reference_steps=steps).figures["reference"]


def scaled(factor, last=None):
    """Function that scales the estimates of a sample; the last one of a second is `last`."""

    def spoil(sample):
        sample.errors = factor * sample.errors
        if last is not None and sample.time == 1.0:
            sample.errors[:] = last
        return sample

    return spoil


@pytest.mark.parametrize("text", [PAIR, TOP])  # an integration, and an exact solution
@pytest.mark.parametrize("factor, covering, close", [(1.0, True, True), (1e-3, False, True), (1e3, True, False)])
@pytest.mark.volume(3)
def test_recorded_estimates_are_compared_with_the_error(tmp_path, text, factor, covering, close):
    """As they are, and falsified by a factor far above their spread of about ten."""
    log = run(tmp_path / "a.mcap", scene_from_text(text), step=1e-2, every=4, spoil=scaled(factor), estimate=True)
    analysis = analyse(read_recording(log))
    figures, largest = analysis.figures, read_recording(log).errors.errors.max(axis=(0, 1))
    assert figures["problems"] == [] and list(figures["estimate"]) == ["position", "angle", "linear", "angular"]
    for entry, value in zip(figures["estimate"].values(), largest):
        assert entry["max"] == value
        if entry["samples"]:  # a free body has no error of its position
            assert (entry["covering"] > 0.95, entry["covering"] < 0.05) == (covering, not covering)
            assert (entry["close"] > 0.9, entry["close"] < 0.1) == (close, not close)
    assert figures["estimate"]["angle"]["samples"] >= 20
    error = next(plot for title, _, plot in make_plots(analysis) if title == "Error")
    drawn = {trace["name"]: trace for trace in error["data"]}
    estimate, true = drawn["attitude, estimate"], drawn["attitude, rad"]
    assert estimate["x"] == true["x"] and estimate["line"]["dash"] == "dash"
    assert max(estimate["y"]) == pytest.approx(largest[1], rel=1e-6)
    table = dict(sections(figures))["Estimate of the error, recorded with the run"]
    shares = [share for _, _, share in table if "samples" in share]
    assert shares and all(share.startswith("at least half of the true error in") for share in shares)


def test_only_known_estimates_and_errors_above_the_uncertainty_count():
    estimate, zero = Estimate(Promise(None)), np.zeros((6, 2))
    error = np.array([[1.0, 0.1]] * 6)
    estimates = np.ones((6, 2, 4)) * np.array([0.4, 0.5, 10.0, 10.1, np.nan, np.inf])[:, None, None]
    uncertainty = np.zeros((6, 2))
    estimate.compare(estimates, Distance(error, zero, error, zero, error), Distance(*[uncertainty] * 5))
    estimate.compare(estimates, Distance(*[error] * 5), Distance(*[error] * 5))
    steps = np.arange(5)
    block = SimpleNamespace(errors=estimates[:5], steps=steps, times=steps, stretch=SimpleNamespace(start=0))
    estimate.add(block)
    figures = estimate.figures()
    assert figures["position"] == {
        "unit": "m",
        "max": 10.1,
        "samples": 5,  # not that of NaN, nor those at the uncertainty
        "covering": 0.8,
        "close": 0.6,
    }
    assert figures["angular"] == {"unit": "rad/s", "max": 10.1, "samples": 0, "covering": None, "close": None}


@pytest.mark.turn(3)
def test_a_recorded_estimate_above_the_limit_fails_the_command(tmp_path, capsys):
    """Also an infinite one; not one that is unknown."""
    scene = load_scene("heavy_top")
    for name, spoil, said in (
        ("good", scaled(1.0, np.nan), ""),
        ("large", scaled(1e6), "recorded estimate of the error"),
        ("infinite", scaled(1.0, np.inf), "recorded estimate of the error inf rad exceeds 0.001"),
    ):
        log = run(tmp_path / f"{name}.mcap", scene, every=1, spoil=spoil, estimate=True)
        given = ["analyze", str(log), "--json", str(tmp_path / "x.json"), "--max-error", "1e-3"]
        assert main(given) == bool(said), name
        err = capsys.readouterr().err
        assert said in err and ("error" in err) == bool(said)
        (figures,) = checked(tmp_path / "x.json")["logs"]
        assert figures["problems"] == [] and figures["estimate"]["angle"]["max"]
    entry = {"max": 0.0, "uncertainty": 0.0, "unit": "m"}
    figures = {"log": "a", "reference": {"position": entry, "angle": entry}}
    unknown = dict.fromkeys(("position", "angle"), {"max": None, "unit": "m"})
    assert find_exceeded([{**figures, "estimate": unknown}], 1.0) == []
    assert find_exceeded([{**figures, "estimate": None}], 1.0) == []


STOPPED = text_of("stopped_analyze_more.yaml")
NO_STOPS = "the reference integration has no stops and no friction (slide)"


@pytest.mark.parametrize("options, why", [([], NO_STOPS), (["--no-reference"], "the comparison with a reference was")])
@pytest.mark.parametrize(
    "largest, kept, unknown",
    [
        (2e-5, True, None),
        (2e-3, False, None),
        (np.inf, None, "the recorded estimate is infinite"),
        (np.nan, None, "the run ended before its first estimate"),
    ],
)
@pytest.mark.volume(3)
def test_without_a_reference_the_recorded_estimate_takes_its_place(
    tmp_path, capsys, options, why, largest, kept, unknown
):
    """Planted in every sample after the start: in the verdict, its tile, plot and table, and in the bound."""

    def planted(sample):
        if sample.time > 0.0:
            sample.errors[:] = (largest, 0.5 * largest, 0.0, 0.0)
        return sample

    scene, files = scene_from_text(STOPPED), [tmp_path / name for name in ("a.mcap", "a.json", "a.html")]
    run(files[0], scene, method=None, step=1e-2, every=5, spoil=planted, accuracy=1e-4)
    given = ["analyze", str(files[0]), "--json", str(files[1]), "--html", str(files[2]), *options]
    assert main([*given, "--max-error", "1e-4"]) == (not kept)
    out, error = (" ".join(text.split()) for text in capsys.readouterr())
    assert (unknown or ("" if kept else "recorded estimate of the error 0.002 m exceeds 0.0001")) in error
    (figures,) = checked(files[1])["logs"]
    assert out.count(why) == (not unknown or not options)
    assert figures["warnings"] == ([f"the error is unknown: {why}; {unknown}"] if unknown and not options else [])
    analysis = analyse(read_recording(files[0]), reference=not options)
    promise, tiles = figures["promise"], {name: value for name, value, _ in headline(analysis.figures)}
    plots = {title: plot for title, _, plot in make_plots(analysis)}
    if unknown:
        assert tiles["error"] == "unknown" and "error unknown" in figures["verdict"] and promise["kept"] is None
        return
    assert promise["kept"] is kept and promise["by"] == "estimate" and promise["seconds"] == 1.0
    assert promise["error"] == pytest.approx(max(largest / promise["length"], 0.5 * largest))
    assert tiles["position error"] == f"{largest:g} m" and tiles["attitude error"] == f"{0.5 * largest:g} rad"
    assert f"estimated error at most {largest:g} m and {0.5 * largest:g} rad" in figures["verdict"]
    assert [max(trace["y"]) for trace in plots["Error"]["data"][:2]] == [largest, 0.5 * largest]
    assert overview(analysis.figures)[:2] == [f"~{largest:g} m", f"~{0.5 * largest:g} rad"]
    lines = {trace["name"]: set(trace["y"]) for trace in plots["Accuracy"]["data"]}
    assert lines.keys() - {"events at joints"} == {"estimated error", "accuracy"} and lines["accuracy"] == {1e-4}
    assert max(lines["estimated error"]) == pytest.approx(promise["error"])


def test_estimates_of_a_later_part_are_not_compared(tmp_path):
    """They count from the start of the run, the error from the start of the part."""

    def later(simulation):
        simulation.advance(200)

    run(tmp_path / "a.mcap", load_scene("heavy_top"), None, estimate=True, first=later)
    analysis = analyse(read_recording(tmp_path / "a.mcap"))
    entry = analysis.figures["estimate"]["position"]
    assert entry["max"] > 0.0 and (entry["samples"], entry["covering"]) == (0, None)
    assert analysis.figures["reference"]["position"]["max"] > 0.0
    (error, *_) = [plot for title, _, plot in make_plots(analysis) if title == "Error"]
    assert {y for trace in error["data"][4:] for y in trace["y"]} == {None}


@pytest.mark.turn(3)
def test_the_coverage_is_the_estimate_divided_by_the_error(tmp_path):
    log = run(tmp_path / "a.mcap", load_scene("double_pendulum"), duration=2.0, estimate=True)
    analysis = analyse(read_recording(log))
    plots = {title: plot for title, _, plot in make_plots(analysis)}
    coverage, error = plots["Coverage"]["data"], plots["Error"]["data"]
    assert [trace["name"] for trace in coverage] == ["position", "attitude"]
    known = 0
    for k, trace in enumerate(coverage):
        true, uncertainty, estimate = (error[j + k]["y"] for j in (0, 2, 4))
        for ratio, *parts in zip(trace["y"], true, uncertainty, estimate):
            if ratio is not None:
                assert ratio == pytest.approx(parts[2] / parts[0], rel=1e-5) and parts[0] >= parts[1]
                known += 1
    assert known > 20


def test_efforts_are_listed_by_joint(tmp_path):
    """The effort at a joint acts on two bodies, but is one."""

    def pushed(simulation):
        simulation.apply_effort("elbow", 1.0, start=0.1)

    run(tmp_path / "a.mcap", load_scene("double_pendulum"), "rkmk4", 1e-2, 0.2, 1, estimate=False, first=pushed)
    figures = analyse(read_recording(tmp_path / "a.mcap")).figures
    assert figures["pushes"] == [{"joint": "elbow", "from_s": 0.1, "to_s": None}] and figures["push_count"] == 1
    (row,) = [row for row in dict(sections(figures))["Run"] if row[0] == "wrenches and efforts"]
    assert row[1:] == ("1", "joint elbow 0.100 s to the end")


@pytest.mark.turn(3)
def test_missing_estimates_are_nan(tmp_path, monkeypatch):
    """Every second message is missing, and the file is read in many pieces."""
    monkeypatch.setattr(read, "PIECE", 1)
    missed = []

    class Missing(write_run.LogFile):
        def sample(self, sample):
            every = self._of
            self._of = {kind: channel for kind, channel in every.items() if kind != "errors" or not self.count % 2}
            super().sample(sample)
            self._of = every
            missed.append(sample.errors if self.count % 2 else np.full((1, 4), np.nan))

    monkeypatch.setattr(write_run, "LogFile", Missing)
    log = run(tmp_path / "a.mcap", load_scene("heavy_top"), every=1, duration=4.0, estimate=True)
    recording = read_recording(log)
    pieces = list(recording.samples())
    assert len(pieces) > 3 and sum(len(piece.stamp_ns) for piece in pieces) == 2001
    found = np.concatenate([piece.errors for piece in pieces])
    assert found.tobytes() == np.array(missed).tobytes()
    assert len(recording.errors.stamp_ns) == 1001
    assert analyse(recording).figures["estimate"]["angle"]["samples"] < 1001


def test_an_unknown_estimate_is_not_shown_as_zero(tmp_path, capsys):
    """A run that is too short for an estimate has only the zero of its initial state."""
    log, document = tmp_path / "a.mcap", tmp_path / "a.json"
    method = ["--method", "rkmk853", "--step", "0.01"]
    assert main(["run", "heavy_top", *method, "--duration", "0.03", "--out", str(log)]) == 0
    assert np.array_equal(read_recording(log).errors.errors[:, 0, 0], [0.0] + [np.nan] * 3, True)
    capsys.readouterr()
    assert main(["analyze", str(log), "--json", str(document)]) == 0
    assert capsys.readouterr().out.count("no estimate is known") == 4
    (figures,) = checked(document)["logs"]
    assert {entry["max"] for entry in figures["estimate"].values()} == {None}


def test_two_recordings_are_compared(logs, tmp_path):
    one, other = (read_recording(logs / name) for name in ("a.mcap", "b.mcap"))
    figures = compare(one, other)
    assert figures["samples"] == 51 and figures["identical"] == 1
    assert figures["first_difference_s"] == pytest.approx(0.02)
    assert figures["settings"]["method"] == ["rkmk4", "rkmk8"]
    assert figures["same_scene"] and figures["same_wrenches"]
    pose, twist = one.pose["top"], one.twist["top"]
    apart = np.linalg.norm(pose.position - other.pose["top"].position, axis=1)
    assert figures["difference"]["position"]["max"] == pytest.approx(apart.max(), rel=1e-12)
    assert figures["difference"]["position"]["at_s"] == pytest.approx(pose.time[apart.argmax()])
    spun = np.linalg.norm((twist.twist - other.twist["top"].twist)[:, :3], axis=1)
    assert figures["difference"]["angular"]["max"] == pytest.approx(spun.max(), rel=1e-12)
    with pytest.raises(RecordingError, match="no body name in common"):
        compare(one, read_recording(logs / "c.mcap"))


@pytest.mark.turn(3)
def test_long_recordings_are_analysed_in_pieces(tmp_path, monkeypatch):
    """The result equals that of a single piece, with and without thinned curves."""
    pushes = [(300, ("left", (0, 0, 1.0, 0, 0, 0))), (400, ("left", (0,) * 6))]
    log = record(tmp_path / "a.mcap", scene_from_text(PAIR), 2000, per_sample=1, resets=(700,), pushes=pushes)
    whole = analyse(read_recording(log))
    for name, value in (
        ("recording.read.PIECE", 130),
        ("recording.motion.KEPT", 500),
        ("recording.motion.LEAST_KEPT", 500),
        ("analysis.drift.MOST_POINTS", 300),
    ):
        monkeypatch.setattr(f"liegroup_sim_ros.{name}", value)
    pieces = analyse(read_recording(log))

    def numbers(value):
        if isinstance(value, dict):
            return {key: numbers(entry) for key, entry in value.items()}
        if isinstance(value, list):
            return [numbers(entry) for entry in value]
        # Sums are made in another order: round-off, of trends that are differences 1e-6.
        return pytest.approx(value, rel=1e-6, abs=1e-14) if isinstance(value, float) else value

    left_out = ("local",)  # looks at other places
    assert {k: v for k, v in pieces.figures.items() if k not in left_out} == numbers(
        {k: v for k, v in whole.figures.items() if k not in left_out}
    )
    kept = [sum(len(s.steps) for s in analysis.motion.stretches) for analysis in (whole, pieces)]
    assert kept[0] == 2002 and 400 <= kept[1] <= 501
    stretch = pieces.motion.stretches[1]
    row = np.searchsorted(whole.motion.stretches[1].steps, stretch.steps)
    assert np.array_equal(whole.motion.stretches[1].position[row], stretch.position)


def test_recordings_are_read_from_urls(logs, monkeypatch):
    """Any URL that fsspec reads; a missing package is reported in one line."""
    memory = fsspec.filesystem("memory")
    memory.pipe("/logs/a.mcap", (logs / "a.mcap").read_bytes())
    here, there = read_recording(logs / "a.mcap"), read_recording("memory://logs/a.mcap")
    assert there.path == "memory://logs/a.mcap" and there.settings == here.settings
    assert np.array_equal(there.pose["top"].quaternion, here.pose["top"].quaternion)
    assert main(["analyze", "memory://logs/*.mcap", "--no-reference"]) == 0
    for address, said in (("memory://logs/b.mcap", "cannot be read"), ("nothing://x.mcap", "Protocol not known")):
        with pytest.raises(RecordingError, match=said):
            read_recording(address)
    monkeypatch.setitem(sys.modules, "fsspec", None)
    with pytest.raises(RecordingError, match="needs the package fsspec: pip install fsspec"):
        read_recording("memory://logs/a.mcap")


def test_a_limit_below_the_reference_uncertainty_fails():
    """The uncertainty of the reference is added to the error."""

    def figures(error, uncertainty):
        entry = {"max": error, "uncertainty": uncertainty, "unit": "m"}
        return [{"log": "a", "reference": {"position": entry, "angle": entry}}]

    assert find_exceeded(figures(0.9, 0.05), 1.0) == []
    for error, uncertainty, said in (
        (0.9, 0.2, "may exceed 1: the reference uncertainty"),
        (math.nan, 0.0, "exceeds 1"),
        (0.0, math.nan, "may exceed 1"),
        (1.1, 0.0, "error 1.1 m exceeds 1"),
    ):
        found = find_exceeded(figures(error, uncertainty), 1.0)
        assert len(found) == 2 and all(said in text for text in found)


@pytest.mark.parametrize("error, uncertainty, said", cases("an_error_is_printed_with_its_uncertainty"))
def test_an_error_is_printed_with_its_uncertainty(error, uncertainty, said):
    entry = {"max": error, "uncertainty": uncertainty, "unit": "m"}
    assert error_text(entry) == said


class _Web(SimpleHTTPRequestHandler):
    """HTTP server of a folder; of short.mcap it sends fewer bytes than announced."""

    def do_GET(self):
        if not self.path.endswith("short.mcap"):
            return super().do_GET()
        self.send_response(200)
        self.send_header("Content-Length", "1000000")
        self.end_headers()
        self.wfile.write(b"\x89MCAP0\r\n")

    def log_message(self, *_):
        pass


@pytest.mark.turn(3)
def test_recordings_are_read_over_http(logs, capsys):
    """From a real server, by several processes; each unavailable one gives one line."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(_Web, directory=logs))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    web = f"http://127.0.0.1:{server.server_port}"
    there = read_recording(f"{web}/a.mcap")
    assert there.complete and there.topics == read_recording(logs / "a.mcap").topics
    capsys.readouterr()
    assert main(["analyze", f"{web}/[ab].mcap", f"{web}/a.mcap?key=1", "--no-reference"]) == 0
    assert "a.mcap" in capsys.readouterr().out

    def refused(name, *said):
        assert main(["analyze", f"{web}/{name}.mcap"]) == 2
        out, err = capsys.readouterr()
        assert out == "" and err.count("\n") == 1 and f"{web}/{name}.mcap: cannot be read: " in err
        assert all(text in err for text in said)

    refused("none", "404")
    refused("short", "1000000")  # and not: a recording without its end
    server.shutdown()
    server.server_close()
    refused("a", "Connect")


@pytest.mark.turn(3)
def test_the_library_works_without_ros(tmp_path):
    """Arrays, data frames and `analyze` in a Python where no ROS package can be imported."""
    log = record(tmp_path / "a.mcap", scene_from_text(PAIR), 100, pushes=[(20, ("left", (0, 0, 1.0, 0, 0, 2.0)))])
    code = """
import sys
for name in ("rclpy", "rosgraph_msgs", "geometry_msgs", "rcl_interfaces", "diagnostic_msgs",
             "builtin_interfaces", "std_msgs", "sensor_msgs"):
    sys.modules[name] = None
from liegroup_sim_ros.recording.read import read_recording
recording = read_recording(sys.argv[1])
pose = recording.pose["left"]
frame = recording.to_pandas()
assert frame["left"].shape == (11, 13) and frame.index.name == "time_s"
assert (frame["left"][["x", "y", "z"]].to_numpy() == pose.position).all()
assert (frame.index == pose.time).all() and frame["right"]["wz"].notna().all()
given = recording.to_pandas("inputs")
assert given.name.tolist() == ["left"] and given.fz.tolist() == [2.0] == [recording.inputs[0].values[5]]
assert given.px.isna().all() and given.end.isna().all() and abs(given.start.iloc[0] - 0.04) < 1e-12
assert recording.to_pandas("events").name.tolist() == ["start", "stop"]
assert recording.joint_states is None and recording.to_pandas("joints").empty
assert recording.errors is None and recording.to_pandas("errors").empty
from liegroup_sim_ros.commands.main import main
sys.exit(main(["analyze", sys.argv[1], "--no-reference"]))
"""
    done = subprocess.run([sys.executable, "-c", code, str(log)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "11 of 11 samples" in " ".join(done.stdout.split())


@pytest.mark.turn(3)
def test_the_code_of_the_analysis_page_runs(tmp_path, monkeypatch, capsys):
    """Every Python block of docs/reference/analysis.md, in order and in one folder."""
    run(tmp_path / "run.mcap", load_scene("heavy_top"))
    monkeypatch.chdir(tmp_path)
    text = (SCHEMA.parents[1] / "docs" / "reference" / "analysis.md").read_text()
    names = {}
    blocks = [block.split("```")[0] for block in text.split("```python\n")[1:]]
    for block in blocks:
        exec(block, names)
    assert len(blocks) == 3 and names["figures"]["repeat"]["identical"] == 51
    assert names["largest"] == pytest.approx(np.abs(names["twist"][:, :3]).max())
    capsys.readouterr()


def test_joint_states_are_read(tmp_path):
    """Joint positions and velocities of all joints that have them, as the node writes them."""
    from liegroup_sim_ros.messages import samples as sample_messages
    from liegroup_sim_ros.recording import attachments
    from liegroup_sim_ros.recording.write import Recorder

    simulation = Simulation(load_scene("double_pendulum"), "rkmk4", 1e-3)
    bodies = simulation.layout.body_names
    topics = {
        "pose": {b: f"/{b}/pose" for b in bodies},
        "events": "/e",
        "diagnostics": "/d",
        "twist": {b: f"/{b}/twist" for b in bodies},
        "clock": None,
    }
    ((_, kind, encode),) = sample_messages.joint_states(simulation.layout, "world")
    wanted = []
    with Recorder(tmp_path / "a.mcap", attachments.at_start(simulation, "/n", "world", 1, topics)) as recorder:
        channel = recorder.add_channel("/n/joint_states", kind)
        for _ in range(30):
            simulation.advance(10)
            sample = simulation.sample()
            recorder.write(channel, sample.time_ns, encode(sample.time_ns, sample))
            wanted.append([sample.time_ns, *np.ravel(list(sample.joint_coordinates.values()))])
    recording = read_recording(tmp_path / "a.mcap")
    states = recording.joint_states
    k = len(states.names)
    assert states.effort.shape == (30, k) and np.isnan(states.effort).all()
    assert k == 2 and states.names == tuple(sample.joint_coordinates)
    assert np.array_equal(
        np.column_stack([states.stamp_ns, states.position[:, 0], states.velocity[:, 0]]), np.array(wanted)[:, :3]
    )
    frame = recording.to_pandas("joints")
    assert frame.shape == (30, 6) and frame[states.names[1]].velocity.iloc[-1] == wanted[-1][4]


CAM = text_of("cam_analyze_more.yaml")


def test_the_violation_of_a_curved_coupling_is_reported(tmp_path):
    """It is that of the recorded poses: the shaft turns about z from 0 on, and the valve rises along z."""
    scene, path = tmp_path / "cam.yaml", tmp_path / "run.mcap"
    scene.write_text(CAM)
    run = ["run", str(scene), "--method", "rkmk2", "--step", "0.05", "--duration", "2", "--out", str(path)]
    assert main(run) == 0
    recording = read_recording(path)
    x, y, z, w = recording.pose["wheel"].quaternion.T
    angle = np.unwrap(2.0 * np.arctan2(z, w), period=2.0 * np.pi)
    gap = np.abs(recording.pose["lifter"].position[:, 2] - 0.05 * angle**2 - 0.02 * angle**3)
    found = analyse(recording, reference=False).figures["joints"]["cam"]
    assert found["largest"] == pytest.approx(gap.max(), rel=1e-9) and gap.max() > 1e-6 and found["unit"] == "m"


def test_a_recording_with_pulls_has_a_reference(tmp_path):
    """A pull that a later one replaces, and one with an end; the reference and a run to 1e-8 agree."""
    setup = tmp_path / "pulls.py"
    setup.write_text(
        "def setup(run):\n"
        "    run.pull('top', [1, 0, 2], 20, 1.5, start=0.1, duration=0.5, point=[0, 0, 0.1], turning_damping=0.01)\n"
        "    run.pull('top', [0, 1, 1], 5, start=0.3, torque=[0, 0.1, 0.2], source='other')\n"
        "    run.pull('top', [0, 1, 1], 10, start=0.8, duration=0.1)\n"
    )
    path = tmp_path / "run.mcap"
    arguments = ["--accuracy", "1e-8", "--duration", "1.5", "--control", f"{setup}:setup", "--out", str(path)]
    assert main(["run", "heavy_top", *arguments]) == 0
    figures = analyse(read_recording(path)).figures
    reference = figures["reference"]
    assert reference["kind"] == "integration" and reference["stopped"] is None and reference["seconds"] == 1.5
    assert reference["position"]["max"] < 1e-8 and reference["angle"]["max"] < 1e-8
