# SPDX-License-Identifier: Apache-2.0
"""Outputs that were logged in another unit, or with the opposite sign: effects that are too large for derivatives.

Some outputs are divided by a factor, and one run is fitted to the first measurements: to more and more of them, as long
as the model is near. A factor is an effect if its run is several times as long as that of the log as it is.
"""

from dataclasses import replace
from itertools import product

import numpy as np

from liegroup_core.errors import LieGroupSimError

from .contradictions import Effects

KINDS = (("rad", "rad/s"), ("m", "m/s"))
# What outputs with a unit then have.
FACTORS = {
    1000.0: lambda unit: f"the unit m{unit}",
    180.0 / np.pi: lambda unit: f"the unit {unit.replace('rad', 'degree')}",
    -1.0: lambda unit: "the opposite sign",
}
MESSAGES = 400  # that are tried
LONGER = 4.0  # than the run of the log as it is
# Deviation of an angle in rad from which on it shows no direction: uniform ones have 1.8, and the mean of normal ones
# with this deviation has a length of exp(-1/2).
NO_DIRECTION = 1.0


def no_direction(fit):
    """Names of angles that are as random as directions."""
    outputs = fit.runs.machine(fit.runs.numbers.values).outputs
    pairs = zip(outputs, fit.deviation)
    return [name for of, sigma in pairs for name in np.array(of.names)[of.angles & (sigma > NO_DIRECTION)]]


def scale(longest, fit):
    """Effect of the group of outputs that has another unit, or the opposite sign; None: none.

    longest : function of (log, s of interest), which returns (Fit, s of the longest run in which the model is near,
              Solution)
    """
    outputs, best = fit.runs.machine(fit.runs.numbers.values).outputs, None
    log = _first(fit.runs.log)
    least, (first, last) = LONGER * _tried(longest, log, 0.0)[1], log.spans[0]
    for t, columns, factor in _candidates(log, outputs) if least <= last - first else ():
        one, length, solution = _tried(longest, _divided(log, t, columns, factor), least)
        if length >= least and length > 0.0:
            least = length * (1.0 + 1e-9)
            found = Effects(one, solution).scale(t, columns)
            best = replace(
                found,
                text=_text(log.measured[t], columns, [outputs[t].units[k] for k in columns], factor),
                value=factor * (1.0 + found.value),
                deviation=abs(factor) * found.deviation,
                share=_explained(one, solution, t, columns),
            )
    return best


def _text(measured, columns, units, factor):
    """Text of an Effect."""
    names, them = ", ".join(measured.channels[k] for k in columns), "it seems" if len(columns) == 1 else "they seem"
    found = " and ".join(dict.fromkeys(map(FACTORS[factor], units)))
    return f"scale of {names} in {measured.name} ({them} to have {found})"


def _tried(longest, log, least):
    """(Fit, s of the longest run, Solution) of a Log; 0 s if none is near, or angles show no direction."""
    try:
        fit, length, solution = longest(log, least)
    except LieGroupSimError:
        return None, 0.0, None
    return fit, 0.0 if no_direction(fit) else length, solution


def _first(log):
    """Log of the first measurements."""
    fullest = max(log.measured, key=lambda each: len(each.times))
    end = min(fullest.times[:MESSAGES][-1], log.spans[0][1])
    counts = [max(1, int((each.times <= end).sum())) for each in log.measured]
    measured = [
        replace(each, times=each.times[:n], values=each.values[:n], deviation=each.noise)
        for each, n in zip(log.measured, counts)
    ]
    return replace(log, measured=tuple(measured), parts=())


def _divided(log, t, columns, factor):
    """Log with some columns of a Measured divided by a factor."""
    size = np.ones(len(log.measured[t].channels))
    size[list(columns)] = factor
    one = log.measured[t]
    one = replace(one, values=one.values / size, deviation=one.deviation / np.abs(size))
    return replace(log, measured=(*log.measured[:t], one, *log.measured[t + 1 :]))


def _candidates(log, outputs):
    """[(number of a Measured, columns, factor)]: of one kind, all of a clock, those of each joint or body, and each."""
    groups = {}
    for (t, of), kind in product(enumerate(outputs), KINDS):
        own = [k for k, unit in enumerate(of.units) if unit in kind and np.isfinite(log.measured[t].values[:, k]).any()]
        owners = [of.names[k].rpartition(".")[0] for k in own]
        parts = [[k for k, owner in zip(own, owners) if owner == name] for name in dict.fromkeys(owners)]
        groups |= {(t, tuple(columns)): kind for columns in (own, *parts, *([k] for k in own)) if columns}
    return [
        (*group, f) for group, kind in groups.items() for f in FACTORS if f < 0.0 or f == 1000.0 or kind is KINDS[0]
    ]


def _explained(fit, solution, t, columns):
    """Share of the sum of squares of the values of some outputs that a Solution explains."""
    rest = np.vstack([parts[t][:, columns] for parts in solution.residuals])
    values = np.vstack([of[t][:, columns] for of in solution.outputs])
    return float(1.0 - np.nansum(rest**2) / np.nansum((rest + values) ** 2))
