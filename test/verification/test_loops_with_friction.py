# SPDX-License-Identifier: Apache-2.0
"""Closed loops in which every joint has friction, against an integration in one coordinate."""

import math

import numpy as np
import pytest
import yaml
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from slider_crank import FRICTION, G, kinematics, slider_crank

from liegroup_core.engine import Engine
from liegroup_core.scene.load import scene_from_text

pytestmark = pytest.mark.slow


def derivative(time, state, friction, signs):
    """Rates of (angle, rate) while joints move in the directions `signs`; complex-step slopes."""
    angle, rate = state
    inertia, _, _, rates = kinematics(angle)
    bent, pulled, *_ = kinematics(complex(angle, 1e-30))
    load = sum(
        friction.get(name, 0.0) * sign * r.real
        for name, r, sign in zip(("main", "pin", "wrist", "slide"), rates, signs)
    )
    force = -0.5 * bent.imag * 1e30 * rate**2 - pulled.imag * 1e30 - load
    return [rate, force / inertia.real]


def directions(angle, rate):
    """Signs of the rates of the joints while the crank turns like `rate`, just after an angle."""
    return np.sign(rate * kinematics(angle + math.copysign(1e-9, rate))[3].real)


def reference(angle, rate, friction, times, upper=None, restitution=0.0, most=1):
    """(angles at `times`, times of rest, times of the first impacts) of the crank.

    It is integrated between rests, dead points and impacts at the stop `upper` of the slide: friction
    keeps its signs between them. It ends with so many impacts.
    """

    def rest(time, state, *_):
        return state[1]

    def stop(time, state, *_):
        return 1.0 if upper is None else upper - kinematics(state[0])[2].real

    # Dead points, where the friction of the wrist or of the slide is reversed.
    def wrist(time, state, friction, signs):
        return signs[0] * signs[2] * kinematics(state[0])[3][2].real

    def slide(time, state, friction, signs):
        return signs[0] * signs[3] * kinematics(state[0])[3][3].real

    rest.terminal = stop.terminal = wrist.terminal = slide.terminal = True
    stop.direction = wrist.direction = slide.direction = -1.0
    now, angles, rests, impacts = 0.0, np.zeros(len(times)), [], []
    signs = directions(angle, rate)
    while now < times[-1] and len(impacts) < most:
        if rate == 0.0:
            force = derivative(now, (angle, 0.0), {}, signs)[1]
            signs = directions(angle, force)
            if derivative(now, (angle, 0.0), friction, signs)[1] * force <= 0.0:
                angles[times > now] = angle
                break
            # The event of rest is not at its own start.
            rate = math.copysign(1e-14, force)
        found = solve_ivp(
            derivative,
            (now, times[-1]),
            [angle, rate],
            "DOP853",
            events=(rest, stop, wrist, slide),
            args=(friction, signs),
            rtol=1e-13,
            atol=1e-15,
            max_step=2e-3,
            dense_output=True,
        )
        part = (times > now) & (times <= found.t[-1])
        if part.any():
            angles[part] = found.sol(times[part])[0]
        now, (angle, rate) = found.t[-1], found.y[:, -1]
        if len(found.t_events[0]):
            rests.append(now)
            rate = 0.0
            continue
        if len(found.t_events[1]):
            impacts.append(now)
            rate *= -restitution
            signs = directions(angle, rate) if rate else signs
        for joint in (2, 3):
            if len(found.t_events[joint]):
                signs[joint] *= -1.0
    return angles, rests, impacts


def run(scene, step, times, **options):
    """(angles of the crank, [JointEvent]) of a run at times that are multiples of the step."""
    engine = Engine(scene, "rkmk8", step, group="relative", **options)
    angles = []
    for time in times:
        engine.advance(round(time / step) - engine.steps)
        angles.append(engine.sample().pose[0, :2])
    return np.array([math.atan2(-b, a) for a, b in angles]), engine


def apart(one, other):
    """Differences of angles, rad."""
    return np.abs(np.remainder(one - other + math.pi, 2.0 * math.pi) - math.pi)


