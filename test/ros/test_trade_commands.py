# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim trade`, `run --accuracy` and the node parameter `accuracy`."""

import json
import os
import signal
import time
from pathlib import Path

import jsonschema
import pytest
from browser import CHROMIUM, Browser
from made_run import record
from node_process import COMPILING, python

from liegroup_core import load_scene
from liegroup_core.integrators.methods import METHODS
from liegroup_core.study import tasks
from liegroup_core.study.trade import accuracy
from liegroup_core.study.trade.trade import Trade
from liegroup_sim_ros.analysis.analyse import analyse
from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.recording.read import read_recording
from liegroup_sim_ros.report.trade_page import make_plot

SCHEMA = Path(__file__).resolve().parents[2] / "config" / "trade.schema.json"
SCENE = "heavy_top"
COMPILED = os.environ.get("LIEGROUP_CACHE_DIR", "")  # where this process has its kernels


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
    """Use that cache in this process, and no other methods."""
    monkeypatch.setenv("LIEGROUP_CACHE_DIR", str(kept))
    monkeypatch.setattr(accuracy, "SHORTLIST", ("rkmk4",))
    return kept


def test_trade_output_from_cached_measurements(measured, tmp_path, capsys):
    """Table, JSON valid by its schema, HTML report and plot, without new measurements."""
    files = [tmp_path / f"a.{kind}" for kind in ("json", "html", "png")]
    arguments = [
        "trade",
        SCENE,
        "--horizon",
        "0.5",
        "--methods",
        "rkmk4",
        "rkmk8",
        "--groups",
        "se3",
        "--stabilisation",
        "none",
        "--budget",
        "0.01",
        "--workers",
        "1",
    ]
    assert (
        main([*arguments, "--json", str(files[0]), "--html", str(files[1]), "--png", str(files[2])])
        == 0
    )
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
        assert entry["cell"] is None or (
            part["margin"] * part["cells"][entry["cell"]]["error"] <= entry["accuracy"]
        )
    # A narrower question is answered as if nothing else had been measured.
    narrower = [word for word in arguments if word != "rkmk4"]
    assert main([*narrower, "--json", str(files[0])]) == 0
    assert {cell["method"] for cell in json.loads(files[0].read_text())["scenes"][0]["cells"]} == {
        "rkmk8"
    }
    page = files[1].read_text()
    assert "Content-Security-Policy" in page and "accuracy against cost" in page
    assert files[2].read_bytes().startswith(b"\x89PNG") and files[2].stat().st_size > 20_000


