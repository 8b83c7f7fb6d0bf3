# SPDX-License-Identifier: Apache-2.0
"""Wrong arguments of the public API: a ValueError with one line, and nothing changes."""

import numpy as np
import pytest

from liegroup_core import Simulation, load_scene
from liegroup_core.forces.commands import Command, Commands
from liegroup_core.state import State

HUGE = 10**400  # no float
LONG = 10**5000  # Python does not write it in decimal


def refuses(call, match=""):
    with pytest.raises(ValueError, match=match) as error:
        call()
    assert "\n" not in str(error.value)


@pytest.fixture(scope="module")
def top():
    return Simulation(load_scene("heavy_top"), accuracy=1e-4, quiet=True)


@pytest.fixture(scope="module")
def arm():
    return Simulation(load_scene("driven_arm"), accuracy=1e-4, quiet=True)


@pytest.mark.parametrize("number", [HUGE, LONG, -HUGE], ids=["huge", "long", "negative"])
def test_numbers_that_are_no_floats_are_refused(top, number):
    scene = top.scene
    refuses(lambda: Simulation(scene, accuracy=number), "accuracy must be")
    refuses(lambda: Simulation(scene, horizon=number), "horizon must be")
    refuses(lambda: Simulation(scene, step=number), "step must be")
    refuses(lambda: Simulation(scene, "rkmk54", rtol=number), "rtol must be")
    refuses(
        lambda: Simulation(scene, "rkmk4", stabilisation="baumgarte", baumgarte_time=number, group="se3"),
        "baumgarte_time must be",
    )
    refuses(lambda: top.set_accuracy(number), "accuracy must be")
    push = [0.0] * 6
    refuses(lambda: top.apply_wrench("top", [number] * 6), "six finite numbers")
    refuses(lambda: top.apply_wrench("top", push, point=[number, 0, 0]), "three finite numbers")
    refuses(lambda: top.apply_wrench("top", push, start=number), "start must be")
    refuses(lambda: top.apply_wrench("top", push, duration=number), "duration must be")
    refuses(lambda: top.place({}, {"top": [number] * 6}), "finite twist")
    refuses(lambda: top.set_state(np.eye(4).tolist(), [[number] * 6]), "expected a twist")


@pytest.mark.parametrize("number", [1.01e100, -1e308])
def test_one_bound_holds_for_all_commands(top, arm, number):
    """1e100, that of the numbers of a scene, and of messages to a node."""
    joint, pose = next(iter(arm.layout.motions)), np.eye(4)
    pose[0, 3] = number
    before = top.snapshot(), arm.snapshot()
    for call in (
        lambda: top.apply_wrench("top", [number] * 6),
        lambda: top.apply_wrench("top", [0.0] * 6, point=[0, number, 0]),
        lambda: top.place({"top": pose}),
        lambda: top.place({}, {"top": [0.0] * 5 + [number]}),
        lambda: arm.apply_effort(joint, number),
        lambda: arm.place(joints={joint: (number, None)}),
        lambda: arm.place(joints={joint: (None, number)}),
        lambda: arm.command_motion(joint, [1.0], [number]),
        lambda: arm.command_motion(joint, [1.0], None, [number]),
        lambda: arm.command_motion(joint, [1.0], [0.0], [0.0], [number]),
        lambda: arm.check_motion(joint, [abs(number)], [0.0]),
    ):
        refuses(call, "is too large, the limit is 1e\\+100")
    assert (top.snapshot(), arm.snapshot()) == before


def test_numbers_of_joints_that_are_no_floats_are_refused(arm):
    joint = next(iter(arm.layout.motions))
    refuses(lambda: arm.place(joints={joint: (HUGE, None)}), "both finite or None")
    refuses(lambda: arm.command_motion(joint, [HUGE], [0.0]), "times must be")
    refuses(lambda: arm.command_motion(joint, [1.0], [HUGE]), "positions must be")
    refuses(lambda: arm.command_motion(joint, [1.0], None, [[HUGE]]), "velocities must be")
    refuses(lambda: arm.apply_effort(joint, HUGE), "effort must be")


