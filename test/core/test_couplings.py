# SPDX-License-Identifier: Apache-2.0
"""Couplings of joints: gears, racks, screws, cams; turns, assembly, redundancy, errors.

Accelerations of random coupled mechanisms: test_relative_accelerations.py, class "couplings".
"""

import math
import os
import subprocess
import sys

import numpy as np
import pytest
from convergence import fitted_order
from numpy.polynomial import Polynomial
from scene_files import cases, filled, text_of
from scipy.integrate import solve_ivp

from liegroup_core import SceneError, Simulation, SimulationError
from liegroup_core.describe import describe
from liegroup_core.layout import make_layout
from liegroup_core.reference import Reference
from liegroup_core.scene import scene_from_text
from liegroup_core.status import TURNS_NOT_COUNTED

EPS = 2.0**-52
SUPPORTED = ("rkmk1", "rkmk2", "rkmk3", "rkmk4", "rkmk8", "rkmk54", "generalized_alpha", "constrained_rattle")

WHEELS = text_of("wheels_couplings.yaml")
# A pinion that drives a rack by -0.1 m/rad; the rail is along an axis in space, or in the plane.
RACK = text_of("rack_couplings.yaml")
FIVE_BAR = text_of("five_bar.yaml")
# A lever, or a sled, that lifts a follower on a spring along its profile.
CAM = text_of("cam_couplings.yaml")
# The second of three slides follows the square of the first, the third that of the second; both say x^4.
POWERS = text_of("powers.yaml")
QUADRATIC, QUARTIC = [0.2], [0.2, -0.05, 0.03]


def cam(kind, curve):
    return scene_from_text(filled(CAM, kind=kind, curve=curve))


def cam_motion(kind, curve, time):
    """(q, rate, force on the follower) of a cam: Lagrange's equation of q, with x = p(q) for the follower.

    (I + m p'^2) q'' + m p' p'' q'^2 = Q - (m g + k (x + 0.1)) p'
    """
    p, own = Polynomial([0.05, 0.1, *curve]), 0.045 if kind == "revolute" else 1.5
    d, dd = p.deriv(), p.deriv(2)

    def load(q):
        return 0.8 * 9.81 + 30 * (p(q) + 0.1)

    def acceleration(q, v):
        torque = 1.5 * 9.81 * 0.1 * math.cos(q) if kind == "revolute" else 0.0
        return (torque - 0.8 * d(q) * dd(q) * v**2 - load(q) * d(q)) / (own + 0.8 * d(q) ** 2)

    q, v = solve_ivp(
        lambda _, y: [y[1], acceleration(*y)], (0.0, time), [0.6, 1.2], "DOP853", rtol=1e-12, atol=1e-13
    ).y[:, -1]
    return q, v, load(q) + 0.8 * (d(q) * acceleration(q, v) + dd(q) * v**2)


def two_pendulums(ratio, bolt=False):
    """Pendulums on axes that are not parallel, coupled; bolt: the second moves along its axis too."""
    kind = "type: screw, pitch: 0.3" if bolt else "type: revolute"
    return scene_from_text(filled(text_of("pendulums_couplings.yaml"), kind=kind, ratio=ratio))


