# SPDX-License-Identifier: Apache-2.0
"""Sweeps: parameters by name, Latin hypercube, runs that depend only on their number."""

import math
import os
import signal
from importlib import import_module
from pathlib import Path

import numpy as np
import pandas
import pyarrow.parquet
import pytest
from scene_files import cases, text_of
from scipy.special import ndtr

from liegroup_core import load_scene
from liegroup_core.fields.frames import ROTATIONS
from liegroup_core.layout import make_layout
from liegroup_core.mechanism import redundancy
from liegroup_core.mechanism.redundancy import generic_poses
from liegroup_core.scene.load import scene_as_written, scene_from_text
from liegroup_core.scene.parameters import ParameterError, changed, parameters, path_of, range_of
from liegroup_core.study.sweep import sweep as sweeps
from liegroup_core.study.sweep.file import SweepFile, SweepFileError
from liegroup_core.study.sweep.sweep import Sweep, describe, described

SCENES = sorted((Path(__file__).resolve().parents[2] / "config" / "scenes").glob("*.yaml"))
# A point on a spring of length 0 about the origin: x(t) = x0 cos(w t) + v0 / w sin(w t) in each
# direction, w^2 = stiffness / mass. It does not turn.
OSCILLATOR = text_of("oscillator_sweep.yaml")
VARY = ["mass=1:4:log", "spring.stiffness=4:9", "position.0=-1,0.5,2", "linear_velocity.1=0~0.5"]
TIME, STEP = 2.0, 0.02


def oscillator(samples=12, **more):
    return Sweep.of(
        scene_from_text(OSCILLATOR),
        VARY,
        samples,
        round(TIME / STEP),
        **{"settings": {"method": "rkmk8", "step": STEP}} | more,
    )


def joined(pieces):
    """{column: values} of all runs in order, without their cost."""
    pieces = sorted(pieces, key=lambda piece: piece["run"][0])
    return {name: [value for piece in pieces for value in piece[name]] for name in pieces[0] if name != "cpu_s"}


def same(first, second):
    """Whether two tables are bit-identical."""

    def bits(columns):
        return {
            name: [np.asarray(value).tobytes() if isinstance(value, (float, np.ndarray)) else value for value in values]
            for name, values in columns.items()
        }

    return bits(first) == bits(second)


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
@pytest.mark.volume(8)
def test_every_number_of_a_scene_is_a_parameter(path):
    """Its own value changes nothing; another value changes nothing else."""
    scene = scene_as_written(path.read_text())
    before = parameters(scene)
    assert all(f"bodies.{body.name}.position.0" in before for body in scene.bodies)
    assert {f"gravity.{i}" for i in range(3)} < set(before)
    for name, value in list(before.items())[:: math.ceil(len(before) / 60)]:
        if value is None or "inertia" in name:  # three that must fit each other
            continue
        after = parameters(changed(scene, {name: value * 0.75 + 0.01}))
        assert after[name] == value * 0.75 + 0.01
        kind = next((kind for kind in ROTATIONS if kind in name), None)
        for other in set(before) - {name}:
            if name.endswith("shape.length") and other.endswith("shape.radius"):
                continue  # of a rod: a part of its length if left out
            if kind is None or not other.startswith(tuple(name.partition(kind)[0] + key for key in ROTATIONS)):
                assert after[other] == before[other], (name, other)
            elif kind == "rotation_vector" and kind in other:
                # Written as such now: the way there and back of a quaternion or an axis rounds.
                assert after[other] == pytest.approx(before[other], abs=1e-14)


def test_a_parameter_name_is_a_path_or_an_unambiguous_ending():
    scene = scene_as_written(OSCILLATOR)
    for name in ("mass", "ball.mass", "bodies.ball.mass"):
        assert path_of(scene, name) == "bodies.ball.mass"
    assert path_of(scene, "rotation_vector.2") == "bodies.ball.rotation_vector.2"
    with pytest.raises(ParameterError, match=r"no parameter mas; did you mean bodies\.ball\.mass"):
        path_of(scene, "mas")
    with pytest.raises(ParameterError, match="is ambiguous: gravity.1, bodies.ball.inertia.1, .* and "):
        path_of(scene, "1")