@pytest.mark.parametrize("name", [["top"], None, 5, {"a": 1}, {1}], ids=repr)
def test_names_that_are_no_texts_are_refused(top, arm, name):
    push = [0.0] * 6
    refuses(lambda: top.apply_wrench(name, push), "unknown body")
    refuses(lambda: top.apply_wrench("top", push, source=name), "source must be a name")
    joint = next(iter(arm.layout.unit_efforts))
    refuses(lambda: arm.apply_effort(name, 1.0), "one coordinate")
    refuses(lambda: arm.apply_effort(joint, 1.0, source=name), "source must be a name")
    refuses(lambda: arm.command_servo(name, 1.0), "no servo")
    refuses(lambda: arm.command_motion(name, [1.0], [0.0]), "not driven")
    assert not top.input_count and not arm.input_count


@pytest.mark.parametrize("wrong", [5, "top", [1], ("a", "b")], ids=repr)
def test_a_place_that_is_no_mapping_is_refused(top, arm, wrong):
    refuses(lambda: top.place(wrong), "poses must be")
    refuses(lambda: top.place({}, wrong), "twists must be")
    refuses(lambda: top.place({}, {}, wrong), "joints must be")
    joint = next(iter(arm.layout.unit_efforts))
    for value in (wrong, (1.0,), (1.0, 2.0, 3.0), ("1", 2.0)):
        refuses(lambda value=value: arm.place(joints={joint: value}), "both finite or None")


@pytest.mark.parametrize("steps", [10**30, 1.5, -5, True, "a", None], ids=repr)
def test_a_state_needs_a_step_count(top, steps):
    top.reset()
    top.advance(3)
    before = top.state()
    refuses(lambda: top.set_state(*top.state(), steps), "steps must be a whole number")
    assert top.steps == 3 and all(map(np.array_equal, before, top.state()))


@pytest.mark.parametrize("name", [None, 5, [1], b"heavy_top"], ids=repr)
def test_what_is_no_name_of_a_scene_is_refused(name):
    refuses(lambda: load_scene(name), "expected the path or the name of a scene")


def damaged(parts):
    """Parts of a state with each of them, and each part of a part, missing or of another kind."""
    for key, part in parts.items():
        rest = {k: v for k, v in parts.items() if k != key}
        yield rest
        if isinstance(part, str):
            continue
        yield from (rest | {key: wrong} for wrong in (None, (), {}, b"", np.zeros(2), "a", 1j))
        if isinstance(part, dict):
            yield from (rest | {key: inner} for inner in damaged(part))
        if isinstance(part, tuple) and part and not hasattr(part, "from_json"):
            yield rest | {key: part[:-1]}
        if isinstance(part, np.ndarray):
            yield rest | {key: part.ravel()[:-1]} if part.size else rest


@pytest.mark.parametrize(
    "options", [{"accuracy": 1e-4}, {"method": "rkmk4"}, {"method": "rkmk4", "estimate": False}], ids=str
)
def test_a_damaged_snapshot_is_refused_and_changes_nothing(options):
    simulation = Simulation(load_scene("door"), step=1e-2, quiet=True, **options)
    simulation.advance(24)
    snapshot = simulation.snapshot()
    parts = snapshot.parts
    simulation.advance(8)
    wrong = [s for s in damaged(parts) if State({}, s) != State({}, parts)]
    wrong += [parts | {"steps": steps} for steps in (None, -1, 0.5, "a", 1 << 63)]
    wrong.append(parts | {"inputs": {"commands": Commands((Command("wrench", "nobody", (0.0,) * 6, 0),))}})
    assert len(wrong) > 40
    now = simulation.snapshot()
    for other in wrong:
        refuses(lambda other=other: simulation.restore(State(snapshot.identity, other)), "snapshot|nobody")
    assert simulation.snapshot() == now
    simulation.restore(snapshot)
    simulation.advance(8)
    assert simulation.snapshot() == now
