# SPDX-License-Identifier: Apache-2.0
"""Real-time figures of a recorded run: requested and achieved factor, latency, gaps."""

from itertools import pairwise

from liegroup_sim_ros.numbers import counted, shown

FASTEST = 0.0  # requested real-time factor that means as fast as possible


def timing_figures(recording, motion):
    """{name: number or None}, the entry "timing" of config/analysis.schema.json."""
    pacing = recording.pacing or _pacing_so_far(recording.diagnostics)
    timing = {
        key: number(pacing.get(key))
        for key in ("ticks", "overruns", "reanchored", "real_time_factor", "wall_seconds", "sim_seconds")
    }
    if timing["ticks"] == 0:  # only steps on request, without real-time pacing
        timing["real_time_factor"] = None
    timing["lateness_us"] = {key: number(pacing["lateness_us"].get(key)) for key in ("p50", "p99", "max")}
    requests = _requests(recording)
    timing["factor_wanted"] = requests[-1][1]
    timing["factor_wanted_mean"] = _mean_factor(requests, motion)
    timing["factor_changes"] = sum(before != after for (_, before), (_, after) in pairwise(requests))
    factors = [
        number(entry.get("real_time_factor")) for _, entry in recording.diagnostics if entry.get("state") == "running"
    ]
    factors = [factor for factor in factors if factor]
    timing["real_time_factor_least"] = min(factors, default=None)
    timing["real_time_factor_most"] = max(factors, default=None)
    return timing | {
        "gaps": motion.gaps,
        "largest_gap_s": motion.largest_gap_s,
        "largest_gap_at_s": motion.largest_gap_at_s,
    }


def _pacing_so_far(diagnostics):
    """Pacing from the last diagnostics, for a recording that was not finished.

    The factor is that of the last diagnostics while running, because diagnostics of a pause have 0.
    """
    last = diagnostics[-1][1] if diagnostics else {}
    running = [entry for _, entry in diagnostics if entry.get("state") == "running"]
    return {
        "ticks": last.get("ticks"),
        "overruns": last.get("overruns"),
        "reanchored": last.get("reanchored"),
        "real_time_factor": running[-1].get("real_time_factor") if running else None,
        "lateness_us": {key: last.get(f"lateness_{key}_us") for key in ("p50", "p99", "max")},
    }


def _requests(recording):
    """[(stamp in ns, requested factor or None)]; the first entry holds from the start of the recording.

    The node records the factor at the start as a parameter and each change as an event "speed". A recording
    without parameters has the factor in its diagnostics or, if `run` wrote it, in its pacing.
    """
    first = (recording.settings.get("parameters") or {}).get("real_time_factor")
    if first is None and recording.diagnostics:
        first = recording.diagnostics[0][1].get("real_time_factor_wanted")
    if first is None and recording.pacing:
        first = recording.pacing.get("real_time_factor_wanted")
    changes = [
        (event.stamp_ns, number(event.text.rpartition(" ")[2])) for event in recording.events if event.name == "speed"
    ]
    return [(-1, number(first)), *changes]


def _mean_factor(requests, motion):
    """Requested real-time factor, averaged over the wall time of the requests.

    It is the simulated time of the run divided by the wall time that the requests imply, so it is directly
    comparable with the achieved factor. Pauses do not count. None if a part of the run was requested as
    fast as possible.
    """
    factors = {factor for _, factor in requests}
    if len(factors) == 1 or not motion.stretches:
        return requests[-1][1]
    first, last = motion.stretches[0], motion.stretches[-1]
    start = first.base_ns + first.first_step * first.step * 1e9
    end = last.base_ns + last.last_step * last.step * 1e9
    edges = [min(max(stamp, start), end) for stamp, _ in requests] + [end]
    parts = [
        (after - before, factor) for (before, after), (_, factor) in zip(pairwise(edges), requests) if after > before
    ]
    factors = {factor for _, factor in parts}
    if len(factors) == 1:
        return factors.pop()
    if None in factors or FASTEST in factors or not parts:
        return None
    return sum(span for span, _ in parts) / sum(span / factor for span, factor in parts)


def is_paced(timing):
    """Whether a run followed the wall clock, as timing_figures says."""
    followed = timing["factor_changes"] or timing["factor_wanted"] not in (None, FASTEST)
    return bool(followed and timing.get("real_time_factor"))


def number(text):
    """Float of a number or numeric text from a recording, else None."""
    try:
        return float(text)
    except (TypeError, ValueError):
        return None


def requested_text(timing):
    """Text with the requested real-time factor; timing : as returned by timing_figures."""
    last = timing["factor_wanted"]
    if not timing["factor_changes"]:
        return "requested: as fast as possible" if last == FASTEST else f"requested {shown(last)}"
    mean = timing["factor_wanted_mean"]
    return (
        ("requested factor " if mean is None else f"requested {shown(mean)} on average, ")
        + f"changed {counted(timing['factor_changes'], 'time')}, last "
        + ("as fast as possible" if last == FASTEST else shown(last))
    )