@pytest.mark.parametrize("text, said", cases("a_wrong_range_is_refused_in_one_line"))
def test_a_wrong_range_is_refused_in_one_line(text, said):
    with pytest.raises(ParameterError) as error:
        range_of(scene_as_written(OSCILLATOR), text)
    assert said in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("samples", [1, 7, 64])
def test_latin_hypercube_has_one_value_per_stratum(samples):
    """Each of N equal intervals of a parameter's range has exactly one value."""
    sweep = oscillator(samples)
    mass, stiffness, position, velocity = sweep.values.T
    shares = (np.log(mass) / math.log(4.0), (stiffness - 4.0) / 5.0, ndtr(velocity / 0.5))
    for share in shares:
        assert sorted(np.floor(share * samples).astype(int)) == list(range(samples))
    if samples == 64:  # 64 shares, a third of them each
        assert sorted(np.unique(position, return_counts=True)[1]) == [21, 21, 22]
    assert np.array_equal(sweep.values, oscillator(samples).values)
    assert not np.array_equal(mass, oscillator(samples, seed=1).values[:, 0])


def test_all_runs_agree_with_the_closed_form():
    """The error of rkmk8 goes with (w h)^8 w t < (3 * 0.02)^8 * 6 < 1e-9, times a constant below
    1e-3 of a method of order 8 (1 / 9!): below rounding, 1e-16 in each of 100 steps.
    """
    columns = joined(oscillator(every=25).run(range(12), workers=1))
    mass, k, x0, v0 = (np.array(columns[path]) for path in oscillator().paths)
    assert columns["status"] == ["ok"] * 12 and columns["warning"] == [None] * 12
    w = np.sqrt(k / mass)
    assert np.allclose(columns["ball.x"], x0 * np.cos(w * TIME), rtol=0, atol=1e-13)
    assert np.allclose(columns["ball.y"], v0 / w * np.sin(w * TIME), rtol=0, atol=1e-13)
    assert np.allclose(columns["ball.vx"], -w * x0 * np.sin(w * TIME), rtol=0, atol=1e-12)
    energy = (k * x0**2 + mass * v0**2) / 2
    assert np.allclose(columns["energy_start"], energy, rtol=1e-14)
    assert (np.array(columns["energy_drift"]) <= 1e-12 * energy).all()
    assert columns["time"] == [TIME] * 12 and columns["largest.constraint_residual"] == [0.0] * 12
    for i in range(12):
        times = columns["samples.time"][i]
        assert np.allclose(times, np.arange(0.0, TIME + STEP, 25 * STEP))
        assert np.allclose(columns["samples.ball.x"][i], x0[i] * np.cos(w[i] * times), atol=1e-13)
        assert columns["samples.ball.y"][i][-1] == columns["ball.y"][i]


@pytest.mark.slow
@pytest.mark.turn(3)
def test_results_are_bit_identical_for_any_workers_pieces_and_a_killed_worker(monkeypatch, tmp_path):
    """One of two workers is killed once, in run 5."""
    died = tmp_path / "died"

    def simulate(work, limit=math.inf):
        module = import_module("liegroup_core.study.sweep.sweep")
        if work[1] == 5 and not died.exists():
            died.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        # Workers import the module as it is.
        return getattr(module, "unchanged", module.simulate)(work, limit)

    monkeypatch.setattr(sweeps, "FIRST", 0.0)
    sweep = oscillator(every=50)
    pieces = list(sweep.run(range(12), workers=1))
    assert [len(piece["run"]) for piece in pieces] == [1, 11]
    alone = joined(sweep.run(range(12), workers=1))
    monkeypatch.setattr(sweeps, "PIECE", 1e-9)  # a run each
    monkeypatch.setattr(sweeps, "unchanged", sweeps.simulate, raising=False)
    monkeypatch.setattr(sweeps, "simulate", simulate)
    shared = list(sweep.run(range(12), workers=2))
    assert died.exists() and len(shared) == 12
    assert same(joined(shared), alone)
    # Runs that are asked for alone, with gaps, too.
    some = joined(sweep.run([2, 3, 7], workers=1))
    assert same(some, {name: [values[k] for k in (2, 3, 7)] for name, values in alone.items()})


