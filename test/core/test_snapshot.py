# SPDX-License-Identifier: Apache-2.0
"""Snapshots: a run that returns to one repeats its continuation bit for bit, wrenches included."""

import copy
import json
import pickle

import numpy as np
import pytest
from scene_files import cases, text_of

from liegroup_core import Simulation, load_scene
from liegroup_core.methods.table import METHODS
from liegroup_core.scene.load import scene_from_text
from liegroup_core.state import State, StoredMatrix, encoded
from liegroup_sim_ros.recording import attachments

SPRING = text_of("wound_snapshot.yaml")
PLATE = text_of("plate.yaml")
PUSH = [0.3, 0.1, 0.0, 0.0, 0.2, 0.0]
CASES = cases("snapshot_cases")


def trace(simulation, count=40):
    """Bits of every state, estimate and time on the way."""
    found = []
    for _ in range(count):
        simulation.advance(1)
        sample = simulation.sample()
        estimate = b"" if sample.errors is None else sample.errors.tobytes()
        found.append((sample.pose.tobytes(), sample.twist.tobytes(), sample.angles.tobytes(), estimate))
    return found, simulation.steps, simulation.largest_error, simulation.accurate_until


@pytest.mark.parametrize("steps", [24, 29])
@pytest.mark.parametrize("scene, options", CASES, ids=lambda v: v if isinstance(v, str) else "")
def test_the_continuation_of_a_snapshot_is_bit_identical(scene, options, steps):
    """One wrench acts at the snapshot and ends later, one starts later, one started just before."""
    simulation = Simulation(load_scene(scene), quiet=True, **options)
    body, h = simulation.layout.body_names[-1], simulation.step
    simulation.apply_wrench(body, PUSH, 5.3 * h, 40.2 * h, "a")
    simulation.apply_wrench(body, PUSH, (steps - 1.5) * h, None, "b", "world")
    simulation.apply_wrench(body, PUSH, (steps + 7.7) * h, 3.0 * h, "c")
    simulation.advance(steps)
    snapshot = simulation.snapshot()
    expected = trace(simulation)
    simulation.apply_wrench(body, np.multiply(PUSH, 50.0))
    simulation.advance(30)
    for _ in range(2):  # a snapshot can be used again
        simulation.restore(snapshot)
        assert simulation.steps == steps
        assert trace(simulation) == expected


def test_unwrapped_angles_return():
    simulation = Simulation(scene_from_text(SPRING), "rkmk4", 1e-3, quiet=True)
    simulation.advance(500)
    assert abs(simulation.sample().angles[0]) > 2.0 * np.pi
    snapshot = simulation.snapshot()
    expected = trace(simulation)
    simulation.reset()
    simulation.restore(snapshot)
    assert trace(simulation) == expected


@pytest.mark.parametrize("steps", [24, 29, 31])
@pytest.mark.parametrize("scene, options", CASES[:2] + CASES[3:4], ids=lambda v: "")
def test_the_recorded_state_continues_bit_for_bit_at_any_step(scene, options, steps):
    """By JSON, with wrenches that act, wait and end; and by pickle."""
    simulation = Simulation(load_scene(scene), quiet=True, **options)
    body, h = simulation.layout.body_names[-1], simulation.step
    simulation.apply_wrench(body, PUSH, 5.3 * h, 40.2 * h, "a")
    simulation.apply_wrench(body, PUSH, (steps - 1.5) * h, None, "b", "world", (0.1, -0.2, 0.3))
    simulation.apply_wrench(body, PUSH, (steps + 7.7) * h, 3.0 * h, "c")
    simulation.advance(steps)
    entries, state = json.loads(json.dumps(attachments.state(simulation, 0))), simulation.snapshot()
    expected = trace(simulation)
    other = Simulation(load_scene(scene), quiet=True, **options)
    assert attachments.restore(other, entries)
    assert other.snapshot() == state == pickle.loads(pickle.dumps(state)) == copy.deepcopy(state)
    assert trace(other) == expected
    assert other.snapshot() == simulation.snapshot() != state


def test_a_recorded_state_continues_with_another_method_and_step():
    """Its wrenches, targets, and whole turns of joints with stops are those of the state."""
    scene = scene_from_text(SERVO.replace("hinge, type", "hinge, friction: {coulomb: 0.01}, type"))
    simulation = Simulation(scene, quiet=True, method="rkmk4", step=1e-3)
    simulation.advance(500)
    simulation.command_servo("hinge", 20.0, start=0.4)
    simulation.apply_wrench("arm", PUSH, 0.52, 0.3, "c")
    simulation.advance(30)
    entries = json.loads(json.dumps(attachments.state(simulation, 0)))
    other = Simulation(scene, "rkmk8", 5e-4, quiet=True)
    assert not attachments.restore(other, entries | {"steps": 1060}, exactly=False)
    assert other.inputs.commands == simulation.inputs.commands
    mine, theirs = (each.sample() for each in (simulation, other))
    assert mine.joint_coordinates["hinge"][0] > 2.0 * np.pi
    assert mine.joint_coordinates["hinge"] == pytest.approx(theirs.joint_coordinates["hinge"], abs=1e-12)
    assert mine.switching[0] == pytest.approx(theirs.switching[0], abs=1e-12)
    simulation.advance(100)
    other.advance(200)
    assert np.abs(simulation.sample().pose - other.sample().pose).max() < 1e-7


