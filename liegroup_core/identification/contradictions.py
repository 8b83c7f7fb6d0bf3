# SPDX-License-Identifier: Apache-2.0
"""What a model lacks: effects that would explain the residuals of a log, each with its size and share.

An effect is a small change of the model: friction, a spring, rotor inertia or a constant effort at a joint, a scaled
commanded effort, more mass of a body, a force on one that floats, an offset or a scale of a measurement, a late clock.
Its column is the change of the weighted outputs along the fitted run. What starts and delays explain is projected out
of residuals and columns, so that the sum of squares that an effect takes away is a score test. Effects are selected one
after the other.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy

from liegroup_core.errors import SimulationError
from liegroup_core.threads import one_blas_thread

from .fit import without
from .machine import floating
from .starts import PARTS

SMALL = 1e-3  # of the loads that occur: size of an effect in its run
AXES = ("x", "y", "z")  # of the world
MOST = 3  # effects that are named
CLEAR = 25.0  # decrease of the sum of squares of a single effect above which it is not by chance: five deviations
WORTH = 0.02  # share of the sum of squares that a further effect must explain
NO_COLUMN = 1e-6  # relative size of a column that starts and delays explain
LAGS = 20  # of the test of whiteness
BINS = 8  # of an effort as a function of the motion
# Standard deviations, by the root of the count: of an rms, and of it by the noise that third differences give. The
# median of absolute values has an efficiency of 0.37, and third differences are correlated.
SPREAD_OF_RMS, SPREAD_OF_NOISE = 0.71, np.hypot(0.71, 1.16 * 1.52)
SURE = 4.0


@dataclass(frozen=True)
class Effect:
    """Effect that explains residuals.

    text  : such as "dry friction of shoulder"
    value, deviation, unit : least-squares estimate, linear about the model
    share : of the sum of squares of the residuals, after the effects named before
    """

    text: str
    value: float
    deviation: float
    unit: str
    share: float


@dataclass(frozen=True, eq=False)
class Missing:
    """Effort that a joint lacks, as a function of its position or velocity: constant between limits.

    joint, variable, unit : variable: "position" or "velocity"; unit of the effort
    at          : (k,) means of the variable between limits with as many parts of the run, rad or m, and per s
    values, deviations : (k,) least-squares efforts, linear about the model
    share       : of the sum of squares of the residuals
    """

    joint: str
    variable: str
    unit: str
    at: np.ndarray
    values: np.ndarray
    deviations: np.ndarray
    share: float


@dataclass(frozen=True)
class ChannelFit:
    """Residuals of one output.

    name, count : of the output and its measurements
    deviation   : of the noise, given or estimated
    rms, largest, time : of the residuals, and when the largest occurs in s
    chi         : rms by deviation
    limit       : of chi, that noise exceeds with a probability below 1e-4
    p_chi       : probability of a sum of squares as large, or larger, by noise alone
    p_white     : of correlations as large between successive residuals (Ljung and Box 1978)
    """

    name: str
    count: int
    deviation: float
    rms: float
    largest: float
    time: float
    chi: float
    limit: float
    p_chi: float
    p_white: float


def channel_fits(fit, solution):
    """[ChannelFit] of all outputs of a Solution."""
    found = []
    segments = fit.runs.segments(solution.point)
    unknowns = sum(basis.shape[1] for basis in solution.bases) + solution.columns.shape[1]
    total = sum(int(np.isfinite(part).sum()) for parts in solution.residuals for part in parts)
    for t, each in enumerate(fit.runs.log.measured):
        parts = [residuals[t] for residuals in solution.residuals]
        times = np.concatenate([each.times[segment.rows[t]] for segment in segments])
        rest = np.concatenate(parts)
        for p, name in enumerate(each.channels):
            known = np.isfinite(rest[:, p])
            e, sigma = rest[known, p], fit.deviation[t][p]
            if not len(e):
                continue
            spread = SPREAD_OF_RMS if np.isfinite(each.deviation[p]) else SPREAD_OF_NOISE
            dof = max(len(e) * (1.0 - unknowns / max(total, 1)), 1.0)
            square, far = float(e @ e), int(np.abs(e).argmax())
            found.append(
                ChannelFit(
                    name,
                    len(e),
                    float(sigma),
                    float(np.sqrt(square / len(e))),
                    float(np.abs(e[far])),
                    float(times[known][far]),
                    float(np.sqrt(square / dof) / sigma),
                    float(1.0 + SURE * spread / np.sqrt(len(e))),
                    float(scipy.stats.chi2.sf(square / sigma**2, dof)),
                    _white([part[np.isfinite(part[:, p]), p] for part in parts]),
                )
            )
    return found


def _white(parts):
    """Probability of Ljung and Box's statistic of residuals, with correlations within each segment only."""
    count, square = sum(map(len, parts)), sum(float(e @ e) for e in parts)
    lags = min(LAGS, max(map(len, parts)) // 4)
    if not lags or not square:
        return 1.0
    total = 0.0
    for lag in range(1, lags + 1):
        correlation = sum(float(e[lag:] @ e[:-lag]) for e in parts if len(e) > lag) / square
        total += correlation**2 / (count - lag)
    return float(scipy.stats.chi2.sf(count * (count + 2) * total, lags))


class Effects:
    """Effects that a fitted run may lack.

    fit, solution : Fit, Solution
    """

    def __init__(self, fit, solution):
        self._fit, self._solution = fit, solution
        self._machine = fit.runs.machine(solution.point.values)
        d = int(fit.free.sum())
        self._late = np.linalg.qr(solution.columns[:, :d])[0] if d else np.zeros((len(solution.left), 0))
        self._left = self._without_delays(solution.left)

    @one_blas_thread()
    def find(self):
        """([Effect] of largest share, one after the other; [Effect] each alone, by share)."""
        names, columns, units = self._columns()
        if not len(names):
            return [], []
        sizes = np.linalg.norm(columns, axis=0)
        kept = sizes > NO_COLUMN * np.array([unit[1] for unit in units])
        names, units = ([each for each, keep in zip(of, kept) if keep] for of in (names, units))
        columns = columns[:, kept]
        total = float(self._left @ self._left)
        alone = sorted(
            (self._effect(names[k], units[k], columns[:, k], self._left, total) for k in range(len(names))),
            key=lambda effect: -effect.share,
        )
        chosen, rest, basis = [], self._left, np.zeros((len(self._left), 0))
        for _ in range(min(MOST, len(names))):
            left = without(basis, columns)
            norms = np.linalg.norm(left, axis=0)
            usable = norms > 1e-3 * np.linalg.norm(columns, axis=0)
            taken = np.where(usable, (left.T @ rest) ** 2 / np.maximum(norms, 1e-300) ** 2, 0.0)
            k = int(taken.argmax())
            white = float(rest @ rest) / len(rest)
            if taken[k] < CLEAR * max(white, 1.0) or taken[k] < WORTH * total:
                break
            chosen.append(self._effect(names[k], units[k], left[:, k], rest, total))
            basis = np.column_stack([basis, left[:, k] / norms[k]])
            rest = rest - basis[:, -1] * (basis[:, -1] @ rest)
        return chosen, alone

    @one_blas_thread()
    def missing(self):
        """[Missing] of each joint with one coordinate, of position and of velocity, largest share first.

        Friction shows as a step or a slope against the velocity, a spring as a slope against the position.
        """
        fit, solution = self._fit, self._solution
        forced, found = _Forced(fit.runs, solution.point), []
        total = float(self._left @ self._left)
        for joint, effort, load in self._loads():
            for k, variable in enumerate(PARTS):
                x = np.concatenate([part[:, k] for part in forced.middles(joint)])
                limits = np.unique(np.quantile(x, np.linspace(0.0, 1.0, BINS + 1)))
                if len(limits) < 3:
                    continue
                limits[-1] = np.inf
                pairs = list(zip(limits[:-1], limits[1:]))
                items = [(variable, (joint, *pair), load) for pair in pairs]
                runs = fit.tasks(forced, items)
                if any(run is None for run in runs):
                    continue
                beside = [fit.beside(solution.outputs, run, solution.residuals) for run in runs]
                J = np.array([self._projected([part / load for part in parts]) for parts in beside]).T
                Q, R = np.linalg.qr(J)
                if np.abs(np.diag(R)).min() <= NO_COLUMN * np.abs(np.diag(R)).max():
                    continue
                part = Q.T @ self._left
                white = max((total - float(part @ part)) / len(self._left), 1.0)
                inverse = np.linalg.inv(R)
                at = np.array([x[(x >= low) & (x < high)].mean() for low, high in pairs])
                deviations = np.sqrt(white * np.sum(inverse**2, axis=1))
                share = float(part @ part) / total if total else 0.0
                found.append(Missing(joint, variable, effort, at, inverse @ part, deviations, share))
        return sorted(found, key=lambda each: -each.share)

    def _effect(self, text, unit, column, rest, total):
        square = float(column @ column)
        value = float(column @ rest) / square
        white = max(float(rest @ rest) / len(rest), 1.0)
        share = value**2 * square / total if total else 0.0
        return Effect(text, value, float(np.sqrt(white / square)), unit[0], share)

    def _without_delays(self, columns):
        return without(self._late, columns)

    def _projected(self, parts):
        """(N,) column of parts [(N_s,)] without what starts and delays explain."""
        rest = [without(U, part) for part, U in zip(parts, self._solution.bases)]
        return self._without_delays(np.concatenate(rest))

    def _columns(self):
        """Texts, columns (N, c) and [(unit, size of the column before the projection)] of all effects."""
        fit, solution = self._fit, self._solution
        forces = self._forces()
        outputs, residuals = solution.outputs, solution.residuals
        runs = fit.tasks(_Forced(fit.runs, solution.point), [(kind, of, size) for _, _, kind, of, size in forces])
        names, columns, units = [], [], []

        def add(text, unit, parts):
            names.append(text)
            columns.append(self._projected(parts))
            units.append((unit, float(np.linalg.norm(np.concatenate(parts)))))

        for (text, unit, _, _, size), other in zip(forces, runs):
            if other is not None:
                add(text, unit, [part / size for part in fit.beside(outputs, other, residuals)])
        for t, each in enumerate(fit.runs.log.measured):
            for p, name in enumerate(each.channels):
                offset = [self._only(rest, t, p, 1.0) for rest in residuals]
                add(f"offset of {name} in {each.name}", "", offset)
                scale = [self._only(rest, t, p, values[t][:, p]) for rest, values in zip(residuals, outputs)]
                add(f"scale of {name} in {each.name}", "1", scale)
        known = np.flatnonzero(~fit.free)
        late = fit.late(solution.point, outputs, residuals, known)
        longest = max(last - first for first, last in fit.runs.log.spans)
        for k, t in enumerate(known):
            parts = [part[:, k] for part in late]
            if np.linalg.norm(np.concatenate(parts)) * longest > 1.0:  # else any delay fits
                add(f"delay of {fit.runs.log.measured[t].name}", "s", parts)
        return names, np.array(columns).T, units

    def _only(self, residuals, t, p, values):
        """(N_s,) weighted change of one output."""
        parts = [np.where(np.isfinite(part), 0.0, np.nan) for part in residuals]
        parts[t][:, p] += values
        return self._fit.weighted(parts)

    @property
    def _weight(self):
        """N, of all bodies; at least at 1 m/s^2."""
        scene = self._machine.layout.scene
        return sum(body.mass for body in scene.bodies) * max(float(np.linalg.norm(scene.gravity)), 1.0)

    def _loads(self):
        """[(joint, unit of its effort, small effort)] of joints with one coordinate that are not driven."""
        layout, weight, found = self._machine.layout, self._weight, []
        for joint in layout.unit_efforts:
            if joint not in layout.motions and joint in layout.coordinates.names:
                turns = layout.coordinates.units.get(joint) == "rad"
                found.append((joint, "N m" if turns else "N", SMALL * weight * (layout.size if turns else 1.0)))
        return found

    def _forces(self):
        """[(text, unit, kind, joint or body or number of an input, size)] of effects that need a run."""
        scene, log = self._machine.layout.scene, self._fit.runs.log
        found = []
        for joint, effort, load in self._loads():
            q = "rad" if effort == "N m" else "m"
            for text, unit, kind in (
                ("dry friction of", effort, "coulomb"),
                ("viscous friction of", f"{effort} s/{q}", "viscous"),
                ("constant effort at", effort, "constant"),
                ("stiffness of", f"{effort}/{q}", "spring"),
                ("rotor inertia of", "kg m^2" if q == "rad" else "kg", "armature"),
            ):
                found.append((f"{text} {joint}", unit, kind, joint, load))
        for k, given in enumerate(log.inputs):
            if given.name.endswith(".effort"):
                found.append((f"scale of {given.name}", "1", "scale", k, SMALL))
        small = SMALL * sum(body.mass for body in scene.bodies)
        found += [(f"mass of {body.name}", "kg", "mass", body.name, small) for body in scene.bodies]
        for body in floating(self._machine.layout):
            found += [(f"force on {body} along {axis}", "N", axis, body, SMALL * self._weight) for axis in AXES]
        return found


class _Forced:
    """Runs with an effect, as a function of (kind, joint or body or input, size); None where a run fails."""

    def __init__(self, runs, point):
        self._runs, self._point, self._paths = runs, point, {}

    def __call__(self, item):
        kind, of, size = item
        machine = self._runs.machine(self._point.values)
        found = []
        try:
            for segment, state in zip(self._runs.segments(self._point), self._point.states):
                run, extra = segment, None
                if kind == "scale":
                    inputs = segment.inputs.copy()
                    inputs[:, of] *= 1.0 + size
                    run = replace(segment, inputs=inputs)
                elif len(segment.inputs):
                    extra = size * self._extra(machine, segment, state, kind, of)
                found.append(machine.run(run, state, extra, halves=self._point.halves))
        except SimulationError:
            return None
        return found

    def _extra(self, machine, segment, state, kind, of):
        """(m, n, COLUMNS) change of the wrenches in the parts of a Segment by an effect of unit size."""
        path, steps = self._path(machine, segment, state), np.diff(segment.times)
        if kind == "mass":
            body = list(machine.layout.body_names).index(of)
            # Of the frame at the centre of mass, in the middle of each part, body axes.
            twist, turn = path.twists[:, body], path.poses[:, body, :9].reshape(-1, 3, 3)
            w, v = 0.5 * (twist[1:, :3] + twist[:-1, :3]), 0.5 * (twist[1:, 3:] + twist[:-1, 3:])
            a = np.diff(twist[:, 3:], axis=0) / steps[:, None] + np.cross(w, v)
            change = np.zeros_like(path.wrenches)
            change[:, body, 3:6] = np.array(machine.layout.scene.gravity) @ (0.5 * (turn[1:] + turn[:-1])) - a
            return change
        if kind in AXES:
            body = list(machine.layout.body_names).index(of)
            turn = path.poses[:, body, :9].reshape(-1, 3, 3)[:, AXES.index(kind)]
            change = np.zeros_like(path.wrenches)
            change[:, body, 3:6] = 0.5 * (turn[1:] + turn[:-1])
            return change
        if kind in PARTS:
            joint, low, high = of
            x = _middle(machine, path, joint)[:, PARTS.index(kind)]
            return ((x >= low) & (x < high))[:, None, None] * machine.effort(joint)
        q, v = path.joints[:, machine.layout.coordinates.names.index(of)].T
        middle = 0.5 * (v[1:] + v[:-1])
        amount = {
            "coulomb": lambda: -np.sign(middle),
            "viscous": lambda: -middle,
            "constant": lambda: np.ones_like(middle),
            "spring": lambda: -0.5 * (q[1:] + q[:-1]),
            "armature": lambda: -np.diff(v) / steps,
        }[kind]()
        return amount[:, None, None] * machine.effort(of)

    def _path(self, machine, segment, state):
        """Path of the fitted run at all times of a Segment."""
        key = segment.start
        if key not in self._paths:
            self._paths[key] = machine.path(segment, state, np.arange(len(segment.times)), halves=self._point.halves)
        return self._paths[key]

    def middles(self, joint):
        """[(m, 2)] positions and velocities of a joint in the middle of the parts of each segment."""
        machine = self._runs.machine(self._point.values)
        pairs = zip(self._runs.segments(self._point), self._point.states)
        return [_middle(machine, self._path(machine, *pair), joint) for pair in pairs]


def _middle(machine, path, joint):
    x = path.joints[:, machine.layout.coordinates.names.index(joint)]
    return 0.5 * (x[1:] + x[:-1])
