# SPDX-License-Identifier: Apache-2.0
"""Laws: formulas against 50 digits, hostile texts, and mechanisms under laws against SciPy."""

import functools
import math
import warnings

import mpmath
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scene_files import cases, text_of
from scipy.integrate import solve_ivp
from volume import some

from liegroup_core import SceneError, Simulation
from liegroup_core.forces import formulas, law
from liegroup_core.forces.formulas import FUNCTIONS, FormulaError, Program, differentiate, evaluate, table_arrays
from liegroup_core.forces.skipping import arrange
from liegroup_core.identification import Log, Measured, identify
from liegroup_core.linear import linearise, sensitivities, trim
from liegroup_core.methods.families import fitting_methods
from liegroup_core.reference.formulas import Postfix
from liegroup_core.reference.formulas import evaluate as by_stack
from liegroup_core.scene.load import scene_from_text

NAMES = ("x", "y", "z")
TABLE = ((-2.0, -0.5, 0.25, 3.0), (1.0, -2.0, 0.5, 4.0))


# ---------------------------------------------------------------- formulas


def random_formula(rng, depth):
    """Text of a formula of x, y, z with every operation and function."""
    if depth == 0:
        return str(rng.choice([*NAMES, f"{rng.uniform(0.2, 3):.3f}", "pi", str(rng.integers(1, 4))]))
    a, b, c = (random_formula(rng, depth - 1) for _ in range(3))
    name = rng.choice([*FUNCTIONS, *"+-*/^", "power", "not", "if", "table", "minus"])
    if name in FUNCTIONS:
        count = 3 if name in ("min", "clip") else FUNCTIONS[name][1]
        return f"{name}({', '.join((a, b, c)[:count])})"
    forms = {"^": f"({a})**{rng.integers(1, 9)}", "power": f"({a})**({b})", "table": f"table({a})", "minus": f"-({a})"}
    forms |= {"not": f"({a} if not {b} > {c} else {c})", "if": f"({a} if {b} < {c} <= 1 or {a} >= 0 else {b})"}
    return forms.get(name, f"({a} {name} {b})")


def exact(text, at):
    """Value of a formula with 50 digits, by Python's own evaluation of its text."""

    def table(value):
        x, y = (list(map(mpmath.mpf, part)) for part in TABLE)
        k = next((k for k in range(len(x) - 1) if x[k] <= value < x[k + 1]), None)
        if k is None:
            return y[0] if value < x[0] else y[-1]
        return y[k] + (y[k + 1] - y[k]) / (x[k + 1] - x[k]) * (value - x[k])

    def real(function):
        def of(*values):
            found = function(*values)
            if isinstance(found, mpmath.mpc):
                raise ValueError("no real number")
            return found

        return of

    functions = {name: real(getattr(mpmath, name)) for name in FUNCTIONS if hasattr(mpmath, name)}
    functions |= {"min": min, "max": max, "abs": real(abs), "table": table, "pi": mpmath.pi}
    functions["clip"] = lambda value, low, high: min(max(value, low), high)
    value = eval(text, functions, at)
    if isinstance(value, mpmath.mpc) or not mpmath.isfinite(value) or abs(value) > 1e12:
        raise ValueError("no real number")
    return mpmath.mpf(value)


def compiled(text):
    """Function of (values, direction) that gives value and derivative of a formula by the kernels."""
    program = Program()
    names = {name: program.new() for name in NAMES}
    to = program.compile(text, names, {"table": program.table(*TABLE)})
    code, arrays = np.array(program.code, dtype=np.int64).reshape(-1, 5), table_arrays(program.tables)

    def at(values, direction):
        registers = np.zeros((len(program.registers), 2))
        registers[:, 0] = program.registers
        for name, value, change in zip(NAMES, values, direction):
            registers[names[name]] = value, change
        plain = registers.copy()
        evaluate(code, *arrays, plain, True)
        differentiate(code, *arrays, registers, True)
        assert plain[:, 0].tobytes() == registers[:, 0].tobytes()
        return registers[to]

    return at


