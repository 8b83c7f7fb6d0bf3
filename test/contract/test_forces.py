# SPDX-License-Identifier: Apache-2.0
"""Properties of every type of force. A new one only needs examples in EXAMPLES."""

from types import SimpleNamespace

import mechanisms
import numpy as np
import pytest
import yaml
from naive import displaced
from scene_files import text_of

from liegroup_core import Simulation
from liegroup_core.forces import external, gravity, kinds, law
from liegroup_core.forces.applied_wrench import wrenches_of
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.groups import SE3
from liegroup_core.mechanism.body_model import build_model
from liegroup_core.scene import ConstantWrench, Frame
from liegroup_core.scene.description import FORCES
from liegroup_core.sensors.distance import DistanceSensor
from liegroup_core.sensors.encoder import Encoder
from liegroup_core.sensors.imu import Imu
from liegroup_core.sensors.pose import Pose

BODIES = ("a", "b", "c")
INDEX = {"a": 0, "b": 1, "c": 2, "world": WORLD}
ON_JOINTS = {"between": ("a", "b"), "ground": ("world", "c")}

# Of each type one force between bodies, if possible, and one to the world.
EXAMPLES = yaml.safe_load(text_of("forces_of_three_bodies.yaml"))
CLASSES = {cls.model_fields["type"].default: cls for cls in FORCES}
EXAMPLES = {kind: [CLASSES[kind](**entry) for entry in entries] for kind, entries in EXAMPLES.items()}
IN_ROWS = [kind for kind in EXAMPLES if kind != "applied_wrench"]
DRIVEN = ("motor", "linear_motor", "servo", "linear_servo", "law", "contact")  # their power may be positive
ELASTIC = [kind for kind in EXAMPLES if kind.endswith("spring_damper")]
SEEDS = range(4)


class State:
    """Random state of three free bodies with forces of one kind.

    The joints are frames only. The poses violate them, with tilts up to 0.4 rad, so that the
    properties also hold for joints with drift.
    """

    def __init__(self, kind, seed, described=None, sensors=()):
        rng = np.random.default_rng([seed, 5])
        pose = np.array([mechanisms.random_pose(rng) for _ in BODIES])
        ends = {}
        for name, (parent, child) in ON_JOINTS.items():
            F_a, F_b = mechanisms.random_pose(rng), mechanisms.random_pose(rng)
            moved = SE3.exp([*rng.uniform(-0.3, 0.3, 2), rng.normal(), *rng.normal(size=3)])
            C_a = np.eye(4) if parent == "world" else pose[INDEX[parent]]
            pose[INDEX[child]] = C_a @ F_a @ moved @ np.linalg.inv(F_b)
            ends[name] = (INDEX[parent], INDEX[child], F_a, F_b)
        self.matrices = pose
        self.twist = rng.normal(size=(3, 6))
        described = EXAMPLES[kind] if described is None else described
        for each in described:
            if kind == "contact":
                body = SimpleNamespace(mass=1.0, shape=None, position=(0.0, 0.0, 0.0), rotation=np.eye(3))
                each.complete(dict.fromkeys(BODIES, body), (0.0, 0.0, -9.81))
        counted = kinds.unwrapped(described, turning=ON_JOINTS, sensors=sensors)
        self.forces = kinds.make_forces(described, INDEX, ends, counted, sensors=sensors)
        self.angle = np.full(kinds.count(self.forces), 0.2)  # states of laws
        self.angle[: len(self.forces.counted)] = 20.0  # three turns
        kinds.count_turns(self.forces, flat(pose), self.angle)
        self.targets, self.registers = (
            kinds.target_values(self.forces),
            kinds.registers_at(self.forces, 2.0, self.angle),
        )

    def wrench(self, twist):
        out = np.zeros((3, 6))
        kinds.add_wrenches(self.forces, self.angle, self.targets, self.registers, flat(self.matrices), twist, out)
        return out

    def energy(self, motion=np.zeros((3, 6))):
        """Energy after a motion of all bodies along the given body twists."""
        moved = [displaced(matrix, twist) for matrix, twist in zip(self.matrices, motion)]
        return kinds.energy(self.forces, self.angle, flat(moved))

    def power(self, twist):
        pose = flat(self.matrices)
        law.measure(self.forces.laws, self.angle, pose, twist, self.registers)
        return kinds.power(self.forces, self.angle, self.targets, self.registers, pose, twist)