def test_a_command_that_was_cleared_has_ended_for_the_estimate_too():
    """The companion is behind: it ends there, not where the companion is."""
    scene, options = CASES[0]
    first, second = (Simulation(load_scene(scene), quiet=True, **options) for _ in range(2))
    body, h = first.layout.body_names[-1], first.step
    first.apply_wrench(body, PUSH, 5.3 * h, None, "a")
    first.apply_wrench(body, PUSH, 90 * h, None, "a")
    first.advance(30)
    first.clear_wrenches("a")
    second.apply_wrench(body, PUSH, 5.3 * h, 24.7 * h, "a")
    first.advance(80)
    second.advance(110)
    # An end that is known ends a substep, one that is not cuts it: the motions differ by less than the tolerance.
    assert first.sample().pose == pytest.approx(second.sample().pose, abs=1e-10)
    assert first.largest_error < 1e-6 > second.largest_error


@pytest.mark.parametrize(
    "change",
    [
        lambda c: c["acting"][0].__setitem__("axes", "sky"),
        lambda c: c["acting"][0].__setitem__("name", "nobody"),
        lambda c: c["acting"][0]["values"].pop(),
        lambda c: c["acting"][0]["values"].__setitem__(2, "x"),
        lambda c: c["acting"][0].__setitem__("start_ns", None),
        lambda c: c["acting"][0].__setitem__("point", [1, 2]),
        lambda c: c["acting"][0].__setitem__("kind", ["wrench"]),
        lambda c: c["acting"][0].__setitem__("more", 1),
        lambda c: c.pop("waiting"),
        lambda c: c["waiting"].append(3),
    ],
)
@pytest.mark.turn(3)
def test_wrong_commands_in_a_state_are_refused(change):
    """Of the simulation or its companion; the state is then that of the poses alone, or an error."""
    simulation = Simulation(load_scene("four_bar"), quiet=True, accuracy=1e-5, step=1e-3)
    simulation.apply_wrench("rocker", PUSH)
    simulation.advance(24)
    entries = json.loads(json.dumps(attachments.state(simulation, 0)))
    other = Simulation(load_scene("four_bar"), quiet=True, accuracy=1e-5, step=1e-3)
    assert attachments.restore(other, entries)
    ours = json.loads(json.dumps(entries))
    change(ours["state"]["inputs"]["commands"])
    with pytest.raises(ValueError, match="state|nobody"):
        attachments.restore(other, ours)
    change(entries["state"]["running"]["companion"]["inputs"]["commands"])
    assert not attachments.restore(other, entries)


def test_all_method_families_are_covered():
    families = {METHODS[o["method"]].family for _, o in CASES if "method" in o}
    assert families == {method.family for method in METHODS.values()} - {"rotation"}


SERVO = SPRING.replace(
    "forces: [", "forces: [{name: drive, type: servo, joint: hinge, stiffness: 20, damping: 1, effort_limit: 4}, "
)


@pytest.mark.parametrize("options", [{"accuracy": 1e-5, "step": 1e-3}, CASES[2][1]], ids=["a", "m"])
def test_servos_and_efforts_return(options):
    """In a snapshot, and in the recorded state with what acts."""
    simulation = Simulation(scene_from_text(SERVO), quiet=True, **options)
    h = simulation.step
    simulation.command_servo("hinge", 0.7, 0.1, 3.4 * h)
    simulation.apply_effort("hinge", 0.5, 5.3 * h)
    simulation.advance(29)
    snapshot = simulation.snapshot()
    entries = json.loads(json.dumps(attachments.state(simulation, 0)))
    acting, expected = simulation.inputs.commands.acting, trace(simulation)
    assert len(acting) == 2 and acting[0].values == (0.7, 0.1)
    simulation.command_servo("hinge", -2.0)
    simulation.advance(30)
    simulation.restore(snapshot)
    assert trace(simulation) == expected
    other = Simulation(scene_from_text(SERVO), quiet=True, **options)
    assert attachments.restore(other, entries)
    assert trace(other) == expected


