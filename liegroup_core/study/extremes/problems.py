# SPDX-License-Identifier: Apache-2.0
"""Problems along the axes of the robustness map: scenes and their reference solutions."""

import math

import numpy as np

from liegroup_core.scene.description import Body, Frame, Joint, Scene, SpringDamper
from liegroup_core.scene.library import GRAVITY
from liegroup_core.scene.load import load_scene
from liegroup_core.scene.shapes import Box, Rod

from . import motions as motions
from .cell import Problem

# Free body of the chapter.
INERTIA, OMEGA = (0.9144, 1.098, 1.66), (0.45549, 0.82623, 0.03476)
SPEED = float(np.linalg.norm(OMEGA))
DOWN = (0.0, 0.0, -GRAVITY)


def _gyration(inertia, mass=1.0):
    return math.sqrt(sum(inertia) / mass)


def _free(inertia, omega, step, steps, motion=None):
    """Free body that rotates about its centre of mass."""
    scene = Scene(
        name="free",
        gravity=(0, 0, 0),
        bodies=[Body(name="body", mass=1.0, inertia=inertia, angular_velocity=tuple(omega))],
    )
    return Problem(
        scene,
        step,
        steps,
        motion or motions.free_body(inertia, omega),
        _gyration(inertia),
        turns=min(1.0, float(np.linalg.norm(omega)) * step * steps),
    )


def step_free(step):
    """The chapter's free body over 16 s."""
    return _free(INERTIA, OMEGA, step, round(16.0 / step))


def turn(angle):
    """Free body that rotates by `angle` rad in each of 64 steps about a changing axis."""
    return _free(INERTIA, OMEGA, angle / SPEED, 64)


def steady_turn(angle):
    """Free body that rotates by `angle` rad in each of 64 steps about its major axis."""
    return _free(INERTIA, (0.0, 0.0, 1.0), angle, 64, motions.spinning((0, 0, 1), 1.0))


def spin_free(spin):
    """Free body at `spin` rad/s, 200 steps of 1 ms."""
    return _free(INERTIA, np.array(OMEGA) * spin / SPEED, 1e-3, 200)


def racket(offset, step=0.05):
    """Rotation about the intermediate axis with a relative offset, until the body has flipped.

    Offsets far below 1e-10 are lost in the round-off of attitudes, and the time of the flip with them.
    """
    a, b, c = INERTIA
    rate = math.sqrt((b - a) * (c - b) / (a * c))
    # The first flip is where offset e^(rate t) is about 1; round-off grows by the same factor.
    return _free(INERTIA, (offset, 1.0, offset), step, math.ceil((1.3 * math.log(2.0 / offset) / rate + 5.0) / step))


def inertia_rod(ratio, step=0.05):
    """Rod with a given ratio of its moments of inertia, tumbling for 20 s."""
    return _free((1.0 / ratio, 1.0, 1.0 + 0.5 / ratio), (2.0, 1.0, 0.5), step, round(20.0 / step))


def inertia_limit(ratio, step=0.05):
    """Flat body at the limit of the triangle inequality, with a given ratio of its moments of inertia."""
    return _free((1.0 / ratio, 1.0, 1.0 + 1.0 / ratio), (2.0, 1.0, 0.5), step, round(20.0 / step))


def steps_free(steps):
    """The chapter's free body with a given number of steps of 0.05 s."""
    return _free(INERTIA, OMEGA, 0.05, int(steps))


def _top(inertia, length, rotation, omega, gravity=DOWN, field=None, forces=(), mass=1.0):
    """(scene, body) of a top whose centre is at the distance `length` from a spherical joint, along its z axis."""
    position = tuple((rotation @ (0.0, 0.0, length)).tolist())
    body = Body(
        name="top",
        mass=mass,
        inertia=inertia,
        position=position,
        rotation_vector=_vector(rotation),
        angular_velocity=tuple(omega),
        linear_velocity=tuple(np.cross(omega, (0.0, 0.0, length)).tolist()),
    )
    joint = Joint(
        name="pivot",
        type="spherical",
        parent="world",
        child="top",
        parent_frame=Frame(),
        child_frame=Frame(position=(0.0, 0.0, -length)),
    )
    return Scene(name="top", gravity=gravity, bodies=[body], joints=[joint], forces=forces), body