def flat(matrices):
    """Poses (n, 12) of matrices (n, 4, 4)."""
    matrices = np.array(matrices)
    return np.concatenate([matrices[:, :3, :3].reshape(-1, 9), matrices[:, :3, 3]], axis=1)


def test_every_type_has_examples():
    assert {*EXAMPLES} == {*CLASSES} and {cls.__name__ for cls in FORCES} == {*kinds.__all__}


@pytest.mark.parametrize("kind", [kind for kind in IN_ROWS if kind != "drag"])
@pytest.mark.parametrize("seed", SEEDS)
def test_forces_between_bodies_cancel(kind, seed):
    """Force and torque about any point sum to zero in world axes.

    A few dozen roundings of terms as large as force times arm, below 1e3 here: 100 * 1e3 * eps.
    """
    state = State(kind, seed, EXAMPLES[kind][:1])
    about = np.random.default_rng(seed).normal(size=3)
    total, size = np.zeros(6), 0.0
    for matrix, wrench in zip(state.matrices, state.wrench(state.twist)):
        torque, force = matrix[:3, :3] @ wrench[:3], matrix[:3, :3] @ wrench[3:]
        total += np.concatenate([torque + np.cross(matrix[:3, 3] - about, force), force])
        size = max(size, np.abs(wrench).max())
    assert size > 0.1
    assert np.abs(total).max() <= 100 * 1e3 * 2.2e-16


@pytest.mark.parametrize("kind", ELASTIC)
@pytest.mark.parametrize("seed", SEEDS)
def test_the_wrench_at_rest_is_minus_the_gradient_of_the_energy(kind, seed):
    """Five-point differences of step 1e-3 leave 1e-12 of the fifth derivative, and eps / 1e-3 of
    the energy, both below 1e3: 1e-9.
    """
    state = State(kind, seed)
    wrench = state.wrench(np.zeros((3, 6)))
    assert np.abs(wrench).max() > 0.1
    for body in range(3):
        for c in range(6):
            motion = np.zeros((3, 6))
            motion[body, c] = 1e-3
            assert wrench[body, c] == pytest.approx(-difference(state, motion) / 1e-3, abs=1e-8)


def difference(state, motion):
    """Change of the energy along a small motion, five-point rule."""
    return (
        state.energy(-2 * motion) - 8 * state.energy(-motion) + 8 * state.energy(motion) - state.energy(2 * motion)
    ) / 12


@pytest.mark.parametrize("kind", IN_ROWS)
@pytest.mark.parametrize("seed", SEEDS)
def test_the_change_of_the_wrench_is_its_derivative(kind, seed):
    """Along random displacements of all bodies, and changes of twists and targets, also of joints that drift.

    Five-point differences of step 1e-3 leave 1e-12 of the fifth derivative, and eps / 1e-3 of the wrench: 1e-9 of it.
    """
    check_changes(State(kind, seed), seed, kind in ("servo", "linear_servo"))  # at their limits


# Servos, of which laws give one target or both, also by what they read elsewhere.
LED = [
    *EXAMPLES["servo"],
    CLASSES["law"](
        name="lead",
        inputs={"q": "ground.position", "w": "between.velocity", "x": "a.x"},
        outputs=[
            {"servo": "s", "position": "0.3*sin(q) + 0.1*w*x", "velocity": "w*q"},
            {"servo": "t", "position": "-0.2 + 0.01*x"},
        ],
    ),
]


