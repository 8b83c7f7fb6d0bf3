# SPDX-License-Identifier: Apache-2.0
"""Random bodies thrown on the ground and at each other, against the independent reference integration."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from volume import some

from liegroup_core import Simulation, SimulationError
from liegroup_core.mechanism.body_model import initial_state
from liegroup_core.reference import WrenchSpan, integrate
from liegroup_core.scene.centres import at_centres_of_mass
from liegroup_core.scene.load import scene_from_text

SHAPES = (
    "{type: sphere, radius: 0.1}",
    "{type: capsule, radius: 0.06, length: 0.2}",
    "{type: box, size: [0.2, 0.3, 0.12]}",
    "{type: cylinder, radius: 0.1, length: 0.15}",
    "{type: hull, points: [[0.1, 0, 0], [-0.1, 0, 0], [0, 0.12, 0], [0, -0.1, 0.02], [0, 0, 0.1], [0.02, 0.03, -0.1]]}",
)
SIZE = 0.3  # m
SEEDS = some(range(512), 1)


def thrown(seed):
    """One or two bodies of random shapes, masses and contacts."""
    rng = np.random.default_rng(seed)
    count, bodies, forces = int(rng.integers(1, 3)), [], []
    for i in range(count):
        mass = float(rng.uniform(0.5, 3.0))
        numbers = {
            "mass": mass,
            "inertia": (mass * rng.uniform(0.004, 0.007, 3)).tolist(),
            "com": rng.uniform(-0.01, 0.01, 3).tolist(),
            "position": [0.32 * i, float(rng.uniform(-0.05, 0.05)), float(rng.uniform(0.25, 0.35))],
            "quaternion": Rotation.from_rotvec(rng.normal(size=3)).as_quat().tolist(),
            "linear_velocity": rng.uniform(-1.0, 1.0, 3).tolist(),
            "angular_velocity": rng.uniform(-5.0, 5.0, 3).tolist(),
        }
        bodies.append(f"  - {{name: b{i}, {', '.join(f'{key}: {value}' for key, value in numbers.items())}}}")
        friction, shape = rng.choice([0.0, 0.2, 0.6]), SHAPES[rng.integers(len(SHAPES))]
        slides = f", friction: {friction}, slip: {10 ** rng.uniform(-4, -3)}" if friction else ""
        keys = f"stiffness: {10 ** rng.uniform(3, 6)}, restitution: {rng.uniform(0.1, 1.0)}{slides}"
        forces.append(f"  - {{name: f{i}, type: contact, body: b{i}, shape: {shape}, {keys}}}")
    if count == 2:
        keys = f"stiffness: {10 ** rng.uniform(3, 5)}, restitution: 0.5, friction: 0.3, slip: 1e-3"
        shapes = f"shape: {SHAPES[rng.integers(2)]}, other_shape: {SHAPES[rng.integers(3)]}"
        forces.append(f"  - {{name: hit, type: contact, body: b0, other: b1, {shapes}, {keys}}}")
    lines = ["name: thrown", "gravity: [0, 0, -9.81]", "bodies:", *bodies, "forces:", *forces]
    return scene_from_text("\n".join(lines), "test")


def reference(scene, times, pushes):
    """Exact motion and its uncertainty; times that come after what the reference knows are removed."""
    try:
        return integrate(scene, *initial_state(at_centres_of_mass(scene)), np.array(times), pushes)
    except SimulationError:  # some motions amplify differences
        if len(times) == 2:
            raise
        times.pop()
        return reference(scene, times, pushes)


def random_pushes(seed, rng):
    """[WrenchSpan] of the first body."""
    wrench, start = (*rng.normal(0.0, 0.3, 3), *rng.normal(0.0, 5.0, 3)), round(rng.uniform(0.05, 0.3), 3)
    return [WrenchSpan(start, start + 0.125, "b0", wrench, "world")] if seed % 3 == 1 else []


@pytest.mark.parametrize("seed", SEEDS)
def test_an_accuracy_is_kept_through_random_contacts_or_the_run_says_so(seed):
    """The estimate is at least half of an error beyond the accuracy; the reference knows its own uncertainty.

    A third of the scenes have a push, in another third the accuracy changes by ten.
    """
    scene, times, rng = thrown(seed), [0.0, 0.2, 0.4, 0.6], np.random.default_rng((seed, 1))
    pushes = random_pushes(seed, rng)
    exact, known = reference(scene, times, pushes)
    uncertain = max(known.position.max() / SIZE, known.angle.max())
    for accuracy in (1e-2, 1e-5, 1e-9):
        simulation, aim = Simulation(scene, accuracy=accuracy, horizon=1.0, quiet=True), accuracy
        for push in pushes:
            simulation.apply_wrench("b0", push.wrench, push.start, 0.125, axes="world")
        for k, time in enumerate(times):
            if seed % 3 == 2 and k == 2:
                change = 10.0 ** rng.choice([-1, 1])
                simulation.set_accuracy(accuracy * change)
                aim = accuracy * max(1.0, change)  # what was lost before remains
            simulation.advance_to(time)
            sample = simulation.sample()
            error = max(
                np.abs(sample.pose_matrices[:, :3, 3] - exact.position[k]).max() / SIZE,
                np.abs(sample.pose_matrices[:, :3, :3] - exact.rotation[k]).max(),
            )
            assert error <= max(aim, 2.0 * simulation.largest_error) + uncertain, (accuracy, time)
    assert uncertain <= 1e-6


@pytest.mark.parametrize("seed, end, accuracies", [(9044, 0.2, (1e-5, 1e-7, 1e-9)), (121, 0.4, (1e-7, 1e-9))])
def test_a_short_slip_of_a_contact_is_not_overlooked(seed, end, accuracies):
    """46 us in the first fifth of a substep, soon after it sticks; and 1.3 us soon after it touches.

    Overlooked, by the run or by the reference, they change poses by 4e-9 and 3e-8.
    """
    scene, times, pushes = thrown(seed), [0.0, end], random_pushes(seed, np.random.default_rng((seed, 1)))
    exact, known = reference(scene, times, pushes)
    assert max(known.position.max() / SIZE, known.angle.max()) < 1e-12
    for accuracy in accuracies:
        simulation = Simulation(scene, accuracy=accuracy, horizon=1.0, quiet=True)
        for push in pushes:
            simulation.apply_wrench("b0", push.wrench, push.start, 0.125, axes="world")
        simulation.advance_to(end)
        pose = simulation.sample().pose_matrices
        off = np.abs(pose[:, :3, 3] - exact.position[1]).max() / SIZE, np.abs(pose[:, :3, :3] - exact.rotation[1]).max()
        assert max(off) < min(accuracy, 1e-9)