def test_a_run_is_reproduced_from_its_scene():
    sweep = oscillator()
    row = joined(sweep.run([5], workers=1))
    simulation = sweep.simulation(5)
    simulation.advance(sweep.steps)
    assert simulation.sample().positions["ball"][0] == row["ball.x"][0]
    assert scene_from_text(sweep.scene(5).text).bodies == sweep.scene(5).bodies
    assert described(describe(sweep)) == sweep


def test_failed_runs_are_rows_with_the_reason():
    """Initial states that violate a joint, one that is assembled, a step that is too large."""
    top = load_scene("heavy_top")
    vary = ["angular_velocity.2=-1,0.5,1"]
    settings = {"step": 1e-3}
    open_ = joined(Sweep.of(top, vary, 6, 10, settings=settings).run(range(6), workers=1))
    for value, status, time in zip(open_["bodies.top.angular_velocity.2"], open_["status"], open_["time"]):
        if value == 0.5:
            assert status == "ok" and time == 0.01
        else:
            assert "the initial velocities violate the joint" in status and math.isnan(time)
    closed = joined(Sweep.of(top, vary, 6, 10, every=10, assemble=True, settings=settings).run(range(6), workers=1))
    assert closed["status"] == ["ok"] * 6 and max(closed["largest.constraint_residual"]) < 1e-9
    # What was drawn is kept, the velocity of the centre follows: 0.5 m from the pivot.
    for value, turn, speed in zip(
        closed["bodies.top.angular_velocity.2"], closed["samples.top.wz"], closed["samples.top.vy"]
    ):
        assert turn[0] == pytest.approx(value, abs=1e-15)
        assert speed[0] == pytest.approx(value / 2, abs=1e-15)
    fast = joined(
        Sweep.of(load_scene("lagrangian_top"), ["mass=1,1.1"], 2, 10, settings={"method": "rkmk4", "step": 0.1}).run(
            range(2), workers=1
        )
    )
    assert all("stopped at t = " in status for status in fast["status"])
    assert all(0.0 <= time < 1.0 for time in fast["time"])
    drawn = joined(oscillator_with("mass=0.1~1").run(range(8), workers=1))
    for mass, status in zip(drawn["bodies.ball.mass"], drawn["status"]):
        assert (status == "ok") == (mass > 0.0)
        assert mass > 0.0 or "mass must be greater than 0" in status
    assert min(drawn["bodies.ball.mass"]) < 0.0


def test_assembly_failures_and_changes_are_reported():
    """Inconsistent velocities are a failure; a pose that closes elsewhere is a warning."""
    top = load_scene("heavy_top")
    settings = {"step": 1e-3}
    found = joined(
        Sweep.of(top, ["angular_velocity.2=1:2", "linear_velocity.1=3:4"], 3, 5, assemble=True, settings=settings).run(
            range(3), workers=1
        )
    )
    assert all("contradict each other" in status for status in found["status"])
    found = joined(
        Sweep.of(top, ["bodies.top.position.0=0.4,0.5"], 2, 5, every=5, assemble=True, settings=settings).run(
            range(2), workers=1
        )
    )
    assert found["status"] == ["ok"] * 2
    for value, warning, start in zip(found["bodies.top.position.0"], found["warning"], found["samples.top.x"]):
        assert start[0] == 0.5  # from the pivot
        assert (warning is None) == (value == 0.5)
        assert warning is None or "position.0 to 0.5 from the sampled 0.4" in warning


def test_a_linkage_is_analysed_once_per_geometry():
    """A cached result is that of a new analysis for other masses; other lengths are not cached."""
    for kept in (generic_poses, redundancy._chosen):
        kept.cache_clear()
    base = scene_as_written((SCENES[0].parent / "four_bar.yaml").read_text())
    paths = [{}, {"bodies.rocker.shape.mass": 2.0}, {"joints.crank_coupler.child_frame.position.0": -0.51}]
    layouts, looks = [], []
    for values in paths:
        layouts.append(make_layout(changed(base, values)))
        assert layouts[-1].normal is not None
        looks.append(generic_poses.cache_info().misses)
    assert looks == [1, 1, 2]
    assert layouts[0].kept_rows == layouts[1].kept_rows and layouts[0].dropped_rows


