# SPDX-License-Identifier: Apache-2.0
"""Problems with stops and dry friction for the robustness map: sliders with closed-form solutions."""

import math

import numpy as np

from liegroup_core.joints.cable import CableJoint
from liegroup_core.joints.stops import Friction, Limits
from liegroup_core.scene.description import Body, Frame, Joint, LinearSpringDamper, Scene
from liegroup_core.scene.library import GRAVITY

from .cell import Problem
from .motions import ReferenceMotion

STEP = 0.01  # s
SMALLEST = 1e-13  # m/s; a ball with a slower rebound stays at rest


def _body(name, **start):
    return Body(name=name, mass=1.0, inertia=(0.1, 0.1, 0.1), **start)


def _slide(body, **keys):
    """Vertical prismatic joint between the world and a body."""
    ends = dict(parent="world", child=body.name, parent_frame=Frame(), child_frame=Frame())
    return Joint(name=f"slide_{body.name}", type="prismatic", **ends, **keys)


def _problem(bodies, joints, place, steps, gravity=0.0, forces=()):
    """Problem of masses of 1 kg that move vertically.

    place : function of times -> heights in m, (times,) for one body or (times, bodies)
    """
    scene = Scene(name="sliders", gravity=(0, 0, -gravity), bodies=bodies, joints=joints, forces=forces)

    def motion(times):
        found = place(times).reshape(len(times), len(bodies))
        position = np.zeros((len(times), len(bodies), 3))
        position[:, :, 2] = found
        rotation = np.broadcast_to(np.eye(3), (len(times), len(bodies), 3, 3))
        return ReferenceMotion(rotation, position, 1e-11 * (1.0 + np.abs(found).max()))

    return Problem(scene, STEP, steps, motion, 1.0)


def _slider(place, steps, start, speed=0.0, gravity=0.0, forces=(), **keys):
    """Problem of one mass on a prismatic joint with stops or friction; place : function of times -> height in m."""
    body = _body("mass", position=(0.0, 0.0, start), linear_velocity=(0.0, 0.0, speed))
    return _problem([body], [_slide(body, **keys)], place, steps, gravity, forces)


def _by_pieces(pieces):
    """Function of times from `pieces`, which yields (end time, function of time) of successive pieces."""

    def place(times):
        found, pending, (end, at) = np.zeros(len(times)), iter(pieces()), (0.0, None)
        for k, time in enumerate(times):
            while time > end or at is None:
                end, at = next(pending)
            found[k] = at(time)
        return found

    return place


def _bouncing(e):
    """Height of a bouncing ball that falls from 1 m, as a function of times; e: coefficient of restitution."""

    def pieces():
        begin, speed = math.sqrt(2.0 / GRAVITY), math.sqrt(2.0 * GRAVITY)
        yield begin, lambda t: 1.0 - 0.5 * GRAVITY * t * t
        while True:
            speed *= e
            if speed < SMALLEST:
                yield math.inf, lambda t: 0.0
            end = begin + 2.0 * speed / GRAVITY
            yield end, lambda t, s=speed, b=begin: (t - b) * (s - 0.5 * GRAVITY * (t - b))
            begin = end

    return _by_pieces(pieces)


def restitution(e):
    """Ball that falls by 1 m onto a rigid stop, over 3 s."""
    limits = Limits(lower=0.0, restitution=e)
    return _slider(_bouncing(e), 300, 1.0, gravity=GRAVITY, limits=limits)


def cable(e):
    """Ball that falls by 1 m until its cable of 1.5 m is taut, over 3 s."""
    ball, height = _body("ball", position=(0.0, 0.0, -0.5)), _bouncing(e)
    ends = dict(parent="world", child="ball", parent_frame=Frame(), child_frame=Frame())
    rope = CableJoint(name="rope", length=1.5, restitution=e, **ends)
    return _problem([ball], [rope], lambda times: height(times) - 1.5, 300, GRAVITY)


