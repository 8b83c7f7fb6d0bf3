# SPDX-License-Identifier: Apache-2.0
"""Wrong stops and friction in a scene, and states beyond a stop: one line each, nothing changes."""

import math

import numpy as np
import pytest
import yaml
from scene_files import cases

from liegroup_core.engine import Engine
from liegroup_core.errors import SceneError
from liegroup_core.scene.load import scene_from_text

BODY = {"mass": 1.0, "inertia": [0.01, 0.02, 0.015]}
HALF = {"position": [0.0, 0.0, 0.5]}
SPARE = {  # a body on a hinge beside the first one
    "name": "spare_hinge",
    "type": "revolute",
    "parent": "world",
    "child": "spare",
    "parent_frame": {"position": [1.0, 0.0, 0.0]},
    "child_frame": HALF,
}


def scene_text(kind, coupling=None, **more):
    """Scene of a body 0.5 m below the origin, on a joint of a type; at z with its frame there."""
    joint = {"name": "j", "type": kind, "parent": "world", "child": "a", "parent_frame": {}}
    joint |= {"child_frame": {} if kind in ("cable", "strut") else HALF} | more
    bodies = [
        {"name": "a", "position": [0.0, 0.0, -0.5]} | BODY,
        {"name": "spare", "position": [1.0, 0.0, -0.5]} | BODY,
    ]
    scene = {"name": "s", "gravity": [0.0, 0.0, -9.81], "bodies": bodies, "joints": [joint, SPARE]}
    if coupling is not None:
        gears = {"name": "gears", "joint": "j", "other": "spare_hinge", "ratio": 2.0}
        scene["couplings"] = [gears | coupling]
    return yaml.safe_dump(scene)


TURNS, SLIDES = {"axis": [1.0, 0.0, 0.0]}, "cylindrical"
WRONG = cases("wrong_stops_are_refused_in_one_line")


@pytest.mark.parametrize("kind, more, message", WRONG)
def test_wrong_stops_are_refused_in_one_line(kind, more, message):
    """The line begins with the place in the file and the joint or coupling."""
    with pytest.raises(SceneError, match=message) as refused:
        scene_from_text(scene_text(kind, **more))
    what = r"couplings\[0\] .gears" if "coupling" in more else r"joints\[0\] .j"
    assert "\n" not in str(refused.value)
    refused.match(rf"^scene:\d+: {what}")


STARTS = [
    ({"lower": -1.0, "upper": 20.0}, 0.0, 0.0),
    ({"lower": -9.0, "upper": -1.0}, -1.5, -1.5),
    ({"lower": 0.0}, math.pi, math.pi),
    ({"upper": 0.0}, -math.pi, -math.pi),
    ({"lower": 0.0, "upper": 4.7}, 4.0, 4.0),
    ({"lower": 4.0, "upper": 8.0}, 0.0, 2.0 * math.pi),
    ({"lower": 4.0}, 0.0, 2.0 * math.pi),
    ({"lower": -20.0, "upper": -4.0}, 0.5, 0.5 - 2.0 * math.pi),
]


@pytest.mark.parametrize("limits, angle, coordinate", STARTS)
def test_the_turn_of_a_start(limits, angle, coordinate):
    """An angle in (-pi, pi] between the stops is taken as it is; else the only turn is taken."""
    scene = yaml.safe_load(scene_text("revolute", limits=limits))
    scene["joints"][0]["parent_frame"] = {"rotation_vector": [0.0, 0.0, -angle]}
    engine = Engine(scene_from_text(yaml.safe_dump(scene)), "rkmk4", 1e-3)
    assert engine.sample().switching[0, 3] == pytest.approx(coordinate, abs=1e-12)


def tilted(angle):
    """Pose of the body if its joint turns about x."""
    pose = np.eye(4)
    pose[1:3, 1:3] = [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
    pose[:3, 3] = -0.5 * pose[:3, 2]
    return pose


def lowered(z):
    """Pose of the body at a height."""
    pose = np.eye(4)
    pose[2, 3] = z
    return pose


BEYOND = [
    ("cable", {"length": 0.9}, lowered(-1.2), "1.2 m is not between -inf and 0.9"),
    ("cable", {"length": 0.9}, lowered(-0.9), None),
    ("cable", {"length": 0.9, "stiffness": 1e4}, lowered(-1.2), None),
    ("strut", {"length": 0.4}, lowered(-0.3), "0.3 m is not between 0.4 and inf"),
    ("spherical", {"limits": {"cone": 0.4}}, tilted(1.0), "1 rad is not between -inf and 0.4"),
    ("spherical", {"limits": {"cone": 0.4}}, tilted(0.3), None),
    (SLIDES, {"limits": {"translation": {"upper": 0.2}}}, lowered(0.0), "0.5 m is not between"),
    (SLIDES, {"limits": {"translation": {"upper": 0.2}}}, lowered(-0.4), None),
]


@pytest.mark.parametrize("kind, more, pose, message", BEYOND)
def test_a_place_beyond_a_stop_is_refused(kind, more, pose, message):
    """Rigid stops refuse it with one line, and nothing changes; other poses are taken."""
    engine = Engine(scene_from_text(scene_text(kind, **more)), "rkmk4", 1e-3)
    engine.advance(3)
    before = engine.state()
    if message is None:
        engine.place({"a": pose})
        assert np.abs(engine.sample().poses["a"] - pose).max() <= 1e-12
        engine.advance(2)
        return
    with pytest.raises(SceneError, match=f"would be beyond its stop: its position {message}"):
        engine.place({"a": pose})
    assert all(map(np.array_equal, engine.state(), before))


def test_a_place_beyond_the_backlash_of_a_coupling_is_refused():
    """Within the gap each joint is set alone; beyond it both must be."""
    text = scene_text("revolute", {"backlash": {"gap": 0.1}})
    engine = Engine(scene_from_text(text), "rkmk4", 1e-3)
    engine.place(joints={"j": (0.04, 0.0)})
    assert engine.sample().joint_coordinates["spare_hinge"] == (0.0, 0.0)
    with pytest.raises(SceneError, match="coupling gears would be beyond its stop: .* 0.4 rad"):
        engine.place(joints={"j": (0.4, 0.0)})
    engine.place(joints={"j": (0.4, 0.0), "spare_hinge": (0.2, 0.0)})
    assert engine.modes == {"gears": "free"}
