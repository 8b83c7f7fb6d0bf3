# SPDX-License-Identifier: Apache-2.0
"""Output of `liegroup_sim analyze`, and its errors for unreadable input."""

import base64
import json
import math
import re
import subprocess
import sys
from html.parser import HTMLParser

import numpy as np
import pytest
from made_run import PACING, PAIR, record
from rich.console import Console
from scene_files import cases
from waiting import PATIENCE

from liegroup_core import Simulation
from liegroup_core.scene.load import scene_from_text
from liegroup_sim_ros.analysis.analyse import analyse
from liegroup_sim_ros.analysis.document import document
from liegroup_sim_ros.analysis.verdict import find_problems
from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.recording import attachments
from liegroup_sim_ros.recording.read import read_recording
from liegroup_sim_ros.recording.write import Recorder
from liegroup_sim_ros.report import plots, view
from liegroup_sim_ros.report.summary import headline, sections
from liegroup_sim_ros.report.terminal import print_table


def test_nan_is_never_shown_as_good(tmp_path, capsys):
    log = record(
        tmp_path / "a.mcap", scene_from_text(PAIR), 20, pacing=PACING | {"real_time_factor": 0.5, "reanchored": 3}
    )
    analysis = analyse(read_recording(log))
    assert "too slow: real-time factor 0.5, requested 1" in analysis.figures["problems"]
    assert any("behind the wall clock, 3 times" in text for text in analysis.figures["problems"])
    figures = analysis.figures | {"energy": analysis.figures["energy"] | {"drift_J": math.nan}}
    text = document([figures])
    assert json.loads(text, parse_constant=pytest.fail)["logs"][0]["energy"]["drift_J"] == "nan"
    assert find_problems(figures)[-1] == "not a number: energy.drift_J"
    print_table(figures, Console())
    assert re.search(r"energy drift\s+not a number", capsys.readouterr().out)


def test_a_run_that_was_only_stepped_is_not_too_slow(tmp_path):
    """It has no pace: no tick was waited for."""
    stepped = {"real_time_factor": 0.0, "ticks": 0, "wall_seconds": 0.0, "sim_seconds": 0.0}
    log = record(tmp_path / "a.mcap", scene_from_text(PAIR), 20, pacing=PACING | stepped)
    figures = analyse(read_recording(log), reference=False).figures
    assert figures["timing"]["real_time_factor"] is None
    assert not [problem for problem in figures["problems"] if "slow" in problem]


@pytest.mark.parametrize("factors, mean, text", cases("the_requested_factor_is_averaged_over_time"))
def test_the_requested_factor_is_averaged_over_time(tmp_path, factors, mean, text):
    pacing = PACING | {"real_time_factor": 0.78}
    log = record(tmp_path / "a.mcap", scene_from_text(PAIR), 200, pacing=pacing, factors=factors)
    figures = analyse(read_recording(log), reference=False).figures
    timing = figures["timing"]
    assert timing["factor_wanted_mean"] == (mean and pytest.approx(mean))
    assert timing["factor_wanted"] == list(factors.values())[-1]
    row = ("real-time factor", "0.780", text)
    assert (row in headline(figures)) == (factors != {0: 0.0})  # not shown for a run without a pace
    slow = [problem for problem in figures["problems"] if problem.startswith("too slow")]
    assert slow == ([f"too slow: real-time factor 0.78, {text}"] if mean and mean > 0.8 else [])


def test_an_offline_run_has_no_requested_real_time_factor(tmp_path):
    log = tmp_path / "a.mcap"
    assert main(["run", "heavy_top", "--duration", "0.1", "--out", str(log)]) == 0
    figures = analyse(read_recording(log), reference=False).figures
    assert not [row for row in headline(figures) if row[0] == "real-time factor"]
    assert dict(sections(figures))["Real time"][0] == ("real-time factor", "-", "requested: as fast as possible")


@pytest.mark.turn(3)
def test_files_are_written_although_stdout_is_closed(tmp_path):
    log = record(tmp_path / "a.mcap", scene_from_text(PAIR), 50)
    page, figures = tmp_path / "a.html", tmp_path / "a.json"
    arguments = ["analyze", str(log), "--html", str(page), "--json", str(figures)]
    command = [sys.executable, "-m", "liegroup_sim_ros.commands.main", *arguments]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    child.stdout.close()
    assert child.wait(PATIENCE) != 0
    assert "Traceback" not in child.stderr.read()
    assert page.stat().st_size > 1_000_000
    assert json.loads(figures.read_text())["logs"][0]["scene"] == "pair"


class Links(HTMLParser):
    """Collect external references, scripts and texts of a page."""

    def __init__(self):
        super().__init__()
        self.fetched, self.scripts, self.texts, self.tag = [], [], [], None

    def handle_starttag(self, tag, attributes):
        self.tag = tag
        self.fetched += [v for k, v in attributes if k in ("src", "href") and v != "data:,"]
        if tag == "script":
            self.scripts.append((dict(attributes), ""))

    def handle_data(self, data):
        if self.tag == "script":
            self.scripts[-1] = (self.scripts[-1][0], self.scripts[-1][1] + data)
        else:
            self.texts.append(data)

    def handle_endtag(self, tag):
        self.tag = None