def simultaneous(count):
    """Ball at 1 m/s that hits a row of touching balls, restitution 0.7: one impact at all contacts."""
    e, size, gap = 0.7, 0.1, 0.4137
    heights = [0.0, *(gap + size * k for k in range(1, count))]
    bodies = [
        _body(f"ball{k}", position=(0.0, 0.0, height), linear_velocity=(0.0, 0.0, float(k == 0)))
        for k, height in enumerate(heights)
    ]
    touch = [
        CableJoint(
            name=f"touch{k}",
            type="strut",
            parent=f"ball{k - 1}",
            child=f"ball{k}",
            parent_frame=Frame(),
            child_frame=Frame(),
            length=size,
            restitution=e,
        )
        for k in range(1, count)
    ]
    after = np.array([1.0 - (count - 1) * e, *[1.0 + e] * (count - 1)]) / count
    before = np.array([1.0, *[0.0] * (count - 1)])

    def place(times):
        late = np.maximum(times - gap, 0.0)[:, None]
        return np.array(heights) + np.minimum(times, gap)[:, None] * before + late * after

    return _problem(bodies, [*map(_slide, bodies), *touch], place, 100)


def stop_stiffness(stiffness):
    """Ball that falls by 1 m onto an elastic stop, over 3 s."""
    speed, omega, sag = math.sqrt(2.0 * GRAVITY), math.sqrt(stiffness), GRAVITY / stiffness
    contact = (2.0 * math.pi - 2.0 * math.atan2(speed / omega, sag)) / omega
    flight = 2.0 * speed / GRAVITY

    def pieces():
        begin = 0.5 * flight
        yield begin, lambda t: 1.0 - 0.5 * GRAVITY * t * t
        while True:
            end = begin + contact
            yield (
                end,
                lambda t, b=begin: sag * math.cos(omega * (t - b)) - speed / omega * math.sin(omega * (t - b)) - sag,
            )
            begin, end = end, end + flight
            yield end, lambda t, b=begin: (t - b) * (speed - 0.5 * GRAVITY * (t - b))
            begin = end

    limits = Limits(lower=0.0, stiffness=stiffness)
    return _slider(_by_pieces(pieces), 300, 1.0, gravity=GRAVITY, limits=limits)


def friction(ratio):
    """Oscillator of 1 Hz released at 1 m; ratio: dry friction relative to the initial force of its spring."""
    omega = 2.0 * math.pi

    def place(times):
        half = np.floor(2.0 * times)
        # Each half swing reduces the amplitude by 2 ratio. The mass rests once friction exceeds the spring force.
        ends = np.maximum(np.ceil((1.0 / ratio - 1.0) / 2.0), 0.0)
        half = np.minimum(half, ends)
        turns = np.minimum(times, 0.5 * ends)
        sign = 1.0 - 2.0 * (half % 2)
        centre, swing = sign * ratio, 1.0 - (2.0 * half + 1.0) * ratio
        moving = centre + sign * swing * np.cos(omega * (turns - 0.5 * half))
        return np.where(half < ends, moving, sign * (1.0 - 2.0 * ends * ratio))

    spring = LinearSpringDamper(name="spring", joint="slide_mass", stiffness=omega**2)
    law = Friction(coulomb=ratio * omega**2)
    return _slider(place, 300, 1.0, forces=[spring], friction=law)


def bounces(rate):
    """Ball that bounces between two elastic stops at 1 m/s, `rate` times a second, over 0.2 s."""
    gap = 1.0371 / rate  # so that the samples cover the whole gap

    def place(times):
        turned, along = np.divmod(times + 0.5 * gap, gap)
        return np.where(turned % 2 == 0, along - 0.5 * gap, 0.5 * gap - along)

    limits = Limits(lower=-0.5 * gap, upper=0.5 * gap, restitution=1.0)
    return _slider(place, 20, 0.0, speed=1.0, limits=limits)
