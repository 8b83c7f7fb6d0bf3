# SPDX-License-Identifier: Apache-2.0
"""Figures of a running simulation for the diagnostics; each name ends with its unit."""

import math


def pacing_figures(pacer, factor, real_time):
    """Figures of a Pacer and a RealTime; factor: achieved real-time factor."""
    pacing = pacer.report()
    return {
        "real_time_factor_wanted": pacer.factor,
        "real_time_factor": factor,
        "lateness_p50_us": pacing["lateness_us"]["p50"],
        "lateness_p99_us": pacing["lateness_us"]["p99"],
        "lateness_max_us": pacing["lateness_us"]["max"],
        "ticks": pacing["ticks"],
        "overruns": pacing["overruns"],
        "reanchored": pacing["reanchored"],
        "integration_share_of_core": real_time.share,
        "messages_share_of_core": real_time.share_of_messages,
    }


def error_figures(simulation, sample):
    """Largest estimated errors of all bodies, and the accuracy; {} without an estimate."""
    if sample.errors is None:
        return {}
    position, attitude = sample.errors[:, :2].max(axis=0).tolist()
    return {
        "position_error_m": position,
        "attitude_error_rad": attitude,
        # Largest error of position, then of attitude; no body while all errors are unknown.
        "worst_body": max(zip(sample.errors.tolist(), sample.body_names))[1] if math.isfinite(position) else "",
        "predictable_until_s": simulation.predictable_until,
        **_accuracy_figures(simulation),
    }


def _accuracy_figures(simulation):
    promise = simulation.promise
    if promise is None:
        return {}
    return {
        "accuracy": promise["accuracy"],
        "accuracy_horizon_s": promise["horizon"],
        "method": simulation.method,
        "accurate_until_s": simulation.accurate_until,
    }


def contact_figures(sample):
    """How many contacts press, and the deepest one; {} without contacts."""
    names = sample.contact_wrenches
    if not names:
        return {}
    depth, deepest = max((sample.signals[f"{name}.depth"], name) for name in names)
    pressing = sum(name in sample.contact_points for name in names)
    return {"contacts_pressing": pressing, "contact_depth_m": depth, "deepest_contact": deepest}


class Saturation:
    """Servos at their effort limit; simulation : liegroup_core.Simulation."""

    def __init__(self, simulation):
        self._exists = bool(simulation.layout.servos)
        self._saturated, self._count = set(), 0  # joints at the last sample; how often a limit was reached

    def reached(self, sample):
        """Joints, sorted, whose servo has reached its limit since the last sample."""
        if not self._exists:
            return []
        before, self._saturated = self._saturated, set(sample.saturated)
        found = sorted(self._saturated - before)
        self._count += len(found)
        return found

    def figures(self, sample):
        """Figures for the diagnostics; {} without servos."""
        if not self._exists:
            return {}
        return {"servos_saturated": ", ".join(sample.saturated), "servo_saturations": self._count}
