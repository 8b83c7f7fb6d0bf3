# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim analyze`: errors, drift and planted defects of recordings.

What it says about the chapter's heavy top is held against numbers of an independent program.
"""

import dataclasses
import json
import math

import numpy as np
import pytest
from made_run import PAIR, record
from scipy.spatial.transform import Rotation

from liegroup_core import load_scene
from liegroup_core.scene.load import scene_from_text
from liegroup_sim_ros.analysis.analyse import analyse
from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.recording.read import read_recording


def figures_of(path, **options):
    return analyse(read_recording(path), **options).figures


PUSHED = {400: ("top", (0.0, 0.0, 0.0, 0.0, 200.0, 0.0)), 700: ("top", (0.0,) * 6)}


@pytest.fixture(scope="module")
def pushed_top(tmp_path_factory):
    """Heavy top, 3 s at h = 2 ms, pushed from 0.8 s to 1.4 s."""
    return record(tmp_path_factory.mktemp("log") / "pushed.mcap", load_scene("heavy_top"), 1500, pushes=PUSHED.items())


@pytest.mark.turn(3)
def test_error_of_the_heavy_top_equals_an_independent_implementation(tmp_path):
    """The error after 6 s is what an independent implementation of the method has: 5.652e-6.

    Three digits are given; another arrangement of the same arithmetic changes the error by its
    round-off, 1e-13 a step, so 1 part in 1000 is the last digit given.
    """
    figures = figures_of(record(tmp_path / "a.mcap", load_scene("heavy_top"), 3000))
    error = figures["reference"]
    assert error["attitude"]["final"] == pytest.approx(5.652e-6, rel=1e-3)
    # The centre of mass is the first column of R times 0.5 m.
    assert error["position"]["final"] <= 0.5 * error["attitude"]["final"]
    assert 0.1 * error["attitude"]["final"] < error["attitude"]["max"] < 1e-4
    assert error["angle"]["max"] == pytest.approx(error["attitude"]["max"], rel=1e-9)
    for entry in (error[name] for name in ("position", "attitude", "angle", "angular", "linear")):
        assert 0.0 < entry["uncertainty"] < 1e-3 * entry["max"]
    assert (error["kind"], error["seconds"]) == ("integration", 6.0)
    same = {"samples": 301, "identical": 301, "first_difference": None, "stopped": None, "platform": {}}
    same["largest_difference"] = dict.fromkeys(("position_m", "angle_rad", "angular_rad_s", "linear_m_s"), 0.0)
    assert figures["repeat"] == same
    assert figures["problems"] == []
    assert figures["joints"]["pivot"]["largest"] < 1e-12
    assert figures["joints"]["pivot"]["unit"] == "m"
    assert figures["sim_seconds"] == 6.0 and figures["samples"] == 301


def test_constraint_drift_on_so3xr3_equals_an_independent_implementation(tmp_path):
    """On SO(3) x R^3 the pivot opens by 1.274e-5 m within 6 s at h = 2 ms; here every 2nd step."""
    figures = figures_of(
        record(tmp_path / "a.mcap", load_scene("heavy_top"), 3000, per_sample=2, group="so3xr3"), reference=False
    )
    assert figures["joints"]["pivot"]["largest"] == pytest.approx(1.274e-5, rel=1e-2)
    assert "reference" not in figures
    assert figures["repeat"]["identical"] == 1501


def test_energy_and_momentum_drift_of_force_free_intervals(pushed_top):
    """Drift within both intervals without wrench, each from its start, by formulas in this test."""
    recording = read_recording(pushed_top)
    figures = analyse(recording, reference=False).figures
    pose, twist = recording.pose["top"], recording.twist["top"].twist
    time = pose.stamp_ns * 1e-9
    R = Rotation.from_quat(pose.quaternion).as_matrix().transpose(1, 2, 0)
    inertia, mass = np.array([0.36, 0.306, 0.09]), 21.6
    kinetic = 0.5 * twist[:, :3] ** 2 @ inertia + 0.5 * mass * (twist[:, 3:] ** 2).sum(axis=1)
    spring = 0.5e4 * ((pose.position - [1.0, 0.0, 0.5]) ** 2).sum(axis=1)
    total = kinetic + spring + mass * 9.81 * pose.position[:, 2]
    spin = np.einsum("ijk,kj->ki", R, twist[:, :3] * inertia)
    linear = mass * np.einsum("ijk,kj->ki", R, twist[:, 3:])
    field = np.array([1e4, 0.0, 1e4 * 0.5 - mass * 9.81])
    along = (spin + np.cross(pose.position, linear)) @ field / np.linalg.norm(field)

    def drift(values):
        parts = values[time < 0.8 + 1e-9], values[time > 1.4 - 1e-9]
        return max(np.abs(part - part[0]).max() for part in parts)

    # Values of size 1e4 J and 10 N m s, so round-off of 1e-12 and 1e-15 of them.
    assert figures["energy"]["drift_J"] == pytest.approx(drift(total), abs=1e-10)
    assert figures["energy"]["largest_kinetic_J"] == pytest.approx(kinetic.max(), rel=1e-12)
    assert drift(total) < 1e-2 < np.ptp(total)  # the push is not in it
    assert "0.6 s with an applied wrench" in figures["energy"]["left_out"]
    (momentum,) = figures["momentum"]
    assert momentum["drift"] == pytest.approx(drift(along), abs=1e-12)
    assert drift(along) < 1e-3 < np.ptp(along)
    assert figures["pushes"] == [{"body": "top", "from_s": 0.8, "to_s": pytest.approx(1.4)}]


@pytest.mark.turn(3)
def test_repetition_and_reference_use_the_recorded_wrenches(pushed_top, tmp_path):
    """With them the run is bit-identical and its error small; with one missing, neither."""
    good = figures_of(pushed_top)
    assert good["repeat"]["identical"] == good["repeat"]["samples"] == 151
    assert good["reference"]["angle"]["max"] < 1e-4

    def without_the_end(topic, k, data):
        return None if "inputs" in topic and k == 1 else data

    spoilt = record(tmp_path / "a.mcap", load_scene("heavy_top"), 1500, pushes=PUSHED.items(), spoil=without_the_end)
    bad = figures_of(spoilt)
    assert bad["repeat"]["identical"] == 71  # up to 1.4 s, where the push should end
    assert bad["repeat"]["first_difference"]["at_s"] == pytest.approx(1.42)
    assert bad["reference"]["angle"]["max"] > 0.1
    assert any("re-simulation is not bit-identical: top" in text for text in bad["problems"])


def test_one_flipped_bit_is_detected(tmp_path):
    def flip(topic, k, data):
        last = data[:-8] + bytes([data[-8] ^ 1]) + data[-7:]  # the quaternion's w, little end
        return last if topic.endswith("pose") and k == 30 else data

    figures = figures_of(record(tmp_path / "a.mcap", load_scene("heavy_top"), 500, spoil=flip))
    assert figures["repeat"]["identical"] == figures["repeat"]["samples"] - 1 == 50
    assert figures["repeat"]["first_difference"] == {"at_s": pytest.approx(0.6), "body": "top"}
    assert len(figures["problems"]) == 1


@pytest.mark.turn(3)
def test_every_reset_starts_a_new_interval(tmp_path):
    """Each interval starts from the initial state; a wrench counts until the reset ends it."""
    push, none = (0, 0, 5.0, 0, 0, 0), (0,) * 6
    pushes = [(at, ("top", wrench)) for at, wrench in ((100, push), (200, none), (400, push), (600, push))]
    figures = figures_of(record(tmp_path / "a.mcap", load_scene("heavy_top"), 900, resets=(300, 555), pushes=pushes))
    assert figures["resets"] == 2 and figures["problems"] == []
    assert figures["repeat"]["identical"] == figures["repeat"]["samples"] == 31 + 26 + 35
    assert figures["reference"]["angle"]["max"] < 1e-4
    # Resets come one step after steps 300 and 555: at 0.602 s and at 1.114 s.
    assert [push["from_s"] for push in figures["pushes"]] == pytest.approx([0.2, 0.802, 1.204])
    assert [push["to_s"] or math.inf for push in figures["pushes"]] == pytest.approx([0.4, 1.114, math.inf])
    assert "1.09 s with an applied wrench" in figures["energy"]["left_out"]  # 0.2 + 0.3 + 0.59, up to last samples
    assert figures["energy"]["intervals"] == 4  # 2 + 1 + 1, the last two up to a push
    assert figures["sim_seconds"] == pytest.approx(0.6 + 0.5 + 0.68)


def test_energy_drift_is_not_judged_with_dampers(tmp_path):
    scene = scene_from_text(PAIR.replace("rest_length", "damping: 0.5, rest_length"))
    figures = figures_of(record(tmp_path / "a.mcap", scene, 500))
    assert figures["energy"]["drift_J"] is None
    assert figures["energy"]["left_out"] == "non-conservative forces: band"
    # Momentum is kept all the same: three components about the centre of mass, two linear ones.
    assert [entry["unit"] for entry in figures["momentum"]] == ["N m s"] * 3 + ["N s"] * 2
    # Up to the error of the method: that of the attitude, times momenta below 2.
    drift = max(entry["drift"] for entry in figures["momentum"])
    assert drift < 2.0 * figures["reference"]["angle"]["max"] < 1e-6
    assert figures["joints"] == {} and figures["reference"]["position"]["max"] < 1e-7


def test_nan_samples_are_reported_and_excluded(tmp_path, capsys):
    """No figure of such samples is shown as good."""

    def spoil(topic, k, data):
        if topic == "/sim_node/left/twist" and k in (20, 21):
            return data[:-8] + np.array(np.nan).tobytes()
        return data

    log = record(tmp_path / "a.mcap", scene_from_text(PAIR), 400, spoil=spoil)
    assert main(["analyze", str(log), "--json", str(tmp_path / "a.json")]) == 0
    said = capsys.readouterr().out
    assert "NaN or infinity in 2 samples, from 0.4 s on" in said
    (figures,) = json.loads((tmp_path / "a.json").read_text(), parse_constant=pytest.fail)["logs"]
    assert figures["not_finite_samples"] == 2 and figures["repeat"]["samples"] == 39


def test_missing_samples_and_messages_are_reported(tmp_path):
    """A sample lacking the messages of one body is excluded; sequence gaps are reported."""

    def missing(topic, k, data):
        return None if k == 7 and topic.startswith("/sim_node/left") else data

    log = record(tmp_path / "a.mcap", scene_from_text(PAIR), 400, spoil=missing)
    recording = dataclasses.replace(read_recording(log), lost={"/clock": 3})
    figures = analyse(recording, reference=False).figures
    assert figures["missing_samples"] == 1 and figures["samples"] == 40
    assert figures["repeat"]["identical"] == 40
    assert figures["problems"] == ["messages are missing: 3 of /clock", "missing from the recording: 1 sample"]


@pytest.mark.turn(3)
def test_the_recording_of_a_killed_process_is_analysed(tmp_path, pushed_top):
    """Truncated in the middle: the existing part is analysed and the file called incomplete."""
    log = tmp_path / "cut.mcap"
    log.write_bytes(pushed_top.read_bytes()[:-3000])
    figures = figures_of(log)
    assert not figures["complete"]
    assert figures["problems"][0].startswith("the file is incomplete")
    assert figures["repeat"]["identical"] == figures["repeat"]["samples"] > 10
