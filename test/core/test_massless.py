# SPDX-License-Identifier: Apache-2.0
"""Bodies without inertia about an axis: point masses, and rods without thickness.

Against textbook equations of point masses, and as the limit of bodies with small inertia.
"""

import json
import warnings

import numpy as np
import pytest
from convergence import order_by_count
from scene_files import cases
from scipy.integrate import solve_ivp
from scipy.special import ellipk

from liegroup_core import SceneError, Simulation
from liegroup_core.describe import describe
from liegroup_core.engine import Engine
from liegroup_core.errors import SimulationError
from liegroup_core.layout import make_layout
from liegroup_core.methods.families import ON_JOINTS, fitting_methods
from liegroup_core.methods.table import METHODS
from liegroup_core.reference.trajectory import Reference
from liegroup_core.scene.load import scene_from_text
from liegroup_core.study.trade.configurations import ladders
from liegroup_sim_ros.commands.main import main

G = 9.81
HEAD = "name: massless\ngravity: [0, 0, -9.81]\n"
BOB = "  - {name: bob, mass: 2, inertia: [0, 0, 0], position: [0, 0, -1]}\n"
ROD = "  - {name: rod, mass: 1, inertia: [0.1, 0.1, 0], position: [0, 0, -0.5]}\n"
ABOVE = "parent_frame: {}, child_frame: {position: [0, 0, 1]}"
END = "parent_frame: {}, child_frame: {position: [0, 0, 0.5]}"
HINGE = "parent_frame: {axis: [0, 1, 0]}, child_frame: {position: [0, 0, 1], axis: [0, 1, 0]}"
CENTRE = "parent_frame: {position: [0, 0, -1]}, child_frame: {}"
CONTACT = (
    "forces: [{{name: c, type: contact, body: {}, shape: {{type: sphere, radius: 1}}, stiffness: 1, damping: 1}}]\n"
)
REMEDY = "where it has no inertia: give it inertia there, or use another joint"


def scene(bodies, *joints, extra=""):
    text = HEAD + extra + "bodies:\n" + bodies
    return scene_from_text(text + ("joints:\n" + "".join(joints) if joints else ""), source="x.yaml")


def joint(kind, child, frames, name="j", parent="world"):
    return f"  - {{name: {name}, type: {kind}, parent: {parent}, child: {child}, {frames}}}\n"


def pendulum():
    """Point mass of 2 kg on a hinge, 1 m away; starts horizontally, at rest."""
    bob = "  - {name: bob, mass: 2, inertia: [0, 0, 0], position: [1, 0, 0]}\n"
    return scene(
        bob,
        joint(
            "revolute", "bob", "parent_frame: {axis: [0, 1, 0]}, child_frame: {position: [-1, 0, 0], axis: [0, 1, 0]}"
        ),
    )


def numbers(vector):
    return [float(x) for x in vector]


LENGTHS, MASSES, ANGLES = (1.0, 0.7), (2.0, 0.5), (1.2, -0.8)


def points(first, second):
    """Positions of the masses of the double pendulum; angles from the vertical."""
    (l1, l2) = LENGTHS
    inner = np.array([l1 * np.sin(first), 0.0, -l1 * np.cos(first)])
    return inner, inner + [l2 * np.sin(second), 0.0, -l2 * np.cos(second)]


def double_pendulum(inertia):
    inner, outer = points(*ANGLES)
    bodies = "".join(
        f"  - {{name: {name}, mass: {mass}, inertia: [{inertia}, {inertia}, {inertia}], position: {numbers(place)}}}\n"
        for name, mass, place in zip("ab", MASSES, (inner, outer))
    )
    axis = "axis: [0, 1, 0]"
    frames = (
        f"parent_frame: {{{axis}}}, child_frame: {{position: {numbers(-inner)}, {axis}}}",
        f"parent_frame: {{{axis}}}, child_frame: {{position: {numbers(inner - outer)}, {axis}}}",
    )
    return scene(bodies, joint("revolute", "a", frames[0]), joint("revolute", "b", frames[1], "k", "a"))


def slope(_, y):
    """Textbook equations of the double pendulum of point masses."""
    (l1, l2), (m1, m2) = LENGTHS, MASSES
    a, b, w, u = y
    d = a - b
    matrix = [[(m1 + m2) * l1, m2 * l2 * np.cos(d)], [l1 * np.cos(d), l2]]
    right = [-m2 * l2 * u**2 * np.sin(d) - (m1 + m2) * G * np.sin(a), l1 * w**2 * np.sin(d) - G * np.sin(b)]
    return [w, u, *np.linalg.solve(matrix, right)]


def end(scene, steps, step=2e-3, **settings):
    engine = Engine(scene, "rkmk8", step, **settings)
    engine.advance(steps)
    return engine


