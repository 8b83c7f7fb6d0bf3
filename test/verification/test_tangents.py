# SPDX-License-Identifier: Apache-2.0
"""Tangents of the equations of motion, against 50 digits and against differences of the accelerations.

    python test/verification/test_tangents.py [COUNT]

prints the largest error against 50 digits in COUNT (500) random mechanisms, by class; larger ones than DIGITS beside
what the data determine.
"""

import sys
from pathlib import Path

from scene_files import filled, text_of

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
import pytest
import random_mechanisms
import stop_scenes
import yaml
from exact_links import Links
from precise import NearlySingular

from liegroup_core import Simulation
from liegroup_core.errors import SimulationError
from liegroup_core.forces.kinds import FORCES
from liegroup_core.joints.kinds import COORDINATES
from liegroup_core.joints.stops import BACKLASH
from liegroup_core.linear import linearise
from liegroup_core.linear.channels import InputChannels
from liegroup_core.linear.coordinates import Coordinates
from liegroup_core.linear.differences import derivative
from liegroup_core.linear.probe import Probe
from liegroup_core.linear.tangents import NOT_SMOOTH
from liegroup_core.scene.load import load_scene, scene_from_text

# Differences of order six have the error of h^6 / 140, h = 0.01, of the seventh derivative, and 2 eps / h of the
# accelerations: about 1e-12 of the largest entry, more where these are much larger than their changes.
DIGITS, ROUNDINGS = 1e-10, 16.0
CLASSES = [name for name in random_mechanisms.CLASSES if name != "large"]


def differ(simulation, kinds=("efforts", "targets"), modes=None):
    """Compare all columns, with given modes of the switches; returns their number."""
    probe = Probe(simulation)
    if modes is not None:
        probe.modes = modes
    coordinates, inputs = Coordinates(probe), InputChannels(probe, kinds)
    moves = [(coordinates.neighbour(k, 1.0), coordinates.size(k)) for k in range(len(coordinates.independent))]
    moves += [(coordinates.neighbour(k, 1.0, True), coordinates.rate_size(k)) for k in range(len(coordinates.moving))]
    count = len(moves)
    directions = np.zeros((count + len(inputs), probe.freedoms, 2))
    directions[:count] = np.reshape([y for y, _ in moves], (count, probe.freedoms, 2))
    sizes = np.array([*(h for _, h in moves), *inputs.sizes])
    found, errors, _ = probe.tangents(directions, sizes, *inputs.changes(count))
    expected = []
    for d in range(len(directions)):
        applied = None if d < count else np.eye(len(inputs))[d - count]

        def slopes(s, d=d, applied=applied):
            given = applied if d < count else inputs.applied(s * applied)
            return probe.slopes(s * directions[d], given)[0]

        # Accelerations are linear in the inputs, up to the limits of servos.
        expected.append(derivative(slopes, sizes[d] if d < count else 1e-3)[0])
    for part in (slice(0, count), slice(count, None)):
        smooth = errors[part] != NOT_SMOOTH
        wanted = np.reshape(expected[part], found[part].shape)[smooth]
        size = np.abs(wanted).max(initial=0.0) + np.abs(probe.slopes()[0]).max(initial=0.0)
        gap = np.abs(found[part][smooth] - wanted)
        assert gap.max(initial=0.0) <= DIGITS * size, (part, np.unravel_index(gap.argmax(), gap.shape), size)
    return np.sum(errors != NOT_SMOOTH)


def random_direction(coordinates, seed):
    """y (f, 2) along all independent coordinates and rates, each by a normal random number."""
    rng, y = np.random.default_rng(seed), 0.0
    for count, is_rate in ((len(coordinates.independent), False), (len(coordinates.moving), True)):
        y = y + sum(rng.normal() * coordinates.neighbour(k, 1.0, is_rate) for k in range(count))
    return y