@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
def test_the_html_report_on_a_screen_and_on_a_phone(measured, tmp_path):
    """Words are not broken, values are beside their names, nothing exceeds the phone's width."""
    page = tmp_path / "a.html"
    assert (
        main(
            [
                "trade",
                SCENE,
                "--horizon",
                "0.5",
                "--methods",
                "rkmk4",
                "rkmk8",
                "--groups",
                "se3",
                "--stabilisation",
                "none",
                "--budget",
                "0.01",
                "--workers",
                "1",
                "--html",
                str(page),
            ]
        )
        == 0
    )
    browser = Browser(tmp_path / "browser")

    def lines(what):
        return browser.run(
            f"[...document.querySelectorAll('{what}')].map(e => "
            "e.getClientRects().length ? e.offsetHeight : 0)"
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
    plot = make_plot({"cells": cells, "front": [0], "reference": {"known": 1e-12}})
    looks = [(trace["line"]["color"], trace["line"]["dash"]) for trace in plot["data"][:-1]]
    assert len(set(looks)) == len(looks) == len(METHODS)


@pytest.mark.parametrize(
    "change, said",
    [
        (["--methods", "rk"], "unknown method 'rk'"),
        (["--groups", "so3"], "unknown group"),
        (["--stabilisation", "glue"], "unknown stabilisation"),
        (["--workers", "0"], "--workers"),
        (["--horizon", "-1"], "horizon"),
        (["--horizon", "0.12345"], "three digits"),
        (["--steps", "0.3", "--horizon", "0.5"], "does not divide a horizon"),
        (["--budget", "0"], "--budget"),
        (["--json", "none/a.json"], "cannot be written"),
        (["--png", "a.txt"], "must end in"),
        (["nope"], "nope"),
        (
            ["--scheduler", "tcp://127.0.0.1:9", "--horizon", "0.5", "--methods", "rkmk2"],
            "no dask scheduler",
        ),
    ],
)
def test_wrong_input_is_one_line(measured, tmp_path, monkeypatch, capsys, change, said):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(tasks, "CONNECTING", 1)  # s instead of 10: nothing listens on that port
    assert main(["trade", SCENE, *change]) == 2
    out, err = capsys.readouterr()
    line = err.splitlines()[-1]
    assert out == "" and said in line and "Traceback" not in err
    assert not list(tmp_path.iterdir())


def test_a_run_for_an_accuracy_is_checked_by_analyze(measured, tmp_path, capsys):
    log = tmp_path / "a.mcap"
    arguments = ["run", SCENE, "--accuracy", "1e-6", "--horizon", "0.5", "--every", "1"]
    assert main([*arguments, "--duration", "1", "--out", str(log)]) == 0
    err = capsys.readouterr().err
    assert "accuracy 1e-06 over 0.5 s" in err and "for the first 0.5 s" in err
    recording = read_recording(log)
    promise = recording.settings["promise"]
    assert promise["accuracy"] == 1e-6 and promise["horizon"] == 0.5
    analysis = analyse(recording)
    found = analysis.figures["promise"]
    assert found["kept"] is True and found["beyond"] is True and found["seconds"] == 0.5
    assert 0.0 < found["error"] <= found["error_of_all"] and found["error"] <= 1e-6
    assert "guaranteed accuracy of 1e-06 is kept" in analysis.figures["verdict"]
    assert analysis.figures["problems"] == []
    assert main(["analyze", str(log), "--json", str(tmp_path / "a.json"), "--max-error", "1"]) == 0
    schema = SCHEMA.with_name("analysis.schema.json")
    jsonschema.Draft202012Validator(json.loads(schema.read_text())).validate(
        json.loads((tmp_path / "a.json").read_text())
    )


@pytest.mark.parametrize(
    "push, kept, seconds", [(None, False, 0.5), (25, False, 0.25), (0, None, 0.0)]
)
def test_a_missed_accuracy_is_reported_as_a_problem(tmp_path, push, kept, seconds):
    """With a much too large step. The accuracy does not apply after a wrench."""
    pushes = [] if push is None else [(push, ("top", (0.0, 0.0, 1.0, 0.0, 0.0, 0.0)))]
    log = record(
        tmp_path / "a.mcap",
        load_scene(SCENE),
        60,
        step=1e-2,
        per_sample=1,
        pushes=pushes,
        promise={"accuracy": 1e-6, "horizon": 0.5, "length": 0.5},
    )
    figures = analyse(read_recording(log)).figures
    found = figures["promise"]
    assert found["seconds"] == seconds and found["beyond"]
    # At a wrench from the start on only the first state counts, which is right.
    assert found["kept"] is (True if seconds == 0.0 else kept)
    assert any("is not kept" in text for text in figures["problems"]) == (kept is False)
    assert "guaranteed accuracy of 1e-06" in figures["verdict"]


@pytest.mark.parametrize(
    "more, said",
    [
        (["--method", "rkmk4"], "cannot be combined with --method"),
        (["--step", "1e-3"], "cannot be combined with --step"),
        (["--accuracy", "0"], "above 0"),
        (["--accuracy", "1e-14"], "cannot be had for heavy_top over 0.5 s on this machine; "),
    ],
)
def test_an_unattainable_accuracy_is_refused_in_one_line(measured, tmp_path, capsys, more, said):
    assert (
        main(
            [
                "run",
                SCENE,
                "--accuracy",
                "1e-6",
                "--horizon",
                "0.5",
                "--duration",
                "0.5",
                "--out",
                str(tmp_path / "a.npz"),
                *more,
            ]
        )
        == 2
    )
    # The first test of an accuracy measures, and says so first.
    err = capsys.readouterr().err.splitlines()
    assert said in err[-1] and all("measuring" in line for line in err[:-1])
    assert not list(tmp_path.iterdir())


# The compiled code stays where it is; the trade is looked for in the folder of these tests.
NODE = """
import os, sys
from liegroup_core.study.trade import accuracy
os.environ["LIEGROUP_CACHE_DIR"] = sys.argv[1]
accuracy.SHORTLIST = ("rkmk4",)
from liegroup_sim_ros.node.entry import main
sys.exit(main(["sim_node", "--ros-args", *sys.argv[2:]]))
"""


def node(folder, *parameters):
    return python(
        NODE,
        folder,
        *(
            word
            for entry in (f"scene:={SCENE}", "accuracy_horizon:=0.5", *parameters)
            for word in ("-p", entry)
        ),
        env={"LIEGROUP_CACHE_DIR": COMPILED},
    )


@pytest.mark.parametrize(
    "more, said",
    [
        (["accuracy:=1e-6", "step:=0.001"], "parameter accuracy: cannot be combined with step"),
        (["accuracy:=1e-14"], "parameter accuracy: accuracy 1e-14 cannot be had"),
        (
            ["accuracy:=1e-6", "real_time_factor:=1000000.0"],
            "at 1e+06 times real time: the cheapest setting that reaches it",
        ),
        ([], "parameter accuracy_horizon: requires accuracy"),
    ],
)
def test_the_node_refuses_in_one_line(measured, more, said):
    process = node(measured, *more)
    _, err = process.communicate(timeout=COMPILING)
    assert process.returncode == 2 and said in err.splitlines()[-1], err
    assert "Traceback" not in err


def test_the_node_runs_for_an_accuracy(measured, tmp_path):
    """It logs the chosen configuration and records the guaranteed accuracy."""
    log = tmp_path / "a.mcap"
    process = node(measured, "accuracy:=1e-6", f"record:={log}", "real_time_factor:=0.0")
    try:
        for line in process.stderr:
            if "for an accuracy of 1e-06 over 0.5 s" in line:
                break
        else:
            pytest.fail("it never said so")
        time.sleep(1.0)
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=COMPILING)
    assert process.returncode == 0
    settings = read_recording(log).settings
    assert settings["promise"]["accuracy"] == 1e-6
    # Messages at 100 Hz are whole steps.
    assert (0.01 / settings["step"]) % 1.0 == pytest.approx(0.0, abs=1e-9)
    assert f"{settings['method']}, step {settings['step']:g} s" in line