def test_blocks_that_are_skipped_change_no_bit():
    """Results and derivatives of random programs with nested conditions, in their order and in that with blocks.

    Old numbers of skipped blocks stay in the registers from one pass to the next, and so do their zeros.
    """
    rng, skipped = np.random.default_rng(7), 0
    for _ in some(range(300), 60):
        program = Program()
        names, table = {name: program.new() for name in NAMES}, {"table": program.table(*TABLE)}
        for k in range(4):  # signals, which later ones use under other conditions
            names[f"s{k}"] = program.compile(random_formula(rng, 3), names, table)
        results = []
        for _ in range(4):
            a, b = rng.choice([*NAMES, "s0", "s1", "s2", "s3"], 2)
            inner = f"({random_formula(rng, 2)} + s1*s2 if {b} < s3 and s0 > 0.1 else 0)"
            # What a block with a condition from another block has, comes before both.
            early = {"early": program.compile(random_formula(rng, 2), names, table)} | names
            outer = f"{inner} + {a}*s1 if {a} > 0.5 else 0"
            results.append(program.compile(f"({outer}) + (early*(early + 1) if {inner} > 0.2 else 0)", early, table))
        rows, _ = arrange(program.code, {*results}, program.number(0.0), program.new)
        orders = [np.array(each, dtype=np.int64) for each in (program.code, [row for row, *_ in rows])]
        arrays, both = table_arrays(program.tables), [np.zeros((len(program.registers), 2)) for _ in range(2)]
        for registers in both:
            registers[:, 0] = program.registers
        for inputs in rng.uniform(-2.0, 3.0, (16, 3, 2)):
            # Each column has its own zeros of blocks, which must not depend on the order of these passes.
            both_columns = rng.uniform() < 0.6
            for code, registers in zip(orders, both):
                registers[[names[name] for name in NAMES]] = inputs
                if both_columns:
                    differentiate(code, *arrays, registers, True)
                else:
                    evaluate(code, *arrays, registers, True)
            skipped += both[0].tobytes() != both[1].tobytes()
            columns = slice(None) if both_columns else 0
            assert both[0][results, columns].tobytes() == both[1][results, columns].tobytes()
    assert skipped > 50


def by_reference(text, values):
    """Value of a formula by the stack machine of the reference integration."""
    program = Postfix()
    program.tables.append(np.transpose(TABLE))
    program.add(text, {name: k for k, name in enumerate(NAMES)}, {"table": 0}, len(NAMES))
    code, numbers = np.array(program.code), np.array(program.numbers, dtype=float)
    found, stack = np.array([*values, 0.0]), np.empty(program.deepest)
    free = np.full(len(program.surfaces), np.inf)
    program = code, np.array([-1, -1, -1, 0]), np.array([3]), numbers, np.array([0, len(TABLE[0])]), np.transpose(TABLE)
    by_stack(*program, stack, found, free, free.copy())
    return found[-1]


def test_the_reference_computes_what_is_needed_only():
    """A number that nothing selects is not computed, and heights of its comparisons are NaN; others are a - b."""
    program, found = Postfix(), np.array([-1.0, np.nan, np.nan, np.nan])
    program.add("max(x, 3)/0", {"x": 0}, {}, 1)
    program.add("y if x > 0 and y < 1 else x - 2", {"x": 0, "y": 1}, {}, 2)
    program.add("z", {"z": 2}, {}, 3)
    begins = np.array([program.begins.get(k, -1) for k in range(4)])
    free, heights = np.full(len(program.surfaces), np.inf), np.zeros(len(program.surfaces))
    tables, stack = (np.array([0]), np.empty((0, 2))), np.empty(program.deepest)
    by_stack(
        np.array(program.code), begins, np.array([3]), np.array(program.numbers), *tables, stack, found, free, heights
    )
    assert found[2] == found[3] == -3.0 and np.isnan(found[1])
    assert sorted(heights[~np.isnan(heights)]) == [1.0] and np.isnan(heights).sum() == 2


