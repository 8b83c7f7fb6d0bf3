# SPDX-License-Identifier: Apache-2.0
"""Trim of large and closed mechanisms: the virtual work of all forces vanishes, computed from body poses alone."""

import os

import numpy as np
import pytest
import scipy
from scene_files import cases, filled, text_of
from slider_crank import FRICTION, kinematics, slider_crank

from liegroup_core import Simulation
from liegroup_core.linear import TrimError, trim
from liegroup_core.scene.consistency import resolve_frames
from liegroup_core.scene.load import load_scene, scene_from_text

ROBOTS = os.path.join(os.path.dirname(__file__), "..", "..", "docs", "robots")
# Components of a relative displacement (rotation, translation) in the parent's joint frame that a joint prevents.
PREVENTED = {
    "fixed": range(6),
    "revolute": (0, 1, 3, 4, 5),
    "prismatic": range(5),
    "spherical": (3, 4, 5),
    "universal": (3, 4, 5),
}


def paused(scene):
    return Simulation(scene, "rkmk4", 1e-3, estimate=False, quiet=True)


class Statics:
    """Virtual work at poses (n, 12) of the bodies of a scene: displacements are rotations and those of the origins."""

    def __init__(self, scene, frames, pose):
        self._numbers = {body.name: i for i, body in enumerate(scene.bodies)}
        self._turns, self._places = pose[:, :9].reshape(-1, 3, 3), pose[:, 9:]
        self.joints, rows = {}, []
        for joint, (F_a, F_b) in zip(scene.joints, frames):
            R, p = self._placed(joint.parent, F_a)
            turn, q = self._placed(joint.child, F_b)
            # Displacement of the child's joint frame against the parent's, in the axes of the parent's.
            moves = self._moves(joint.child, q) - self._moves(joint.parent, q)
            moves = np.vstack([R.T @ moves[:3], R.T @ moves[3:]])
            rows.append(moves[list(PREVENTED[joint.type])])
            if joint.type == "universal":
                rows.append((np.cross(R[:, 0], turn[:, 1]) @ R @ moves[:3])[None])
            self.joints[joint.name] = moves[5 if joint.type == "prismatic" else 2], float(R[:, 2] @ (q - p))
        self._free = scipy.linalg.null_space(np.vstack(rows), rcond=1e-9)
        self._weights = np.zeros(6 * len(scene.bodies))
        for body in scene.bodies:
            R, p = self._placed(body.name, np.eye(4))
            com = p + R @ np.array(body.com)
            self._weights += body.mass * np.array(scene.gravity) @ self._moves(body.name, com)[3:]

    def _placed(self, body, frame):
        if body == "world":
            return frame[:3, :3], frame[:3, 3]
        i = self._numbers[body]
        return self._turns[i] @ frame[:3, :3], self._places[i] + self._turns[i] @ frame[:3, 3]

    def _moves(self, body, point):
        """(6, 6 n): rotation of a body and displacement of its point, of the displacements of all bodies."""
        found = np.zeros((6, 6 * len(self._numbers)))
        if body != "world":
            i = self._numbers[body]
            x, y, z = point - self._places[i]
            found[:, 6 * i : 6 * i + 6] = np.eye(6)
            found[3:, 6 * i : 6 * i + 3] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
        return found

    @property
    def freedoms(self):
        return self._free.shape[1]

    def work(self, efforts):
        """(freedoms,) virtual work of weights and of {joint: effort}."""
        forces = self._weights + sum(effort * self.joints[joint][0] for joint, effort in efforts.items())
        return forces @ self._free

    def efforts(self, joints):
        """Those of the smallest sum of squares that balance the weights."""
        columns = np.array([self.joints[joint][0] for joint in joints]) @ self._free
        return np.linalg.lstsq(columns.T, -self.work({}), rcond=1e-10)[0]


def statics_of(simulation, result):
    frames = resolve_frames(simulation.scene)
    return Statics(simulation.scene, frames, result.pose)


def held(scene, joints):
    """(Trim that holds joints by efforts, its Statics)."""
    simulation = paused(scene)
    result = trim(simulation, held=joints, inputs=[f"{joint}.effort" for joint in joints])
    return result, statics_of(simulation, result)


