# SPDX-License-Identifier: Apache-2.0
"""What a model lacks: effects that would explain the residuals of a log, each with its size and share.

An effect is a small change of the model: friction, drag, cogging, a spring, rotor inertia or a constant effort at a
joint, a scaled or lagging commanded effort, another number of a contact, more mass of a body, a force on one that
floats, an offset or a scale of a measurement, a late clock. Its column is the change of the weighted outputs and of the
ends of segments. These are near to the measurements, so that columns are nearly those of the machine; their starts are
tied, so that small effects add up along the log. What starts, delays and numbers explain is projected out of residuals
and columns: the sum of squares that an effect takes away is a score test. Effects are selected one after the other.
"""

import math
from dataclasses import dataclass
from itertools import islice, product

import numpy as np
import scipy

from liegroup_core.threads import one_blas_thread

from .chain import Chain
from .fit import without
from .forced import AXES, VARIABLES, Forced
from .machine import floating

SMALL = 1e-3  # of the loads that occur: size of an effect in its run
MOST = 3  # effects that are named
CLEAR = 25.0  # decrease of the sum of squares of a single effect above which it is not by chance: five deviations
EXPLAINED = 0.9  # part of the sum of squares beyond noise that effects take away, if they explain it
WORTH = 0.02  # share of the sum of squares that a further effect must explain
NO_COLUMN = 1e-6  # relative size of a column that others explain
# The same of delays and numbers: a force is constant in each part of a run, and of a column that numbers explain such
# differences are left. Of what starts explain, nothing below HIDDEN_PART / UNTOLD is told.
UNTOLD, HIDDEN_PART = 0.01, 0.1
WAVES = (1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 14, 16, 20, 24)  # of cogging, a turn
LAG_TIMES = (2e-3, 1e-2, 5e-2)  # s
NUMBERS = {"friction": "1", "stiffness": "N/m", "sinks": "m", "damping": "s/m", "restitution": "1"}  # of contacts
BINS = 8  # of an effort as a function of the motion or of time
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
class Candidate:
    """Effect to be tried: text and unit as of Effect, columns [[(N_s + z,)]] of its k numbers, see `Fit.beside`."""

    text: str
    unit: str
    columns: list


