# SPDX-License-Identifier: Apache-2.0
"""The accuracy is made coarser only if that helps: decisions of RealTime from given times."""

import random

import pytest

from liegroup_core.accuracy import METHOD
from liegroup_sim_ros.messages import events
from liegroup_sim_ros.serving import real_time

GIVEN, STEP, PERIOD = 1e-8, 0.01, 20  # rad, s, steps that take SHARE_PERIOD
MANY = 200  # periods: 40 s


def expected(accuracy):
    """Cost relative to that of GIVEN, of a method of order 8 whose steps are not cut short."""
    return (GIVEN / accuracy) ** (1.0 / 8.0)


class Run:
    """Simulation and pacer of a RealTime.

    integration, messages : functions of the accuracy: s of CPU time for s of simulated time
    substeps              : for a step, function of the accuracy
    """

    def __init__(self, integration, messages, substeps=lambda accuracy: 20.0 * expected(accuracy)):
        self._integration, self._messages, self._substeps = integration, messages, substeps
        self.step, self.method, self.time, self.substeps = STEP, METHOD, 1.0, (0, 0)
        self.promise = {"accuracy": GIVEN}
        self.accuracies, self.texts, self.factor = [GIVEN], [], 1.0
        self.real = real_time.RealTime(self, self)

    def set_accuracy(self, accuracy):
        self.promise = {"accuracy": accuracy}
        self.accuracies.append(accuracy)

    def recent_factor(self):
        return 0.5 * self.factor

    def take(self, periods=MANY, more=lambda: 1.0):
        """Take steps; more() : factor of a disturbance of both times. Returns the accuracies so far."""
        for _ in range(periods):
            accuracy, simulated = self.promise["accuracy"], PERIOD * STEP
            self.substeps = (0, self.substeps[1] + PERIOD * self._substeps(accuracy))
            given = (part(accuracy) * simulated * more() for part in (self._integration, self._messages))
            if text := self.real.add(simulated, *given):
                self.texts.append(text)
        assert [events.number(text) for text in self.texts] == pytest.approx(self.accuracies[1:])
        return self.accuracies

    def slow(self):
        """What is said of a run that had half of the factor for two seconds."""
        self.real.slow(True)
        self.take(5)
        return self.real.slow(True)


def falling(cost, floor=0.0):
    return lambda accuracy: max(floor, cost * expected(accuracy))


def flat(cost):
    return lambda accuracy: cost


# (integration, messages, accuracies, what is said in the last line about a change)
PATTERNS = {
    "integration alone, with gain": (falling(0.8), flat(0.05), [GIVEN, 1e-7, 1e-6], "takes 60 %"),
    "no gain": (flat(0.8), flat(0.05), [GIVEN, 1e-7, GIVEN], "takes the most, at any accuracy"),
    "a growing cost": (
        lambda accuracy: 0.8 / expected(accuracy),
        flat(0.05),
        [GIVEN, 1e-7, GIVEN],
        "takes 107 % of a core in real time instead of 80 %",
    ),
    "gain up to a level": (falling(0.8, 0.6), flat(0.05), [GIVEN, 1e-7, 1e-6, 1e-7], "takes the most, at any accuracy"),
    "messages alone": (falling(0.26), flat(0.66), [GIVEN], None),
    "messages, no gain": (flat(0.25), flat(0.9), [GIVEN], None),
    "both, with gain": (falling(0.5), flat(0.45), [GIVEN, 1e-7], "takes 50 %"),
    "both, no gain": (flat(0.49), flat(0.45), [GIVEN, 1e-7, GIVEN], "at any accuracy"),
    "too much for any accuracy": (falling(9.0), flat(0.05), [GIVEN], None),
    "enough time": (falling(0.49), flat(0.4), [GIVEN], None),
}


@pytest.mark.parametrize("pattern", PATTERNS)
def test_an_accuracy_is_given_away_only_if_that_helps(pattern):
    """Else the one before returns, for good, with one line that says what to do."""
    integration, messages, accuracies, said = PATTERNS[pattern]
    run = Run(integration, messages)
    assert run.take() == pytest.approx(accuracies)
    assert said is None or said in run.texts[-1]


@pytest.mark.parametrize("share, raised", [(2.0, [1e-3]), (2.5, [])])
def test_the_coarsest_accuracy_must_do(share, raised):
    """0.1 instead of 1e-4 takes 1e-3^(1/8) = 0.42 of the substeps of a method of order 8."""
    run = Run(flat(share), flat(0.0))
    run.promise = {"accuracy": 1e-4}
    assert run.take(3)[1:] == pytest.approx(raised)


def test_a_single_substep_cannot_become_longer():
    run = Run(flat(0.8), flat(0.05), substeps=lambda accuracy: 1.1)
    assert run.take() == [GIVEN]


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("integration, last", [(flat(0.8), GIVEN), (falling(0.8), 1e-6)], ids=["no gain", "gain"])
def test_disturbances_change_no_decision(seed, integration, last):
    """Up to 4 % always, and every twentieth period takes up to four times as long."""
    chance = random.Random(seed)

    def more():
        return chance.uniform(1.0, 1.04) * (chance.uniform(1.0, 4.0) if chance.random() < 0.05 else 1.0)

    run = Run(integration, flat(0.02))
    run.take(more=more)
    assert run.accuracies[-1] == pytest.approx(last)
    assert len(run.accuracies) <= 4


def test_a_pause_or_another_factor_does_not_end_the_judgement():
    """A state that is set does: the accuracy is the one that was asked for again."""
    run = Run(flat(0.8), flat(0.05))
    run.take(3)
    assert run.accuracies == pytest.approx([GIVEN, 1e-7])
    run.real.slow(False)  # paused
    run.real.forget()
    assert run.take() == pytest.approx([GIVEN, 1e-7, GIVEN])
    run.real.forget()
    assert len(run.take()) == 3  # known for good
    run.promise = {"accuracy": GIVEN}
    run.real.restart()
    run.take(3)
    assert run.promise["accuracy"] == pytest.approx(1e-7)  # tried anew
    run.promise = {"accuracy": GIVEN}
    run.real.restart()
    run.take(3)
    assert len(run.accuracies) == 5 and run.promise["accuracy"] == pytest.approx(1e-7)


@pytest.mark.parametrize(
    "integration, messages, said",
    [
        (
            falling(9.0),
            0.1,
            "the integration takes the most: raise accuracy or step, or lower real_time_factor (bounces)",
        ),
        (flat(0.95), 0.02, "the integration takes the most, at any accuracy: lower real_time_factor (bounces)"),
        (flat(0.25), 0.9, "the messages take the most: lower publish_rate"),
        (flat(0.1), 0.1, "other processes occupy the cores"),
    ],
)
def test_a_slow_run_says_what_takes_the_time_and_what_to_do(integration, messages, said, monkeypatch):
    monkeypatch.setattr(real_time, "cause_of_cost", lambda simulation: "bounces")  # as a run warns
    run = Run(integration, flat(messages))
    run.take()
    assert said in run.slow()