def test_random_formulas_and_their_derivatives_have_all_digits():
    """Against 50 digits: values by Python's evaluation, derivatives by differences of step 1e-20 with 60 digits.

    The reference integration has its own evaluation, of the same values.
    Sums of 1e3 roundings of numbers up to the largest intermediate one, which the formula itself states: formulas whose
    value jumps or has a kink within 1e-9 are left out, because there a rounding decides.
    """
    rng, checked = np.random.default_rng(5), 0
    kinds = set()
    while checked < 300:
        text = random_formula(rng, int(rng.integers(1, 5)))
        values, direction = rng.uniform(-2.5, 2.5, size=3), rng.normal(size=3)
        with mpmath.workdps(60):
            given = dict(zip(NAMES, map(mpmath.mpf, values.tolist())))
            along = dict(zip(NAMES, map(mpmath.mpf, direction.tolist())))
            try:
                ends = [
                    exact(text, {n: given[n] + s * along[n] for n in NAMES}) for s in (-1e-9, -1e-20, 0, 1e-20, 1e-9)
                ]
            except (ValueError, ZeroDivisionError, OverflowError, TypeError, mpmath.libmp.NoConvergence):
                continue
            slope = (ends[3] - ends[1]) / mpmath.mpf(2e-20)
            far = (ends[4] - ends[0]) / mpmath.mpf(2e-9)
            if abs(far - slope) > 1e-4 * (1 + abs(slope)) or abs(slope) > 1e6:
                continue
        try:
            value, change = compiled(text)(values.tolist(), direction.tolist())
        except FormulaError as error:
            pytest.fail(f"{text}: {error}")
        kinds |= {name for name in FUNCTIONS if name in text}
        # Functions lose digits where they are steep; 1e6 is the largest slope kept above.
        assert abs(value - float(ends[2])) <= 1e-9 * (1 + abs(value)), text
        assert abs(by_reference(text, values.tolist()) - float(ends[2])) <= 1e-9 * (1 + abs(value)), text
        assert abs(change - float(slope)) <= 1e-7 * (1 + abs(change)), text
        checked += 1
    assert kinds == {*FUNCTIONS}


def test_values_that_do_not_exist_are_no_numbers_and_no_errors():
    at = [0.0, -1.0, 1e300]
    for text, expected in (
        ("1/x", math.inf), ("-1/x", -math.inf), ("x/x", math.nan), ("sqrt(y)", math.nan), ("log(x)", -math.inf),
        ("log(y)", math.nan), ("exp(z)", math.inf), ("z**2", math.inf), ("y**0.5", math.nan), ("x**y", math.inf),
        ("asin(2)", math.nan), ("sin(1/x)", math.nan), ("y**3", -1.0), ("z*z*0", math.nan), ("atan2(x, x)", 0.0),
    ):  # fmt: skip
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            value, _ = compiled(text)(at, [1.0, 1.0, 0.0])
        assert value == expected or value != value and expected != expected, text


@pytest.mark.parametrize(
    "text, reason",
    [
        ("q + ", "is no formula"),
        ("__import__('os').system('true')", "unknown function"),
        ("q.real", "cannot be used"),
        ("[q]", "cannot be used"),
        ("lambda: 1", "cannot be used"),
        ("q if q", "is no formula"),
        ("f(q)", "unknown function"),
        ("sin(q, q)", "takes 1 values, got 2"),
        ("sin(x=q)", "takes values only"),
        ("sin(*q)", "takes values only"),
        ("1e400", "at most"),
        ("'a'", "is not a number"),
        ("True", "is not a number"),
        ("q @ q", "use + - * / **"),
        ("q & 1", "use + - * / **"),
        ("~q", "cannot be used"),
        ("q in q", "comparisons are"),
        ("kp*Q", "unknown name 'Q'"),
        ("(" * 300 + "q" + ")" * 300, "is no formula"),
        ("-" * 900 + "q", "levels"),
        ("q" * 2001, "at most 2000 characters"),
        ("9**9**9**9", None),
        ("\0", "is no formula"),
        ("(yield)", "cannot be used"),
        ("(q := 1)", "cannot be used"),
        ("f'{q}'", "cannot be used"),
    ],
)
def test_a_formula_that_is_none_is_refused_in_one_line(text, reason):
    law = {"type": "law", "name": "own", "inputs": {"q": "hinge.position"}, "parameters": {"kp": 2.0}}
    law["outputs"] = [{"joint": "hinge", "effort": text}]
    if reason is None:
        pendulum(law)
        return
    with pytest.raises(SceneError) as refused:
        pendulum(law)
    assert reason in str(refused.value) and "\n" not in str(refused.value) and len(str(refused.value)) < 700