@dataclass(frozen=True, eq=False)
class Missing:
    """Effort that a joint lacks, as a function of its position or velocity, or of time: constant between limits.

    joint, variable, unit : variable: one of VARIABLES; unit of the effort
    at          : (k,) means of the variable between limits with as many parts of the run, rad or m, and per s, or s
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
    p_white     : of correlations as large between successive residuals, see Whiteness; NaN: not tested
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


def channel_fits(fit, solution, white=None, errors=None):
    """[ChannelFit] of all outputs of a Solution; white: its Whiteness, None: not tested; errors: as that takes them."""
    found = []
    segments = fit.runs.segments(solution.point)
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
            dof = max(len(e) * (1.0 - solution.unknowns / max(solution.count, 1)), 1.0)
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
                    math.nan if white is None else white(t, [p], errors),
                )
            )
    return found


def _least(J):
    """Least singular value of columns (m, k)."""
    return np.linalg.svd(J, compute_uv=False)[-1] if J.shape[1] <= J.shape[0] else 0.0


class Effects:
    """Effects that a fitted run may lack.

    fit, solution : Fit, Solution
    finer : outputs with steps of half the size, whose difference no effect may explain; None: not known
    """

    def __init__(self, fit, solution, finer=None):
        self._fit, self._solution = fit, solution
        self._machine, self._freedom = fit.runs.machine(solution.point.values), solution.freedom
        self._forced = Forced(fit.runs, solution.point)
        other = solution.outputs if finer is None else finer
        self._errors = fit.beside(solution.outputs, other, solution.residuals)

    @one_blas_thread()
    def find(self, is_noise):
        """([Effect] one after the other; [Effect] each alone, by share; [Missing], by share; whether they explain all).

        is_noise : whether residuals are: then efforts that depend on position, velocity or time are not tried. They are
                   named only if no other effects explain the residuals.
        """
        listed = self._simple(is_noise)
        chosen, alone, is_explained = self._chosen(listed)
        if is_noise:
            return chosen, alone, [], is_explained
        profiles = self._profiles()
        missing = self._missing(profiles)
        if not (is_explained and len(chosen) == 1):  # several together may imitate one
            listed += self._waves(missing)
            chosen, alone, is_explained = self._chosen(listed)
        if not is_explained:
            chosen, alone, _ = self._chosen([*listed, *(each for each, *_ in profiles)])
        return chosen, alone, missing, is_explained

    def scale(self, t, columns):
        """Effect of one scale of some outputs of a Measured."""
        pairs = list(zip(self._solution.residuals, self._solution.outputs))
        candidate = Candidate(
            "", "1", [[self._only(rest, t, columns, of[t][:, columns], of[-1]) for rest, of in pairs]]
        )
        left, J, _ = self._reduced(candidate.columns)
        return self._effect(candidate, J, left, float(left @ left))

    def _chosen(self, candidates):
        """([Effect] one after the other; [Effect] each alone, by share; whether they explain what is not noise)."""
        if not candidates:
            return [], [], False
        tried = [column for each in candidates for column in each.columns]
        left, columns, sizes = self._reduced([*tried, self._errors])
        ends = np.cumsum([len(each.columns) for each in candidates])
        *columns, errors = np.split(columns, ends, axis=1)
        usable = [
            k
            for k, (J, of) in enumerate(zip(columns, np.split(sizes[:-1], ends[:-1])))
            if _least(J) > UNTOLD * of.min()
        ]
        total, basis, rest, chosen = float(left @ left), np.zeros((len(left), 0)), left, []
        alone = [self._effect(candidates[k], columns[k], left, total) for k in usable]
        for _ in range(MOST):
            best = None
            for k in usable:
                J = without(basis, columns[k])
                if _least(J) <= UNTOLD * _least(columns[k]):
                    continue
                Q = np.linalg.qr(J)[0]
                taken = float(np.sum((Q.T @ rest) ** 2))
                white = max((float(rest @ rest) - taken) / self._freedom, 1.0)
                # One deviation from the mean is the least of a number that is not there.
                score = taken - CLEAR * white * (len(J.T) - 1)
                clear = (np.sqrt(CLEAR * white) + np.linalg.norm(Q.T @ errors)) ** 2
                if (best is None or score > best[0]) and score > clear and taken > WORTH * total:
                    best = score, k, J, Q
            if best is None:
                break
            _, k, J, Q = best
            chosen.append(self._effect(candidates[k], J, rest, total))
            basis, rest = np.hstack([basis, Q]), without(Q, rest)
        is_explained = total - float(rest @ rest) > EXPLAINED * (total - self._freedom)
        return chosen, sorted(alone, key=lambda effect: -effect.share), is_explained

    def _missing(self, profiles):
        """[Missing] of candidates with (joint, variable, unit, means), by share."""
        found = []
        for each, joint, variable, unit, at in profiles:
            left, J, _ = self._reduced(each.columns)
            Q, R = np.linalg.qr(J)
            part, total = Q.T @ left, float(left @ left)
            white = max((total - float(part @ part)) / self._freedom, 1.0)
            if _least(J) <= NO_COLUMN * np.linalg.norm(J):
                continue
            inverse = np.linalg.inv(R)
            deviations, share = np.sqrt(white * np.sum(inverse**2, axis=1)), float(part @ part) / total
            found.append(Missing(joint, variable, unit, at, inverse @ part, deviations, share))
        return sorted(found, key=lambda each: -each.share)

    def _profiles(self):
        """[(Candidate, joint, variable, unit, means (k,))]: efforts that are constant between limits of a variable."""
        found = []
        for joint, effort, load in self._loads():
            motion = np.concatenate(self._forced.middles(joint))
            for x, variable in zip(motion.T, VARIABLES):
                limits = np.unique(np.quantile(x, np.linspace(0.0, 1.0, BINS + 1)))
                if len(limits) > 2:
                    limits[-1] = np.inf
                    pairs = list(zip(limits[:-1], limits[1:]))
                    means = np.array([x[(x >= low) & (x < high)].mean() for low, high in pairs])
                    text = f"an effort at {joint} that depends on {'time' if variable == 'time' else f'its {variable}'}"
                    items = [(variable, (joint, *pair), load) for pair in pairs]
                    found += [(each, joint, variable, effort, means) for each in self._forces([(text, effort, items)])]
        return found

    def _waves(self, missing):
        """[Candidate] of cogging, at the turning joint that lacks most as a function of its position, by [Missing]."""
        joints = [each.joint for each in missing if each.variable == "position" and each.unit == "N m"][:1]
        loads, wanted = {joint: load for joint, _, load in self._loads()}, []
        for joint, n in product(joints, WAVES):
            items = [("wave", (joint, n, part), loads[joint]) for part in (np.sin, np.cos)]
            wanted.append((f"cogging of {joint}, {n} times a turn", "N m", items))
        return self._forces(wanted)

    def _effect(self, candidate, J, rest, total):
        """Effect of columns (m, k); its value is the largest of k, of two the amplitude."""
        Q, R = np.linalg.qr(J)
        part, inverse = Q.T @ rest, np.linalg.inv(R)
        white = max((float(rest @ rest) - float(part @ part)) / self._freedom, 1.0)
        values, share = inverse @ part, float(part @ part) / total if total else 0.0
        deviation = np.sqrt(white * np.sum(inverse**2, axis=1)).max()
        value = values[0] if len(values) == 1 else np.linalg.norm(values) if len(values) == 2 else np.abs(values).max()
        return Effect(candidate.text, float(value), float(deviation), candidate.unit, share)

    def _reduced(self, columns):
        """(m,) residuals and (m, n) columns [[(N_s + z,)]], without what starts, delays and numbers explain.

        And (n,) sizes of columns without what starts alone explain, or of the least that is not round-off.
        """
        parts = []
        for k, (part, linear) in enumerate(zip(self._solution.parts, self._solution.linear)):
            n, added, tie = len(part.rest), np.array([each[k] for each in columns]).T, part.tie
            if tie:
                tie = tie._replace(shared=np.hstack([tie.shared, linear.tie.gap @ added[n:]]))
            parts.append(part._replace(shared=np.hstack([part.shared, added[:n]]), tie=tie))
        chain, g = Chain(parts), len(self._solution.covariance)
        before = [np.linalg.norm(np.concatenate(column)) for column in columns]
        sizes = np.maximum(np.linalg.norm(chain.columns[:, g:], axis=0), HIDDEN_PART * np.array(before))
        return chain.left[g:], chain.columns[g:, g:], sizes  # of a triangular factor

    def _forces(self, wanted):
        """[Candidate] of [(text, unit, [(kind, of, size)])] that need runs; without those whose runs fail."""
        fit, solution = self._fit, self._solution
        items = [item for _, _, items in wanted for item in items]
        runs, found = iter(zip(items, fit.tasks(self._forced, items))), []
        for text, unit, own in wanted:
            columns = []
            for (*_, size), other in islice(runs, len(own)):
                if other is not None:
                    parts = fit.beside(solution.outputs, other, solution.residuals)
                    columns.append([part / size for part in parts])
            if len(columns) == len(own):
                found.append(Candidate(text, unit, columns))
        return found

    def _simple(self, is_noise):
        """[Candidate] of one column: forces, outputs, clocks; lags and friction by load if residuals are no noise."""
        fit, solution = self._fit, self._solution
        outputs, residuals = solution.outputs, solution.residuals
        found = self._forces(
            [
                (text, unit, [tuple(item)])
                for text, unit, *item in self._forces_of_scene()
                if not is_noise or item[0] not in ("by_load", "lag")
            ]
        )
        segments = fit.runs.segments(solution.point)
        efforts = {each.name.removesuffix(".effort"): k for k, each in enumerate(fit.runs.log.inputs)}
        for t, each in enumerate(fit.runs.log.measured):
            for p, name in enumerate(each.channels):
                pairs, units = list(zip(residuals, outputs)), fit.runs.machine(solution.point.values).outputs[t].units
                offset = [self._only(rest, t, p, 1.0, of[-1]) for rest, of in pairs]
                found.append(Candidate(f"offset of {name} in {each.name}", units[p] or "", [offset]))
                scale = [self._only(rest, t, p, of[t][:, p], of[-1]) for rest, of in pairs]
                found.append(Candidate(f"scale of {name} in {each.name}", "1", [scale]))
                joint, _, part = name.rpartition(".")
                if part == "position" and joint in efforts:
                    loads = [
                        s.inputs[np.maximum(s.places[t] - 1, 0), efforts[joint]] for s in segments if len(s.inputs)
                    ]
                    if len(loads) == len(pairs):
                        bent = [self._only(rest, t, p, load, of[-1]) for (rest, of), load in zip(pairs, loads)]
                        found.append(Candidate(f"flexibility of {joint}", f"{units[p]}/(effort)", [bent]))
        known = np.flatnonzero(~fit.free)
        late = fit.late(solution.point, outputs, residuals, known)
        longest = max(last - first for first, last in fit.runs.log.spans)
        for k, t in enumerate(known):
            parts = [part[:, k] for part in late]
            if np.linalg.norm(np.concatenate(parts)) * longest > 1.0:  # else any delay fits
                found.append(Candidate(f"delay of {fit.runs.log.measured[t].name}", "s", [parts]))
        return found

    def _only(self, residuals, t, p, values, gap):
        """(N_s + z,) weighted change of one output."""
        parts = [np.where(np.isfinite(part), 0.0, np.nan) for part in residuals]
        parts[t][:, p] += values
        return np.concatenate([self._fit.weighted(parts), 0.0 * gap])

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

    def _forces_of_scene(self):
        """[(text, unit, kind, joint or body or number of an input, size)] of effects that need a run."""
        scene, log = self._machine.layout.scene, self._fit.runs.log
        found = []
        for joint, effort, load in self._loads():
            q = "rad" if effort == "N m" else "m"
            for text, unit, kind in (
                ("dry friction of", effort, "coulomb"),
                ("viscous friction of", f"{effort} s/{q}", "viscous"),
                ("quadratic drag of", f"{effort} s^2/{q}^2", "drag"),
                ("friction by load of", "m" if q == "rad" else "1", "by_load"),
                ("constant effort at", effort, "constant"),
                ("stiffness of", f"{effort}/{q}", "spring"),
                ("rotor inertia of", "kg m^2" if q == "rad" else "kg", "armature"),
            ):
                found.append((f"{text} {joint}", unit, kind, joint, load))
        for k, given in enumerate(log.inputs):
            if given.name.endswith(".effort"):
                found.append((f"scale of {given.name}", "1", "scale", (k,), SMALL))
                found += [
                    (f"second-order lag of {given.name} by {1e3 * lag:g} ms", "1", "lag", (k, lag), SMALL)
                    for lag in LAG_TIMES
                ]
        for force in scene.forces:
            for key in NUMBERS if force.type == "contact" else ():
                if value := getattr(force, key):
                    # Downwards: a restitution of 1 has none above.
                    item = f"{key} of {force.name}", NUMBERS[key], "number", f"forces.{force.name}.{key}"
                    found.append((*item, -SMALL * value))
        small = SMALL * sum(body.mass for body in scene.bodies)
        found += [(f"mass of {body.name}", "kg", "mass", body.name, small) for body in scene.bodies]
        for body in floating(self._machine.layout):
            found += [(f"force on {body} along {axis}", "N", axis, body, SMALL * self._weight) for axis in AXES]
        return found