def off(name, seed):
    """Largest error of the bodies' derivatives along a random direction, and what may be lost, both relative.

    To the largest derivative and acceleration. Lost is what round-off of the data changes, see
    test_relative_accelerations.py. None where the pose is nearly singular, or nothing moves.
    """
    scene, _ = random_mechanisms.random_mechanism(name, seed)
    try:
        probe = Probe(Simulation(scene, "rkmk4", 1e-3, estimate=False, quiet=True), in_space=True)
        coordinates = Coordinates(probe)
        if not len(coordinates.moving):
            return None
        y = random_direction(coordinates, seed)
        found, uncertain, _ = probe.tangents(y[None], np.array([1e-2]))
        slopes, f = probe.slopes()[0], probe.freedoms
        assert uncertain[0] != NOT_SMOOTH
        given = scene, y, slopes[f:], found[0, f:]
        exact, by_joints, accelerations = Links(probe).derivatives(*given)
    except (SimulationError, NearlySingular):
        return None
    size, lost = np.abs(exact).max() + np.abs(accelerations).max(), 0.0
    error = np.abs(by_joints - exact).max() / size
    if error > DIGITS:
        changed = [Links(probe, rounding).derivatives(*given)[0] for rounding in range(3)]
        lost = ROUNDINGS * max(np.abs(each - exact).max() for each in changed) / size
    return error, lost


@pytest.mark.parametrize("name", CLASSES)
@pytest.mark.volume(2)
def test_tangents_of_random_mechanisms_are_the_derivatives_of_their_accelerations(name):
    """Against 50 digits, along a random direction of the independent coordinates and rates."""
    found = [pair for pair in (off(name, seed) for seed in range(3)) if pair is not None]
    assert found and all(error <= DIGITS + lost for error, lost in found)


@pytest.mark.parametrize("name", ["bicycle", "diff_drive", "cable", "driven_arm", "flyball_governor", "stick_slip"])
def test_tangents_of_scenes(name):
    """Rolling, cables, couplings, driven joints and friction, in motion."""
    simulation = Simulation(load_scene(name), "rkmk4", 1e-4, estimate=False, quiet=True)
    simulation.advance(200)
    assert differ(simulation) > 0


def test_tangents_of_curved_couplings_and_of_switches():
    """A coupling q_1 = 0.7 q_2 + 0.3 q_2^2 - 0.2 q_2^3, sliding friction, a compliant stop, and held joints."""
    text = text_of("chain_tangents.yaml")
    simulation = Simulation(scene_from_text(text, "test"), "rkmk4", 1e-4, estimate=False, quiet=True)
    simulation.advance(200)
    assert differ(simulation) > 0
    simulation = Simulation(scene_from_text(stop_scenes.PRESS, "test"), "rkmk4", 1e-4, estimate=False, quiet=True)
    simulation.advance(400)
    assert differ(simulation) > 0


# A chain with every kind of force, and of coordinate with stops or friction.
STOPS = "limits: {lower: -0.3, upper: 0.4, stiffness: 300.0, damping: 2.0}, friction: {coulomb: 0.1, viscous: 0.3}"
EVERY_SWITCH = filled(text_of("every_switch.yaml"), stops=STOPS)


def combined(switches, rng, count):
    """`count` random modes (k, 5) of switches: each free, sliding, in contact or at rest because of others."""
    for _ in range(count):
        modes = np.zeros((len(switches), 5))
        modes[:, 1], modes[:, 2] = rng.choice([-1.0, 1.0], (2, len(switches)))
        modes[:, 2] *= rng.random(len(switches)) < 0.7
        modes[:, 2] *= [
            np.isfinite(each.limits.least if side < 0.0 else each.limits.largest)
            for each, side in zip(switches, modes[:, 2])
        ]
        modes[:, 0] = 2.0 * (rng.random(len(switches)) < 0.2)
        modes[:, 4] = modes[:, 0] * rng.normal(size=len(switches))
        yield modes