def test_hostile_texts_are_refused_or_understood():
    """2000 texts: formulas with characters replaced, deleted, doubled or moved."""
    rng, refused = np.random.default_rng(8), 0
    letters = list("xyz0123456789+-*/()<>=!.,:;[]{}'\"\\ \t\n#@&|~%$_eEjJ\0\u00e9\u4e00") + [
        "**",
        "if",
        "not",
        "lambda",
        "__",
    ]
    for _ in some(range(2000), 500):
        text = list(random_formula(rng, int(rng.integers(1, 4))))
        for _ in range(rng.integers(1, 6)):
            k = int(rng.integers(len(text))) if text else 0
            text[k : k + rng.integers(0, 2)] = list(str(rng.choice(letters)))
        try:
            compiled("".join(text))([0.3, 1.2, -0.7], [1.0, 0.5, 0.2])
        except FormulaError as error:
            refused += 1
            assert "\n" not in str(error)
    assert refused > 100


def test_a_scene_with_too_many_operations_is_refused(monkeypatch):
    monkeypatch.setattr(formulas, "MOST_INSTRUCTIONS", 900)
    signals = {f"s{k}": " + ".join(f"sin(q + {k}.{n})" for n in range(1, 101)) for k in range(6)}
    with pytest.raises(SceneError, match="at most 900 operations"):
        pendulum({"type": "law", "name": "own", "inputs": {"q": "hinge.position"}, "signals": signals})


# ---------------------------------------------------------------- scenes

PENDULUM = text_of("pendulum_laws.yaml")
INERTIA, WEIGHT = 0.05 + 0.8 * 0.25, 0.8 * 9.81 * 0.5


def pendulum(*laws):
    """The pendulum with laws; its equation is INERTIA q'' = effort - WEIGHT sin(q)."""
    return scene_from_text(PENDULUM, "test").remade(forces=list(laws))


def at_hinge(effort, **keys):
    inputs = {"q": "hinge.position", "w": "hinge.velocity"}
    return {"type": "law", "name": "own", "inputs": inputs, "outputs": [{"joint": "hinge", "effort": effort}]} | keys


def expected(effort, duration, start=0.7):
    """(q, w) of the pendulum under effort(t, q, w), by SciPy."""
    found = solve_ivp(
        lambda t, y: [y[1], (effort(t, *y) - WEIGHT * np.sin(y[0])) / INERTIA],
        (0.0, duration),
        [start, 0.0],
        method="DOP853",
        rtol=1e-13,
        atol=1e-14,
    )
    return found.y[:, -1]


def _stribeck(_, q, w):
    return -(0.1 + 0.3 * np.exp(-((w / 0.2) ** 2))) * np.tanh(w / 0.05) - 0.02 * w


def _muscle(t, q, w):
    length = 0.3 - 0.05 * q
    active = 1 / (1 + np.exp(-4 * np.sin(3 * t)))
    return 0.05 * 60 * active * np.exp(-(((length / 0.3 - 1) / 0.45) ** 2)) * (1 - w * 0.05 / 0.5)


SMOOTH = {
    "pd that follows a sine": (
        at_hinge("kp*(0.5*sin(2*t) - q) - kd*w", parameters={"kp": 6.0, "kd": 0.4}),
        lambda t, q, w: 6.0 * (0.5 * np.sin(2 * t) - q) - 0.4 * w,
    ),
    "stribeck friction": (
        at_hinge("-(c + s*exp(-(w/0.2)**2))*tanh(w/0.05) - 0.02*w", parameters={"c": 0.1, "s": 0.3}),
        _stribeck,
    ),
    "muscle": (
        at_hinge(
            "0.05*60*active*shape*(1 - w*0.05/0.5)",
            signals={
                "length": "0.3 - 0.05*q",
                "active": "1/(1 + exp(-4*sin(3*t)))",
                "shape": "exp(-((length/0.3 - 1)/0.45)**2)",
            },
        ),
        _muscle,
    ),
    "magnet at the tip": (
        {
            "type": "law",
            "name": "magnet",
            "inputs": {
                "x": {"quantity": "bob.x", "point": [0, 0, -1]},
                "z": {"quantity": "bob.z", "point": [0, 0, -1]},
            },
            "signals": {"dx": "0.3 - x", "dz": "-1.2 - z", "r2": "dx**2 + dz**2 + 0.01"},
            "outputs": [
                {"body": "bob", "force": ["0.2*dx/r2**2", 0, "0.2*dz/r2**2"], "point": [0, 0, -1], "axes": "world"}
            ],
        },
        lambda t, q, w: _magnet(q),
    ),
}