# Bodies from the right foot on: parent, origin at the hinge, axis of the hinge, mass, centre of mass.
HUMANOID = cases("humanoid")
ON_BOTH = (
    "  - {name: left_sole, type: spherical, parent: world, child: left_shank, child_frame: {position: [0, 0, -0.4]}}\n"
)


def humanoid(more=""):
    """Scene of 14 bodies and 13 hinges, with more lines; the right foot is fixed to the world."""
    text, joints = "name: humanoid\ngravity: [0, 0, -9.81]\nbodies:\n", "joints:\n"
    for name, (parent, place, axis, mass, com) in HUMANOID.items():
        inertia = [0.02 * mass, 0.03 * mass, 0.02 * mass]
        text += f"  - {{name: {name}, mass: {mass}, inertia: {inertia}, com: {com}, position: {place}}}\n"
        kind, frame = ("fixed", "{}") if axis is None else ("revolute", f"{{axis: {axis}}}")
        joints += f"  - {{name: {name}, type: {kind}, parent: {parent}, child: {name}, child_frame: {frame}}}\n"
    return scene_from_text(text + joints + more, source="test")


def hinges(scene):
    return [joint.name for joint in scene.joints if joint.type == "revolute"]


LEGS = [f"leg{k}" for k in range(6)]
# Relative to the largest effort: round-off of the accelerations, times the condition of the mechanism.
DIGITS = 1e-10


@pytest.mark.parametrize(
    "scene, joints, freedoms",
    [
        (lambda: load_scene(os.path.join(ROBOTS, "stewart.sdf")), LEGS, 6),
        (lambda: load_scene(os.path.join(ROBOTS, "five_bar.yaml")).remade(forces=[]), ["left", "right"], 2),
        (humanoid, None, 13),
        (lambda: humanoid(ON_BOTH), None, 10),
    ],
    ids=["stewart", "five bar", "on one foot", "on both feet"],
)
@pytest.mark.turn(3)
def test_efforts_hold_a_pose(scene, joints, freedoms):
    """Those of the smallest sum of squares where there are more than needed: on both feet."""
    scene = scene()
    joints = joints or hinges(scene)
    result, statics = held(scene, joints)
    expected = statics.efforts(joints)
    assert statics.freedoms == freedoms and np.abs(statics.work({})).max() > 1.0
    found = np.array([result.inputs[f"{joint}.effort"] for joint in joints])
    assert np.abs(found - expected).max() < DIGITS * np.abs(expected).max()
    assert bool(result.undetermined) is (freedoms < len(joints))


@pytest.mark.parametrize("file", ["five_bar.yaml", "scissor_lift.yaml", "stewart.sdf"])
@pytest.mark.volume(1)
def test_a_held_coordinate_of_a_loop_keeps_its_value(file):
    """Its own effort holds it while all others move to an equilibrium, in the five bar by more than 2 rad.

    1e-9 rad or m: the joints are closed to 1e-13 in each of at most 100 steps.
    """
    scene = load_scene(os.path.join(ROBOTS, file))
    simulation = paused(scene.remade(forces=[force for force in scene.forces if force.type != "motor"]))
    start = {joint: values[0] for joint, values in simulation.sample().joint_coordinates.items()}
    for joint in [freedom.name for freedom in simulation.layout.freedoms if freedom.is_of_joint]:
        result = trim(simulation, held=[joint], inputs=[f"{joint}.effort"])
        assert abs(result.joints[joint] - start[joint]) < 1e-9 and joint not in result.loose
        if file == "five_bar.yaml":  # the others have springs
            efforts = {joint: result.inputs[f"{joint}.effort"]}
            assert np.abs(statics_of(simulation, result).work(efforts)).max() < 1e-9 * 20.0


@pytest.mark.parametrize("hold", [[], ["left"], ["right_elbow"], ["left", "right"]])
def test_of_a_family_of_equilibria_the_nearest_one_is_taken(hold):
    """Two motors hold a five bar anywhere: it stays at its start, with the efforts of that pose."""
    scene = load_scene(os.path.join(ROBOTS, "five_bar.yaml")).remade(forces=[])
    simulation = paused(scene)
    result = trim(simulation, held=hold, inputs=["left.effort", "right.effort"])
    start = simulation.sample().joint_coordinates
    assert all(abs(result.joints[joint] - start[joint][0]) < 1e-12 for joint in start)
    expected = statics_of(simulation, result).efforts(["left", "right"])
    assert list(result.inputs.values()) == pytest.approx(expected, abs=1e-10)
    assert set(result.loose) == (set() if len(hold) == 2 else set(start) - set(hold))


