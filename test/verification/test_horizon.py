# SPDX-License-Identifier: Apache-2.0
"""How far ahead a model predicts: logs of pendulums that SciPy integrates, some with an effort that the model lacks.

Short segments, each with a start of its own, agree with any of these models.
"""

import functools
from dataclasses import replace

import numpy as np
import pytest
import scipy
from scene_files import filled, text_of

from liegroup_core import Simulation
from liegroup_core.identification import Given, Log, Measured, compare, identify
from liegroup_core.identification.horizon import Horizon, _rounded
from liegroup_core.identification.shadow import ENDS, PRESENT, START, Shadow
from liegroup_core.scene.load import scene_from_text

MASS, LENGTH, RADIUS, VISCOUS, GRAVITY = 0.4, 0.6, 0.01, 0.02, 9.80665
SECONDS, RATE, NOISE = 12.0, 100.0, 2e-3
SCENE = filled(
    text_of("pendulum_horizon.yaml"), gravity=GRAVITY, half=-LENGTH / 2, length=LENGTH, radius=RADIUS, mass=MASS
)
LACKING = {
    "nothing": lambda q, v: 0.0,
    "quadratic drag": lambda q, v: -0.01 * v * abs(v),
    "cogging": lambda q, v: 0.03 * np.sin(8.0 * q),
    "a spring that hardens": lambda q, v: -0.1 * q**3,
    "friction by load": lambda q, v: rubbed(q, v, 1e-3),
}
INERTIA = MASS * (LENGTH**2 / 3.0 + RADIUS**2 / 4.0)


def rubbed(q, v, size):
    """Effort of friction that is `size` in m times the force in the hinge, which depends on it: by iteration."""
    effort, arm = 0.0, 0.5 * LENGTH
    for _ in range(4):  # each one has 1e-3 of the error of the one before
        slope = (effort - VISCOUS * v - MASS * GRAVITY * arm * np.sin(q)) / INERTIA
        force = MASS * np.hypot(arm * slope + GRAVITY * np.sin(q), arm * v**2 + GRAVITY * np.cos(q))
        effort = -size * force * np.sign(v)
    return effort


TIMES = np.arange(SECONDS * RATE) / RATE


@functools.cache
def motion(effort, start=(1.1, 0.0), viscous=VISCOUS):
    """Positions of a pendulum, from rest at 1.1 rad."""

    def slope(_, y):
        weight = MASS * GRAVITY * 0.5 * LENGTH * np.sin(y[0])
        return [y[1], (-viscous * y[1] + effort(*y) - weight) / INERTIA]

    return scipy.integrate.solve_ivp(slope, (0.0, SECONDS), start, t_eval=TIMES, rtol=1e-11, atol=1e-12).y[0]


def log_of(effort, seed, noise=NOISE):
    """Log of the position of a pendulum with noise."""
    q = motion(effort)
    values = q + noise * np.random.default_rng(seed).normal(size=len(q))
    return Log((), (Measured("/joint_states", TIMES, ("hinge.position",), values[:, None], np.array([np.nan]), 0.0),))


NAMED = {
    "quadratic drag": ("quadratic drag of hinge", 0.01),
    "cogging": ("cogging of hinge, 8 times a turn", 0.03),
    "friction by load": ("friction by load of hinge", 1e-3),
}


