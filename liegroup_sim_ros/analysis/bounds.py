# SPDX-License-Identifier: Apache-2.0
"""Check of figures against bounds on error and drift."""

import math

from .estimate import error_of


def find_exceeded(found, max_error=None, max_drift=None):
    """Messages on bounds that recordings exceed, or that cannot be checked."""
    exceeded = []
    for figures in found:
        if "failed" in figures:
            continue
        log = figures["log"]
        if max_error is not None:
            errors, why = error_of(figures)
            if errors is None:
                exceeded.append(f"{log}: its error is unknown: {why}")
            elif why is None:
                exceeded += [
                    f"{log}: {text}" for name in ("position", "angle") if (text := _too_large(errors[name], max_error))
                ]
                if errors.get("stopped"):
                    exceeded.append(f"{log}: {errors['stopped']}")
            exceeded += [
                f"{log}: recorded estimate of the error {entry['max']:.3g} {entry['unit']} exceeds {max_error:g}"
                for entry in (_estimates(figures) if errors else [])
                if not entry["max"] <= max_error
            ]
        if max_drift is not None:
            drifts = _relative_drifts(figures)
            if not drifts:
                exceeded.append(f"{log}: there is no drift to check: no conserved energy or momentum is found")
            exceeded += [
                f"{log}: relative drift {drift:.3g} of {name} exceeds {max_drift:g}"
                for name, drift in drifts
                if not drift <= max_drift
            ]
    return exceeded


def _too_large(error, bound):
    """Message if an error exceeds a bound, or may do so within the uncertainty; else None."""
    unit = error["unit"]
    if not error["max"] <= bound:
        return f"error {error['max']:.3g} {unit} exceeds {bound:g}"
    if not error["max"] + error["uncertainty"] <= bound:
        return (
            f"error {error['max']:.3g} {unit} may exceed {bound:g}: the reference "
            f"uncertainty is {error['uncertainty']:.3g} {unit}"
        )
    return None


def _estimates(figures):
    """Recorded estimates of position and attitude errors that are known."""
    found = figures.get("estimate") or {}
    entries = [found[name] for name in ("position", "angle") if name in found]
    return [entry for entry in entries if entry["max"] is not None]


def _relative_drifts(figures):
    """[(name, relative drift)] of all conserved quantities."""
    if "energy" not in figures:
        return [("the motion", math.nan)]  # no sample is finite
    drifts = [("the energy", figures["energy"]["relative_drift"])]
    drifts += [("the " + entry["component"], entry["relative_drift"]) for entry in figures["momentum"]]
    return [(name, drift) for name, drift in drifts if drift is not None]
