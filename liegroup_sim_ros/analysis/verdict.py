# SPDX-License-Identifier: Apache-2.0
"""Numerical error of a run in one sentence, and the problems of the run and its recording."""

import math

from liegroup_core.pacing import SLOW
from liegroup_sim_ros.messages.events import is_requested
from liegroup_sim_ros.numbers import counted, error_text, shown
from liegroup_sim_ros.playback.resimulate import difference_cause

from .estimate import error_of
from .promise import promise_text
from .timing import is_paced, requested_text

# Relative to the characteristic length, and of the energies to the largest of them: a larger violation makes
# the motion invalid.
OPEN = 1e-3


def find_problems(figures):
    """Problems of the run and of its recording, one sentence each."""
    problems = []
    if figures["file_problem"]:
        problems.append("the file is incomplete: " + figures["file_problem"].removeprefix(f"{figures['log']}: "))
    if figures["lost_messages"]:
        problems.append(
            "messages are missing: "
            + ", ".join(f"{count} of {topic}" for topic, count in figures["lost_messages"].items())
        )
    if figures["missing_samples"]:
        problems.append("missing from the recording: " + counted(figures["missing_samples"], "sample"))
    if figures["recorder_lost"]:
        problems.append(f"the recorder dropped {counted(figures['recorder_lost'], 'message')}")
    if figures["not_finite_samples"]:
        problems.append(
            f"NaN or infinity in {counted(figures['not_finite_samples'], 'sample')}, from "
            f"{shown(figures['first_not_finite_s'], 's')} on: excluded from all figures"
        )
    problems += [f"the run stopped with an error: {text}" for text in figures["faults"]]
    problems += _open_joints(figures)
    problems += _energy_problems(figures)
    problems += _replay_problems(figures)
    promise = figures.get("promise")
    if promise and promise["kept"] is False:
        problems.append(promise_text(promise))
    timing = figures["timing"]
    factor, requested = timing.get("real_time_factor"), timing["factor_wanted_mean"]
    if requested and factor is not None and not factor >= SLOW * requested:
        problems.append(f"too slow: real-time factor {shown(factor)}, {requested_text(timing)}")
    if timing.get("reanchored"):
        problems.append(
            "more than 0.1 s behind the wall clock, "
            f"{counted(timing['reanchored'], 'time')}; the simulation continued from there "
            "without catching up"
        )
    # An infinite estimate means that the error is unknown, not that the run is wrong.
    computed = {name: entry for name, entry in figures.items() if name not in ("estimate", "promise")}
    wrong = [name for name, value in _numbers(computed) if not math.isfinite(value)]
    if wrong:
        problems.append("not a number: " + ", ".join(wrong[:5]))
    return problems


# Events of a run that reports a loss of accuracy or of real time.
_REPORTED = ("inaccurate", "unpredictable", "accuracy", "slow")


def find_warnings(figures, events):
    """Limits of the result that are no problems of the run, one sentence each.

    events : of the recording
    """
    warnings = []
    for name in _REPORTED:
        texts = [event.text for event in events if event.name == name and not is_requested(event.text)]
        more = f" (and {len(texts) - 1} more)" if len(texts) > 1 else ""
        warnings += [f"the run reported: {text}{more}" for text in texts[:1]]
    timing, (errors, why) = figures["timing"], error_of(figures)
    if timing.get("overruns"):
        of = "" if timing.get("ticks") is None else f" of {counted(timing['ticks'], 'tick')}"
        warnings.append(f"{counted(timing['overruns'], 'deadline miss')}{of}")
    if errors is None and "reference" in figures:
        warnings.append(f"the error is unknown: {why}")
    return warnings