def driven(lag, compliance):
    """Log of the pendulum with an effort that acts behind a critically damped lag in s, and an encoder of its motor.

    Between encoder and rod a spring bends by the compliance, rad/(N m), times the effort.
    """
    at = np.arange(300) / RATE
    u, y, q = 0.6 * np.sin(9.0 * at) + 0.6 * np.sin(23.0 * at + 1.0), [0.3, 0.0, 0.0, 0.0], [0.3]

    def slope(_, y, u):
        effort = y[2] if lag else u
        late = [y[3], (u - y[2]) / lag**2 - 2.0 * y[3] / lag] if lag else [0.0, 0.0]
        return [y[1], (effort - VISCOUS * y[1] - MASS * GRAVITY * 0.5 * LENGTH * np.sin(y[0])) / INERTIA, *late]

    for each in u[:-1]:
        y = scipy.integrate.solve_ivp(slope, (0.0, 1.0 / RATE), y, args=(each,), rtol=1e-10, atol=1e-12).y[:, -1]
        q.append(y[0])
    values = q + compliance * np.append(0.0, u[:-1]) + 5e-4 * np.random.default_rng(3).normal(size=len(q))
    measured = Measured("/joint_states", at, ("hinge.position",), values[:, None], np.array([np.nan]), 0.0)
    return Log((Given("hinge.effort", at, u),), (measured,))


@pytest.mark.parametrize(
    ("lag", "compliance", "effect", "size"),
    [(0.01, 0.0, "second-order lag of hinge.effort by 10 ms", 1.0), (0.0, 0.02, "flexibility of hinge", 0.02)],
)
@pytest.mark.volume(1)
def test_a_drive_that_lags_or_bends_is_named(lag, compliance, effect, size):
    """The size is linear about a model without: to a tenth."""
    scene = scene_from_text(SCENE.replace("viscous: 0.01", f"viscous: {VISCOUS}"))
    found = compare(scene, driven(lag, compliance), workers=1)
    first = found.effects[0]
    assert not found.agrees and first.text == effect and first.value == pytest.approx(size, rel=0.1)
    assert compare(scene, driven(0.0, 0.0), workers=1).agrees


def bound():
    """Deviation of the viscous friction by Cramer and Rao, of a log without a known start, by differences of SciPy."""
    point, change = np.array([1.1, 0.0, VISCOUS]), 1e-5

    def outputs(p):
        return motion(LACKING["nothing"], tuple(p[:2]), p[2])

    J = np.array([(outputs(point + way) - outputs(point - way)) / (2.0 * change) for way in change * np.eye(3)])
    return NOISE * np.sqrt(np.linalg.inv(J @ J.T)[2, 2])


@pytest.mark.parametrize("lacking", LACKING)
@pytest.mark.volume(2)
def test_a_model_agrees_only_if_long_runs_do(lacking):
    """A right one is as near as its noise to the end; of others predictions are off by more than is explained."""
    found = identify(scene_from_text(SCENE), log_of(LACKING[lacking], 1), ["hinge.friction.viscous"], workers=1)
    (horizon,), verdict = found.comparison.horizons, found.comparison.verdict
    assert horizon.unit == "rad" and horizon.ahead[-1] == pytest.approx(SECONDS, rel=0.01)
    if lacking == "nothing":
        assert horizon.noise == pytest.approx(NOISE, rel=0.2)
        low, high = found.intervals[0]
        assert low < VISCOUS < high and horizon.differs_from == np.inf
        # Noise is estimated from 1200 values: to 2 % of one deviation.
        assert found.deviations[0] == pytest.approx(bound(), rel=0.1)
        assert verdict.startswith(f"The model predicts hinge.position within its noise for all of {SECONDS:g} s.")
    else:
        assert horizon.differs_from < SECONDS and horizon.within_noise < 0.2 * SECONDS
        assert verdict.startswith("The model predicts hinge.position within its noise for ") and "off by" in verdict
    assert found.comparison.agrees == (lacking == "nothing"), verdict
    if lacking in NAMED:
        effect, size = NAMED[lacking]
        first = found.comparison.effects[0]
        assert first.text == effect and first.value == pytest.approx(size, rel=0.05) and found.comparison.is_explained


