# SPDX-License-Identifier: Apache-2.0
"""Reference solutions and errors of a trade against independent results.

Free body, tops: end states by Taylor series in 45 digits, and errors of independent implementations of the methods.
Four-bar: crank angle by quadrature of its energy, and errors of an implementation with other joint rows.
Heavy top, double pendulum, four-bar: motions by accelerations of other software, made and kept by
benchmarks/trade_truth_peers.py.
"""

import json
from pathlib import Path

import numpy as np
import pytest
from golden import END

from liegroup_core import Simulation, load_scene
from liegroup_core.layout import make_layout
from liegroup_core.reference import Trajectory, distance
from liegroup_core.study.trade import reference_solution as truth
from liegroup_core.study.trade.configurations import as_time
from liegroup_core.study.trade.reference_solution import find_truth, scaled

PEERS = json.loads(Path(__file__).with_name("peers.json").read_text())
MEASURED = Path(__file__).resolve().parents[2] / "docs" / "which_method.json"
CRANK_ANGLE_1 = -0.765225378176  # rad, modulo a turn
# scene, horizon s, [(method, group, step s, |R - R_true|_2 there)]
ELSEWHERE = [
    (
        "free_body",
        10.0,
        [
            ("stoermer_verlet", "auto", 0.25, 1.8392e-2),
            ("lie_newmark", "auto", 0.25, 1.2714e-3),
            ("coadjoint_rkmk2", "auto", 0.25, 6.6897e-3),
            ("rattle", "auto", 0.25, 9.5058e-2),
            ("simo_wong", "auto", 0.25, 1.0676e-2),
            ("coadjoint_rkmk4", "auto", 0.25, 7.3253e-6),
            ("rkmk4", "se3", 0.25, 3.4191e-6),
            ("lie_midpoint", "auto", 0.25, 4.2340e-3),
        ],
    ),
    (
        "lagrangian_top",
        1.0,
        [
            ("stoermer_verlet", "auto", 2.0**-12, 1.1404e-3),
            ("rattle", "auto", 2.0**-12, 3.3614e-2),
            ("lie_newmark", "auto", 2.0**-12, 8.0759e-3),
            ("lie_midpoint", "auto", 2.0**-12, 9.0806e-4),
        ],
    ),
    (
        "heavy_top",
        6.0,
        [
            ("rkmk4", "se3", 1e-3, 3.623e-7),
            ("rkmk4", "se3", 5e-4, 2.294e-8),
            ("rkmk4", "so3xr3", 1e-3, 5.771e-6),
            ("rkmk4", "so3xr3", 5e-4, 3.608e-7),
        ],
    ),
]


@pytest.fixture(autouse=True)
def few_samples(monkeypatch):
    """Use few sampling times."""
    monkeypatch.setattr(truth, "sample_times", lambda horizon: [0 * horizon, horizon / 2, horizon])


@pytest.mark.parametrize("name, horizon, runs", ELSEWHERE)
@pytest.mark.turn(3)
def test_errors_equal_independently_published_errors(name, horizon, runs):
    """Tolerance: a unit of the fourth or fifth digit plus the reference uncertainty."""
    found = find_truth(make_layout(load_scene(name)), as_time(horizon))
    assert found.known <= 1e-10
    end = found.motion.rotation[-1, 0]
    assert np.linalg.norm(end - END[name, int(horizon)][:3], 2) <= (1e-10 if name == "heavy_top" else 2e-11)
    for method, group, step, elsewhere in runs:
        simulation = Simulation(load_scene(name), method, step, group)
        simulation.advance(round(horizon / step))
        turn = simulation.sample().pose[0, :9].reshape(3, 3)
        error = np.linalg.norm(turn - end, 2)
        assert error == pytest.approx(elsewhere, rel=1e-3, abs=found.known), (method, step)


@pytest.mark.turn(3)
def test_four_bar_reference_against_energy_quadrature():
    found = find_truth(make_layout(load_scene("four_bar")), as_time(1.0))
    crank = found.motion.rotation[-1, 0]
    angle = np.arctan2(crank[1, 0], crank[0, 0])
    # Twelve digits are given, and what the truth is not sure of.
    assert angle == pytest.approx(CRANK_ANGLE_1, abs=1e-11 + found.known)
    for step, elsewhere in ((2e-3, 2.2e-2), (1e-3, 1.7e-3), (1e-4, 1.87e-7)):
        simulation = Simulation(load_scene("four_bar"), "rkmk4", step)
        simulation.advance(round(1.0 / step))
        turn = simulation.sample().pose[0, :9].reshape(3, 3).T @ crank
        # Other joint rows are another index-1 form, whose joints drift otherwise: errors of the
        # same order and size, not the same digits.
        assert 0.7 * elsewhere <= abs(np.arctan2(turn[1, 0], turn[0, 0])) <= 1.1 * elsewhere


def error_against(peer, rows, rotation, position):
    """Error in the trade's metric of rotation (k, n, 3, 3) and position (k, n, 3) at peer times."""

    def motion(turns, places):
        return Trajectory(None, turns, places, np.zeros((*places.shape[:2], 6)))

    off = distance(
        motion(rotation, position), motion(np.array(peer["rotation"])[rows], np.array(peer["position"])[rows])
    )
    return scaled(off.position, off.angle, peer["length"])


@pytest.mark.parametrize("peer", PEERS, ids=lambda peer: peer["scene"])
@pytest.mark.volume(1)
def test_the_reference_agrees_with_other_software(peer, monkeypatch):
    """Tolerance: the uncertainties of both. The peer scenes are written independently as well."""
    times = [as_time(at) for at in peer["times"]]
    monkeypatch.setattr(truth, "sample_times", lambda horizon: times)
    found = find_truth(make_layout(load_scene(peer["scene"])), as_time(peer["horizon"]))
    assert found.length == pytest.approx(peer["length"]) and len(times) >= 10
    assert max(found.known, peer["known"]) <= 1e-9
    assert error_against(peer, slice(None), found.motion.rotation, found.motion.position) <= (
        found.known + peer["known"]
    )


@pytest.mark.parametrize("peer", PEERS, ids=lambda peer: peer["scene"])
def test_the_cheapest_configurations_meet_their_stated_error(peer):
    """By the motion of the other software, at those of its instants that are whole steps; the
    errors that are said are the largest of more instants, and measured against our truth.
    """
    (part,) = (part for part in json.loads(MEASURED.read_text())["scenes"] if part["scene"] == peer["scene"])
    assert part["horizon"] == peer["horizon"]
    for entry in part["cheapest"]:
        cell = part["cells"][entry["cell"]]
        step = as_time(cell["step"])
        rows = [row for row, at in enumerate(peer["times"]) if as_time(at) % step == 0]
        simulation = Simulation(
            load_scene(peer["scene"]),
            cell["method"],
            cell["step"],
            cell["group"],
            stabilisation=cell["stabilisation"],
            **cell["options"],
        )
        poses = []
        for row in rows:
            simulation.advance(round(as_time(peer["times"][row]) / step) - simulation.steps)
            poses.append(simulation.sample().pose)
        poses = np.array(poses)
        error = error_against(peer, rows, poses[..., :9].reshape(*poses.shape[:2], 3, 3), poses[..., 9:])
        assert len(rows) >= 5 and part["margin"] * cell["error"] <= entry["accuracy"]
        assert error <= cell["error"] + part["reference"]["known"] + peer["known"]
