# SPDX-License-Identifier: Apache-2.0
"""Texts of the events about the accuracy of a run; they begin with the number that a reader needs."""


def accuracy(value, time, before, share):
    """From now on another accuracy is kept, as the one before takes this share of a core."""
    return (
        f"{value:g} is the accuracy from t = {time:.6g} s on: {before:g} takes "
        f"{100.0 * share:.0f} % of a core in real time"
    )


def inaccurate(since):
    """The estimated error exceeds the accuracy; since : s, the last time at which it did not."""
    return f"{since:.9g} s is the last time with an estimated error within the accuracy"


def unpredictable(since):
    """The estimated error is large since a time in s."""
    return (
        f"{since:.9g} s is the time from which on the error is too large for the motion to be known"
    )


def reports(simulation):
    """[(name, text)] of what the estimate of a Simulation says up to its present time."""
    return [
        (text.__name__, text(since))
        for text, since in (
            (inaccurate, simulation.accurate_until),
            (unpredictable, simulation.predictable_until),
        )
        if since <= simulation.time
    ]


def number(text):
    """The number at the beginning of a text. Raises ValueError."""
    return float(text.partition(" ")[0])