def _magnet(q):
    # The tip is at (-sin q, -cos q) of x and z, and turns by (-cos q, sin q).
    x, z = -np.sin(q), -np.cos(q)
    dx, dz = 0.3 - x, -1.2 - z
    r2 = dx**2 + dz**2 + 0.01
    return 0.2 / r2**2 * (dx * -np.cos(q) + dz * np.sin(q))


@pytest.mark.parametrize("name", SMOOTH)
def test_motions_under_smooth_laws_are_those_of_scipy(name):
    """To 1e-10: both are run a hundred times more exactly."""
    law, effort = SMOOTH[name]
    simulation = Simulation(pendulum(law), accuracy=1e-11, quiet=True)
    simulation.advance_to(2.0)
    found = simulation.sample().joint_coordinates["hinge"]
    assert_allclose(found, expected(effort, 2.0), rtol=0, atol=1e-10 * 10)


PID = at_hinge(
    "a",
    parameters={"kp": 6.0, "ki": 4.0, "kd": 0.4},
    states={
        "i": {"rate": "e if abs(u) < 3 or e*u < 0 else 0"},
        "a": {"start": 0.2, "rate": "(clip(u, -3, 3) - a)/0.05"},
    },
    signals={"e": "0.5*sin(2*t) - q", "u": "kp*e + ki*i - kd*w"},
)
WINDING = at_hinge(
    "0.9*current", parameters={"R": 1.3, "L": 0.004}, states={"current": {"rate": "(6*sin(5*t) - R*current - 0.9*w)/L"}}
)


@functools.cache
def _with_states(start, slopes, duration, limit=np.inf):
    """(q, w, states) of the pendulum under effort slopes(...)[0] with states of rates slopes(...)[1:], by SciPy."""

    def slope(t, y):
        effort, *rates = slopes(t, *y)
        return [y[1], (effort - WEIGHT * np.sin(y[0])) / INERTIA, *rates]

    given = {"method": "Radau" if limit < np.inf else "DOP853", "max_step": limit}
    return solve_ivp(slope, (0, duration), [0.7, 0.0, *start], rtol=1e-13, atol=1e-14, **given).y[:, -1]


def _winding(t, q, w, current):
    return 0.9 * current, (6 * np.sin(5 * t) - 1.3 * current - 0.9 * w) / 0.004


def _pid(t, q, w, i, a):
    e = 0.5 * np.sin(2 * t) - q
    u = 6 * e + 4 * i - 0.4 * w
    return a, e if abs(u) < 3 or e * u < 0 else 0.0, (min(max(u, -3), 3) - a) / 0.05


@pytest.mark.parametrize("method", ["rkmk4", "rkmk8", "generalized_alpha", "constrained_rattle", "radau5"])
def test_states_of_laws_have_the_order_of_every_method(method):
    """A motor with inductance, time constant 3 ms: fitted slopes of motion and current."""
    known, errors = _with_states((0.0,), _winding, 0.5), []
    order = {"rkmk4": 4, "rkmk8": 8, "generalized_alpha": 2, "constrained_rattle": 2, "radau5": 5}[method]
    steps = np.array([1 / 512, 1 / 1024, 1 / 2048] if order < 5 else [1 / 256, 1 / 384, 1 / 512])
    for step in steps:
        settings = {"rtol": 1e3, "atol": 1e3} if method == "radau5" else {}
        simulation = Simulation(pendulum(WINDING), method, step, quiet=True, estimate=False, **settings)
        simulation.advance_to(0.5)
        sample = simulation.sample()
        found = np.array([*sample.joint_coordinates["hinge"], sample.signals["own.current"]])
        errors.append(np.abs(found - known).max())
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert order - 0.4 <= slope <= order + 1.2, errors