def test_only_a_snapshot_of_this_simulation_is_restored():
    """Of another object with the same scene and arguments, too."""

    def made(scene="double_pendulum", method="rkmk4", **options):
        return Simulation(load_scene(scene), method, quiet=True, **{"step": 1e-3} | options)

    simulation = made()
    simulation.advance(30)
    mine, before = simulation.snapshot(), simulation.state()
    for wrong in (None, 3, {}, mine.parts, [mine], simulation.state(), "a"):
        with pytest.raises(ValueError, match="^expected what `snapshot` of this simulation returned"):
            simulation.restore(wrong)
    for other, said in (
        (made("four_bar"), "scene"),
        (made(method="rkmk8"), "method, 'rkmk8' instead of 'rkmk4'"),
        (made(step=2e-3), "step, 0.002 instead of 0.001"),
        (made(group="se3"), "group, 'se3' instead of 'relative'"),
        (made(estimate=False), "estimate, False instead of None"),
        (made(method=None, accuracy=1e-5), "method, None instead of 'rkmk4'"),
    ):
        with pytest.raises(ValueError) as error:
            simulation.restore(other.snapshot())
        assert str(error.value) == f"the snapshot is of a simulation with another {said}"
    assert all(np.array_equal(old, new) for old, new in zip(before, simulation.state()))
    expected, twin = trace(simulation), made()
    twin.restore(mine)
    assert trace(twin) == expected


# A run continued from a saved state is bit-identical, for methods with any memory.


# A wrench starts before the state is saved and continues. Methods that restart when a wrench
# changes must not restart at SAVED.
SAVED, END = 23, 60
# Tolerances tight enough to need substeps; otherwise the substep size would always be the step.
FINE = {"step": 1e-2, "rtol": 1e-12, "atol": 1e-12}
OPTIONS = {name: FINE for name, method in METHODS.items() if method.controlled}


def run(scene, method, steps, start=None):
    """Run from the start, from a State, or from (pose, twist, steps, angles)."""
    simulation = Simulation(load_scene(scene), method, **OPTIONS.get(method, {}))
    body = simulation.layout.body_names[0]
    if isinstance(start, State):
        simulation.restore(start)
    else:
        if start is not None:
            simulation.set_state(*start)
        if METHODS[method].family != "rotation":
            if start is None:
                simulation.advance(11)
            simulation.apply_wrench(body, (0.3, 0.1, 0.0, 0.0, 0.2, 0.0))
    simulation.advance(steps - simulation.steps)
    return simulation


def bits(simulation):
    pose, twist = simulation.state()
    return pose.tobytes(), twist.tobytes()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.volume(10)
def test_a_run_continued_from_a_saved_state_is_bit_identical(method):
    scene = "free_body" if METHODS[method].family == "rotation" else "four_bar"
    saved = run(scene, method, SAVED)
    state = (*saved.state(), SAVED, saved.sample().angles)
    expected = bits(run(scene, method, END))
    kept = saved.snapshot()
    assert bits(run(scene, method, END, pickle.loads(pickle.dumps(kept)))) == expected
    if kept.parts["memory"]:
        without = run(scene, method, END, state)
        entry = METHODS[method]
        if saved.group == "relative" and entry.family == "rkmk" and not entry.controlled:
            # Relative coordinates are found again from the poses, to their round-off.
            for mine, exact in zip(without.state(), run(scene, method, END).state()):
                assert np.abs(mine - exact).max() <= 1e-13 * np.abs(exact).max()
        else:
            assert bits(without) != expected


def test_the_jacobian_of_an_implicit_method_is_in_a_state_only_where_it_is_used_again():
    """Its columns that are not zero, or all of them as in earlier versions; at the end of a step there is none."""
    turns = np.exp(0.125j * np.pi * np.arange(16))
    at = [[0.1 * z.real.item(), 0.1 * z.imag.item(), -0.02] for z in turns]
    scene = scene_from_text(PLATE.replace("POINTS", str(at)))
    one, other = (Simulation(scene, accuracy=1e-3, horizon=1.0, step=0.5, quiet=True) for _ in range(2))
    stored = {}
    for time in (0.5, 0.6):
        one.advance_to(time)
        assert one.method == "radau5"
        stored[time] = [part for part in one.snapshot().parts["memory"] if isinstance(part, StoredMatrix)]
    assert [len(part.at) for part in stored[0.5]] == [0, 0]
    f = stored[0.6][0].size
    assert f == 6 + 1 + 2 * 16 and 0 < len(stored[0.6][0].at) <= 5
    snapshot, entries = one.snapshot(), json.loads(json.dumps(attachments.state(one, 0)))
    before, whole = copy.deepcopy(entries), np.zeros((f, f))
    for parts in (before["state"], before["state"]["running"]["companion"]):
        for k, part in enumerate(parts["memory"]):
            if isinstance(part, list):
                columns = StoredMatrix(f).from_json(part, "")
                whole[:], whole[:, columns.at] = 0.0, columns.values
                parts["memory"][k] = encoded(whole)
    one.advance_to(1.3)
    for each in (entries, before):
        assert attachments.restore(other, each)
        assert other.snapshot() == snapshot
        other.advance_to(1.3)
        assert other.snapshot() == one.snapshot()
