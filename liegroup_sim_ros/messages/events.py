# SPDX-License-Identifier: Apache-2.0
"""Texts of events that readers of a recording need.

Those about accuracy, real time and servos begin with a number. That of a state that was set has the
state.
"""

import json


def accuracy(value, time, before, share, share_of_messages):
    """From now on another accuracy is kept, as the one before takes too much of a core."""
    return (
        f"{value:g} is the accuracy from t = {time:.6g} s on: {before:g} takes "
        f"{_percent(share)} of a core in real time, messages {_percent(share_of_messages)}"
    )


def slow(had, wanted, time, share, share_of_messages, accuracy):
    """Real time is not kept.

    had, wanted : real-time factors
    time        : s
    share       : of a core, that the integration takes in real time where it takes most
    accuracy    : that holds; None with a method
    """
    return (
        f"{had:.3g} is the real-time factor at t = {time:.6g} s, of {wanted:g}: in real time the "
        f"integration takes up to {_percent(share)} of a core"
        + (f" at the accuracy of {accuracy:g}" if accuracy else "")
        + f", messages {_percent(share_of_messages)}"
    )


def _percent(share):
    return f"{100.0 * share:.0f} %"


def inaccurate(since, reason):
    """The estimated error exceeds the accuracy.

    since  : s, the last time at which it did not
    reason : Simulation.inaccurate_because
    """
    text = f"{since:.9g} s is the last time with an estimated error within the accuracy"
    return f"{text}: {reason}" if reason else text


def unpredictable(since):
    """The estimated error is large after a time in s."""
    return (
        f"{since:.9g} s is the last time before the error is too large for the motion to be known"
    )


def saturated(effort, joint, time):
    """A servo has reached its effort limit; effort : N m or N, time : s."""
    return (
        f"{effort:g} is the effort limit that the servo of {joint} has reached at t = {time:.6g} s"
    )


def reports(simulation):
    """[(name, text)] of what the estimate of a Simulation says up to its present time."""
    found, time = [], simulation.time
    if (since := simulation.accurate_until) <= time:
        found.append(("inaccurate", inaccurate(since, simulation.inaccurate_because)))
    if (since := simulation.predictable_until) <= time:
        found.append(("unpredictable", unpredictable(since)))
    return found


def number(text):
    """The number at the beginning of a text. Raises ValueError."""
    return float(text.partition(" ")[0])


def state(reason, entries):
    """The run continues from a state that was set; its second line is the exact state.

    entries : JSON types, see recording.attachments.state
    """
    return f"{reason}, step {entries['steps']}\n{json.dumps(entries, separators=(',', ':'))}"


def state_of(text):
    """The state in a text of `state`, a dict. Raises ValueError."""
    entries = json.loads(text.partition("\n")[2])
    if not isinstance(entries, dict):
        raise ValueError("a state must be a JSON object")
    return entries
