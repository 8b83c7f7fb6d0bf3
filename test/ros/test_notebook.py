# SPDX-License-Identifier: Apache-2.0
"""`show` in a notebook: a self-contained report in a frame, of a recording or of a simulation."""

import html
import re

import numpy as np
import pytest

import liegroup_sim_ros
from liegroup_core import Simulation, load_scene
from liegroup_sim_ros import show
from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.recording import RecordingError


def test_a_recording_shows_itself(tmp_path):
    log = tmp_path / "run.mcap"
    assert main(["run", "heavy_top", "--duration", "0.2", "--out", str(log)]) == 0
    shown = show(log, reference=False)
    cell = shown._repr_html_()
    [page] = re.findall(r'<iframe srcdoc="([^"]*)"', cell)
    assert html.unescape(page) == shown.html and 'sandbox="allow-scripts"' in cell
    assert shown.html.startswith("<!DOCTYPE html>") and "default-src 'none'" in shown.html
    assert len(cell) < 20e6 and repr(shown).startswith("heavy_top, 0.2 s with rkmk4")
    assert shown.save(tmp_path / "page.html").read_text(encoding="utf-8") == shown.html


def test_a_simulation_is_shown_from_its_present_state_and_stays(tmp_path):
    simulation = Simulation(load_scene("double_pendulum"), step=1e-3)
    simulation.advance(100)
    before = simulation.state()
    shown = show(simulation, seconds=0.3, reference=False)
    assert "double_pendulum, 0.3 s" in repr(shown)
    assert simulation.steps == 100
    assert all(np.array_equal(a, b) for a, b in zip(before, simulation.state()))


def test_wrong_arguments(tmp_path):
    simulation = Simulation(load_scene("free_body"))
    for seconds in (None, 0.0, -1.0):
        with pytest.raises(ValueError, match="how many seconds"):
            show(simulation, seconds)
    with pytest.raises(ValueError, match="seconds requires a Simulation"):
        show(tmp_path / "none.mcap", 1.0)
    with pytest.raises(RecordingError):
        show(tmp_path / "none.mcap")
    with pytest.raises(AttributeError, match="no attribute 'shows'"):
        liegroup_sim_ros.shows  # noqa: B018