def test_every_force_and_every_switch_has_derivatives_in_every_mode():
    """A new type of force or of coordinate with stops is missing here until EVERY_SWITCH has it."""
    scene = scene_from_text(EVERY_SWITCH, "test")
    assert {force.type for force in scene.forces} == {cls.model_fields["type"].default for cls in FORCES}
    simulation = Simulation(scene, "rkmk4", 1e-5, estimate=False, quiet=True)
    switches = simulation.layout.switches
    assert {switch.kind for switch in switches} == {*COORDINATES, BACKLASH}
    simulation.advance(3)
    present = simulation.sample().switching[:, 3]
    for modes in combined(switches, np.random.default_rng(3), 40):
        modes[:, 3] = present
        assert differ(simulation, modes=modes) > 0


@pytest.mark.parametrize("name", ["four_bar", "slider_crank"])
def test_rows_of_cut_joints_have_derivatives_in_every_mode(name):
    """Every joint of a loop has stops and friction: the one that is cut has them as a row."""
    keys = yaml.safe_load(load_scene(name)._text)
    for joint in keys["joints"]:
        if joint["type"] not in ("revolute", "prismatic"):
            continue
        joint["limits"] = {"lower": -3.0, "upper": 3.0, "stiffness": 300.0, "damping": 2.0}
        joint["friction"] = {"coulomb": 0.1, "viscous": 0.3}
    simulation = Simulation(scene_from_text(yaml.safe_dump(keys)), "rkmk4", 1e-5, estimate=False, quiet=True)
    simulation.advance(3)
    present = simulation.sample().switching[:, 3]
    for modes in combined(simulation.layout.switches, np.random.default_rng(4), 10):
        modes[:, 3] = present
        assert differ(simulation, modes=modes) > 0


@pytest.mark.parametrize("law", ["gap: 0.002, damping: 0.02", "gap: 0, damping: 0.02", "gap: 0, viscous: 0.02"])
def test_a_pressed_mesh_of_gears_is_a_spring(law):
    """Gears on shafts without springs: J = 0.002 and 0.04 kg m^2, contact 200 N m/rad, damping 0.02, ratio 0.5.

    x = q_g - q_m / 2 has the effective inertia m = 1 / (1 / 0.04 + 1 / (4 * 0.002)), so the pole is
    -d / 2 m +- i sqrt(k / m - (d / 2 m)^2) = -1.5 +- 173.1986 i.
    """
    text = text_of("belt_tangents.yaml")
    simulation = Simulation(scene_from_text(text.replace("LAW", law), "test"), quiet=True)
    simulation.advance_to(0.012)
    mass = 1.0 / (1.0 / 0.04 + 0.25 / 0.002)
    decay = 0.02 / (2.0 * mass)
    expected = [-decay + 1j * np.sqrt(200.0 / mass - decay**2), 0.0, 0.0]
    poles = sorted((pole for pole in linearise(simulation).poles if pole.imag >= 0.0), key=lambda pole: -pole.imag)
    # A double pole at 0 of a matrix with entries of 3e4 is known to the root of 3e4 eps, 1e-5 of its scale 173.
    assert abs(poles[0] - expected[0]) < 1e-6 * 173.0
    assert all(abs(pole) < 1e-2 for pole in poles[1:])


if __name__ == "__main__":
    total = int(sys.argv[1]) if sys.argv[1:] else 500
    seeds = {name: [] for name in random_mechanisms.CLASSES}
    for k in range(total):
        name = list(seeds)[k % len(seeds)]
        seeds[name].append(off(name, k // len(seeds)))
    for name, found in seeds.items():
        known = [pair for pair in found if pair is not None]
        more = [f"{error:.1e} of {lost:.1e}" for error, lost in known if error > DIGITS]
        largest = max((error for error, _ in known if error <= DIGITS), default=0.0)
        print(f"{name}: {len(known)} of {len(found)} not singular, largest {largest:.1e}", *more, flush=True)