@pytest.mark.parametrize("seed", SEEDS)
def test_the_change_of_a_servo_that_a_law_leads_is_its_derivative(seed):
    """As above; the work of the servo is its power."""
    state = State("servo", seed, LED)
    check_changes(state, seed)
    assert np.sum(state.wrench(state.twist) * state.twist) == pytest.approx(state.power(state.twist), rel=1e-10)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_change_of_a_law_that_reads_sensors_is_its_derivative(seed):
    """All numbers that follow from positions and velocities, of sensors in frames of their own."""
    frame = Frame(position=(0.3, -0.2, 0.1), rotation_vector=(0.4, 1.1, -0.7))
    sensors = [
        Pose(name="tracker", body="a", frame=frame),
        Imu(name="imu", body="b", frame=frame, angular_velocity_bias=(0.1, 0.2, 0.3)),
        DistanceSensor(name="wire", parent="a", child="c", parent_point=(0.1, 0.2, 0.3), child_point=(1, 0, 0.5)),
        DistanceSensor(name="laser", parent="world", child="b", parent_point=(3, 0, 0)),
        Encoder(name="coder", joint="between"),
    ]
    counts = {"tracker": 13, "imu": 7, "wire": 2, "laser": 2, "coder": 1}
    inputs = {f"{name}{k}": f"{name}.{k}" for name, count in counts.items() for k in range(count)}
    sums = [
        " + ".join(f"sin({0.1 + 0.05 * k + 0.1 * j:.2f}*{name})" for k, name in enumerate(inputs)) for j in range(6)
    ]
    law = CLASSES["law"](name="own", inputs=inputs, outputs=[{"body": "a", "torque": sums[:3], "force": sums[3:]}])
    check_changes(State("law", seed, [law], sensors), seed)


def check_changes(state, seed, rests=False):
    """Compare changes of the wrenches with differences; rests : whether they may be zero."""
    rng = np.random.default_rng([seed, 9])
    moves, rates, shifts = rng.normal(size=(3, 6)), rng.normal(size=(3, 6)), rng.normal(size=state.targets.shape)
    found, sums, at = np.zeros((3, 6)), np.zeros((3, 6)), np.zeros((1, 2))  # an offset of one row
    given = state.forces, state.angle, state.targets, state.registers, flat(state.matrices), state.twist
    kinds.add_changes(*given, moves, rates, np.concatenate([at, shifts]), 1, found)
    for step, weight in ((-2, 1.0), (-1, -8.0), (1, 8.0), (2, -1.0)):
        s, out = 1e-3 * step, np.zeros((3, 6))
        moved = flat([displaced(matrix, s * twist) for matrix, twist in zip(state.matrices, moves)])
        targets, twist = state.targets + s * shifts, state.twist + s * rates
        kinds.add_wrenches(state.forces, state.angle, targets, state.registers, moved, twist, out)
        sums += weight * out / 12e-3
    size = max(1.0, np.abs(sums).max(), np.abs(state.wrench(state.twist)).max())
    assert np.abs(found - sums).max() <= 1e-8 * size
    assert np.abs(found).max() > 0.1 or rests


def test_external_wrenches_change_with_the_attitude():
    """Parts in body and in world axes, a force at a point, and a pull; differences as above."""
    rng = np.random.default_rng(8)
    pose, moves, more = mechanisms.random_pose(rng), rng.normal(size=(1, 6)), rng.normal(size=(1, external.COLUMNS))
    given, found, sums = rng.normal(size=(1, external.COLUMNS)), np.zeros((1, 6)), np.zeros((1, 6))
    given[0, 15] = 2.0
    twist, rates = rng.normal(size=(1, 6)), rng.normal(size=(1, 6))
    external.set_changes(given, more, 0, flat([pose]), twist, moves, rates, found)
    for step, weight in ((-2, 1.0), (-1, -8.0), (1, 8.0), (2, -1.0)):
        s, out, pushed = 1e-3 * step, np.zeros((1, 6)), given.copy()
        pushed[:, :6] += s * more[:, :6]
        external.set_external_wrenches(pushed, flat([displaced(pose, s * moves[0])]), twist + s * rates, out)
        sums += weight * out / 12e-3
    assert np.abs(found - sums).max() <= 1e-9 * np.abs(sums).max()


def test_gravity_is_minus_the_gradient_of_its_energy():
    rng = np.random.default_rng(3)
    model, *_ = build_model(mechanisms.named("tree"))
    matrices = np.array([mechanisms.random_pose(rng) for _ in model.bodies])
    wrench = np.zeros((len(matrices), 6))
    gravity.add_wrench(model, flat(matrices), wrench)
    for body in range(len(matrices)):
        for c in range(6):
            ends = []
            for sign in (1.0, -1.0):
                moved = matrices.copy()
                moved[body] = displaced(matrices[body], sign * 1e-4 * np.eye(6)[c])
                ends.append(gravity.energy(model, flat(moved)))
            # the energy is linear in the position: only round-off, eps / 1e-4 of it, remains
            assert wrench[body, c] == pytest.approx((ends[1] - ends[0]) / 2e-4, abs=1e-9)