@pytest.mark.parametrize("accuracy", [1e-4, 1e-7])
@pytest.mark.parametrize("group", ["auto", "se3"])
def test_a_controller_with_states_runs_to_an_accuracy(accuracy, group):
    """PID with anti-windup and a lag, whose integral stops at kinks; by SciPy in steps of 1 ms."""
    known = _with_states((0.0, 0.2), _pid, 2.0, limit=1e-3)
    simulation = Simulation(pendulum(PID), accuracy=accuracy, group=group, quiet=True)
    simulation.advance_to(2.0)
    sample = simulation.sample()
    assert abs(np.array(sample.joint_coordinates["hinge"]) - known[:2]).max() <= accuracy * 3
    assert simulation.largest_error <= accuracy * 1.01
    assert sample.signals["own.i"] == pytest.approx(known[2], abs=10 * accuracy)


def test_states_are_part_of_snapshots_branches_and_states_that_are_set():
    import copy

    simulation = Simulation(pendulum(PID), accuracy=1e-6, quiet=True)
    simulation.advance_to(0.61)
    restored, branch = Simulation(pendulum(PID), accuracy=1e-6, quiet=True), copy.deepcopy(simulation)
    restored.restore(simulation.snapshot())
    for run in (simulation, restored, branch):
        run.advance_to(1.13)
    first = simulation.sample()
    for other in (restored.sample(), branch.sample()):
        assert other.signals == first.signals and other.pose.tobytes() == first.pose.tobytes()
    fixed = Simulation(pendulum(PID), "rkmk4", 1e-3, quiet=True)
    fixed.set_state(first.pose, first.twist, 0, angles=first.angles)
    assert fixed.sample().signals["own.i"] == first.signals["own.i"]
    fixed.place(joints={"hinge": (0.1, 0.0)})
    assert fixed.sample().signals["own.i"] == first.signals["own.i"]


def test_linear_systems_have_the_states_of_laws():
    """A (4, 4) by hand, at the start and at the equilibrium that trim finds: the integral holds the weight there."""
    law = at_hinge(
        "a",
        states={"i": {"rate": "e"}, "a": {"start": 0.2, "rate": "(6*e + 4*i - 0.4*w - a)/0.05"}},
        signals={"e": "0.5 - q"},
    )
    simulation = Simulation(pendulum(law), quiet=True)

    def system(q):
        gravity = -WEIGHT * np.cos(q) / INERTIA
        return [[0, 1, 0, 0], [gravity, 0, 0, 1 / INERTIA], [-1, 0, 0, 0], [-120, -8, 80, -20]]

    found = linearise(simulation, outputs=["own.i", "own.e", "hinge.position"])
    assert found.states == ("hinge", "hinge.rate", "own.i", "own.a")
    assert_allclose(found.A, system(0.7), rtol=1e-9, atol=1e-9)
    assert_allclose(found.C, [[0, 0, 1, 0], [-1, 0, 0, 0], [1, 0, 0, 0]], atol=1e-9)
    rest = trim(simulation)
    assert rest.joints["hinge"] == pytest.approx(0.5, abs=1e-9)
    assert_allclose(rest.system.A, system(0.5), rtol=1e-8, atol=1e-8)


def test_a_ramp_is_a_law():
    """A torque that grows from 1 s to 2 s to 3 N m and stays: its kinks are met by substeps, to the accuracy."""
    law = at_hinge("clip(3*(t - 1), 0, 3)")
    for accuracy in (1e-5, 1e-8):
        simulation = Simulation(pendulum(law), accuracy=accuracy, quiet=True)
        simulation.advance_to(4.0)
        known = expected(lambda t, q, w: min(max(3 * (t - 1), 0), 3), 4.0)
        assert abs(simulation.sample().joint_coordinates["hinge"] - known).max() <= accuracy


