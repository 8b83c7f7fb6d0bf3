# SPDX-License-Identifier: Apache-2.0
"""The commands `sweep`, `trade` and `extremes`: results, tables, reports, interruption, and wrong input."""

import json
import re
import signal
from pathlib import Path

import jsonschema
import numpy as np
import pandas
import pytest
from browser import CHROMIUM, Browser
from scene_files import text_of

from liegroup_core import load_scene
from liegroup_core.methods.table import METHODS
from liegroup_core.study.extremes import extremes
from liegroup_core.study.sweep import sweep as sweeps
from liegroup_core.study.sweep.file import SweepFile
from liegroup_core.study.trade import cache as store
from liegroup_core.study.trade.trade import Trade
from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.report.trade_page import make_plot

# A free body that falls: z = -g/2 t^2 + v t, whatever its mass.
FALL = text_of("fall.yaml")
VARIED = "--vary linear_velocity.2=1:3 mass=1:9:log --vary gravity.2=-9.9:-9.7"
ARGUMENTS = f"{VARIED} --samples 20 --duration 0.5 --method rkmk4 --step 0.01".split()


@pytest.fixture
def fall(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "fall.yaml").write_text(FALL)
    return ["sweep", "fall.yaml", *ARGUMENTS, "--out", "a.parquet"]


def test_sweep_gives_closed_form_results_and_resumes(fall, capsys):
    """Results against the closed form, printed tables, and a repeated call."""
    assert main(fall) == 0
    out = capsys.readouterr().out
    frame = pandas.read_parquet("a.parquet")
    assert len(frame) == 20 and set(frame["status"]) == {"ok"}
    t = 0.5
    height = frame["gravity.2"] * t**2 / 2 + frame["bodies.stone.linear_velocity.2"] * t
    # Exact for a method of order 4; 50 steps of additions to numbers of size 1.
    assert np.allclose(frame["stone.z"], height, rtol=0, atol=50 * 4e-16)
    assert "fall: 20 runs of 0.5 s, rkmk4 at 10 ms; 0 failed" in out
    row = next(line for line in out.splitlines() if line.startswith("stone.z")).split()
    assert float(row[1]) == pytest.approx(frame["stone.z"].min(), rel=1e-2)
    assert float(row[5]) == pytest.approx(frame["stone.z"].max(), rel=1e-2)
    ranks = [line for line in out.splitlines() if line.startswith("stone.z")][1].split()
    assert float(ranks[1]) > 0.95 and abs(float(ranks[2])) < 0.5
    assert float(ranks[1]) == pytest.approx(
        frame["stone.z"].corr(frame["bodies.stone.linear_velocity.2"], method="spearman"), abs=0.005
    )

    before = {path: path.stat().st_mtime_ns for path in SweepFile("a.parquet").path.iterdir()}
    assert main([*fall, "--show", "stone.x"]) == 0
    assert before == {path: path.stat().st_mtime_ns for path in before}
    assert main([*fall, "--seed", "1"]) == 2
    assert "a.parquet: contains a different sweep: seed 0 there and 1 here" in capsys.readouterr().err
    assert main(["sweep", "fall.yaml", "--list"]) == 0
    assert "bodies.stone.mass 1.0" in capsys.readouterr().out.splitlines()


@pytest.mark.turn(3)
def test_an_interrupted_sweep_keeps_its_runs(fall, capsys, monkeypatch):
    """The signal arrives while the third piece is written."""
    monkeypatch.setattr(sweeps, "FIRST", 0.0)
    monkeypatch.setattr(sweeps, "PIECE", 1e-9)
    add, calls = SweepFile.add, []

    def interrupted(file, columns):
        calls.append(columns)
        if len(calls) == 3:
            signal.raise_signal(signal.SIGINT)
        add(file, columns)

    with monkeypatch.context() as patch:
        patch.setattr(SweepFile, "add", interrupted)
        assert main([*fall, "--workers", "1"]) == 130
    err = capsys.readouterr().err
    assert "interrupted; a.parquet has 2 of 20 runs, the same command runs the others" in err
    assert main([*fall, "--workers", "1"]) == 0
    assert "a.parquet has 2 of 20 runs already" in capsys.readouterr().err
    assert main([*fall[:-1], "b.parquet"]) == 0
    tables = [SweepFile(name).table().drop_columns(["cpu_s"]) for name in ("a.parquet", "b.parquet")]
    assert tables[0].equals(tables[1])