def test_a_stewart_platform_rests_on_its_springs():
    """400 N/m in each leg; the platform sinks by a few cm and tilts."""
    simulation = paused(load_scene(os.path.join(ROBOTS, "stewart.sdf")))
    result = trim(simulation)
    statics = statics_of(simulation, result)
    start = Statics(simulation.scene, resolve_frames(simulation.scene), simulation.sample().pose)
    springs = {leg: -400.0 * (statics.joints[leg][1] - start.joints[leg][1]) for leg in LEGS}
    assert np.abs(statics.work(springs)).max() < 1e-9 * np.abs(start.work({})).max()
    assert max(map(abs, springs.values())) > 5.0 and result.is_stable


@pytest.mark.parametrize("forces", [0.0, 1.0, -2.0])
def test_a_five_bar_finds_its_equilibrium(forces):
    """Hanging, or turned by a motor."""
    scene = load_scene(os.path.join(ROBOTS, "five_bar.yaml"))
    motors = [force.remade(torque=forces) for force in scene.forces if force.type == "motor"]
    simulation = paused(scene.remade(forces=[*motors]))
    result = trim(simulation)
    statics = statics_of(simulation, result)
    assert np.abs(statics.work({"left": forces})).max() < 1e-9 * 20.0
    assert result.is_stable is not False


def test_a_humanoid_stands_on_springs():
    """Springs in all hinges: the equilibrium is 0.9 rad from the start."""
    springs = "forces:\n" + "".join(
        f"  - {{name: s_{name}, type: torsional_spring_damper, joint: {name}, stiffness: 150.0, damping: 1.0}}\n"
        for name in HUMANOID
        if name != "foot"
    )
    simulation = paused(humanoid(springs))
    result = trim(simulation)
    statics = statics_of(simulation, result)
    efforts = {joint: -150.0 * result.joints[joint] for joint in hinges(simulation.scene)}
    assert np.abs(statics.work(efforts)).max() < 1e-8 * max(map(abs, efforts.values()))
    assert max(map(abs, result.joints.values())) > 0.5


def pendulum(angle, friction):
    """A rod of 1 kg that hangs 0.5 m below its pin, turned by an angle."""
    at, joint = f"{-0.5 * np.sin(angle)}, 0, {-0.5 * np.cos(angle)}", f" friction: {{{friction}}},"
    text = filled(text_of("pendulum_on_a_spring.yaml"), at=at, angle=angle, joint=joint, stiffness=0)
    return scene_from_text(text, source="test")


@pytest.mark.parametrize(
    "friction, most",
    [
        ("coulomb: 0.7", 0.7),
        ("coulomb: 0.7, static: 0.9", 0.9),
        ("mu: 0.2, mu_static: 0.3, radius: 0.05, coulomb: 0.1", 0.1 + 0.3 * 0.05 * 9.81),
    ],
)
@pytest.mark.parametrize("angle", [0.05, 1.0])
def test_friction_leaves_an_interval_of_efforts(angle, friction, most):
    """m g l sin(q) -+ friction; at the smaller angle it sticks at the start, at the larger one it does not."""
    simulation = paused(pendulum(angle, friction))
    result = trim(simulation, held=["pin"], inputs=["pin.effort"])
    effort = 9.81 * 0.5 * np.sin(angle)
    assert result.inputs["pin.effort"] == pytest.approx(effort, abs=1e-12)
    assert result.intervals["pin.effort"] == pytest.approx((effort - most, effort + most), abs=1e-12)
    alone = trim(simulation)
    assert 9.81 * 0.5 * abs(np.sin(alone.joints["pin"])) <= most * (1.0 + 1e-9) and not alone.intervals