def pendulum_motion(ratio, time, bolt=False):
    """(angle, rate) of the first pendulum: one equation for its angle, from energies.

    The second axis is turned by 0.4 rad about x: the rotation angle psi = ratio phi gives its centre
    the height -0.3 cos(0.4) sin(psi), and with a bolt + 0.3 sin(0.4) psi along the axis.
    """
    inertia = 0.3 + 1.5 * 0.4**2
    second = 0.12 + 0.8 * 0.3**2 + (0.8 * 0.3**2 if bolt else 0.0)
    full = inertia + ratio**2 * second

    def rates(_, x):
        psi = ratio * x[0]
        torque = 1.5 * 9.81 * 0.4 * math.cos(x[0])
        lift = 0.3 * math.cos(0.4) * math.cos(psi) - (0.3 * math.sin(0.4) if bolt else 0.0)
        return [x[1], (torque + ratio * 0.8 * 9.81 * lift) / full]

    return solve_ivp(rates, (0.0, time), [0.0, 0.0], "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]


def relation(simulation):
    """Violations of all couplings, by the joint coordinates of a sample."""
    q = simulation.sample().joint_coordinates
    return [
        q[found["joint"]][0] - Polynomial([found["offset"], found["ratio"], *found["curve"]])(q[found["other"]][0])
        for found in describe(simulation.layout)["couplings"]
    ]


@pytest.mark.parametrize("method", SUPPORTED)
def test_gears_turn_as_their_inertias_say(method):
    """Constant acceleration: order 1 is exact for the rate, order 2 for the angle."""
    simulation = Simulation(scene_from_text(WHEELS), method, 0.01)
    simulation.advance(500)
    acceleration = 0.25 / (0.3 + 0.7**2 * 0.5)
    angle, rate = simulation.sample().joint_coordinates["ja"]
    # Five hundred sums of numbers up to 16, with the round-off of each.
    assert rate == pytest.approx(2 + 5 * acceleration, abs=500 * 16 * EPS)
    if method != "rkmk1":
        assert angle == pytest.approx(2 * 5 + 12.5 * acceleration, abs=500 * 16 * EPS)
    assert simulation.sample().joint_coordinates["jb"][1] == pytest.approx(-0.7 * rate, abs=500 * 16 * EPS)
    assert np.abs(relation(simulation)).max() < 500 * 16 * EPS


@pytest.mark.parametrize("axis", [[1, 0, 0], [-1, 0, 0], [0.6, 0, 0.8]])
@pytest.mark.parametrize("first", ["rail", "axle"])
def test_a_pinion_drives_its_rack(axis, first):
    """In the plane and in space, along either direction, written either way round."""
    way = -0.1
    pair = ("rail", "axle", way) if first == "rail" else ("axle", "rail", 1 / way)
    speed = [2 * way * part for part in axis]
    text = filled(RACK, axis=axis, speed=speed, joint=pair[0], other=pair[1], ratio=pair[2])
    simulation = Simulation(scene_from_text(text), "rkmk4", 0.01)
    assert (simulation.layout.normal is None) == (axis[2] != 0)
    simulation.advance(1000)
    acceleration = 1 / (0.3 + way**2 * 2)
    q = simulation.sample().joint_coordinates
    angle = 2 * 10 + 50 * acceleration
    # 28 turns: the angle of the joint follows from the relation.
    assert q["axle"][0] == pytest.approx(angle, abs=1000 * 200 * EPS)
    assert q["rail"][0] == pytest.approx(way * angle, abs=1000 * 200 * EPS)


@pytest.mark.parametrize("case", ["hinges", "bolt", "cam", "sled"])
@pytest.mark.parametrize("method, order", cases("coupled_bodies_move_at_the_order_of_the_method"))
@pytest.mark.volume(8)
def test_coupled_bodies_move_at_the_order_of_the_method(method, order, case):
    """Pendulums in space and cams, against one equation of motion that knows no joint; of cams also the force."""
    if case in ("hinges", "bolt"):
        scene, exact = two_pendulums(-1.7, case == "bolt"), pendulum_motion(-1.7, 1.0, case == "bolt")
    else:
        kind, curve = ("revolute", QUARTIC) if case == "cam" else ("prismatic", QUADRATIC)
        scene, exact = cam(kind, curve), cam_motion(kind, curve, 1.0)
    errors, steps = [], np.array([0.02, 0.01, 0.005])
    for step in steps:
        simulation = Simulation(scene, method, step)
        simulation.advance(round(1.0 / step))
        sample = simulation.sample()
        found = [*sample.joint_coordinates["ja"], *(sample.reactions["lift"][5:] if len(exact) == 3 else ())]
        errors.append(np.abs(np.subtract(found, exact)).max())
    assert order - 0.2 < fitted_order(steps, errors) < order + 0.6
    assert errors[-1] < 1e-2 * max(1.0, np.abs(exact).max())


def test_a_coupling_does_not_drift():
    """Rows that are linear in the coordinates are kept by every method.

    1e5 steps of 1 ms: each rounds rates of up to 10 rad/s. That is a random walk of the velocity of
    the relation, which adds up in 100 s.
    """
    simulation = Simulation(two_pendulums(0.37), "rkmk4", 1e-3)
    assert simulation.stabilisation == "none" and not simulation.layout.drifts("relative")
    simulation.advance(100_000)
    assert np.abs(relation(simulation)).max() < 1e5**0.5 * 10 * EPS * 100


def test_a_cam_is_projected():
    """Its row drifts; projection keeps it, and the energy up to the error of rkmk8 at 1 ms, below round-off.

    Round-off of the energy: a random walk of 2e4 steps of terms of 20 J.
    """
    free, kept = (
        Simulation(cam("revolute", QUARTIC), m, 1e-3, stabilisation=s)
        for m, s in (("rkmk2", "none"), ("rkmk8", "projection"))
    )
    assert kept.layout.drifts("relative") and Simulation(cam("revolute", QUARTIC)).stabilisation == "projection"
    before = kept.sample().energy
    for run in (free, kept):
        run.advance(20_000)
    assert abs(relation(free)[0]) > 1e-7
    assert abs(relation(kept)[0]) < 16 * EPS
    assert abs(kept.sample().energy - before) < 20_000**0.5 * 20 * EPS * 10


def test_turns_of_a_cam_are_counted_and_follow_in_both_directions():
    """A wheel of 24 rad and another by a cubic law: projected, placed, restored; the energy gives the rate."""
    text = WHEELS.replace("ratio: -0.7", "ratio: -0.7, curve: [0.003, -0.0001]").split("forces:")[0]
    scene = scene_from_text(text.replace("0, 2]", "0, 6]").replace("-1.4]", "-4.2]"))
    p = Polynomial([0, -0.7, 0.003, -0.0001])
    simulation = Simulation(scene, "rkmk8", 1e-2, stabilisation="projection")
    simulation.advance(400)
    (q, v), (second, rate) = (simulation.sample().joint_coordinates[name] for name in ("ja", "jb"))
    slope = p.deriv()(q)
    assert q > 7 * math.pi
    assert (second, rate) == pytest.approx((p(q), slope * v), abs=1e-13)
    assert v**2 * (0.3 + 0.5 * slope**2) == pytest.approx(36 * (0.3 + 0.5 * 0.7**2), abs=1e-11)
    again = Simulation(scene, "rkmk8", 1e-2, stabilisation="projection")
    again.restore(simulation.snapshot())
    for run in (simulation, again):
        run.advance(10)
    assert again.state()[0].tobytes() == simulation.state()[0].tobytes()
    simulation.place(joints={"ja": (30.0, 1.0)})
    assert simulation.sample().joint_coordinates["jb"] == pytest.approx((p(30), p.deriv()(30)), abs=1e-12)
    simulation.place(joints={"jb": (p(31), 1.0)})
    assert simulation.sample().joint_coordinates["ja"] == pytest.approx((31, 1 / p.deriv()(31)), abs=1e-12)


def test_turns_are_counted_at_any_ratio():
    """After 100 turns, and from a state that was set with its angles: the same bits."""
    text = WHEELS.replace("ratio: -0.7", "ratio: -0.7123").replace("-1.4]", "-1.4246]")
    scene = scene_from_text(text.replace("torque: 0.25", "torque: 3"))
    simulation = Simulation(scene, "rkmk4", 0.01, stabilisation="projection")
    simulation.advance(1000)
    sample = simulation.sample()
    assert sample.angles[0] > 2 * math.pi * 40
    assert np.abs(relation(simulation)).max() < 1000 * 600 * EPS
    again = Simulation(scene, "rkmk4", 0.01, stabilisation="projection")
    again.restore(simulation.snapshot())
    for run in (simulation, again):
        run.advance(100)
    assert again.state()[0].tobytes() == simulation.state()[0].tobytes()
    assert again.sample().angles.tobytes() == simulation.sample().angles.tobytes()


def test_turns_that_cannot_be_counted_are_reported():
    scene = scene_from_text(WHEELS.replace("0, 2]", "0, 400]").replace("-1.4]", "-280]"))
    simulation = Simulation(scene, "rkmk4", 0.01)
    with pytest.raises(SimulationError, match="the joint of mesh rotates by pi") as failure:
        simulation.advance(10)
    assert failure.value.status & 0xFF == TURNS_NOT_COUNTED


@pytest.mark.parametrize("method", ["rkmk8", "generalized_alpha", "constrained_rattle"])
def test_a_geared_five_bar_keeps_energy_and_closes(method):
    """A coupling in a loop: one freedom is left. The loop drifts, or is projected; energy is kept.

    Error of the energy: that of the method, measured at half the step to be 4 and 100 times less.
    """
    simulation = Simulation(
        scene_from_text(FIVE_BAR), method, 1e-3, **({"stabilisation": "projection"} if method == "rkmk8" else {})
    )
    assert describe(simulation.layout)["degrees_of_freedom"] == 1
    before = simulation.sample().energy
    simulation.advance(500)
    sample = simulation.sample()
    assert abs(sample.energy - before) < (1e-9 if method == "rkmk8" else 1e-2)
    assert sample.constraint_residual < 1e-14
    assert np.abs(relation(simulation)).max() < 1e-13


@pytest.mark.parametrize(
    "scene",
    [
        two_pendulums(-1.7),
        two_pendulums(0.4, bolt=True),
        scene_from_text(FIVE_BAR),
        scene_from_text(FIVE_BAR.replace("ratio: 0.5", "ratio: 0.3, curve: [0.05, 0.01]")),
        scene_from_text(
            FIVE_BAR.replace("ratio: 0.5, offset: 0.2", "ratio: 0.4, curve: [0.1], terms: {c: 0.3, d: -0.1}")
        ),
        scene_from_text(WHEELS),
        cam("revolute", QUARTIC),
    ],
    ids=["pendulums", "bolt", "five_bar", "five_bar_with_cam", "five_bar_of_four", "wheels", "cam"],
)
def test_coupled_motions_are_those_of_the_classical_formulation(scene):
    """All coordinates of all bodies, with integrated angles; its tolerance is 1e-13."""
    simulation = Simulation(scene, "rkmk8", 1e-3, stabilisation="projection")
    found, _ = Reference(simulation.scene, *simulation.state()).at(np.array([0.25, 0.5]))
    simulation.advance(500)
    sample = simulation.sample()
    assert np.abs(found.position[-1] - sample.pose[:, 9:]).max() < 1e-11
    assert np.abs(found.twist[-1] - sample.twist).max() < 1e-10


def test_assembly_satisfies_couplings():
    """The given rate drives both cranks, and the guess is moved to the offset."""
    scene = scene_from_text(FIVE_BAR)
    q = make_layout(scene).sample(*_start(scene)).joint_coordinates
    assert q["b"][0] - 0.5 * q["a"][0] == pytest.approx(0.2, abs=1e-14)
    assert (q["a"][1], q["b"][1]) == pytest.approx((3.0, 1.5), abs=1e-13)


def test_assembly_satisfies_curves():
    """The lever follows a given height of its follower; a height below the profile gives the nearest one."""
    text = filled(CAM, kind="revolute", curve=QUADRATIC).replace(", coordinate: 0.6, rate: 1.2", "")
    text = text.replace("child_frame: {}}", "child_frame: {}, coordinate: 0.3, rate: 0.5}")
    q = make_layout(scene_from_text(text)).sample(*_start(scene_from_text(text))).joint_coordinates
    root = (-0.1 + math.sqrt(0.01 + 0.8 * 0.25)) / 0.4
    assert q["ja"] == pytest.approx((root, 0.5 / (0.1 + 0.4 * root)), abs=1e-13)
    # The least height of 0.05 + 0.1 q + 0.2 q^2 is at q = -1/4.
    with pytest.raises(SceneError, match="with the coordinate -0.5; .* nearest ones: lift 0.0375"):
        make_layout(scene_from_text(text.replace("coordinate: 0.3, rate: 0.5", "coordinate: -0.5")))


def test_a_follower_cannot_be_driven_below_its_profile():
    text = filled(CAM, kind="revolute", curve=QUADRATIC).replace("name: lift,", "name: lift, driven: true,", 1)
    simulation = Simulation(scene_from_text(text.replace("rate: 1.2", "rate: -0.5")), "rkmk4", 2e-3, quiet=True)
    with pytest.raises(SimulationError, match="beyond their reach: 'lift' at 0.037"):
        simulation.advance(1000)


def _start(scene):
    simulation = Simulation(scene, "rkmk4", 1e-3)
    return simulation.at_bodies()


def test_redundant_couplings_are_eliminated():
    """Three wheels in a ring: the third ratio follows from the others."""
    text = WHEELS.replace(
        "joints:",
        "  - {name: c, mass: 2, inertia: [0.4, 0.4, 0.5], position: [2, 0, 0], angular_velocity: [0, 0, 0.7]}\njoints:",
    )
    text = text.replace(
        "couplings:", "  - {name: jc, type: revolute, parent: world, child: c, child_frame: {}}\ncouplings:"
    ).replace(
        "forces:",
        "  - {name: second, joint: jc, other: jb, ratio: -0.5}\n"
        "  - {name: third, joint: jc, other: ja, ratio: 0.35}\nforces:",
    )
    simulation = Simulation(scene_from_text(text), "rkmk4", 0.01)
    assert len(simulation.layout.relative.couplings) == 2
    assert describe(simulation.layout)["degrees_of_freedom"] == 1
    simulation.advance(100)
    acceleration = 0.25 / (0.3 + 0.7**2 * 0.5 + 0.35**2 * 0.5)
    assert simulation.sample().joint_coordinates["ja"][1] == pytest.approx(2 + acceleration, abs=100 * 16 * EPS)
    assert np.abs(relation(simulation)).max() < 100 * 16 * EPS


def test_redundant_cams_are_eliminated():
    """Of x^2, y^2 and x^4 one follows from the others where they hold, also of 2 y and 2 x^2; the energy is kept."""
    with_gear = POWERS.replace("other: y, ratio: 0, curve: [1]", "other: y, ratio: 2")
    with_gear = with_gear.replace("[0.0625", "[0.5").replace("[0.5, 0, 0]}\njoints", "[2, 0, 0]}\njoints")
    assert len(make_layout(scene_from_text(with_gear.replace("[0, 0, 1]", "[2]"))).relative.couplings) == 2
    simulation = Simulation(scene_from_text(POWERS), "rkmk8", 1e-2, stabilisation="projection")
    assert len(simulation.layout.relative.couplings) == 2
    simulation.advance(50)
    (x, v), (y, _), (z, rate) = (simulation.sample().joint_coordinates[name] for name in "xyz")
    assert (y, z, rate) == pytest.approx((x**2, x**4, 4 * x**3 * v), abs=1e-14)
    assert v**2 * (1 + 4 * x**2 + 16 * x**6) == pytest.approx(1 + 1 + 0.25, abs=1e-12)


def test_coupled_joints_are_in_the_tree():
    """Whatever is the better cut otherwise: here the coupled joint is the last one of the loop."""
    text = FIVE_BAR.replace("joint: b, other: a, ratio: 0.5, offset: 0.2", "joint: e, other: a, ratio: 0.5")
    layout = make_layout(scene_from_text(text))
    tree = [entry["joint"] for entry in describe(layout)["formulation"]["tree"]]
    assert {"a", "e"} <= set(tree)


def test_momentum_is_not_said_to_be_kept():
    """One wheel drives the other through the world: no momentum is conserved."""
    facts = describe(make_layout(scene_from_text(WHEELS)))
    assert facts["kept_momentum"] == []
    assert facts["groups"] == [["a", "b"]]


def test_all_joints_of_a_loop_cannot_be_coupled():
    """A square of four hinges, at rest."""
    bodies = ["left", "top", "right"]
    joints = [("world", "left", 0, 0), ("left", "top", 0, 1), ("top", "right", 1, 1), ("world", "right", 1, 0)]
    text = "name: square\ngravity: [0, 0, 0]\nbodies:\n"
    for name in bodies:
        text += f"  - {{name: {name}, mass: 1, inertia: [0.1, 0.1, 0.1]}}\n"
    text += "joints:\n"
    for k, (parent, child, x, y) in enumerate(joints):
        frame = f"{{position: [{x}, {y}, 0]}}"
        text += f"  - {{name: j{k}, type: revolute, parent: {parent}, child: {child}, child_frame: {frame}}}\n"
    text += "couplings:\n"
    text += "".join(f"  - {{name: g{k}, joint: j{k}, other: j0, ratio: 0.1}}\n" for k in (1, 2, 3))
    with pytest.raises(SceneError, match="closes a loop of coupled joints"):
        make_layout(scene_from_text(text))


def test_groups_of_rigid_bodies_have_no_couplings():
    scene = scene_from_text(WHEELS)
    assert Simulation(scene, "rkmk4", 0.01).group == "relative"
    with pytest.raises(ValueError, match="group 'se3' cannot integrate this scene: it has couplings"):
        Simulation(scene, "rkmk4", 0.01, group="se3")


@pytest.mark.turn(3)
def test_plain_python_gives_the_same_numbers():
    """Without fast-math both round alike; only the last bit of libm functions may differ."""
    code = (
        "import sys; sys.path[:0] = sys.argv[1:]; import test_couplings as t\n"
        "from liegroup_core import Simulation\n"
        "for scene in (t.two_pendulums(0.37), t.scene_from_text(t.FIVE_BAR), t.cam('revolute', t.QUARTIC)):\n"
        "    s = Simulation(scene, 'rkmk4', 5e-3, stabilisation='projection')\n"
        "    s.advance(4)\n"
        "    print(s.state()[0].tobytes().hex())"
    )
    lines = [
        subprocess.run(
            [sys.executable, "-c", code, os.path.dirname(__file__), os.path.dirname(os.path.dirname(__file__))],
            capture_output=True,
            text=True,
            check=True,
            env={**os.environ, "NUMBA_DISABLE_JIT": disable},
        ).stdout.split()
        for disable in ("1", "0")
    ]
    for plain, fast in zip(*lines, strict=True):
        plain, fast = (np.frombuffer(bytes.fromhex(line)) for line in (plain, fast))
        assert np.abs(plain - fast).max() <= 1e-13


# Three wheels on one axis, or on three: a train with the coefficients of PLANETARY or DIFFERENTIAL.
TRAIN = text_of("train.yaml")


@pytest.mark.parametrize("method", ["rkmk4", "generalized_alpha", "constrained_rattle"])
@pytest.mark.parametrize("axis, ratio, further", [("[0, 0, 1]", 3.0, -2.0), ("[0, 1, 0]", 2.0, -1.0)])
def test_planetary_gears_and_differentials_move_as_willis_says(method, axis, ratio, further):
    """Constant accelerations: M a = tau + k lambda with k a = 0, k = (1, -ratio, -c), the equation of Willis.

    About 50 turns: angles have errors of steps times EPS times the angle, 3000 * 300 EPS = 2e-10.
    """
    scene = scene_from_text(filled(TRAIN, axis=axis, ratio=ratio, further=further))
    simulation = Simulation(scene, method, 0.01)
    start = simulation.sample().joint_coordinates
    simulation.advance(3000)
    k, inertia = np.array([1.0, -ratio, -further]), np.array([0.3, 0.4 if axis[4] == "1" else 0.7, 0.5])
    torque = np.array([0.25, -0.4, 0.0])
    force = -(k @ (torque / inertia)) / (k @ (k / inertia))
    rates = np.array([rate for _, rate in start.values()])
    assert abs(k @ rates) < 1e-14
    found = np.array([simulation.sample().joint_coordinates[name] for name in ("sun", "carrier", "ring")])
    acceleration = (torque + k * force) / inertia
    assert found[:, 1] == pytest.approx(rates + 30.0 * acceleration, abs=2e-10)
    assert found[:, 0] == pytest.approx(30.0 * rates + 450.0 * acceleration, abs=2e-10)
    assert simulation.sample().constraint_residual < 1e-12
