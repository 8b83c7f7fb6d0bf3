# SPDX-License-Identifier: Apache-2.0
"""Stiff scenes: the implicit method, and when a simulation to an accuracy takes it.

References: the matrix exponential of sliders in series, which are linear, and the independent reference
integration for chains in space that are stiff enough to matter but not for it.
"""

import mpmath
import numpy as np
import pytest
import yaml
from true_error import distance_at

from liegroup_core import Simulation, load_scene
from liegroup_core.reference import Reference
from liegroup_core.scene.load import scene_from_text
from liegroup_core.stiffness import STIFF, MethodChoice

GRAVITY = 9.81
EXPLICIT = "rkmk853"
# An explicit method of twelve stages is stable up to about 6 / rate.
REACH = 6.0
# Part of the accuracy. An error below is not set by the tolerance: a motion that decays is resolved by
# substeps that cannot grow faster, and one at the limit of stability is wrong now and then.
TINY = 1e-4
DIGITS = 60  # matrices with rates of 1e9 1/s are squared some forty times


class Sliders:
    """Bodies on prismatic joints in series, with springs and dampers, from rest or with velocities.

    mass, stiffness, damping, start, rate : of each, SI units; start: of the spring's length and its rate
    """

    def __init__(self, mass, stiffness, damping, start, rate):
        n = len(mass)
        below = np.tril(np.ones((n, n)))  # positions from coordinates
        self.start, self._below = start, below
        # Rounding of rates of 1e9 1/s would be seen in the slow motion.
        with mpmath.workdps(DIGITS):
            exact = mpmath.matrix
            self._at = exact([*start, *rate, 1.0])
            self._system = mpmath.zeros(2 * n + 1)
            inverse = mpmath.inverse(exact(below.T) * mpmath.diag(mass) * exact(below))
            force = exact(below.T) * exact([-GRAVITY * mpmath.mpf(m) for m in mass])
            self._system[:n, n : 2 * n] = mpmath.eye(n)
            self._system[n : 2 * n, :n] = -inverse * mpmath.diag(stiffness)
            self._system[n : 2 * n, n : 2 * n] = -inverse * mpmath.diag(damping)
            self._system[n : 2 * n, 2 * n] = inverse * force
        matrix = np.array(self._system.tolist(), dtype=float)
        self.rates = np.linalg.eigvals(matrix[: 2 * n, : 2 * n])
        bodies, joints, forces = [], [], []
        for i, velocity in enumerate(below @ rate):
            body = {"name": f"b{i}", "mass": float(mass[i]), "inertia": [0.01, 0.01, 0.01]}
            bodies.append(body | {"linear_velocity": [0.0, 0.0, float(velocity)]})
            ends = {"parent": f"b{i - 1}" if i else "world", "child": f"b{i}"}
            joints.append({"name": f"j{i}", "type": "prismatic", **ends, "parent_frame": {"axis": [0.0, 0.0, 1.0]}})
            law = {"stiffness": float(stiffness[i]), "damping": float(damping[i]), "rest_position": -float(start[i])}
            forces.append({"name": f"f{i}", "type": "linear_spring_damper", "joint": f"j{i}", **law})
        scene = {"name": "sliders", "gravity": [0.0, 0.0, -GRAVITY], "bodies": bodies, "joints": joints}
        self.scene = scene_from_text(yaml.safe_dump(scene | {"forces": forces}))

    def positions(self, time):
        """Exact positions of the bodies in m."""
        n = len(self._below)
        with mpmath.workdps(DIGITS):
            now = mpmath.expm(self._system * time) * self._at
        return self._below @ (np.array(now.T.tolist()[0], dtype=float)[:n] - self.start)


