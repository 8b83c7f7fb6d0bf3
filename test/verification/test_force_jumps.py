# SPDX-License-Identifier: Apache-2.0
"""Forces that jump or have a kink: accuracies against closed forms, piece by piece.

The error estimate of a substep is small by chance if a jump falls into some of its places, see
methods/munthe_kaas/error_control.py.
"""

import bisect
import math

import numpy as np
import pytest

from liegroup_core import Scene, Simulation
from liegroup_core.scene.description import Body, Frame, Joint, LinearServo, SpringDamper

DURATION = 10.0  # s


def through_its_end(rng):
    """Spring with a rest length on a body of 1 kg that runs through its other end: x'' = -k (x - l sign x)."""
    k, l = 10.0 ** rng.uniform(1.0, 4.5), 10.0 ** rng.uniform(-2.0, 0.0)
    x0, w = l * rng.uniform(2.2, 6.0), math.sqrt(k)
    pieces, t, x, v, side = [], 0.0, x0, 0.0, 1.0
    while t < DURATION:
        pieces.append((t, x, v, w, side * l))
        amplitude, phase = math.hypot(x - side * l, v / w), math.atan2(-v / w, x - side * l)
        turned = (side * math.acos(-side * l / amplitude) - phase) % (2.0 * math.pi)
        t, x, v = t + turned / w, 0.0, -amplitude * w * math.sin(phase + turned)
        side = -side
    ends = dict(parent="world", parent_point=(0, 0, 0), child="b", child_point=(0, 0, 0))
    return x0, SpringDamper(name="k", **ends, stiffness=k, rest_length=l), pieces


def at_its_limit(rng):
    """Servo on a body of 1 kg, mostly at its largest effort: x'' = -clip(k x, F)."""
    k, x0 = 10.0 ** rng.uniform(1.0, 7.0), 10.0 ** rng.uniform(-1.0, 0.5)
    largest = min(k * x0 * 10.0 ** rng.uniform(-5.0, -0.3), 1000.0 * x0)
    w, edge = math.sqrt(k), largest / k
    pieces, t, x, v, side = [], 0.0, x0, 0.0, 1.0
    while t < DURATION:
        if side:  # constant force until x = side * edge
            pieces.append((t, x, v, 0.0, -side * largest))
            root = math.sqrt(v * v + 2.0 * largest * (side * x - edge))
            t, x, v, side = t + (side * v + root) / largest, side * edge, -side * root, 0.0
        else:  # spring, to the other edge
            pieces.append((t, x, v, w, 0.0))
            amplitude, phase, side = (math.hypot(x, v / w), math.atan2(-v / w, x), math.copysign(1, v))
            turned = (-side * math.acos(side * edge / amplitude) - phase) % (2.0 * math.pi)
            v = -amplitude * w * math.sin(phase + turned)
            t, x = t + turned / w, side * edge
    return x0, LinearServo(name="k", joint="j", stiffness=k, effort_limit=largest), pieces


def position(pieces, starts, time):
    """m, of a piece (start, x, v, w, centre) of an oscillation, or with w = 0 an acceleration."""
    start, x, v, w, centre = pieces[bisect.bisect_right(starts, time) - 1]
    q = time - start
    if w == 0.0:
        return x + v * q + 0.5 * centre * q * q
    return centre + (x - centre) * math.cos(w * q) + v / w * math.sin(w * q)


@pytest.mark.parametrize("accuracy", [1e-4, 1e-6])
@pytest.mark.parametrize("make", [through_its_end, at_its_limit])
@pytest.mark.volume(1)
def test_the_accuracy_is_kept_or_its_end_said(make, accuracy):
    """Finer ones end at rounding: no substep can be shorter than what rounding of a pose allows."""
    along = Frame(axis=(1, 0, 0))
    for seed in range(24):
        x0, force, pieces = make(np.random.default_rng([seed, make is at_its_limit]))
        scene = Scene(
            name="slider",
            gravity=(0, 0, 0),
            bodies=[Body(name="b", mass=1.0, inertia=(1.0, 1.0, 1.0), position=(x0, 0, 0))],
            joints=[
                Joint(name="j", type="prismatic", parent="world", child="b", parent_frame=along, child_frame=along)
            ],
            forces=[force],
        )
        simulation = Simulation(scene, accuracy=accuracy, horizon=DURATION, quiet=True)
        size, starts = simulation.promise["length"], [piece[0] for piece in pieces]
        while simulation.time < DURATION:
            simulation.advance(1)
            error = simulation.sample().positions["b"][0] - position(pieces, starts, simulation.time)
            if simulation.time <= simulation.accurate_until:
                assert abs(error) <= accuracy * size, (seed, simulation.time)
