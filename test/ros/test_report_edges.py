# SPDX-License-Identifier: Apache-2.0
"""Reports of random recordings, sweeps and trades are written, and shown without an error of a script."""

import contextlib
import io
import json
import random
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pytest
from browser import CHROMIUM, Browser
from random_recordings import random_recording
from rich.console import Console
from volume import VERIFY, some

from liegroup_core.methods.table import METHODS
from liegroup_sim_ros import show
from liegroup_sim_ros.analysis import analyse
from liegroup_sim_ros.analysis.analyse import Analysis
from liegroup_sim_ros.analysis.bounds import find_exceeded
from liegroup_sim_ros.analysis.comparison import differences
from liegroup_sim_ros.analysis.document import document
from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.commands.trade import document as trade_document
from liegroup_sim_ros.recording import RecordingError, read_recording
from liegroup_sim_ros.report import picture, trade_page
from liegroup_sim_ros.report.page import make_page, page_part
from liegroup_sim_ros.report.plots import line, plane
from liegroup_sim_ros.report.sweep_tables import print_sweep
from liegroup_sim_ros.report.terminal import print_comparison, print_overview, print_table
from liegroup_sim_ros.report.trade_figures import print_trade

SEEDS = some(range(1150, 1200), 12)  # among them huge errors, and estimates of zero beside errors
VIEWS = SEEDS[::6]  # whose 3D view is drawn too, half a second each


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """{seed: Analysis of a random recording, or the RecordingError}."""
    folder, found = tmp_path_factory.mktemp("random"), {}
    for seed in SEEDS:
        path = random_recording(seed, folder)
        try:
            with np.errstate(all="ignore"):
                found[seed] = analyse(read_recording(path), seed % 5 != 0, reference_steps=500)
        except RecordingError as error:
            found[seed] = error
    return found


def parts_of(found):
    """Parts of the page of several recordings."""
    return [
        {"figures": {"log": f"{seed}.mcap", "failed": str(analysis)}}
        if isinstance(analysis, RecordingError)
        else page_part(analysis)
        for seed, analysis in found.items()
    ]


@pytest.fixture
def terminal():
    return Console(file=io.StringIO(), width=100)


def written(console):
    return " ".join(console.file.getvalue().split())


@pytest.mark.turn(3)
def test_reports_of_random_recordings_are_written(found, terminal, tmp_path):
    """Terminal, JSON, bounds, and of some the image and the notebook."""
    good = {seed: each for seed, each in found.items() if not isinstance(each, RecordingError)}
    assert len(good) > (0.7 * len(SEEDS) if VERIFY else 0)
    for seed, analysis in good.items():
        figures = analysis.figures
        print_table(figures, terminal)
        exceeded = find_exceeded([figures], 1e-3, 1e-3)
        read = json.loads(document([figures], None, 1e-3, 1e-3, exceeded))
        assert read["logs"][0]["verdict"] == figures["verdict"]
        if analysis.motion.stretches and seed % 6 == 0:
            picture.write_picture(analysis, tmp_path / "a.svg")
        if seed in VIEWS:
            assert repr(show(analysis.recording, reference=False)).startswith(figures["scene"])
    assert written(terminal).count("Real time") == len(good)
    print_overview([part["figures"] for part in parts_of(found)], terminal)


@pytest.mark.turn(3)
def test_pages_of_random_recordings_run_without_an_error(found, tmp_path):
    """All in one page, each opened in turn; a part of them is compared with another one."""
    parts = parts_of(found)
    for seed, part in zip(found, parts):
        if "view" in part and seed not in VIEWS:
            part["view"] = None
    pairs = [
        (one, other)
        for one, other in pairwise(found.values())
        if Analysis is type(one) is type(other) and one.recording.bodies == other.recording.bodies
    ]
    compared = None
    for one, other in pairs:
        with contextlib.suppress(RecordingError):  # no sample time in common
            compared = differences(one.recording, other.recording)
            print_comparison(compared[0], Console(file=io.StringIO()))
    assert compared is not None or not VERIFY  # some commits have no pair with a sample time in common
    text = make_page(parts, compared)
    assert text.count('<details class="log"') == len(SEEDS)
    if CHROMIUM is None:
        pytest.skip("needs chromium")
    file = tmp_path / "all.html"
    file.write_text(text, encoding="utf-8")
    browser = Browser(tmp_path / "browser")
    try:
        browser.open(file)
        for k, seed in enumerate(found):
            browser.run(
                f"new Promise(done => {{ const d = document.querySelectorAll('details.log')[{k}]; "
                "d.open = true; requestAnimationFrame(() => setTimeout(() => { d.open = false; done(); })); })"
            )
            assert browser.errors == [], seed
        drawn = browser.run("document.querySelectorAll('details.log .plane .main-svg').length")
        assert drawn >= sum(len(part.get("plots", ())) for part in parts) > len(SEEDS)
    finally:
        browser.close()


@pytest.mark.turn(3)
def test_most_accurate_runs_have_a_report(tmp_path, capsys):
    """All errors are below what the reference knows: no ratio of estimate and error is positive."""
    log, file = tmp_path / "a.mcap", tmp_path / "a.html"
    run = ["run", "slider_crank", "--accuracy", "1e-9", "--duration", "0.5", "--out", str(log)]
    assert main(run) == main(["analyze", str(log), "--html", str(file)]) == 0
    text = " ".join(capsys.readouterr().out.split())  # lines end anywhere
    assert "the reference uncertainty" in text and file.stat().st_size > 1e6