@pytest.mark.parametrize("joints", ["main", "pin", "wrist", "slide", "main pin", "all"])
@pytest.mark.volume(3)
def test_slider_crank_with_friction(joints):
    """Friction of one joint, of two, of all: other joints are cut, and the motion is that of the crank.

    It runs over its dead points, where the friction of a joint is reversed, and with friction of all
    turns round twice. The reference stops at the dead points, too: it is known to 1e-11.
    """
    friction = {name: size for name, size in FRICTION.items() if joints == "all" or name in joints.split()}
    times = np.linspace(0.1, 4.0, 40)
    expected, rests, _ = reference(1.0, -6.0, friction, times)
    found, _ = run(slider_crank(1.0, -6.0, friction), 2e-3, times, stabilisation="projection")
    assert len(rests) >= (2 if joints == "all" else 0)
    assert apart(found, expected).max() < 1e-9


@pytest.mark.parametrize("restitution, most", [(0.0, 1), (0.6, 4)])
def test_slider_crank_with_friction_and_a_stop(restitution, most):
    """The ram has a stop short of its dead point: impacts at the times of the reference."""
    times = np.linspace(0.01, 3.0, 300)
    expected, _, impacts = reference(2.5, -6.0, FRICTION, times, 0.385, restitution, most)
    scene = slider_crank(2.5, -6.0, FRICTION, 0.385, restitution)
    found, engine = run(scene, 2e-3, times, stabilisation="projection")
    hits = [event for event in engine.drain_events() if event.kind == "impact"]
    assert len(impacts) == most
    assert [event.time for event in hits[:most]] == pytest.approx(impacts, abs=1e-10)
    before = times < impacts[-1]
    assert apart(found, expected)[before].max() < 1e-9
    assert max(event.energy for event in hits) < 0.0


def four_bar(friction, turn=None, rate=2.0):
    """Four-bar in the x, y plane, turned by a rotation vector; friction : {joint: keys}."""
    frame = Rotation.from_rotvec([0.0, 0.0, 0.0] if turn is None else turn)
    between = lambda v: (frame.apply(v)).tolist()  # noqa: E731
    own = {"a": 1.0, "b": 1.5, "c": 1.2}
    coms = {"a": 0.1, "b": 0.25, "c": 0.2}
    places = {"a": [0, 0, 0], "b": [0.1, 0.17, 0], "c": [0.45, 0, 0]}
    angles = {"a": 1.0, "b": 0.2, "c": 1.3}
    bodies = []
    for name, mass in own.items():
        body = {"name": name, "mass": mass, "inertia": [0.02] * 3, "com": [coms[name], 0, 0]}
        body["position"] = between(places[name])
        turned = frame * Rotation.from_rotvec([0, 0, angles[name]])
        bodies.append(body | {"rotation_vector": turned.as_rotvec().tolist()})
    bodies[0] |= {"initial": "fixed", "angular_velocity": [0, 0, rate]}
    ground = {"rotation_vector": frame.as_rotvec().tolist()}
    ends = [
        ("A", "world", "a", ground, {}),
        ("B", "a", "b", {"position": [0.2, 0, 0]}, {}),
        ("C", "b", "c", {"position": [0.5, 0, 0]}, {"position": [0.4, 0, 0]}),
        ("D", "world", "c", ground | {"position": between([0.45, 0, 0])}, {}),
    ]
    joints = []
    for name, parent, child, on_parent, on_child in ends:
        joint = {"name": name, "type": "revolute", "parent": parent, "child": child}
        joint |= {"parent_frame": on_parent, "child_frame": on_child}
        if name in friction:
            joint["friction"] = friction[name]
        joints.append(joint)
    scene = {"name": "fb", "gravity": between([0, -G, 0]), "assemble": True, "bodies": bodies}
    return scene_from_text(yaml.safe_dump(scene | {"joints": joints}))


LAW = {"coulomb": 0.3, "static": 0.5, "viscous": 0.05}


@pytest.mark.parametrize("joint", ["A", "B", "C", "D"])
def test_the_cut_does_not_matter(joint):
    """Friction of one joint; and the same with zero friction of the others, so that a cut one has some.

    Both solve the same equations with other joints cut. Between 2e-3 s steps 1e-15 grow to 1e-12.
    """
    none = {"coulomb": 0.0, "static": 0.0}
    laws = ({joint: LAW}, dict.fromkeys("ABCD", none) | {joint: LAW})
    ends, events = [], []
    for law in laws:
        engine = Engine(four_bar(law), "rkmk8", 2e-3, stabilisation="projection")
        engine.advance(1500)
        ends.append(engine.sample())
        events.append([event for event in engine.drain_events() if event.joint == joint])
    assert ends[0].pose == pytest.approx(ends[1].pose, abs=1e-10)
    assert ends[0].twist == pytest.approx(ends[1].twist, abs=1e-9)
    assert [event.kind for event in events[0]] == [event.kind for event in events[1]]
    times = [[event.time for event in found] for found in events]
    assert times[0] == pytest.approx(times[1], abs=1e-10)