def test_a_simple_pendulum_has_its_period():
    period = 4.0 * np.sqrt(1.0 / G) * ellipk(0.5)
    engine = Engine(pendulum(), "rkmk8", period / 4000)
    assert engine.group == "relative"
    engine.advance(2000)
    np.testing.assert_allclose(engine.sample().positions["bob"], [-1, 0, 0], rtol=0, atol=1e-12)
    engine.advance(2000)
    np.testing.assert_allclose(engine.sample().positions["bob"], [1, 0, 0], rtol=0, atol=1e-12)
    # The hinge carries the weight and the centripetal force: energy is that of the height.
    assert abs(engine.energy() - Engine(pendulum()).energy()) <= 1e-12


def test_a_double_pendulum_follows_its_textbook_equations():
    y = solve_ivp(slope, (0, 2), [*ANGLES, 0, 0], method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    engine = end(double_pendulum(0), 1000)
    for name, place in zip("ab", points(*y[:2])):
        np.testing.assert_allclose(engine.sample().positions[name], place, rtol=0, atol=1e-12)


def test_small_inertia_converges_to_none():
    """The difference is proportional to the inertia, in relative coordinates and on SE(3)^n."""
    zero = end(double_pendulum(0), 1000).sample().pose
    for inertia, settings in ((1e-6, {"group": "relative"}), (1e-6, {"group": "se3"}), (1e-9, {"group": "relative"})):
        pose = end(double_pendulum(inertia), 1000, **settings).sample().pose
        assert 0.1 * inertia < np.abs(pose - zero).max() < 20.0 * inertia


def spinning_rod(spin):
    rod = (
        f"  - {{name: rod, mass: 1, inertia: [0.1, 0.1, {spin}], position: [0, 0, -0.5], "
        "angular_velocity: [1.5, 0.5, 0]}\n"
    )
    return scene(rod, joint("universal", "rod", END), extra="assemble: true\n")


def test_a_thin_rod_on_a_universal_joint_is_the_limit_of_thick_ones():
    """With the spherical pendulum of the same length the rod's tip has the same motion."""
    thin = end(spinning_rod(0), 500)
    assert abs(thin.energy() - Engine(spinning_rod(0)).energy()) <= 1e-12
    for spin in (1e-4, 1e-7):
        away = np.abs(end(spinning_rod(spin), 500).sample().pose - thin.sample().pose).max()
        assert 0.0 < away < 1e-3 * spin

    # A spherical pendulum: d''= -G' (z - (z . d) d) - |d'|^2 d, with G' = m g l / (I + m l^2).
    def spherical(_, y):
        d, v = y[:3], y[3:]
        pull = np.array([0, 0, -0.5 * G / (0.1 + 0.25)])
        return [*v, *(pull - (pull @ d) * d - (v @ v) * d)]

    start = Engine(spinning_rod(0)).sample()
    middle, speed = start.positions["rod"], start.twists["rod"][3:]
    speed = start.pose[0, :9].reshape(3, 3) @ speed
    y = solve_ivp(spherical, (0, 1), [*2 * middle, *2 * speed], method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    np.testing.assert_allclose(thin.sample().positions["rod"], 0.5 * y[:3], rtol=0, atol=1e-11)


def loop(spin):
    """(bodies, joints) of a four-bar in the x-z plane: rods along their x axes."""
    corners = [(0.0, 0.0), (0.2, 0.9), (1.3, 1.2), (1.0, 0.0)]
    names = ["crank", "coupler", "rocker"]
    bodies, joints, parent = "", [], "world"
    for name, (x, z), (u, w) in zip(names, corners, corners[1:]):
        length = float(np.hypot(u - x, w - z))
        bodies += (
            f"  - {{name: {name}, mass: {length}, inertia: [{spin}, {length**3 / 12}, "
            f"{length**3 / 12}], position: {numbers(((x + u) / 2, 0, (z + w) / 2))}, "
            f"rotation_vector: [0, {float(-np.arctan2(w - z, u - x))}, 0]}}\n"
        )
        frame = f"child_frame: {{position: [{-length / 2}, 0, 0], axis: [0, 1, 0]}}"
        joints.append(joint("revolute", name, frame, f"to_{name}", parent))
        parent = name
    frame = f"child_frame: {{position: [{length / 2}, 0, 0], axis: [0, 1, 0]}}"
    joints.append(joint("revolute", "rocker", frame, "last"))
    return bodies, joints


def test_least_kinetic_energy_of_assembly_is_the_limit():
    def twists(inertia):
        text = HEAD + (
            "assemble: true\nbodies:\n"
            f"  - {{name: a, mass: 2, inertia: [{inertia}, {inertia}, {inertia}], "
            "position: [1, 0, 0]}\n"
            f"  - {{name: b, mass: 1, inertia: [{inertia}, {inertia}, {inertia}], "
            "position: [1.6, 0, -0.8], linear_velocity: [0, 0, 1]}\njoints:\n"
        )
        axis = "axis: [0, 1, 0]"
        for name, parent, child, place in (("j", "world", "a", [-1, 0, 0]), ("k", "a", "b", [-0.6, 0, 0.8])):
            frames = f"parent_frame: {{{axis}}}, child_frame: {{position: {place}, {axis}}}"
            text += joint("revolute", child, frames, name, parent)
        return np.array([body.twist for body in make_layout(scene_from_text(text)).scene.bodies])

    # By hand: rates p, q of the two rods; b starts with v = (0, 0, 1).
    assert np.abs(twists(1e-8) - twists(0)).max() < 1e-7
    (_, p, _, _, _, v), (_, q, *_) = twists(0)
    np.testing.assert_allclose([p, q, v], [-8 / 33, -5 / 11, 8 / 33], rtol=1e-9)


ABOUT_Z = f'joints[0] "j": it lets "rod" rotate about its axis (0, 0, 1), {REMEDY}'
ALONG_X = "  - {name: rod, mass: 1, inertia: [0, 0.1, 0.1], position: [-0.5, 0, 0]}\n"
TIP = "parent_frame: {position: [0, 0, -1]}, child_frame: {position: [0, 0, -0.5]}"


@pytest.mark.parametrize(("bodies", "joints", "text"), [
    (BOB, [("spherical", "bob", ABOVE)], ABOUT_Z.replace("rod", "bob") + ", such as a universal joint"),
    (BOB, [("spherical", "bob", CENTRE)], f'joints[0] "j": it lets "bob" rotate about any axis, {REMEDY}'),
    (BOB, [("universal", "bob", CENTRE)],
     f'joints[0] "j": it lets "bob" rotate about its axes (1, 0, 0) and (0, 1, 0), {REMEDY}'),
    (BOB, [("planar", "bob", ABOVE)], ABOUT_Z.replace("rod", "bob")),
    (BOB, [], 'bodies[0] "bob": it is free to rotate about any axis, where it has no inertia: give it inertia there, '
     "or hold it by a joint that prevents this rotation"),
    (BOB, [("distance", "bob", "parent_frame: {}, child_frame: {}, length: 1")],
     'bodies[0] "bob": it is free to rotate about any axis'),
    (ROD, [("spherical", "rod", END)], ABOUT_Z),
    (ROD, [("revolute", "rod", END)], ABOUT_Z),
    (ROD, [], 'bodies[0] "rod": it is free to rotate about its axis (0, 0, 1), where'),
    (ROD + BOB, [("fixed", "bob", "parent_frame: {}", "j", "rod")],
     'bodies[1] "bob": it is free to rotate about its axis (0, 0, 1), where'),
    # A rod between two balls of a loop: the second ball is cut.
    (ROD, [("spherical", "rod", END), ("spherical", "rod", TIP, "k")], ABOUT_Z),
    (ALONG_X, [("universal", "rod", "parent_frame: {}, child_frame: {position: [0.5, 0, 0]}")],
     f'joints[0] "j": it lets "rod" rotate about its axis (1, 0, 0) in its initial pose, {REMEDY}'),
])  # fmt: skip
def test_a_rotation_without_inertia_is_refused_in_one_line(bodies, joints, text):
    joints = [joint(*each) for each in joints]
    with pytest.raises(SceneError) as caught:
        make_layout(scene(bodies, *joints))
    message = str(caught.value)
    assert text in message and "\n" not in message
    line = message.split(":")[1]
    place = caught.value.place
    lines = (HEAD + "bodies:\n" + bodies + "joints:\n" + "".join(joints)).splitlines()
    name = message.split('"')[1]
    assert f"name: {name}," in lines[int(line) - 1] and place[0] == message.split(": ")[1][:6]
    with pytest.raises(SceneError) as caught:  # a contact has states, which move no body
        make_layout(scene(bodies, *joints, extra=CONTACT.format(name if place[0] == "bodies" else bodies[11:14])))
    assert text in str(caught.value)


@pytest.mark.parametrize(("bodies", "kind", "child", "frames"), [
    (BOB, "revolute", "bob", HINGE), (BOB, "universal", "bob", ABOVE), (BOB, "prismatic", "bob", ABOVE),
    (ROD, "universal", "rod", END), (ROD, "fixed", "rod", END),
    # Small numbers that are physical: an arm of 1 um, a light thick body, a hinge 1 um beside the rod's axis.
    (BOB, "revolute", "bob", HINGE.replace("[0, 0, 1]", "[0, 0, 1e-6]")),
    (BOB.replace("2", "1e-9").replace("[0, 0, 0]", "[1e-30, 1e-30, 1e-30]"), "spherical", "bob", ABOVE),
    (ROD, "revolute", "rod", END.replace("[0, 0, 0.5]", "[1e-6, 0, 0.5]")),
])  # fmt: skip
def test_a_freedom_with_some_inertia_is_accepted(bodies, kind, child, frames):
    make_layout(scene(bodies, joint(kind, child, frames), extra="assemble: true\n"))


@pytest.mark.parametrize("settings", cases("methods_that_need_inertia_refuse_in_one_line"))
def test_methods_that_need_inertia_refuse_in_one_line(settings):
    with pytest.raises(ValueError) as caught:
        Simulation(pendulum(), **settings)
    assert str(caught.value).endswith(
        'cannot integrate this scene: bodies[0] "bob" has no inertia about any axis. Use group '
        f"'relative' with one of: {', '.join(name for name in METHODS if METHODS[name].family in ON_JOINTS)}"
    )
    assert str(caught.value).startswith(f"method {settings['method']} in group ")


def test_lists_of_methods_are_those_that_can_integrate_it():
    layout = make_layout(spinning_rod(0))
    methods = [name for name in METHODS if METHODS[name].family in ON_JOINTS]
    assert fitting_methods(layout) == methods
    assert {ladder.group for ladder in ladders(layout)} == {"relative"}
    facts = describe(make_layout(pendulum()))
    assert "no inertia about any axis" in facts["formulation"]["only"]
    assert facts["methods"] == methods and facts["degrees_of_freedom"] == 1


def test_the_reference_integration_refuses_it():
    with pytest.raises(SimulationError, match='but bodies.0. "bob" has no inertia about any axis'):
        Reference(pendulum(), *Engine(pendulum()).state())


@pytest.mark.parametrize("stabilisation", ["none", "projection", "baumgarte"])
def test_a_loop_of_thin_rods_is_the_limit_of_thick_ones(stabilisation):
    bodies, joints = loop(0)
    thin = end(scene(bodies, *joints), 300, stabilisation=stabilisation)
    assert thin.group == "relative" and thin.sample().constraint_residual < 1e-9
    assert abs(thin.energy() - Engine(scene(bodies, *joints)).energy()) < 1e-9
    bodies, joints = loop(1e-3)
    thick = end(scene(bodies, *joints), 300, stabilisation=stabilisation, group="relative")
    assert np.abs(thick.sample().pose - thin.sample().pose).max() < 1e-9


def test_a_simulation_to_an_accuracy_with_its_estimate():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        simulation = Simulation(double_pendulum(0), accuracy=1e-8, horizon=2.0)
    assert simulation.group == "relative" and simulation.layout.model.refinements == 0
    simulation.advance(round(2.0 / simulation.step))
    y = solve_ivp(slope, (0, 2), [*ANGLES, 0, 0], method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    error = np.abs(simulation.sample().positions["b"] - points(*y[:2])[1]).max()
    assert error < 1e-8 and 0.0 < simulation.largest_error < 1e-8 and simulation.doubt is None


def test_generalized_alpha_has_order_two_without_inertia():
    y = solve_ivp(slope, (0, 1), [*ANGLES, 0, 0], method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    counts, found = (128, 256, 512), []
    for count in counts:
        engine = Engine(double_pendulum(0), "generalized_alpha", 1 / count)
        engine.advance(count)
        found.append(np.abs(engine.sample().positions["b"] - points(*y[:2])[1]).max())
    assert engine.group == "relative"
    assert order_by_count(counts, found) == pytest.approx(2.0, abs=0.2)


def test_a_body_that_is_fixed_to_the_world_stays():
    engine = Engine(scene(BOB, joint("fixed", "bob", ABOVE)), "rkmk4", 1e-2)
    engine.advance(10)
    np.testing.assert_array_equal(engine.sample().positions["bob"], [0, 0, -1])


def test_commands(tmp_path, capsys):
    path = tmp_path / "massless.yaml"
    path.write_text(pendulum().text)
    assert main(["describe", str(path), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert "no inertia about any axis" in facts["formulation"]["only"]
    assert main(["describe", str(path)]) == 0 and "relative" in capsys.readouterr().out
    assert main(["run", str(path), "--duration", "0.5", "--out", str(tmp_path / "run.npz")]) == 0
    refused = ["run", str(path), "--duration", "0.5", "--out", str(tmp_path / "no.npz")]
    assert main([*refused, "--method", "rkmk4", "--group", "se3"]) != 0
    assert 'bodies[0] "bob" has no inertia about any axis' in " ".join(capsys.readouterr().err.split())