@pytest.mark.turn(6)
def test_intervals_are_robust_where_noise_is_not_white():
    """Of 20 logs with noise that is correlated by 0.9 from one measurement to the next.

    Of right 95 % intervals 17 or more hold with a probability of 0.984; 13 or fewer with one of 1e-7, as of those for
    white noise, which are too short by up to sqrt((1 + 0.9) / (1 - 0.9)).
    """
    scene, held, rho = scene_from_text(SCENE), [], 0.9
    for seed in range(20):
        log = log_of(LACKING["nothing"], seed, noise=0.0)
        (measured,) = log.measured
        kept = slice(0, 800, 2)  # 8 s at 50 Hz
        white = np.random.default_rng(seed).normal(size=600)
        noise = NOISE * scipy.signal.lfilter([np.sqrt(1.0 - rho**2)], [1.0, -rho], white)[200:]
        values = measured.values[kept] + noise[:, None]
        log = Log((), (replace(measured, times=measured.times[kept], values=values),))
        found = identify(scene, log, ["hinge.friction.viscous"], workers=1)
        solution = found.comparison.solution
        plain = np.sqrt(solution.covariance[0, 0] * solution.reduced) * found.comparison.fit.runs.numbers.scales[0]
        off, width = abs(found.values[0] - VISCOUS), found.comparison.half_width
        held.append((off < width * found.deviations[0], off < width * plain))
        assert found.is_robust
    robust, white = np.sum(held, axis=0)
    assert robust >= 17 and white <= 13


def test_a_wrong_mass_of_a_driven_load_shows_in_long_runs():
    """The period of a pendulum with a disc three times as heavy differs, although 0.1 s of it fit any mass."""
    log = log_of(LACKING["nothing"], 2)
    half = tuple(replace(each, times=each.times[:600], values=each.values[:600]) for each in log.measured)
    found = compare(scene_from_text(SCENE.replace("length: 0.6", "length: 0.5")), Log((), half), workers=1)
    assert not found.agrees and found.horizon.within_noise < 1.0
    spread = found.fit.runs.log.measured[0].spread[0]
    assert found.horizon.error.max() > 0.5 * spread


@pytest.mark.turn(3)
def test_the_explained_part_is_that_of_the_noise_of_starts():
    """Of 12 right models the mean square of error by what is explained is near 1: within four standard deviations.

    At the longest time ahead one run is left: a chi-square of one degree of freedom, of variance 2.
    """
    scene, ratios = scene_from_text(SCENE.replace("viscous: 0.01", f"viscous: {VISCOUS}")), []
    for seed in range(12):
        found = compare(scene, log_of(LACKING["nothing"], 10 + seed), workers=1)
        (horizon,) = found.horizons
        ratios.append(float((horizon.error[-1] / horizon.expected[-1]) ** 2))
    assert abs(np.mean(ratios) - 1.0) < 4.0 * np.sqrt(2.0 / len(ratios))


def test_times_of_a_horizon():
    ahead = np.array([0.1, 0.2, 0.4, 0.8])
    error, none = np.array([0.011, 0.014, 0.03, 0.02]), np.zeros(4)
    horizon = Horizon(
        "a.position",
        "/a",
        "rad",
        0.01,
        ahead,
        error,
        none,
        none,
        np.full(4, 3),
        np.full(4, 1000),
        np.full(4, 3),
        0.02,
        (),
    )
    assert (horizon.within_noise, horizon.within(0.02), horizon.within(0.001)) == (0.2, 0.2, 0.0)
    assert horizon.within(0.05) == 0.8 and horizon.differs_from == 0.4
    assert "within its noise for 0.2 s, within 0.02 rad for 0.2 s; it is off by up to 0.03 rad" in horizon.text
    assert [_rounded(size) for size in (0.0317, 0.07, 1.3, 0.0)] == [0.05, 0.05, 1.0, 0.0]


SLEDGE = text_of("sledge_horizon.yaml")


