# SPDX-License-Identifier: Apache-2.0
"""Experiment design: the motion of some joints, within limits, that would sharpen numbers of a scene most.

A motion is the quintic spline through equally distant points, at rest at both ends. Chosen joints are driven along it,
against their friction, the others move as the scene says. From the efforts of the drives and the noise of what would be
measured follow the standard deviations of the numbers, as those of a fit. Points are chosen at random, then changed one
motion after the other as long as that makes the product of the deviations smaller.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from liegroup_core.errors import SceneError, SimulationError
from liegroup_core.layout import make_layout
from liegroup_core.linear.channels import OutputChannels
from liegroup_core.linear.numbers import Numbers
from liegroup_core.linear.probe import Probe
from liegroup_core.simulation import Simulation

from .comparison import SLACKS, in_short_steps
from .fit import Fit
from .log import LINEAR, Given, Log, Measured
from .machine import PRESCRIBED, law_of_driven
from .runs import Runs, Unknowns, longest_step
from .starts import first_states

POINTS = 8  # of a motion, after its start
TRIES, STEPS = 12, 24  # motions at random, and changes of the best one
FIRST_SIZE, LAST_SIZE = 0.5, 0.05  # of changes, by the range of a joint
AT_REST = [(1, 0.0), (2, 0.0)]  # derivatives at an end
PART = 0.5  # s, of the segments: differences grow little in them


@dataclass(frozen=True, eq=False)
class Move:
    """Limits of the motion of a joint: positions in rad or m, and the largest speed in rad/s or m/s."""

    joint: str
    low: float
    high: float
    speed: float = np.inf


@dataclass(frozen=True, eq=False)
class Plan:
    """The best motion that was found.

    paths, values : of the q numbers
    joints     : names of the m joints that move
    times      : (k,) s;  positions, rates, efforts : (k, m)
    deviations : (q,) standard deviations of the numbers from a log of this motion
    alone      : {joint: (q,)} likewise, of the best motions that were found of one joint
    """

    paths: tuple
    values: np.ndarray
    joints: tuple
    times: np.ndarray
    positions: np.ndarray
    rates: np.ndarray
    efforts: np.ndarray
    deviations: np.ndarray
    alone: dict


def plan(scene, names, moves, measured, seconds=5.0, rate=100.0, seed=0, workers=None):
    """Plan of a motion of some joints for numbers of a scene.

    names    : of the numbers, as `liegroup_sim sweep --vary` takes them
    moves    : [Move]
    measured : {output: standard deviation}, names as those of a log
    seconds, rate : of the log, in s and Hz
    Raises SceneError for unknown names, limits that exclude the start, and motions that cannot be simulated.
    """
    made = _Motions(scene, names, moves, measured, seconds, rate, workers)
    rng, alone = np.random.default_rng(seed), {}
    for k, move in enumerate(moves if len(moves) > 1 else ()):
        alone[move.joint] = made.best(rng, [k])
    best = made.best(rng, range(len(moves)), list(alone.values()))
    if best is None:
        raise SceneError("no motion within the limits can be simulated")
    return Plan(
        made.numbers.paths,
        made.numbers.values,
        tuple(move.joint for move in moves),
        *best.motion,
        best.deviations,
        {joint: found.deviations for joint, found in alone.items() if found is not None},
    )


@dataclass(frozen=True, eq=False)
class _Found:
    """Points (POINTS, m) of a motion, (times, positions, rates, efforts), deviations of the numbers, and their size."""

    points: np.ndarray
    motion: tuple
    deviations: np.ndarray
    size: float


class _Motions:
    """Motions of the joints of a scene, with the deviations that they give."""

    def __init__(self, scene, names, moves, measured, seconds, rate, workers):
        self._scene, self._moves, self._measured = scene, moves, dict(measured)
        self._seconds, self._rate, self._names, self._workers = seconds, rate, names, workers
        start = Simulation(scene, "rkmk4", 1.0 / rate, estimate=False, quiet=True).sample().joint_coordinates
        joints = {joint.name: joint for joint in scene.joints}
        for move in moves:
            if move.joint not in start:
                raise SceneError(f"{move.joint} is no joint with one coordinate: choose one of {', '.join(start)}")
            if not move.low <= start[move.joint][0] <= move.high or not move.low < move.high or not move.speed > 0.0:
                raise SceneError(
                    f"{move.joint} starts at {start[move.joint][0]:.6g}: its limits must include that, from low to "
                    "high, and its speed be positive"
                )
            stops = joints[move.joint].limits
            if stops is not None and not stops.least <= move.low < move.high <= stops.largest:
                raise SceneError(f"{move.joint}: plan a motion between its stops, {stops.least:g} to {stops.largest:g}")
        self._start = np.array([start[move.joint][0] for move in moves])
        self._knots = np.linspace(0.0, seconds, POINTS + 1)
        self.numbers = Numbers(scene, list(names))
        try:
            self._laws = [(k, law_of_driven(joints[m.joint])) for k, m in enumerate(moves) if joints[m.joint].friction]
            make_layout(self._driven(np.tile(self._start, (POINTS, 1))))
        except SceneError as error:
            raise SceneError(f"a plan drives the joints that move: {error}") from None

    def best(self, rng, chosen, before=()):
        """_Found with the smallest deviations of motions of some joints, from motions found before on; None: none."""
        chosen, m = list(chosen), len(self._moves)
        moving = np.isin(np.arange(m), chosen)
        ranges = np.array([move.high - move.low for move in self._moves])
        low = np.array([move.low for move in self._moves])
        tries = [low + ranges * rng.uniform(size=(POINTS, m)) for _ in range(TRIES)]
        found = [self._of(np.where(moving, points, self._start)) for points in tries]
        best = min((each for each in (*found, *before) if each is not None), key=lambda each: each.size, default=None)
        for k in range(STEPS if best is not None else 0):
            size = FIRST_SIZE * (LAST_SIZE / FIRST_SIZE) ** (k / (STEPS - 1))
            change = np.where(moving, size * ranges * rng.standard_normal((POINTS, m)), 0.0)
            other = self._of(best.points + change)
            if other is not None and other.size < best.size:
                best = other
        return best

    def _of(self, points):
        """_Found of points, which come nearer to the start where the motion would leave its limits; None: no motion."""
        points = points.copy()
        fine = np.linspace(0.0, self._seconds, 500 * POINTS)
        for k, move in enumerate(self._moves):
            curve = self._curve(points[:, k], k)
            way, speed = curve(fine) - self._start[k], np.abs(curve(fine, 1)).max()
            room = [
                (move.high - self._start[k]) / max(way.max(), 1e-300),
                (self._start[k] - move.low) / max(-way.min(), 1e-300),
                move.speed / max(speed, 1e-300),
            ]
            points[:, k] = self._start[k] + min(1.0, *room) * (points[:, k] - self._start[k])
        try:
            motion, outputs = self._simulated(points)
            deviations = self._deviations(motion, outputs)
        except SimulationError:
            return None
        size = float(np.log(np.minimum(deviations / self.numbers.scales, 1e12)).mean())
        return _Found(points, motion, deviations, size)

    def _curve(self, points, k):
        """Spline of joint k; the motion of a driven joint with its positions, rates and accelerations is the same."""
        return scipy.interpolate.make_interp_spline(
            self._knots, [self._start[k], *points], 5, bc_type=(AT_REST, AT_REST)
        )

    def _driven(self, points):
        """Scene whose joints follow points; neither their stops nor their friction act."""
        motions = {
            move.joint: {
                "times": self._knots.tolist(),
                "positions": [self._start[k], *points[:, k].tolist()],
                "velocities": curve(self._knots, 1).tolist(),
                "accelerations": [*curve(self._knots[:-1], 2).tolist(), 0.0],
            }
            for k, move in enumerate(self._moves)
            for curve in [self._curve(points[:, k], k)]
        }
        joints = [
            joint.remade(**PRESCRIBED | {"motion": motions[joint.name]}) if joint.name in motions else joint
            for joint in self._scene.joints
        ]
        return self._scene.remade(joints=joints)

    def _simulated(self, points):
        """(times, positions, rates, efforts) of the joints, and outputs (k, p)."""
        simulation = Simulation(self._driven(points), "rkmk4", 0.5 / self._rate, estimate=False, quiet=True)
        count = int(self._seconds * self._rate) + 1
        probe = Probe(simulation)
        outputs, rows, motion = OutputChannels(probe, list(self._measured)), [], []
        for _ in range(count):
            sample = simulation.sample()
            rows.append(outputs.of(sample))
            motion.append(
                [(*sample.joint_coordinates[move.joint], sample.drive_efforts[move.joint]) for move in self._moves]
            )
            simulation.advance(2)
        positions, rates, efforts = np.array(motion).transpose(2, 0, 1)
        for k, law in self._laws:
            efforts[:, k] += law.against(rates[:, k])
        return (np.arange(count) / self._rate, positions, rates, efforts), np.array(rows)

    def _deviations(self, motion, outputs):
        """(q,) standard deviations of the numbers from a log of a motion."""
        times, _, _, efforts = motion
        given = tuple(Given(f"{move.joint}.effort", times, efforts[:, k], LINEAR) for k, move in enumerate(self._moves))
        noise = np.array(list(self._measured.values()), dtype=float)
        log = Log(given, (Measured("plan", times, tuple(self._measured), outputs, noise, 0.0),))
        runs = Runs(self._scene, log, self._names, longest_step(self._scene))
        fit = Fit(runs, [noise], [False], workers=self._workers)
        ends = np.linspace(0.0, times[-1] + 1e-6, max(1, round(times[-1] / PART)) + 1)
        bounds, delays = np.column_stack([ends[:-1], ends[1:]]), np.zeros(1)
        point = Unknowns(bounds, delays, runs.numbers.values, first_states(runs, bounds, delays))
        return (
            np.sqrt(np.diag(fit.solution(in_short_steps(fit, point), slack=SLACKS[-1]).covariance))
            * runs.numbers.scales
        )