def _open_joints(figures):
    """Problem text for the joint with the largest constraint violation, if the motion is invalid; a list."""
    if not figures.get("joints"):
        return []
    name, worst = max(figures["joints"].items(), key=lambda item: item[1]["largest"])
    if not worst["largest"] > OPEN * figures["mechanism_size"]:
        return []
    return [
        f"constraint violation of joint {name} reaches "
        f"{shown(worst['largest'], worst['unit'])} at {shown(worst['at_s'], 's')}: the "
        "motion is not valid; use stabilisation projection or a smaller step"
    ]


def _energy_problems(figures):
    """Problem text if the energy balance fails by more than the error of the work, and much; a list."""
    balance = figures.get("balance", {})
    if not balance.get("quadrature_J"):  # no work is done: the drift of the energy says the same
        return []
    sizes = [abs(entry[key]) for entry in balance["stored"] for key in ("start_J", "end_J")]
    largest = max(figures["energy"]["largest_kinetic_J"], *sizes, *map(abs, balance["work_J"].values()))
    if not balance["largest_J"] > balance["quadrature_J"] + OPEN * largest:
        return []
    return [
        f"the energy does not add up by {shown(balance['largest_J'], 'J')}, above "
        f"the estimated error of the work of {shown(balance['quadrature_J'], 'J')}: the motion is wrong, or "
        "the samples are too far apart for the work"
    ]


def _replay_problems(figures):
    repeat = figures.get("repeat", {})
    problems = []
    if "failed" in repeat:
        problems.append(f"re-simulation is not possible: {repeat['failed']}")
    elif repeat and repeat["identical"] < repeat["samples"]:
        at = repeat["first_difference"]
        where = f"{at['body']} differs from {shown(at['at_s'], 's')} on" if at else f"it {repeat['stopped']}"
        problems.append(f"re-simulation is not bit-identical: {where}; {difference_cause(repeat['platform'])}")
    if figures.get("reference", {}).get("stopped"):
        problems.append(figures["reference"]["stopped"])
    return problems


def _numbers(figures, name=""):
    """(name, value) of every float in the figures."""
    entries = (
        figures.items()
        if isinstance(figures, dict)
        else enumerate(figures)
        if isinstance(figures, (list, tuple))
        else ()
    )
    for key, value in entries:
        path = f"{name}.{key}" if name else str(key)
        if isinstance(value, float):
            yield path, value
        else:
            yield from _numbers(value, path)


def verdict(figures):
    """Numerical error of the run in one sentence."""
    head = (
        f"{figures['scene']}, {shown(figures['sim_seconds'], 's')} with {figures['method']} "
        f"at {shown(figures['step'] * 1e3, 'ms')}"
    )
    statements = []
    errors, why = error_of(figures)
    if errors:
        texts = f"{error_text(errors['position'])} and {error_text(errors['angle'])}"
        if why:
            statements += [
                f"estimated error at most {texts}, recorded with the run",
                f"no independent reference: {why}",
            ]
        elif errors["seconds"] >= figures["sim_seconds"] * (1.0 - 1e-9):
            statements.append(f"error at most {texts}")
        else:
            statements.append(f"error at most {texts} in the first {shown(errors['seconds'], 's')}")
    elif "estimate" in figures:
        statements.append("error unknown")
    if figures.get("promise"):
        statements.append(promise_text(figures["promise"]))
    if figures.get("joints"):
        worst = max(figures["joints"].values(), key=lambda joint: joint["largest"])
        statements.append(f"constraint residual at most {shown(worst['largest'], worst['unit'])}")
    if figures.get("energy") and figures["energy"]["relative_drift"] is not None:
        statements.append(f"energy drift {shown(figures['energy']['relative_drift'])} of the largest kinetic energy")
    repeat = figures.get("repeat", {})
    if repeat and repeat.get("identical") == repeat.get("samples"):
        statements.append("re-simulation bit-identical")
    if is_paced(figures["timing"]):
        statements.append(f"real-time factor {figures['timing']['real_time_factor']:.3f}")
    return f"{head}: {'; '.join(statements) or 'nothing could be checked'}."