def random_trade(seed):
    """Part of a trade's document: few or no cells, some stopped, errors of zero or below the known ones."""
    chance = random.Random(seed)
    known = chance.choice((0.0, 1e-300, 1e-12))
    cells = []
    for _ in range(chance.choice((0, 1, 2, 9))):
        cell = {
            "method": chance.choice(list(METHODS)),
            "step": chance.choice((1e-6, 1.0)),
            "group": "se3",
            "stabilisation": "none",
            "options": chance.choice(({}, {"rtol": 1e-3})),
            "cpu": "a <b>processor</b>",
            "stopped": chance.choice((None, None, "a reason")),
        }
        if cell["stopped"] is None:
            numbers = "error", "angular", "linear", "energy", "joints", "cost_us"
            cell |= {name: chance.choice((0.0, 1e-300, 1e-13, 1.0, 1e300)) for name in numbers}
            cell["cost_us"] += 1e-3
            cell["momentum"] = chance.choice((None, 0.0, 1e-16))
        cells.append(cell)
    known_errors = dict.fromkeys(("position", "attitude", "angular", "linear"), known)
    good = [k for k, cell in enumerate(cells) if cell["stopped"] is None]
    first = min(good, key=lambda k: cells[k]["cost_us"], default=None)
    return {
        "scene": "random <b>",
        "horizon": 1.0,
        "length": 1.0,
        "reference": {"known": known, **known_errors},
        "margin": 3.0,
        "cells": cells,
        "front": [] if first is None else [first],
        "cheapest": [{"accuracy": 1e-3, "cell": first, "real_time_factor": 1.0}],
        "to_accuracy": [
            {"accuracy": 1e-4, "error": 0.0, "estimate": None, "until": None, "cost_us": 1.0},
            {"accuracy": 1e-4, "error": 0.0, "estimate": 0.0, "until": 0.0, "cost_us": 1.0},
        ][: chance.choice((0, 1, 2))],
        "best": None if first is None else 1.0,
    }


def test_a_single_sample_has_a_marker_and_an_axis_of_its_size():
    """Without a range, plotly.js labels the axis of 1e12 by its round-off."""
    alone = line("a", np.arange(5.0), np.array([np.nan, 1e12, np.nan, 1e12, 1e12]), "--blue")
    assert alone["mode"] == "lines+markers" and alone["marker"]["size"] == [0, 5, 0, 0, 0]
    assert plane([alone], [], "N m")["layout"]["yaxis"]["range"] == [0.0, 2e12]
    whole = line("b", np.arange(3.0), np.array([1.0, 2.0, 3.0]), "--blue")
    assert whole["mode"] == "lines" and "range" not in plane([whole], [], "N m")["layout"]["yaxis"]


@pytest.mark.turn(3)
def test_reports_of_random_trades_are_written(terminal, tmp_path):
    trades = [random_trade(seed) for seed in range(20)]
    for seed, part in enumerate(trades):
        print_trade(part, terminal)
        assert json.loads(trade_document([part]))["scenes"] == [part]
        if seed % 7 == 0:
            trade_page.write_picture(part, tmp_path / "a.svg")
    assert written(terminal).count("Pareto front;") == len(trades)
    file = tmp_path / "all.html"
    file.write_text(trade_page.make_page(trades), encoding="utf-8")
    if CHROMIUM is None:
        pytest.skip("needs chromium")
    browser = Browser(tmp_path / "browser")
    try:
        browser.open(file)
        assert browser.errors == []
        assert browser.run("document.querySelectorAll('.plane .main-svg').length") >= len(trades)
    finally:
        browser.close()


@pytest.mark.parametrize("runs", [0, 1, 2, 30])
def test_tables_of_random_sweeps_are_printed(terminal, runs):
    """No run, failed ones only, constant, huge and no numbers."""
    chance = random.Random(runs)
    columns = {"a.x": "float", "energy": "float", "constant": "float", "empty": "float"}
    values = {
        "a.x": [chance.choice((-1e308, 0.0, 5e-324, 1e308, np.nan, np.inf)) for _ in range(runs)],
        "energy": [chance.random() for _ in range(runs)],
        "constant": [1.0] * runs,
        "empty": [np.nan] * runs,
        "run": list(range(runs)),
        "status": [chance.choice(("ok", "stopped at 3")) for _ in range(runs)],
        "warning": [chance.choice((None, "[b]odd[/b] 4")) for _ in range(runs)],
        "cpu_s": [0.0] * runs,
        "time": [0.0] * runs,
        "p": [chance.random() for _ in range(runs)],
    }
    kinds = columns | {"run": "int", "status": "text", "warning": "text", "cpu_s": "float"}
    kinds |= {"time": "float", "p": "float"}
    types = {"float": pa.float64(), "int": pa.int64(), "text": pa.string()}
    schema = pa.schema([(name, types[kind]) for name, kind in kinds.items()])
    settings = (("step", 1e-3), ("method", "rkmk4"))
    sweep = SimpleNamespace(columns=kinds, paths=("p",), name="s", samples=runs, steps=1, settings=settings)
    file = SimpleNamespace(sweep=sweep, table=pa.table(values, schema).select)
    assert print_sweep(file, None, terminal) == set(values["status"])
    assert f"s: {runs} run" in written(terminal)