@pytest.mark.parametrize("turn", [[0.3, 0.0, 0.0], [0.5, -0.8, 0.4]])
def test_a_four_bar_in_space(turn):
    """Turned with gravity, where the equations are those of space, it moves as in its plane."""
    laws = dict.fromkeys("ABCD", LAW)
    frame = Rotation.from_rotvec(turn).as_matrix()
    plane, space = (
        Engine(four_bar(laws, of), "rkmk8", 2e-3, stabilisation="projection", space=kind)
        for of, kind in ((None, "auto"), (turn, "space"))
    )
    for _ in range(20):
        plane.advance(50)
        space.advance(50)
        flat, turned = plane.sample().pose_matrices, space.sample().pose_matrices
        assert turned[:, :3, :3] == pytest.approx(frame @ flat[:, :3, :3], abs=1e-9)
        assert turned[:, :3, 3] == pytest.approx(flat[:, :3, 3] @ frame.T, abs=1e-9)
    events = [[(e.joint, e.kind) for e in each.drain_events()] for each in (plane, space)]
    assert events[0] == events[1]
    assert plane.modes == space.modes


@pytest.mark.parametrize("turn", [None, [0.5, -0.8, 0.4]])
@pytest.mark.volume(1)
def test_a_loop_that_friction_holds_does_not_creep(turn):
    """A four-bar comes to rest: from then on there are no events, and no bit of a pose changes in a million steps.

    The projection of velocities leaves round-off of rates that are round-off themselves, at most eps^2.
    """
    laws = dict.fromkeys("ABCD", {"coulomb": 1.0, "static": 1.5})
    engine = Engine(four_bar(laws, turn), "rkmk4", 2e-3, stabilisation="projection")
    engine.advance(2000)
    events = engine.drain_events()
    assert {event.joint for event in events if event.kind == "stick"} == set("ABCD")
    assert len(events) <= 40
    pose, _ = engine.state()
    count = engine.event_count
    assert set(engine.modes.values()) == {"stick"}
    engine.advance(1_000_000)
    assert engine.state()[0].tobytes() == pose.tobytes()
    assert np.abs(engine.state()[1]).max() <= np.finfo(float).eps ** 2
    assert engine.event_count == count


def test_what_friction_of_all_joints_can_hold():
    """A loop at rest breaks away where the torque on its crank exceeds what all joints hold together.

    By virtual work: torque - weight = static (1 + |b' - 1| + |c' - b'| + |c'|), with the rates of the
    others by the crank's.
    """
    engine = Engine(four_bar(dict.fromkeys("ABCD", {"static": 2.0}), rate=0.0), "rkmk4", 1e-3)
    still = engine.sample()
    moving = Engine(four_bar({}, rate=1.0), "rkmk4", 1e-3).sample()
    w = moving.twist[:, 2]
    assert w[0] == pytest.approx(1.0, abs=1e-12)
    lever = abs(w[0]) + abs(w[1] - w[0]) + abs(w[2] - w[1]) + abs(w[2])
    lift = 0.0
    for mass, com, pose, twist in zip((1.0, 1.5, 1.2), (0.1, 0.25, 0.2), still.pose_matrices, moving.twist):
        v = pose[:3, :3] @ (twist[3:] + np.cross(twist[:3], [com, 0, 0]))
        lift += mass * G * v[1]
    for torque, mode in (
        ((lift + 2.0 * lever) * (1.0 - 1e-9), "stick"),
        ((lift + 2.0 * lever) * (1.0 + 1e-9), "free"),
        ((lift - 2.0 * lever) * (1.0 - 1e-9), "stick"),
        ((lift - 2.0 * lever) * (1.0 + 1e-9), "free"),
    ):
        engine.reset()
        engine.apply_effort("A", torque)
        engine.advance(3)
        assert set(engine.modes.values()) == {mode}, (torque, engine.modes)