def test_failed_runs_are_listed_by_reason(fall, capsys):
    """One third of the masses is negative; the command still succeeds."""
    fall[fall.index("mass=1:9:log")] = "mass=1~2"
    assert main(fall) == 0
    out = capsys.readouterr().out
    failed = int(re.search(r"; (\d+) failed", out)[1])
    frame = pandas.read_parquet("a.parquet")
    assert 3 <= failed == (frame["bodies.stone.mass"] <= 0.0).sum()
    assert f'{failed} failed: Body "stone": mass must be greater than 0, got -' in out
    assert frame["stone.z"].isna().sum() == failed


def test_an_inconsistent_start_suggests_assembly(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    arguments = ["sweep", "heavy_top", "--vary", "angular_velocity.2=-1:1", "--samples", "12", "--duration", "0.01"]
    assert main([*arguments, "--out", "a.parquet"]) == 1
    out, err = capsys.readouterr()
    assert "12 failed" in out and "the initial velocities violate the joint" in out
    assert "--assemble" in err
    assert main([*arguments, "--out", "b.parquet", "--assemble"]) == 0
    assert "0 failed" in capsys.readouterr().out
    assert main([*arguments, "--out", "b.parquet"]) == 2
    assert "assemble True there and False here" in capsys.readouterr().err


def test_a_sweep_to_an_accuracy_has_one_step_and_resumes(fall, capsys):
    """The step is that of the unchanged scene; every run controls its own error."""
    at = fall.index("--method")
    fall[at : at + 4] = ["--accuracy", "1e-6", "--horizon", "0.5"]
    assert main(fall) == 0
    said = "20 runs of 0.5 s, accuracy 1e-06 in 0.5 s, states at 10 ms; 0 failed"
    assert said in capsys.readouterr().out
    description = SweepFile("a.parquet").description
    assert description["settings"]["accuracy"] == 1e-6
    assert description["settings"]["horizon"] == 0.5
    frame = pandas.read_parquet("a.parquet")
    height = frame["gravity.2"] * 0.5**2 / 2 + frame["bodies.stone.linear_velocity.2"] * 0.5
    # Exact for a method of order 8; 50 steps, of at least one substep each.
    assert np.allclose(frame["stone.z"], height, rtol=0, atol=1e-12)
    assert main(fall) == 0
    assert SweepFile("a.parquet").description == description
    fall[fall.index("1e-6")] = "1e-7"
    assert main(fall) == 2
    assert "contains a different sweep" in capsys.readouterr().err


@pytest.mark.parametrize("keep, step", [("0.1", "10 ms"), ("0.0625", "8.93 ms")])
def test_states_are_kept_at_steps_of_an_accuracy(fall, capsys, keep, step):
    """A step that divides both the duration and the period of --keep."""
    for option in ("--method", "--step"):
        at = fall.index(option)
        del fall[at : at + 2]
    assert main([*fall, "--keep", keep]) == 0
    said = f"20 runs of 0.5 s, accuracy 0.0001 in 60 s, states at {step}; 0 failed"
    assert said in capsys.readouterr().out
    times = pandas.read_parquet("a.parquet")["samples.time"][0]
    assert np.allclose(times, np.arange(len(times)) * float(keep), rtol=1e-12, atol=0)


def test_a_missing_pyarrow_is_named(fall, capsys, monkeypatch):
    monkeypatch.setattr("liegroup_core.study.sweep.file.find_spec", lambda name: None)
    assert main(fall) == 2
    assert "pip install 'liegroup_sim_ros[many]'" in capsys.readouterr().err


SCHEMA = Path(__file__).resolve().parents[2] / "config" / "trade.schema.json"
SCENE = "heavy_top"


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """Cache folder with a short measurement of the trade of SCENE over 0.5 s."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("LIEGROUP_CACHE_DIR", str(folder))
        trade = Trade(load_scene(SCENE), 0.5)
        for _ in trade.measure(["rkmk4", "rkmk8"], ["se3"], ["none"], budget=0.05, workers=1):
            pass
    return folder


@pytest.fixture
def measured(kept, monkeypatch):
    """Use that cache in this process."""
    monkeypatch.setenv("LIEGROUP_CACHE_DIR", str(kept))
    return kept


@pytest.mark.turn(3)
def test_trade_output_from_cached_measurements(measured, tmp_path, capsys):
    """Table, JSON valid by its schema, HTML report and plot, without new measurements."""
    files = [tmp_path / f"a.{kind}" for kind in ("json", "html", "png")]
    arguments = [
        "trade",
        SCENE,
        *"--horizon 0.5 --methods rkmk4 rkmk8 --groups se3 --stabilisation none --budget 0.01 --workers 1".split(),
    ]
    assert main([*arguments, "--json", str(files[0]), "--html", str(files[1]), "--png", str(files[2])]) == 0
    out = capsys.readouterr().out
    assert "Cheapest configuration for each accuracy" in out and "rkmk8" in out and "below" in out
    document = json.loads(files[0].read_text())
    schema = json.loads(SCHEMA.read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.Draft202012Validator(schema).validate(document)
    (part,) = document["scenes"]
    costs = [part["cells"][k]["cost_us"] for k in part["front"]]
    assert costs == sorted(costs) and len(costs) > 3
    for entry in part["cheapest"]:
        assert entry["cell"] is None or (part["margin"] * part["cells"][entry["cell"]]["error"] <= entry["accuracy"])
    # A narrower question is answered as if nothing else had been measured.
    narrower = [word for word in arguments if word != "rkmk4"]
    assert main([*narrower, "--json", str(files[0])]) == 0
    assert {cell["method"] for cell in json.loads(files[0].read_text())["scenes"][0]["cells"]} == {"rkmk8"}
    page = files[1].read_text()
    assert "Content-Security-Policy" in page and "accuracy against cost" in page
    assert files[2].read_bytes().startswith(b"\x89PNG") and files[2].stat().st_size > 20_000


@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
@pytest.mark.turn(3)
def test_the_html_report_on_a_screen_and_on_a_phone(measured, tmp_path):
    """Words are not broken, values are beside their names, nothing exceeds the phone's width."""
    page = tmp_path / "a.html"
    command = (
        f"trade {SCENE} --horizon 0.5 --methods rkmk4 rkmk8 --groups se3 --stabilisation none --budget 0.01 "
        f"--workers 1 --html {page}"
    )
    assert main(command.split()) == 0
    browser = Browser(tmp_path / "browser")

    def lines(what):
        return browser.run(
            f"[...document.querySelectorAll('{what}')].map(e => e.getClientRects().length ? e.offsetHeight : 0)"
        )

    try:
        browser.open(page, width=1000)
        assert browser.errors == [] and browser.requests == [f"file://{page}"]
        broken = """[...document.querySelectorAll('.logs th')].filter(th => {
            const range = document.createRange();
            range.selectNodeContents(th);
            return !th.textContent.includes(' ') && range.getClientRects().length > 1;
        }).map(th => th.textContent)"""
        assert browser.run(broken) == []
        browser.open(page, width=390, height=800, phone=True)
        browser.run("new Promise(done => setTimeout(done, 600))")
        assert browser.run("document.documentElement.scrollWidth") <= 390
        # Two lines of a long setting are some 50 px.
        heights = lines(".logs td")
        assert len(heights) > 20 and max(heights) < 60
    finally:
        browser.close()


def test_every_method_has_a_distinct_line_style():
    cells = [
        {
            "method": name,
            "step": 0.01,
            "group": "se3",
            "stabilisation": "none",
            "options": {},
            "stopped": None,
            "error": 1e-3,
            "cost_us": 1.0,
        }
        for name in METHODS
    ]
    part = {"cells": cells, "front": [0], "to_accuracy": [], "reference": {"known": 1e-12}}
    curves = [trace for trace in make_plot(part)["data"] if trace["name"] in METHODS]
    looks = [(trace["line"]["color"], trace["line"]["dash"]) for trace in curves]
    assert len(set(looks)) == len(looks) == len(METHODS)


def test_table_picture_and_json(tmp_path, capsys):
    picture, cells = tmp_path / "map.png", tmp_path / "map.json"
    command = f"extremes --axes step_free --methods rkmk4 rkmk8 --quick --workers 1 --png {picture} --json {cells}"
    assert main(command.split()) == 0
    shown = capsys.readouterr().out
    assert "step, free body over 16 s, s" in shown and "silent 0" in shown
    found = json.loads(cells.read_text())
    assert found["counts"] == {"accurate": 4, "flagged": 0, "refused": 2, "stopped": 0, "unjudged": 0, "silent": 0}
    assert [cell["value"] for cell in found["cells"]] == [8.0, 8.0, 1.0, 1.0, 0.25, 0.25]
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.turn(3)
def test_an_interrupted_map_keeps_its_cells(tmp_path, capsys, monkeypatch):
    """The next call shows the cells of the first one and runs only the remaining ones."""
    monkeypatch.setattr(store, "cache_root", lambda: tmp_path)
    call = ["extremes", "--axes", "turn", "--methods", "rkmk4", "rkmk8", "--workers", "1"]
    made, presses = [], iter([3])

    def column(item):
        if len(made) == 3 and next(presses, None):
            signal.raise_signal(signal.SIGINT)
        made.append(item[1])
        return extremes_column(item)

    extremes_column = extremes.column
    monkeypatch.setattr(extremes, "column", column)
    assert main(call) == 130
    assert capsys.readouterr().err.splitlines()[-1] == (
        "liegroup_sim: interrupted; finished cells are saved, the same command continues"
    )
    assert len(made) == 3
    assert main(call) == 0
    assert sorted(made) == sorted(next(a for a in extremes.AXES if a.name == "turn").values)
    assert len(made) == len(set(made)) and "silent 0" in capsys.readouterr().out


def test_a_user_scene_is_mapped(capsys):
    assert main("extremes free_body --horizon 0.5 --axes step --methods rkmk4 --workers 1".split()) == 0
    assert "accurate 9" in capsys.readouterr().out


def test_a_scene_at_rest_has_no_speeds_and_quick_is_quick(capsys):
    assert main("extremes double_pendulum --horizon 0.5 --quick --methods rkmk8 rattle --workers 1".split()) == 0
    shown, said = capsys.readouterr()
    # Every third of nine steps, for the one method that is for it.
    heads, row = (line.split() for line in shown.splitlines()[1:3])
    assert heads == ["0.5", "0.05", "0.005"] and row == ["rkmk8", ".", ".", "."]
    assert "initial velocities at" not in shown and "initially at rest" in said


@pytest.mark.turn(3)
def test_close_values_are_distinguishable_and_not_truncated(tmp_path, capsys):
    """1.000001 differs from 1 on the terminal and in the report; column heads are complete."""
    page, wanted = tmp_path / "map.md", next(a for a in extremes.AXES if a.name == "sleeping")
    assert (
        main(["extremes", "--axes", "sleeping", "--methods", "rkmk8", "--workers", "1", "--markdown", str(page)]) == 0
    )
    heads = capsys.readouterr().out.splitlines()[1].split()
    assert tuple(map(float, heads)) == wanted.values
    row = next(line for line in page.read_text().splitlines() if line.startswith("| | 0.5"))
    assert [float(x) for x in row.strip("| ").split("|")] == list(wanted.values)
    # The page may be anywhere, so a path of the documentation would lead nowhere.
    assert "](" not in page.read_text()