@pytest.mark.parametrize("method", ["rkmk4", "rkmk8", "generalized_alpha", "constrained_rattle"])
def test_laws_of_the_time_keep_the_order_of_every_method(method):
    """Fitted slopes of the error at three steps; a quarter below the order would be a stage at a wrong time."""
    law, effort = SMOOTH["pd that follows a sine"]
    known, errors = expected(effort, 1.0), []
    order = {"rkmk4": 4, "rkmk8": 8, "generalized_alpha": 2, "constrained_rattle": 2}[method]
    steps = np.array([1 / 8, 1 / 12, 1 / 16] if order == 8 else [1 / 64, 1 / 128, 1 / 256])
    for step in steps:
        simulation = Simulation(pendulum(law), method, step, quiet=True)
        simulation.advance(round(1 / step))
        errors.append(np.abs(simulation.sample().joint_coordinates["hinge"] - known).max())
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert order - 0.25 <= slope <= order + 1.0, errors


def test_rotation_methods_refuse_laws_of_the_time_and_with_states():
    text = PENDULUM.replace("type: revolute", "type: spherical")
    wrench = {"type": "law", "name": "spin", "outputs": [{"body": "bob", "torque": [0, 0, "0.1*cos(t)"]}]}
    scene = scene_from_text(text, "test")
    fitting = fitting_methods(Simulation(scene, quiet=True).layout)
    timed = Simulation(scene.remade(forces=[wrench]), quiet=True)
    assert any(name.startswith("lie_") or "newmark" in name for name in fitting) or len(fitting) > 4
    lost = {*fitting} - {*fitting_methods(timed.layout)}
    assert lost
    with pytest.raises(ValueError, match="the law spin depends on t"):
        Simulation(scene.remade(forces=[wrench]), sorted(lost)[0], 1e-3, quiet=True)
    wrench |= {"states": {"i": {"rate": 1}}, "outputs": [{"body": "bob", "torque": [0, 0, "i"]}]}
    with pytest.raises(ValueError, match="it integrates bodies only, but the law of spin has states"):
        Simulation(scene.remade(forces=[wrench]), sorted(lost)[0], 1e-3, quiet=True)


def test_laws_read_signals_of_earlier_laws_and_samples_show_them():
    filter_ = {"type": "law", "name": "plan", "signals": {"goal": "0.3*t"}}
    own = at_hinge("5*(goal - q)", inputs={"q": "hinge.position", "goal": "plan.goal"}, signals={"miss": "goal - q"})
    simulation = Simulation(pendulum(filter_, own), accuracy=1e-6, quiet=True)
    simulation.advance_to(1.5)
    sample = simulation.sample()
    q, _ = sample.joint_coordinates["hinge"]
    assert sample.signals == {"plan.goal": 0.3 * 1.5, "own.miss": 0.3 * 1.5 - q}
    assert sample.law_efforts == {"hinge": 5 * (0.3 * 1.5 - q)}
    assert sample.total_efforts["hinge"] == sample.law_efforts["hinge"]
    with pytest.raises(SceneError, match="'plan.goal' is no quantity of a law"):
        pendulum(own, filter_)


@pytest.mark.parametrize("change, reason", cases("a_wrong_law_is_refused_in_one_line"))
def test_a_wrong_law_is_refused_in_one_line(change, reason):
    with pytest.raises(SceneError) as refused:
        pendulum(at_hinge("q*w") | change)
    assert reason in str(refused.value) and "\n" not in str(refused.value)


@pytest.mark.parametrize("signals, reason", cases("a_comma_without_quotes_is_named"))
def test_a_comma_without_quotes_is_named(signals, reason):
    """YAML takes it as the end of the formula."""
    with pytest.raises(SceneError) as refused:
        scene_from_text(f"{PENDULUM}forces:\n- {{name: own, type: law, signals: {signals}}}\n", "test")
    assert f"{reason}; between braces or brackets, quote a text that has a comma" in str(refused.value)
    assert str(refused.value).startswith("test:10: ")