def oscillator_with(*vary):
    return Sweep.of(scene_from_text(OSCILLATOR), vary, 8, 10, settings={"step": STEP})


def test_invalid_sweeps_are_refused():
    for change, said in (
        ({"samples": 0}, "samples must be"),
        ({"seed": -1}, "the seed must be"),
        ({"samples": 10**12}, "exceed 1e"),
        ({"settings": {"method": "rk"}}, "unknown method"),
    ):
        with pytest.raises(ValueError, match=said):
            oscillator(**change)
    for vary, said in (((), "no parameter varies"), (("mass=1:2", "ball.mass=1:3"), "given twice")):
        with pytest.raises(ParameterError, match=said):
            oscillator_with(*vary)


def test_an_interrupted_sweep_resumes_to_the_same_file(tmp_path, monkeypatch):
    monkeypatch.setattr(sweeps, "FIRST", 0.0)
    monkeypatch.setattr(sweeps, "PIECE", 1e-9)
    sweep = oscillator(every=50)
    whole, begun = tmp_path / "whole.parquet", tmp_path / "begun.parquet"
    with SweepFile(whole, describe(sweep)).writing() as file:
        for columns in sweep.run(range(12), workers=1):
            file.add(columns)
    with SweepFile(begun, describe(sweep)).writing() as file:
        runs = sweep.run(file.missing, workers=1)
        for columns in (next(runs), next(runs)):
            file.add(columns)
        runs.close()
    (begun / ".runs-000000009-000000009.parquet.part").write_bytes(b"cut off")
    monkeypatch.setattr(sweeps, "PIECE", 1.0)
    with SweepFile(begun, describe(sweep)).writing() as file:
        assert list(file.missing) == list(range(2, 12))
        for columns in sweep.run(file.missing, workers=1):
            file.add(columns)
        with pytest.raises(SweepFileError, match="another process is writing"):
            with SweepFile(begun).writing():
                pass
    assert not list(begun.glob(".*"))
    tables = [SweepFile(path).table().drop_columns(["cpu_s"]) for path in (whole, begun)]
    assert tables[0].equals(tables[1]) and tables[0].num_rows == 12
    assert SweepFile(begun).sweep == sweep and not len(SweepFile(begun).missing)
    # Others read the folder as one table, and each file says what it is.
    frame = pandas.read_parquet(begun)
    assert list(frame["run"]) == list(range(12)) and frame["bodies.ball.mass"].between(1, 4).all()
    assert frame["samples.ball.x"][0].shape == (3,)
    assert pyarrow.parquet.read_table(begun).num_rows == 12
    part = min(begun.glob("*.parquet"))
    assert b"liegroup_sim.sweep" in pyarrow.parquet.read_schema(part).metadata

    with pytest.raises(SweepFileError, match="contains a different sweep: seed 0 there and 1 here"):
        SweepFile(begun, describe(oscillator(every=50, seed=1)))
    part.write_bytes(part.read_bytes()[:200])
    with pytest.raises(SweepFileError, match="is damaged"):
        SweepFile(begun)


def test_a_folder_without_a_sweep_is_not_touched(tmp_path):
    sweep = describe(oscillator())
    (tmp_path / "a.parquet").write_text("mine")
    (tmp_path / "b.parquet").mkdir()
    (tmp_path / "b.parquet" / "notes.txt").write_text("mine")
    for name, said in (
        ("a.parquet", "is a file"),
        ("b.parquet", "it contains notes.txt"),
        ("c.csv", "must end in .parquet"),
    ):
        with pytest.raises(SweepFileError, match=said):
            SweepFile(tmp_path / name, sweep)
    with pytest.raises(SweepFileError, match="no sweep found"):
        SweepFile(tmp_path / "d.parquet")
    with pytest.raises(SweepFileError, match="cannot be written"):
        with SweepFile(tmp_path / "none" / "e.parquet", sweep).writing():
            pass
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["a.parquet", "b.parquet", "notes.txt"]