@pytest.mark.parametrize("kind", IN_ROWS)
@pytest.mark.parametrize("seed", SEEDS)
def test_work_is_energy_taken_plus_power(kind, seed):
    """wrench . twist = -dE/dt + power, at any state; the accuracy is that of the gradient."""
    state = State(kind, seed)
    work = np.sum(state.wrench(state.twist) * state.twist)
    rate = difference(state, 1e-3 * state.twist) / 1e-3 if kind in ELASTIC else 0.0
    assert state.energy() == 0.0 or kind in ELASTIC
    assert abs(work) > 1e-3
    assert work == pytest.approx(state.power(state.twist) - rate, rel=1e-10, abs=1e-8)


@pytest.mark.parametrize("kind", IN_ROWS)
def test_what_is_conservative_has_no_power(kind):
    for force in EXAMPLES[kind]:
        states = [State(kind, seed, [force]) for seed in SEEDS]
        powers = [state.power(state.twist) for state in states]
        assert force.is_conservative == (not any(powers)), force


@pytest.mark.parametrize("kind", [kind for kind in IN_ROWS if kind not in DRIVEN])
def test_what_dissipates_never_gives_power(kind):
    powers = [State(kind, seed).power(State(kind, seed).twist) for seed in range(20)]
    assert max(powers) < 0.0
    assert State(kind, 0).power(np.zeros((3, 6))) == 0.0


def test_without_rows_nothing_happens():
    state = State("drag", 0, described=[])
    wrench = np.random.default_rng(0).normal(size=(3, 6))
    before = wrench.tobytes()
    state.wrench(state.twist)
    pose = flat(state.matrices)
    kinds.add_wrenches(state.forces, state.angle, state.targets, state.registers, pose, state.twist, wrench)
    assert wrench.tobytes() == before
    assert state.energy() == 0.0 and state.power(state.twist) == 0.0
    assert kinds.too_fast(state.forces, 1e9, flat(state.matrices), state.twist) == -1


def test_a_wrench_acts_where_it_is_told_to():
    state, both = State("drag", 0), EXAMPLES["applied_wrench"]
    for acting in ([True, False], [False, True], [False, False]):
        wrench = of_scene([force for force, acts in zip(both, acting) if acts], state)
        assert wrench.any(axis=1).tolist() == [*acting, False]


def of_scene(forces, state):
    """(3, 6) wrenches in body axes of ConstantWrenches, about the origins of the body frames."""
    wrench, offsets = np.zeros((3, 6)), SimpleNamespace(com=np.zeros((3, 3)))
    still = np.zeros((3, 6))
    external.set_external_wrenches(wrenches_of(forces, INDEX, offsets), flat(state.matrices), still, wrench)
    return wrench


@pytest.mark.parametrize("seed", SEEDS)
def test_a_wrench_in_body_axes_is_that_in_world_axes_turned(seed):
    both = [
        ConstantWrench(name=axes, body="a", torque=(1, 2, 3), force=(4, 5, -6), axes=axes) for axes in ("world", "body")
    ]
    state = State("drag", seed)
    in_world = of_scene(both[:1], state)[0].reshape(2, 3)
    np.testing.assert_allclose(
        in_world @ state.matrices[0][:3, :3].T, [[1, 2, 3], [4, 5, -6]], atol=1e-14
    )  # a few roundings of numbers below 9


# ---------------------------------------------------------------- along a motion


@pytest.mark.slow
@pytest.mark.parametrize("group", ["se3", "so3xr3"])
def test_energy_changes_by_the_power(group):
    """E(T) - E(0) = integral of the power; step and Simpson's rule are both of order 4."""
    gaps = []
    for steps in (500, 1000):
        simulation = Simulation(mechanisms.under_many_forces(), method="rkmk4", step=1.0 / steps, group=group)
        samples = [simulation.sample()]
        for _ in range(steps):
            simulation.advance()
            samples.append(simulation.sample())
        power = np.array([sample.power for sample in samples])
        integral = (power[0] + power[-1] + 4 * power[1::2].sum() + 2 * power[2:-1:2].sum()) / (3 * steps)
        gaps.append(abs(samples[-1].energy - samples[0].energy - integral))
    assert np.abs(power).mean() > 1.0
    assert gaps[1] < gaps[0] / 12 and gaps[1] < 1e-5 * np.abs(power).mean()