def random_sliders(seed):
    """Two or three sliders, the stiffest of which decays at 1e5 to 1e9 1/s."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 4))
    mass, damping = rng.uniform(0.5, 2.0, n), 10.0 ** rng.uniform(0.0, 3.0, n)
    damping[rng.integers(n)] = 10.0 ** rng.uniform(5.0, 9.0)
    stiffness = damping * 10.0 ** rng.uniform(-1.0, 1.0, n)
    return Sliders(mass, stiffness, damping, rng.uniform(-0.2, 0.2, n), rng.uniform(-1, 1, n))


def off(sliders, simulation):
    return np.abs(simulation.state()[0][:, 11] - sliders.positions(simulation.time)).max()


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.volume(2)
def test_steps_of_the_implicit_method_do_not_depend_on_stiffness(seed):
    """Steps of a thousand and more time constants of the fast motion, at tolerances of the slow one."""
    sliders, step = random_sliders(seed), 0.01
    assert np.abs(sliders.rates).max() * step > 1e3
    for tolerance in (1e-4, 1e-6, 1e-8):
        simulation = Simulation(sliders.scene, STIFF, step, rtol=tolerance, atol=tolerance, estimate=False)
        simulation.advance(100)
        # The errors of all substeps add up, and decay with the motion.
        assert off(sliders, simulation) <= 100.0 * tolerance
        assert simulation.substeps[0] < 0.1 * np.abs(sliders.rates).max() / REACH


@pytest.mark.parametrize("accuracy", [1e-4, 1e-6, 1e-8])
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.volume(4)
def test_an_accuracy_takes_the_implicit_method_and_is_kept(seed, accuracy):
    """Against the matrix exponential; estimates at least half of all errors that are not tiny."""
    sliders = random_sliders(10 + seed)
    simulation = Simulation(sliders.scene, accuracy=accuracy, horizon=1.0)
    size, evaluations = simulation.promise["length"], simulation._integrator.evaluations
    while simulation.time < 1.0:
        simulation.advance(max(1, round(0.05 / simulation.step)))
        error = off(sliders, simulation) / size
        assert error <= accuracy
        assert error < TINY * accuracy or simulation.largest_error >= 0.5 * error
    assert simulation.method == STIFF and simulation.doubt is None
    # Less than half of what stability alone would take with the explicit method.
    needed = 12.0 * np.abs(sliders.rates).max() / REACH
    assert simulation._integrator.evaluations - evaluations < 0.5 * needed


@pytest.mark.parametrize("horizon", [1.0, 60.0])
@pytest.mark.parametrize("accuracy", [1e-4, 1e-6, 1e-9])
def test_a_light_body_that_a_damper_stops_at_once(accuracy, horizon):
    """Its velocity of 1 m/s decays within 1e-13 s. That takes substeps of less, but only a few of them."""
    sliders = Sliders([1.0, 1e-11], [30.0, 1e3], [1.0, 100.0], [0.1, 0.0], [0.0, 1.0])
    assert np.abs(sliders.rates).max() > 0.99e13
    simulation = Simulation(sliders.scene, accuracy=accuracy, horizon=horizon, quiet=True)
    size = simulation.promise["length"]
    for time in (0.01, 0.1, 0.5, 1.0):
        simulation.advance(round(time / simulation.step) - simulation.steps)
        assert off(sliders, simulation) / size <= accuracy
    assert simulation.substeps[1] < 1000 and simulation.doubt is None


def chain(stiffness, damping, n=3):
    """Bodies on hinges in space whose axes are not parallel, with a stiff torsional spring in each."""
    bodies, joints, forces = [], [], []
    for i in range(n):
        body = {"name": f"b{i}", "mass": 1.0, "inertia": [0.01, 0.02, 0.025], "com": [0.5, 0.0, 0.05]}
        bodies.append(body | {"position": [float(i), 0.0, 0.0]})
        joint = {"name": f"j{i}", "type": "revolute", "parent": f"b{i - 1}" if i else "world", "child": f"b{i}"}
        axis = [0.0, 1.0, 0.2 * i]
        joint["parent_frame"] = {"position": [float(i > 0), 0.0, 0.0], "axis": axis}
        joints.append(joint | {"child_frame": {"axis": axis}})
        law = {"stiffness": stiffness, "damping": damping}
        forces.append({"name": f"s{i}", "type": "torsional_spring_damper", "joint": f"j{i}", **law})
    scene = {"name": "chain", "gravity": [0.0, 0.0, -GRAVITY], "bodies": bodies, "joints": joints, "forces": forces}
    return scene_from_text(yaml.safe_dump(scene))


@pytest.fixture(scope="module")
def in_space():
    """(scene, times, reference at them): the joints decay at some 1e4 1/s."""
    scene, times = chain(2e3, 600.0), np.linspace(0.05, 0.5, 10)
    start = Simulation(scene, STIFF, estimate=False).state()
    exact, uncertainty = Reference(scene, *start, end=0.5).at(times)
    assert max(uncertainty.position.max(), uncertainty.angle.max()) < 1e-13
    return scene, times, exact


@pytest.mark.parametrize("group", ["relative", "se3", "so3xr3"])
@pytest.mark.volume(1)
def test_chains_in_space_against_the_reference(in_space, group):
    scene, times, exact = in_space
    simulation = Simulation(scene, accuracy=1e-5, horizon=1.0, group=group, stabilisation="none")
    size, used = simulation.promise["length"], set()
    for k, time in enumerate(times):
        simulation.advance(round(time / simulation.step) - simulation.steps)
        used.add(simulation.method)
        found = distance_at(simulation.sample(), exact, k)
        error = max(found.position.max() / size, found.angle.max())
        assert error <= 1e-5
        assert error < TINY * 1e-5 or simulation.largest_error >= 0.5 * error
    assert STIFF in used


def spun(accuracy=1e-8):
    """A slider that is stiff, and a free body that begins to spin at 0.2 s: then substeps must follow it."""
    sliders = Sliders([1.0], [100.0], [3e4], [0.01], [0.0])
    text = yaml.safe_load(sliders.scene.text)
    text["bodies"].append({"name": "top", "mass": 1.0, "inertia": [0.01, 0.02, 0.025]})
    simulation = Simulation(scene_from_text(yaml.safe_dump(text)), accuracy=accuracy, horizon=1.0)
    simulation.apply_wrench("top", (40.0, 600.0, 30.0, 0.0, 0.0, 0.0), 0.2017, 0.1)
    return simulation


def test_the_method_follows_the_motion_and_repeats_are_bit_identical():
    """From snapshots before and after changes of the method, with a push inside a step."""
    simulation, methods, kept = spun(), [], []
    assert simulation.method == EXPLICIT  # chosen at the first step
    for k in range(50):
        simulation.advance(1)
        methods.append(simulation.method)
        if k in (0, 11, 19, 33):
            kept.append((simulation.snapshot(), simulation.steps))
    end = simulation.snapshot()
    assert methods[10] == STIFF and methods[-1] == EXPLICIT
    for snapshot, steps in kept:
        for other in (simulation, spun()):
            other.restore(snapshot)
            assert other.steps == steps and other.method == methods[steps - 1]
            other.advance(50 - steps)
            assert other.method == methods[-1]
            assert other.snapshot() == end
    simulation.reset()
    assert simulation.method == EXPLICIT and simulation.advance(1) is None
    assert simulation.method == methods[0]


@pytest.mark.parametrize("name", ["lagrangian_top", "slider_crank", "four_bar"])
def test_where_tolerances_limit_the_steps_nothing_is_tried(name, monkeypatch):
    """Without hard springs a companion with larger tolerances takes longer substeps."""
    simulation, tried = Simulation(load_scene(name), step=0.1, accuracy=1e-6, quiet=True), []
    choose = MethodChoice._choose

    def counted(choice, steps):
        tried.append(simulation.time)
        choose(choice, steps)

    monkeypatch.setattr(MethodChoice, "_choose", counted)
    simulation.advance(200)
    assert len(tried) <= 1, tried  # at the start


def test_a_tolerance_below_rounding_does_not_make_substeps_tiny():
    """Rounding eps of a position makes an error h rate^2 eps of the velocity in a substep h.

    The tolerance is at least 0.03 eps / h. So substeps need not be smaller than 0.17 / rate, where the two are
    equal: 6 rate substeps a second. Twice as many may be taken, as weights of the estimate may exceed 1.
    """
    sliders = Sliders([0.34], [9.8e8], [98.0], [0.02], [0.0])
    rate = np.abs(sliders.rates).max()
    simulation = Simulation(sliders.scene, step=1e-3, accuracy=1e-12)
    simulation.advance(20)
    assert simulation.method == EXPLICIT and simulation._control._tolerance < 1e-14
    assert simulation.substeps[1] < 12.0 * rate * simulation.time