def _vector(rotation):
    """Rotation vector about a coordinate axis, accurate for tiny angles."""
    sine = 0.5 * np.array(
        [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    )
    axis = np.flatnonzero(sine)
    if len(axis) == 0:
        return (0.0, 0.0, 0.0)
    angle = math.atan2(sine[axis[0]], 0.5 * (np.trace(rotation) - 1.0))
    return tuple((angle * (np.arange(3) == axis[0])).tolist())


TOP_INERTIA, TOP_LENGTH = (0.3, 0.3, 0.4), 1.0
# Smallest spin in rad/s at which the top stays upright ("sleeps").
CRITICAL = 2.0 * math.sqrt((TOP_INERTIA[0] + 1.0) * GRAVITY) / TOP_INERTIA[2]


def spin_top(spin, step=1e-3, steps=500):
    """Top on a spherical joint, 1 rad off the vertical, with a spin in rad/s."""
    R = motions.about(0, np.array([1.0]))[0]
    scene, body = _top(TOP_INERTIA, TOP_LENGTH, R, (0.0, 0.0, spin))
    return Problem(scene, step, steps, motions.top(body, DOWN, R), TOP_LENGTH)


def step_top(step):
    """Top at 30 rad/s, over 1 s or two steps."""
    return spin_top(30.0, step, max(2, round(1.0 / step)))


def sleeping(part, step=5e-3):
    """Top 1 mrad off the vertical for 4 s, spin relative to the stability limit (sleeping top)."""
    R = motions.about(0, np.array([1e-3]))[0]
    scene, body = _top(TOP_INERTIA, TOP_LENGTH, R, (0.0, 0.0, part * CRITICAL))
    return Problem(scene, step, round(4.0 / step), motions.top(body, DOWN, R), TOP_LENGTH)


def _pulled_top(stiffness, damping, rotation):
    """Top in the field of a spring of zero rest length from its centre to a point 1 m away."""
    spring = SpringDamper(
        name="spring",
        parent="world",
        parent_point=(0.0, 0.6, 0.8),
        child="top",
        child_point=(0.0, 0.0, 0.0),
        stiffness=stiffness,
        damping=damping,
    )
    return _top(TOP_INERTIA, TOP_LENGTH, rotation, (0.3, 0.2, 0.5), forces=[spring])


def stiff(stiffness, step=1e-3, steps=100):
    """Top with an undamped spring of the given stiffness in N/m, which acts as a strong uniform field."""
    scene, body = _pulled_top(stiffness, 0.0, np.eye(3))
    field = stiffness * np.array((0.0, 0.6, 0.8)) + np.array(DOWN)
    return Problem(scene, step, steps, motions.top(body, field), TOP_LENGTH)


def stiff_damped(stiffness, step=1e-3, steps=50):
    """Top with a stiff spring, damped at half of critical damping."""
    scene, _ = _pulled_top(stiffness, math.sqrt(stiffness), np.eye(3))
    return Problem(scene, step, steps, motions.integrated(scene, TOP_LENGTH), TOP_LENGTH)


def step_stiff(step):
    """Top with a spring of 1e4 N/m, over 0.5 s or two steps."""
    return stiff(1e4, step, max(2, round(0.5 / step)))


def angle(amplitude, part=0.1):
    """Pendulum released at the angle `amplitude`; 100 steps of `part` rad of its phase."""
    across, length = 0.3 + 1.0, 1.0
    frequency = math.sqrt(GRAVITY * length / across)
    R = motions.about(1, np.array([amplitude]))[0]
    hanging = tuple((R @ (0.0, 0.0, -length)).tolist())
    scene = Scene(
        name="pendulum",
        gravity=DOWN,
        bodies=[
            Body(name="bob", mass=1.0, inertia=TOP_INERTIA, position=hanging, rotation_vector=(0.0, amplitude, 0.0))
        ],
        joints=[
            Joint(
                name="pivot",
                type="spherical",
                parent="world",
                child="bob",
                parent_frame=Frame(),
                child_frame=Frame(position=(0.0, 0.0, length)),
            )
        ],
    )

    def place(angles):
        R = motions.about(1, angles)
        return R[:, None], (R @ (0.0, 0.0, -length))[:, None]

    motion = (
        motions.linear_swing(amplitude, frequency, place)
        if amplitude < 1e-7
        else motions.one_angle(lambda a: -(frequency**2) * math.sin(a), amplitude, 0.0, place)
    )
    return Problem(scene, part / frequency, 100, motion, length)


def mass_chain(ratio):
    """Two jointed rods of 1 m with a given mass ratio, falling for 0.8 s, step 1 ms."""
    rods = [Rod(axis=(1, 0, 0), length=1.0, radius=0.05, mass=m, position=(0.5, 0, 0)) for m in (1.0, ratio)]
    far, hinge = Frame(position=(1.0, 0, 0), axis=(0, 1, 0)), Frame(axis=(0, 1, 0))
    bodies = [Body(name="upper", shape=rods[0]), Body(name="lower", shape=rods[1], position=(1.0, 0, 0))]
    scene = Scene(
        name="rods",
        gravity=DOWN,
        bodies=bodies,
        joints=[
            Joint(
                name="shoulder", type="revolute", parent="world", child="upper", child_frame=hinge, parent_frame=hinge
            ),
            Joint(name="elbow", type="spherical", parent="upper", child="lower", child_frame=hinge, parent_frame=far),
        ],
    )
    motion = motions.two_rods([(body.mass, body.inertia_matrix[1, 1]) for body in bodies], GRAVITY)
    return Problem(scene, 1e-3, 800, motion, 1.0)


def mass_spring(ratio):
    """Two free bodies with a given mass ratio and a spring between points off their centres, 2 s."""
    light = min(1.0, ratio)
    bodies = [
        Body(name=name, mass=m, inertia=(0.3 * m, 0.4 * m, 0.5 * m), position=(x, 0, 0), angular_velocity=w)
        for name, m, x, w in (("one", 1.0, 0.0, (0.1, 0.5, 0.2)), ("other", ratio, 1.5, (0.3, -0.4, 0.2)))
    ]
    spring = SpringDamper(
        name="spring",
        parent="one",
        parent_point=(0.2, 0.1, 0),
        child="other",
        child_point=(-0.2, 0, 0.1),
        stiffness=20.0 * light,
        rest_length=0.8,
    )
    scene = Scene(name="pair", gravity=(0, 0, 0), bodies=bodies, forces=[spring])
    return Problem(scene, 0.01, 200, motions.integrated(scene, 1.0), 1.0)


def length_top(length):
    """Top of a given length, 30 rad/s at 1 m; times scale with the square root of the length."""
    scale = math.sqrt(length)
    R = motions.about(0, np.array([1.0]))[0]
    inertia = tuple(length**2 * i for i in TOP_INERTIA)
    scene, body = _top(inertia, length, R, (0.0, 0.0, 30.0 / scale))
    return Problem(scene, 5e-3 * scale, 200, motions.top(body, DOWN, R), length)


def _four_bar(length, step, steps):
    """Four-bar of config/scenes, scaled to a length, at the same angular velocity."""

    def bar(name, size, mass, x, y, turned, **more):
        return Body(
            name=name,
            shape=Box(size=(size * length, 0.05 * length, 0.05 * length), mass=mass),
            position=(x * length, y * length, 0.0),
            rotation_vector=(0, 0, turned),
            **more,
        )

    def pin(name, kind, parent, child, at, to, **more):
        return Joint(
            name=name,
            type=kind,
            parent=parent,
            child=child,
            parent_frame=Frame(position=(at * length, 0, 0)),
            child_frame=Frame(position=(to * length, 0, 0)),
            **more,
        )

    bars = [
        bar("crank", 0.5, 0.5, 0.0, 0.25, math.pi / 2, initial="fixed"),
        bar("coupler", 1.0, 1.0, 0.44, 0.75, 0.5),
        bar("rocker", 1.0, 1.0, 0.94, 0.5, 1.7),
    ]
    rate = 10 * math.pi
    scene = Scene(
        name="bars",
        gravity=(0, 0, 0),
        assemble=True,
        bodies=bars,
        joints=[
            pin("ground_crank", "revolute", "world", "crank", 0.0, -0.25, rate=rate),
            pin("crank_coupler", "revolute", "crank", "coupler", 0.25, -0.5),
            pin("coupler_rocker", "spherical", "coupler", "rocker", 0.5, 0.5),
            pin("ground_rocker", "revolute", "world", "rocker", 1.0, -0.5),
        ],
    )
    motion = motions.four_bar(0.5, rate, [(body.mass, body.inertia_matrix[2, 2] / length**2) for body in bars], length)
    return Problem(scene, step, steps, motion, length)


def length_bars(length):
    """Four-bar scaled by a factor, 0.2 s at 1 ms."""
    return _four_bar(length, 1e-3, 200)


def step_bars(step):
    """Four-bar with 20 to 54 rad/s of its crank, over 0.5 s or two steps."""
    return _four_bar(1.0, step, max(2, round(0.5 / step)))


def redundant(hinges):
    """Door that falls about several collinear hinges, all but one redundant; 1 s at 1 ms."""

    def door(count):
        frames = [Frame(position=(0.0, y, 0.0), axis=(0, 1, 0)) for y in np.linspace(-1.0, 1.0, count).tolist()]
        return Scene(
            name="door",
            gravity=DOWN,
            bodies=[Body(name="door", shape=Box(size=(1.0, 2.0, 0.05), mass=20.0, position=(0.5, 0, 0)))],
            joints=[
                Joint(
                    name=f"hinge{k}",
                    type="revolute",
                    parent="world",
                    child="door",
                    parent_frame=frame,
                    child_frame=frame,
                )
                for k, frame in enumerate(frames)
            ],
        )

    return Problem(door(int(hinges)), 1e-3, 1000, motions.integrated(door(1), 1.0), 1.0)


def flat(rate, stabilisation="none"):
    """Parallelogram that passes its flat configuration at a rate in rad/s, up to ten times."""

    def rod(name, axis, x, y, **more):
        middle = tuple(0.5 * a for a in axis)
        return Body(
            name=name,
            shape=Rod(axis=axis, length=1.0, radius=0.05, mass=1.0, position=middle),
            position=(x, y, 0.0),
            **more,
        )

    ends = Frame(), Frame(position=(0.0, 1.0, 0.0)), Frame(position=(1.0, 0.0, 0.0))
    cranks = [rod(f"crank{k}", (0, 1, 0), float(k), 0.0, angular_velocity=(0, 0, -rate)) for k in (0, 1)]
    coupler = rod("coupler", (1, 0, 0), 0.0, 1.0, linear_velocity=(rate, 0.0, 0.0))
    scene = Scene(
        name="parallelogram",
        gravity=(0, -GRAVITY, 0),
        bodies=[*cranks, coupler],
        joints=[
            *(
                Joint(name=f"ground{k}", type="revolute", parent="world", child=f"crank{k}", child_frame=ends[0])
                for k in (0, 1)
            ),
            Joint(
                name="left",
                type="revolute",
                parent="crank0",
                child="coupler",
                parent_frame=ends[1],
                child_frame=ends[0],
            ),
            Joint(
                name="right",
                type="revolute",
                parent="crank1",
                child="coupler",
                parent_frame=ends[1],
                child_frame=ends[2],
            ),
        ],
    )
    # Two cranks about their pins, and a coupler that does not rotate; angle from upright.
    inertia = 2.0 * (cranks[0].inertia_matrix[2, 2] + 0.25) + 1.0
    torque = (2.0 * 0.5 + 1.0) * GRAVITY

    def place(angles):
        R = motions.about(2, -angles)
        still = np.broadcast_to(np.eye(3), R.shape)
        zero, tops = np.zeros((len(angles), 3)), R @ (0.0, 1.0, 0.0)
        return (np.stack([R, R, still], axis=1), np.stack([zero, zero + (1.0, 0.0, 0.0), tops], axis=1))

    steps = min(4000, math.ceil(30.0 / rate / 1e-3))
    return Problem(
        scene,
        1e-3,
        steps,
        motions.one_angle(lambda a: torque / inertia * math.sin(a), 0.0, rate, place),
        1.0,
        settings={"stabilisation": stabilisation},
    )


def moves(scene):
    """True if a body or joint of a Scene has an initial velocity."""
    return any(any(body.angular_velocity) or any(body.linear_velocity) for body in scene.bodies) or any(
        joint.rate for joint in scene.joints
    )


def of_scene_step(name, horizon, step):
    """Scene of the user with a given step."""
    scene = load_scene(name)
    return _of_scene(scene, step, max(1, round(horizon / step)))


def of_scene_speed(name, horizon, factor, step=1e-3):
    """The scene of the user with scaled initial velocities, and a step of 1 ms."""
    scene = load_scene(name)
    bodies = [
        body.model_copy(
            update={
                key: tuple(factor * x for x in getattr(body, key)) for key in ("angular_velocity", "linear_velocity")
            }
        )
        for body in scene.bodies
    ]
    joints = [
        joint if joint.rate is None else joint.model_copy(update={"rate": factor * joint.rate})
        for joint in scene.joints
    ]
    return _of_scene(
        scene.model_copy(update={"bodies": tuple(bodies), "joints": tuple(joints)}), step, max(1, round(horizon / step))
    )


def _of_scene(scene, step, steps):
    from liegroup_core.layout import make_layout

    length = make_layout(scene).size
    return Problem(scene, step, steps, motions.integrated(scene, length), length)