def test_the_html_report_is_self_contained_and_escaped(tmp_path, capsys):
    """Every plot has finite data, for wide and narrow windows, light and dark themes."""
    pushes = [(50, ("left", (0, 0, 1.0, 0, 0, 0))), (80, ("left", (0,) * 6))]
    log = record(tmp_path / "a.mcap", scene_from_text(PAIR), 400, pushes=pushes)
    page = tmp_path / "a.html"
    assert main(["analyze", str(log), "--html", str(page)]) == 0
    capsys.readouterr()
    text = page.read_text()
    links = Links()
    links.feed(text)
    assert links.fetched == []
    assert len(links.scripts) == 3 and "<script>alert(1)" not in text
    assert "<script>alert(1)</script> & more" in "".join(links.texts)
    assert "start: <b>begin</b>" in "".join(links.texts)
    assert 'name="viewport"' in text and "prefers-color-scheme: dark" in text
    (part,) = json.loads(
        next(data for given, data in links.scripts if given.get("id") == "data"), parse_constant=pytest.fail
    )
    assert len(part["plots"]) == 5  # energies, their error, error, momentum, lateness; no joints
    for plot in part["plots"]:
        for trace in plot["data"]:
            assert len(trace["x"]) == len(trace["y"]) > 0
            assert sum(y is not None for y in trace["y"]) > 0
    assert part["plots"][0]["layout"]["shapes"][0]["x0"] == pytest.approx(0.1)
    motion = part["view"]
    assert [body["name"] for body in motion["bodies"]] == ["left", "right"]
    assert [body for body, *_ in motion["pushes"]] == [0] and motion["frames"] == 41


def test_an_accidental_tiny_error_does_not_stretch_a_log_axis():
    """Initial values of 1e-46 m are not shown; slow growth from 1e-15 m is."""

    def axis(y):
        plot = plots.plane([plots.line("error", np.arange(len(y)), y, "--blue")], [], "m", True)
        return plot["layout"]["yaxis"]

    odd = axis(np.array([0.0, 1e-46, *np.linspace(1e-15, 3e-15, 500)]))
    assert -18.0 < odd["range"][0] < -16.0 and -14.6 < odd["range"][1] < -14.0
    assert "range" not in axis(np.logspace(-15, 0, 500)) and "range" not in axis(np.zeros(9))


@pytest.mark.turn(3)
def test_the_report_size_is_bounded_for_long_recordings(tmp_path, monkeypatch):
    """The number of plotted points is bounded, and peaks are preserved."""
    y = np.sin(np.linspace(0.0, 300.0, 1_000_000))
    y[123_456], y[654_321], y[777_777] = 7.0, -5.0, np.nan
    drawn = plots.line("a curve", np.arange(1e6), y, "--blue")
    assert len(drawn["x"]) == len(drawn["y"]) <= 3 * plots.BINS
    assert (drawn["x"][drawn["y"].index(7.0)], drawn["x"][drawn["y"].index(-5.0)]) == (123_456, 654_321)
    assert None in drawn["y"]
    log = record(tmp_path / "a.mcap", scene_from_text(PAIR), 2000, per_sample=1, resets=(700,))
    monkeypatch.setattr(view, "MOST_PLACES", 400)
    found = view.make_view(analyse(read_recording(log), reference=False))
    assert found["frames"] == 200 and found["seconds"] == pytest.approx(4.002)
    assert len(found["breaks"]) == 1
    places = np.frombuffer(base64.b64decode(found["places"]), "<f4").reshape(200, 2, 7)
    last = read_recording(log).pose["right"]
    assert np.allclose(places[-1, 1, :3], last.position[-1], atol=1e-6)
    assert abs(places[-1, 1, 3:] @ last.quaternion[-1]) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.turn(3)
def test_plots_of_every_file_type(tmp_path, capsys):
    """An unsupported file type is refused before the analysis."""
    log = str(record(tmp_path / "a.mcap", scene_from_text(PAIR), 100))
    starts = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}
    for kind, start in starts.items():
        picture = tmp_path / f"a.{kind}"
        assert main(["analyze", log, "--no-reference", "--png", str(picture)]) == 0
        assert picture.read_bytes().startswith(start)
    text = (tmp_path / "a.svg").read_text()
    assert text.count('id="axes_') == 5  # paths, energies, their error, momentum, lateness
    capsys.readouterr()
    for picture, more, said in (
        (tmp_path / "a.jpg", [], "must end in .png"),
        (tmp_path / "no" / "a.png", [], "cannot be written"),
        (tmp_path / "a.png", [log], "requires exactly one recording"),
    ):
        assert main(["analyze", log, *more, "--png", str(picture)]) == 2
        out, err = capsys.readouterr()
        assert out == "" and said in err and err.count("\n") == 1


def test_command_line(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert ended.value.code == 0 and re.fullmatch(r"liegroup_sim \d+\.\d+\.\d+\n", capsys.readouterr().out)
    with pytest.raises(SystemExit) as ended:
        main(["nonsense"])
    assert ended.value.code == 2


def test_an_invalid_scene_in_a_recording_gives_one_line(tmp_path, capsys):
    topics = {"pose": {}, "twist": {}, "events": "/e", "clock": None, "diagnostics": "/d"}
    at_start = attachments.at_start(Simulation(scene_from_text(PAIR)), "/n", "world", 10, topics)
    Recorder(tmp_path / "b.mcap", {**at_start, "scene.yaml": ("application/yaml", b"name: 3")}).close()
    assert main(["analyze", str(tmp_path / "b.mcap")]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "b.mcap" in err