@pytest.mark.turn(3)
def test_derivatives_by_the_sampled_numbers_are_columns():
    """x = x0 cos(w t), w^2 = k / m: by x0, k and m, for each sample."""
    sweep = oscillator(4, gradient=["ball.x", "ball.vx"])
    columns = {name: np.array(values) for name, values in joined(sweep.run(range(4), workers=1)).items()}
    paths = ["bodies.ball.mass", "forces.spring.stiffness", "bodies.ball.position.0"]
    m, k, x = (columns[path] for path in paths)
    w = np.sqrt(k / m)
    slope = -x * TIME * np.sin(w * TIME)
    for path, expected in zip(paths, (-0.5 * slope * w / m, 0.5 * slope * w / k, np.cos(w * TIME))):
        np.testing.assert_allclose(columns[f"d ball.x / d {path}"], expected, rtol=1e-8, atol=1e-9)
    assert list(sweep.columns) == [*columns, "cpu_s"] and described(describe(sweep)) == sweep


def test_the_largest_reactions_of_each_run_are_columns():
    """For three masses of the crank, they are those of a simulation at the same times."""
    sweep = Sweep.of(
        load_scene("four_bar"),
        ["bodies.crank.shape.mass=1:3"],
        3,
        20,
        every=10,
        settings={"method": "rkmk4", "step": 1e-3},
        reactions=True,
    )
    columns = joined(sweep.run(range(3), workers=1))
    assert list(sweep.columns) == [*columns, "cpu_s"]
    simulation, looks = sweep.simulation(1), []
    for steps in (0, 10, 10):
        simulation.advance(steps)
        looks.append(np.abs(simulation.sample().reactions["crank_coupler"]))
    found = [columns[f"largest.crank_coupler.{part}"][1] for part in ("tx", "ty", "tz", "fx", "fy", "fz")]
    assert np.array_equal(found, np.max(looks, axis=0), equal_nan=True)
    assert np.isnan(found).any() and found[3] > 1.0
    again = described(describe(sweep))
    assert again == sweep


def test_the_largest_impulses_at_impacts_are_columns():
    """For three masses of the leaf, those of a simulation; zero in a run without an impact."""
    settings = {"method": "rkmk4", "step": 1e-3}
    scene = load_scene("door")
    vary = [f"bodies.{scene.bodies[0].name}.shape.mass=20:40"]
    sweep = Sweep.of(scene, vary, 2, 3000, every=500, settings=settings, reactions=True)
    columns = joined(sweep.run(range(2), workers=1))
    assert list(sweep.columns) == [*columns, "cpu_s"]
    simulation = sweep.simulation(1)
    simulation.drain_impacts()
    simulation.advance(3000)
    largest = np.max([np.abs(impact.array) for impact in simulation.drain_impacts()], axis=0)
    joint = scene.joints[0].name
    parts = ("tx", "ty", "tz", "fx", "fy", "fz")
    found = [columns[f"largest.{joint}.impulse_{part}"][1] for part in parts]
    assert np.array_equal(found, largest[0], equal_nan=True) and np.nanmax(found) > 10.0
    short = Sweep.of(scene, vary, 2, 100, settings=settings, reactions=True)
    few = joined(short.run(range(2), workers=1))
    assert [few[f"largest.{joint}.impulse_{part}"][0] for part in parts] == [0.0] * 6
    without = Sweep.of(scene, vary, 2, 100, settings=settings)
    assert not any("impulse" in name for name in without.columns)


def test_the_largest_efforts_of_forces_at_joints_are_columns_beside_the_reactions():
    text = text_of("pair_sweep.yaml")
    settings = {"method": "rkmk4", "step": 1e-3}
    sweep = Sweep.of(scene_from_text(text), ["bodies.arm.mass=1:3"], 3, 200, 50, settings=settings, reactions=True)
    columns = joined(sweep.run(range(3), workers=1))
    assert list(sweep.columns) == [*columns, "cpu_s"] and "largest.wind.effort" not in columns
    simulation, looks = sweep.simulation(2), []
    for steps in (0, 50, 50, 50, 50):
        simulation.advance(steps)
        looks.append(simulation.sample().force_efforts["spring"])
    assert columns["largest.spring.effort"][2] == np.abs(looks).max() > 0.1
    assert list(columns["largest.drive.effort"]) == [2.0] * 3
