# SPDX-License-Identifier: Apache-2.0
"""A driven joint of a loop that is commanded beyond its reach ends the run with its name."""

import math

import pytest
import yaml

from liegroup_core import Simulation, SimulationError, load_scene
from liegroup_core.scene.load import scene_from_text

# Rocker of the four-bar: its end is 1.5 m from the crank's pin where crank and coupler are in line,
# and 0.5 m where they are folded. All other links are 1 m, and its angle counts from the ground line.
OUTER, INNER = (math.pi - math.acos(1.0 - 0.5 * d * d) for d in (1.5, 0.5))


def driven_rocker():
    scene = yaml.safe_load(load_scene("four_bar").text)
    for joint in scene["joints"]:
        joint.pop("rate", None)
        if joint["name"] == "ground_rocker":
            joint |= {"driven": True, "rate": 0.0}
    return scene_from_text(yaml.safe_dump(scene))


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"method": "rkmk4"},
        {"method": "rkmk8", "stabilisation": "projection"},
        {"method": "generalized_alpha", "group": "relative"},
        {"method": "constrained_rattle", "group": "relative"},
    ],
    ids=lambda options: options.get("method", "accuracy"),
)
@pytest.mark.parametrize("change, end, sign", [(1.5, INNER, 1.0), (-3.0, OUTER, -1.0)])
@pytest.mark.turn(3)
def test_a_position_beyond_the_reach_of_a_loop_is_named(options, change, end, sign):
    """Within what the joint moves in four steps, at most 3 * 15/8 rad/s."""
    simulation = Simulation(driven_rocker(), quiet=True, **options)
    start = simulation.sample().prescribed["ground_rocker"][0]
    simulation.command_motion("ground_rocker", [1.0], [start + change])
    with pytest.raises(SimulationError) as caught:
        simulation.advance(round(1.0 / simulation.step))
    text = str(caught.value)
    assert "beyond their reach: 'ground_rocker' at " in text and "\n" not in text
    position = float(text.partition("'ground_rocker' at ")[2].split()[0])
    most = 3.0 * 1.875 * 4 * simulation.step
    assert 0.0 < sign * (position - end) < most
    assert "coupler_rocker" not in text


def test_a_failure_within_the_reach_keeps_its_reason():
    """Tolerances below round-off, which no substep meets."""
    simulation = Simulation(driven_rocker(), "rkmk54", 1e-2, quiet=True, rtol=1e-30, atol=1e-30)
    simulation.command_motion("ground_rocker", [1.0], None, [0.2])
    with pytest.raises(SimulationError, match="tolerance"):
        simulation.advance(10)
