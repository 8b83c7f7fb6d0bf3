# SPDX-License-Identifier: Apache-2.0
"""The command `liegroup_sim trade`: table, JSON, HTML report, plot and wrong input."""

import json
from pathlib import Path

import jsonschema
import pytest
from browser import CHROMIUM, Browser

from liegroup_core import load_scene
from liegroup_core.methods.table import METHODS
from liegroup_core.study.trade.trade import Trade
from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.report.trade_page import make_plot

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