def test_lqr_from_linearise_holds_a_cart_pole():
    """The gains that linearise and SciPy give, pasted into a law, bring the closed loop where they should."""
    text = text_of("cart_pole.yaml")
    scene = scene_from_text(text, "test")
    # Rail and hinge: M(q) of the cart pole at the upright pose.
    mass = np.array([[1.2, 0.1], [0.1, 0.02 + 0.2 * 0.25]])
    A = np.block(
        [[np.zeros((2, 2)), np.eye(2)], [np.linalg.solve(mass, np.diag([0, 0.2 * 9.81 * 0.5])), np.zeros((2, 2))]]
    )
    B = np.concatenate([[0, 0], np.linalg.solve(mass, [1, 0])])[:, None]
    from scipy.linalg import solve_continuous_are

    gains = (B.T @ solve_continuous_are(A, B, np.diag([4.0, 10, 1, 1]), [[0.5]])).ravel() / 0.5
    inputs = {"x": "rail.position", "q": "hinge.position", "v": "rail.velocity", "w": "hinge.velocity"}
    names = dict(zip(("k1", "k2", "k3", "k4"), gains.tolist()))
    lqr = {"type": "law", "name": "lqr", "inputs": inputs, "parameters": names}
    lqr["outputs"] = [{"joint": "rail", "effort": "-(k1*x + k2*q + k3*v + k4*w)"}]
    closed = linearise(Simulation(scene.remade(forces=[lqr]), quiet=True))
    known = np.linalg.eigvals(A - B @ gains[None, :])
    assert_allclose(np.sort_complex(np.linalg.eigvals(closed.A)), np.sort_complex(known), rtol=1e-8)
    assert known.real.max() < -0.5
    open_loop = linearise(Simulation(scene, quiet=True))
    assert np.linalg.eigvals(open_loop.A).real.max() > 1.0


@pytest.mark.parametrize("drive", ["0", "kp*sin(2*t)"])
def test_parameters_of_a_law_have_sensitivities(drive):
    """d q(1) / d kp against differences of SciPy's solutions, also of a law that is zero at the start."""
    law = at_hinge(f"{drive} - kp*q - kd*w", parameters={"kp": 6.0, "kd": 0.4})
    found = sensitivities(pendulum(law), ["own.parameters.kp"], [1.0], ["hinge.position"])
    driven = float(drive != "0")
    ends = [
        expected(lambda t, q, w, k=k: driven * k * np.sin(2 * t) - k * q - 0.4 * w, 1.0)[0]
        for k in (6.0 - 1e-3, 6.0 + 1e-3)
    ]
    slope = (ends[1] - ends[0]) / 2e-3  # error below 1e-3^2 of the third derivative
    assert found.derivatives.item() == pytest.approx(slope, rel=1e-5)


@pytest.mark.parametrize("limits", [None, {"lower": -0.2, "upper": 0.95, "restitution": 0.6}])
def test_a_log_is_fitted_by_laws_of_the_time(limits):
    """t is the time of the log, also beside stops, where a run goes on step by step; kp within 5 deviations of 6."""
    scene = pendulum(SMOOTH["pd that follows a sine"][0])
    scene = scene.remade(joints=[scene.joints[0].remade(limits=limits)])
    times, rng, angles = np.linspace(0.0, 2.0, 201), np.random.default_rng(3), []
    simulation = Simulation(scene, accuracy=1e-9, quiet=True)
    for sample in simulation.samples(times):
        angles.append(sample.joint_coordinates["hinge"][0] + 1e-3 * rng.normal())
    assert limits is None or simulation.event_count > 0
    measured = Measured("log", times, ("hinge.position",), np.array(angles)[:, None], np.array([1e-3]), 0.0)
    other = scene.remade(forces=[scene.forces[0].remade(parameters={"kp": 5.0, "kd": 0.4})])
    found = identify(other, Log((), (measured,)), ["own.parameters.kp"], workers=1)
    assert abs(found.values[0] - 6.0) < 5 * found.deviations[0] < 0.05
    assert found.comparison.agrees


def test_the_laws_of_equal_scenes_are_compiled_once(monkeypatch):
    """An analysis makes several simulations of the scene of a recording; a robot with contacts has large laws."""
    text = text_of("pendulum_laws.yaml") + "forces: [{name: lift, type: law, signals: {a: 2*t}}]"
    assert [*law.signals_of(scene_from_text(text).forces)] == ["lift.a"]
    monkeypatch.setattr(law, "arrange", None)
    assert [*law.signals_of(scene_from_text(text).forces)] == ["lift.a"]
    with pytest.raises(TypeError):
        law.signals_of(scene_from_text(text.replace("2*t", "3*t")).forces)