@pytest.mark.parametrize("is_known", [False, True])
def test_predictions_beside_a_machine_that_is_pushed(is_known):
    """A force of which the model does not know: starts are straight lines through parts of a parabola, see polyfit.

    Of what is known to act nothing is left but round-off: differences of runs are so by 1e-7, of motions below 10 m.
    """
    a, last, scene = 0.7, 4.37, scene_from_text(SLEDGE)
    simulation = Simulation(scene, method="rkmk4", step=0.01, quiet=True)
    simulation.apply_effort("rail", 2.0 * a)
    simulation.advance(1)
    acting = ((0.0, simulation.sample().acting),) if is_known else ()
    at = np.arange(0.0, last, 1.0 / RATE)
    x = 0.5 * a * at**2
    log = Log((), (Measured("/m", at, ("rail.position",), x[:, None], np.array([1e-3]), 0.0),), acting=acting)
    (found,) = Shadow(scene).horizons(log)
    squares = [[] for _ in ENDS]
    for begin in START * np.arange(int(at[-1] / START))[-int(ENDS[-1] / START + 2) : -1]:
        own = (at > begin - 1e-9) & (at < begin + START - 1e-9)
        off = x - np.polyval(np.polyfit(at[own], x[own], 1), at)
        ahead = at - begin - START
        for k, (low, high) in enumerate(zip((0.0, *ENDS), ENDS)):
            here = (ahead > low + 1e-9) & (ahead < high + 1e-9) & (at >= at[-1] - PRESENT)
            squares[k] += np.sort(off[here] ** 2)[: -1 if here.sum() > 2 else None].tolist()
    expected = [np.sqrt(np.mean(of)) for of in squares]
    assert found.ahead.tolist() == ENDS.tolist()
    if is_known:
        assert found.error.max() < 1e-6
    else:
        assert found.error == pytest.approx(expected, rel=1e-3)
        assert found.within(0.05) == ENDS[np.flatnonzero(np.array(expected) > 0.05)[0] - 1]


@pytest.mark.parametrize("what", ["nothing", "a jam", "a payload", "a wrong sign"])
@pytest.mark.volume(2)
def test_a_machine_that_departs_is_seen_within_a_second(what):
    """Of a pendulum, each quarter of a second, up to 1 s ahead; before, and of the same, errors are as explained.

    In 30 comparisons of 10 intervals an rms beyond 6 deviations has a probability below 1e-6. Until it departs, each
    machine is the one that does not.
    """
    scene, event = scene_from_text(SCENE.replace("viscous: 0.01", "viscous: 0.02")), 5.0
    heavier = 3.0 if what == "a payload" else 1.0  # the mass of a point at the end is that of the rod

    def slope(t, y):
        arm, inertia = (
            (1.5 * LENGTH, INERTIA + MASS * LENGTH**2) if heavier > 1.0 and t > event else (0.5 * LENGTH, INERTIA)
        )
        return [y[1], (-VISCOUS * y[1] - MASS * GRAVITY * arm * np.sin(y[0])) / inertia]

    at = np.arange(0.0, 8.0, 1.0 / RATE)
    y = scipy.integrate.solve_ivp(slope, (0.0, 8.0), [1.1, 0.0], t_eval=at, rtol=1e-9, atol=1e-12, max_step=0.01).y.T
    if what == "a jam":
        y[at > event] = y[np.argmax(at > event), 0], 0.0
    elif what == "a wrong sign":
        y[at > event, 0] *= -1.0
    y += NOISE * np.random.default_rng(5).normal(size=y.shape)
    shadow, seen = Shadow(scene), []
    for now in np.arange(1.0 if what == "nothing" else event, event + 1.26, 0.25):
        rows = (at <= now) & (at > now - 4.5)
        channels, unknown = ("hinge.position", "hinge.velocity"), np.full(2, np.nan)
        horizons = shadow.horizons(Log((), (Measured("/m", at[rows], channels, y[rows], unknown, 0.0),)))
        near = [each.error[each.ahead <= 1.0] / each.expected[each.ahead <= 1.0] for each in horizons]
        seen.append((now, max(each.max() for each in near)))
        if what != "nothing" and now > event and seen[-1][1] > 12.0:
            break
    before = [ratio for now, ratio in seen if now <= event or what == "nothing"]
    assert max(before) < 6.0
    if what != "nothing":
        assert seen[-1][1] > 12.0 and seen[-1][0] <= event + 1.0