@pytest.mark.parametrize("angle", [0.7, 2.2, -1.1])
def test_friction_in_a_loop_adds_up_by_the_rates_of_its_joints(angle):
    """A slider-crank: interval of the crank's effort +- sum of friction times rate by the crank's rate, in closed form.

    Of two inputs each has the interval with the other one as found.
    """
    simulation = paused(slider_crank(angle, 0.0, FRICTION))
    _, _, _, rates = kinematics(angle)
    slope = kinematics(complex(angle, 1e-30))[1].imag * 1e30
    rates = dict(zip(FRICTION, np.real(rates)))
    most = sum(friction * abs(rates[joint]) for joint, friction in FRICTION.items())
    result = trim(simulation, held=["main"], inputs=["main.effort"])
    assert result.inputs["main.effort"] == pytest.approx(slope, abs=1e-10)
    assert result.intervals["main.effort"] == pytest.approx((slope - most, slope + most), abs=1e-10)
    both = trim(simulation, held=["main"], inputs=["main.effort", "slide.effort"])
    levers = {"main.effort": 1.0, "slide.effort": rates["slide"]}
    total = sum(lever**2 for lever in levers.values())
    for name, lever in levers.items():
        effort = slope * lever / total
        assert both.inputs[name] == pytest.approx(effort, abs=1e-10)
        ends = effort - most / abs(lever), effort + most / abs(lever)
        assert both.intervals[name] == pytest.approx(ends, abs=1e-9)


@pytest.mark.parametrize("rubs", [*FRICTION, None])
def test_friction_in_any_joint_of_a_loop_holds_the_pose(rubs):
    """Whichever coordinate keeps its position: nothing moves, and without friction the pose is unstable."""
    simulation = paused(slider_crank(2.2, 0.0, {rubs: FRICTION[rubs]} if rubs else {}))
    for freedom in simulation.layout.freedoms:
        result = trim(simulation, held=[freedom.name], inputs=["main.effort"])
        assert result.system.coordinates == (0 if rubs else 1) and result.is_stable is bool(rubs)


def test_a_joint_without_a_motor_rests_by_its_friction():
    """On one foot, without the motors of the arms: their friction holds them, or does not."""

    def with_friction(coulomb):
        scene = humanoid()
        arms = ("right_arm", "right_hand", "left_arm", "left_hand")
        return scene.remade(
            joints=[j.remade(friction={"coulomb": coulomb}) if j.name in (*arms, "hip") else j for j in scene.joints]
        ), arms

    scene, arms = with_friction(6.0)
    motors = [joint for joint in hinges(scene) if joint not in arms]
    simulation = paused(scene)
    result = trim(simulation, held=hinges(scene), inputs=[f"{joint}.effort" for joint in motors])
    expected = dict(zip(hinges(scene), statics_of(simulation, result).efforts(hinges(scene))))
    for joint in motors:
        most = 6.0 if joint == "hip" else 0.0
        ends = expected[joint] - most, expected[joint] + most
        assert result.inputs[f"{joint}.effort"] == pytest.approx(expected[joint], abs=1e-9)
        assert result.intervals[f"{joint}.effort"] == pytest.approx(ends, abs=1e-9)
    scene, _ = with_friction(5.0)  # one arm needs 5.4 N m
    with pytest.raises(TrimError):
        trim(paused(scene), held=hinges(scene), inputs=[f"{joint}.effort" for joint in motors])


def test_friction_holds_what_it_does_not_hold_without_the_inputs():
    """A rod hangs from a horizontal one: its joint slides if this falls, and needs no effort if a motor holds it."""
    text = text_of("double_trim.yaml")
    simulation = paused(scene_from_text(text, source="test"))
    assert simulation.sample().modes == {"elbow": "free"}
    result = trim(simulation, held=["shoulder", "elbow"], inputs=["shoulder.effort"])
    effort = -9.81 * (2.0 * 0.4 + 1.5 * 0.8)
    assert result.inputs["shoulder.effort"] == pytest.approx(effort, rel=1e-12)
    assert result.intervals["shoulder.effort"] == pytest.approx((effort, effort), rel=1e-12)
    assert result.system.states == ("shoulder", "shoulder.rate")


def test_a_stop_holds_in_one_direction():
    """A horizontal rod on its stop rests until an effort lifts its weight."""
    text = filled(text_of("rod_on_stop.yaml"), upper=0)
    result = trim(paused(scene_from_text(text, source="test")), inputs=["hinge.effort"])
    assert result.inputs["hinge.effort"] == pytest.approx(0.0, abs=1e-12)
    least, most = result.intervals["hinge.effort"]
    assert least == pytest.approx(-1.5 * 9.81 * 0.6, rel=1e-12) and most == np.inf


