# SPDX-License-Identifier: Apache-2.0
"""`show` in a notebook: a self-contained report of a recording or simulation in a frame."""

import html
import re

import numpy as np
import pytest
from browser import CHROMIUM, Browser
from scene_files import text_of

import liegroup_sim_ros
from liegroup_core import Simulation, load_scene
from liegroup_core.scene.load import scene_from_text
from liegroup_sim_ros import notebook, show
from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.playback.resimulate import resimulate
from liegroup_sim_ros.recording import RecordingError, read_recording


def test_a_recording_has_a_notebook_representation(tmp_path):
    log = tmp_path / "run.mcap"
    assert main(["run", "heavy_top", "--duration", "0.2", "--out", str(log)]) == 0
    shown = show(log, reference=False)
    cell = shown._repr_html_()
    [page] = re.findall(r'<iframe srcdoc="([^"]*)"', cell)
    assert html.unescape(page) == shown.html and 'sandbox="allow-scripts"' in cell
    assert shown.html.startswith("<!DOCTYPE html>") and "default-src 'none'" in shown.html
    assert len(cell) < 20e6 and repr(shown).startswith("heavy_top, 0.2 s with rkmk853")
    assert show(read_recording(log), reference=False).html == shown.html
    assert shown.save(tmp_path / "page.html").read_text(encoding="utf-8") == shown.html


def test_a_simulation_is_shown_from_its_current_state_and_not_changed(tmp_path):
    simulation = Simulation(load_scene("double_pendulum"))
    simulation.advance(10)
    before = simulation.state()
    shown = show(simulation, seconds=0.3)
    assert "double_pendulum, 0.3 s" in repr(shown)
    # The copy starts later: what it began with counts for the original.
    assert "cannot be checked: there is no reference from the start of the run" in repr(shown)
    assert simulation.steps == 10
    assert all(np.array_equal(a, b) for a, b in zip(before, simulation.state()))


def test_a_report_from_a_later_step_reports_no_problem(monkeypatch):
    """Earlier time and wrenches of the original simulation are not errors of the copy."""
    found = []
    analyse = notebook.analyse
    monkeypatch.setattr(notebook, "analyse", lambda *given: found.append(analyse(*given)) or found[0])
    simulation = Simulation(load_scene("heavy_top"), "rkmk4", 1e-3)
    simulation.apply_wrench("top", [0, 0, 0, 0, 0, 1.0])
    simulation.advance(7)
    show(simulation, 0.1, reference=False)
    figures = found[0].figures
    assert figures["problems"] == [] and figures["sim_seconds"] == pytest.approx(0.1)
    assert figures["repeat"]["samples"] == figures["repeat"]["identical"] == 11
    assert found[0].recording.initial_state["steps"] == 7
    assert float(found[0].motion.stretches[0].log_times[0]) == pytest.approx(7e-3)


def test_a_joint_that_has_turned_many_times_meets_its_stop_in_the_copy(tmp_path):
    """After 3 s at 5 rad/s it is at 15 rad; 1 s later it stops at 20 rad."""
    text = text_of("winch_notebook.yaml")
    simulation = Simulation(scene_from_text(text), "rkmk4", 0.01)
    simulation.advance(300)
    recording = read_recording(notebook._record(simulation, 2.0, tmp_path / "run.mcap"))
    velocity = recording.twist["drum"].twist[:, 2]
    assert velocity[0] == pytest.approx(5.0) and velocity[-1] == pytest.approx(0.0, abs=1e-12)
    found = resimulate(recording)
    assert found["identical"] == found["samples"] > 1


@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
@pytest.mark.turn(3)
def test_the_frame_renders_inside_another_page(tmp_path):
    """As in a notebook, the sandboxed frame runs its scripts and sends no requests."""
    simulation = Simulation(load_scene("heavy_top"), "rkmk4", 1e-3)
    page = tmp_path / "notebook.html"
    cell = show(simulation, 0.2, reference=False)._repr_html_()
    page.write_text(f"<!DOCTYPE html><meta charset=utf-8>{cell}", encoding="utf-8")
    browser = Browser(tmp_path / "browser")
    try:
        browser.open(page)
        (frame,) = browser.call("Page.getFrameTree")["frameTree"]["childFrames"]
        world = browser.call("Page.createIsolatedWorld", frameId=frame["frame"]["id"])
        drawn = browser.call(
            "Runtime.evaluate",
            contextId=world["executionContextId"],
            expression="document.querySelectorAll('.plot .main-svg').length",
        )
        assert drawn["result"]["value"] > 0 and browser.errors == []
        local = ("data:", "about:", "blob:")
        assert [r for r in browser.requests if not r.startswith(local)] == [f"file://{page}"]
    finally:
        browser.close()


def test_wrong_arguments(tmp_path):
    simulation = Simulation(load_scene("free_body"))
    for seconds in (None, 0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="seconds must be a positive number"):
            show(simulation, seconds)
    with pytest.raises(ValueError, match="seconds requires a Simulation"):
        show(tmp_path / "none.mcap", 1.0)
    with pytest.raises(RecordingError):
        show(tmp_path / "none.mcap")
    with pytest.raises(AttributeError, match="no attribute 'shows'"):
        liegroup_sim_ros.shows  # noqa: B018
