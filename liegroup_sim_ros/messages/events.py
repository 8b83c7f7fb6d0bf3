# SPDX-License-Identifier: Apache-2.0
"""Texts of events that readers of a recording parse.

Texts about accuracy, real time and servos begin with a number. The text of a state that was set contains
the state.
"""

import json

# Share of a core; a run that takes less can keep real time.
BUSY = 0.7
_REQUESTED = ", as requested"


def accuracy(value, time, before, share, share_of_messages):
    """The accuracy becomes coarser, because the previous one takes too much of a core."""
    return (
        f"{value:g} is the accuracy from t = {time:.6g} s on: {before:g} takes "
        f"{_percent(share)} of a core in real time, messages {_percent(share_of_messages)}"
    )


def accuracy_requested(value, time):
    """The accuracy is another one, as requested."""
    return f"{value!r} is the accuracy from t = {time:.6g} s on{_REQUESTED}"


def is_requested(text):
    """Whether a change of the accuracy with this text was requested."""
    return text.endswith(_REQUESTED)


def accuracy_returns(value, time, coarser, before, after, share_of_messages):
    """The previous accuracy returns, because a coarser one does not help.

    before, after : shares of a core that the integration takes in real time, previously and at the coarser one
    """
    return (
        f"{value:g} is the accuracy from t = {time:.6g} s on: {coarser:g} takes {_percent(after)} of a "
        f"core in real time instead of {_percent(before)}, messages "
        f"{_percent(share_of_messages)}; {_advice(after, share_of_messages, helpless=True)}"
    )


def _advice(share, share_of_messages, helpless=False, cause=""):
    """What to do if real time is not kept; helpless: a coarser accuracy does not help; cause of the cost of steps."""
    if share < share_of_messages:
        return "the messages take the most: lower publish_rate, or publish and record less"
    cause = f" ({cause})" if cause else ""
    if helpless:
        return f"the integration takes the most, at any accuracy: lower real_time_factor{cause}"
    return f"the integration takes the most: raise accuracy or step, or lower real_time_factor{cause}"


def slow(had, wanted, time, share, share_of_messages, accuracy, helpless=False, cause=""):
    """Real time is not kept.

    had, wanted : real-time factors
    time        : s
    share       : largest share of a core that the integration takes in real time
    accuracy    : current accuracy; None with a method
    helpless    : a coarser accuracy does not help
    cause       : of the cost of the integration, and what helps
    """
    advice = _advice(share, share_of_messages, helpless, cause)
    if share + share_of_messages < BUSY:
        advice = "other processes occupy the cores: end them, or lower real_time_factor"
    return (
        f"{had:.3g} is the real-time factor at t = {time:.6g} s instead of {wanted:g}: in real time the "
        f"integration takes up to {_percent(share)} of a core"
        + (f" at the accuracy of {accuracy:g}" if accuracy else "")
        + f", messages {_percent(share_of_messages)}; {advice}"
    )


def _percent(share):
    return f"{100.0 * share:.0f} %"


def inaccurate(since, accuracy, reason):
    """The estimated error exceeds the accuracy.

    since    : s, Simulation.accurate_until
    accuracy : Simulation.exceeded
    reason   : Simulation.inaccurate_because
    """
    text = f"{since:.9g} s is the last time before the estimated error exceeds the accuracy of {accuracy:.2g}"
    return f"{text}: {reason}" if reason else text


def unpredictable(since):
    """The estimated error is large after a time in s."""
    return f"{since:.9g} s is the last time before the error is too large for the motion to be known"


def saturated(effort, joint, time):
    """A servo has reached its effort limit; effort : N m or N, time : s."""
    return f"{effort:g} is the effort limit that the servo of {joint} has reached at t = {time:.6g} s"


def slips(contact, joint, time):
    """A wheel or ball would slip or lift off; contact : (normal, tangential) force in N, time : s."""
    normal, along = contact
    if normal < 0.0:
        return f"{joint} pulls: it needs {normal:.4g} N normal to the plane at t = {time:.6g} s and would lift off"
    return (
        f"{along:.4g} N along the plane, with {normal:.4g} N normal to it, is beyond the friction of {joint} at t = "
        f"{time:.6g} s: there it would slip"
    )


def reports(simulation):
    """[(name, text)] of the events about the error estimate of a Simulation up to its present time."""
    found, time = [], simulation.time
    if (since := simulation.accurate_until) <= time:
        found.append(("inaccurate", inaccurate(since, simulation.exceeded, simulation.inaccurate_because)))
    if (since := simulation.predictable_until) <= time:
        found.append(("unpredictable", unpredictable(since)))
    return found


def number(text):
    """The number at the beginning of a text. Raises ValueError."""
    return float(text.partition(" ")[0])


def state(reason, entries):
    """The run continues from a state that was set; the second line of the text is the exact state.

    entries : JSON types, see recording.attachments.state
    """
    return f"{reason}, step {entries['steps']}\n{json.dumps(entries, separators=(',', ':'))}"


def state_of(text):
    """The state in a text of `state`, a dict. Raises ValueError."""
    entries = json.loads(text.partition("\n")[2])
    if not isinstance(entries, dict):
        raise ValueError("a state must be a JSON object")
    return entries