@pytest.mark.parametrize("gap", [0.0, 0.02])
def test_a_spring_between_slides_is_pressed_in_equilibrium(gap):
    """2 kg on a coupling of 300 N/m, which starts pressed, over 1 kg on a spring of 100 N/m: 3 g / 100, 2 g / 300."""
    text = filled(text_of("pressed_trim.yaml"), gap=gap)
    q = trim(paused(scene_from_text(text))).joints
    assert q["ja"] == pytest.approx(-0.03 * 9.81, rel=1e-9)
    assert q["jb"] - q["ja"] == pytest.approx(-2.0 * 9.81 / 300.0 - 0.5 * gap, rel=1e-9)


def test_stops_and_friction_hold_together():
    """Of two rods on their hinges one rests on its stop, the other one by friction that no motor replaces."""
    rods = [
        f"  - {{name: b{k}, mass: 1.5, inertia: [0.1, 0.2, 0.1], position: [0.6, {k}, 0], com: [{com}, 0, 0]}}\n"
        for k, com in enumerate((0.0, -0.5))
    ]
    text = "name: rods\ngravity: [0, 0, -9.81]\nbodies:\n" + "".join(rods) + "joints:\n"
    for k, key in enumerate(("limits: {upper: 0}", "friction: {coulomb: 2.0}")):
        frame = f"{{position: [0, {k}, 0], axis: [0, 1, 0]}}"
        text += f"  - {{name: j{k}, type: revolute, parent: world, child: b{k}, parent_frame: {frame}, {key}}}\n"
    result = trim(paused(scene_from_text(text, source="test")), inputs=["j0.effort"])
    assert result.inputs["j0.effort"] == pytest.approx(0.0, abs=1e-12)
    assert result.intervals["j0.effort"] == pytest.approx((-1.5 * 9.81 * 0.6, np.inf), rel=1e-12)
    assert result.residual < 1e-12


@pytest.mark.parametrize("rate", [5.0, -5.0])
@pytest.mark.parametrize("start", [0.0, 5.0])
def test_friction_opposes_given_rates(start, rate):
    """A rotor, at rest or not: its motor supplies the sliding and the viscous friction."""
    text = filled(text_of("rotor_trim.yaml"), start=start)
    result = trim(paused(scene_from_text(text, source="test")), {"shaft": rate}, inputs=["shaft.effort"])
    assert result.inputs["shaft.effort"] == pytest.approx(0.3 * np.sign(rate) + 0.1 * rate, rel=1e-12)
    assert result.is_steady and not result.intervals


def test_targets_are_those_to_command():
    """A rod of 2 kg with its centre at 0.5 m rests level where k (target - 0) carries it, whatever the target was."""
    text = text_of("servo_trim.yaml")
    found = trim(paused(scene_from_text(text, source="test")), held=["hinge"], inputs=["hinge.target"])
    assert found.inputs["hinge.target"] == pytest.approx(2.0 * 10.0 * 0.5 / 50.0, rel=1e-10)


@pytest.mark.parametrize("angle, mu", [(0.7, 0.2), (2.5, 0.4)])
def test_a_run_rests_within_the_interval_and_moves_beyond_it(angle, mu):
    """Friction by load in all joints of a slider-crank: the load at the ends of the interval depends on the effort."""
    scene = slider_crank(angle, 0.0, {})
    radius = {"revolute": {"radius": 0.02}, "prismatic": {}}
    scene = scene.remade(joints=[j.remade(friction={"mu": mu, **radius[j.type]}) for j in scene.joints])
    interval = trim(paused(scene), held=["main"], inputs=["main.effort"]).intervals["main.effort"]
    inwards = 1e-7 * (interval[1] - interval[0])
    for effort, rests in zip((*interval, *interval), (True, True, False, False)):
        change = inwards if (effort == interval[0]) is rests else -inwards
        run = paused(scene)
        run.apply_effort("main", effort + change)
        run.advance(5)
        assert (set(run.sample().modes.values()) == {"stick"}) is rests
