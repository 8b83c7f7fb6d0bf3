# SPDX-License-Identifier: Apache-2.0
"""The command `liegroup_sim sweep`: results, interruption, failures and wrong input."""

import re
import signal

import numpy as np
import pandas
import pytest
from scene_files import text_of

from liegroup_core.study.sweep import sweep as sweeps
from liegroup_core.study.sweep.file import SweepFile
from liegroup_sim_ros.commands.main import main

# A free body that falls: z = -g/2 t^2 + v t, whatever its mass.
FALL = text_of("fall.yaml")
VARIED = "--vary linear_velocity.2=1:3 mass=1:9:log --vary gravity.2=-9.9:-9.7"
ARGUMENTS = f"{VARIED} --samples 20 --duration 0.5 --method rkmk4 --step 0.01".split()


@pytest.fixture
def fall(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "fall.yaml").write_text(FALL)
    return ["sweep", "fall.yaml", *ARGUMENTS, "--out", "a.parquet"]


def test_sweep_gives_closed_form_results_and_resumes(fall, capsys):
    """Results against the closed form, printed tables, and a repeated call."""
    assert main(fall) == 0
    out = capsys.readouterr().out
    frame = pandas.read_parquet("a.parquet")
    assert len(frame) == 20 and set(frame["status"]) == {"ok"}
    t = 0.5
    height = frame["gravity.2"] * t**2 / 2 + frame["bodies.stone.linear_velocity.2"] * t
    # Exact for a method of order 4; 50 steps of additions to numbers of size 1.
    assert np.allclose(frame["stone.z"], height, rtol=0, atol=50 * 4e-16)
    assert "fall: 20 runs of 0.5 s, rkmk4 at 10 ms; 0 failed" in out
    row = next(line for line in out.splitlines() if line.startswith("stone.z")).split()
    assert float(row[1]) == pytest.approx(frame["stone.z"].min(), rel=1e-2)
    assert float(row[5]) == pytest.approx(frame["stone.z"].max(), rel=1e-2)
    ranks = [line for line in out.splitlines() if line.startswith("stone.z")][1].split()
    assert float(ranks[1]) > 0.95 and abs(float(ranks[2])) < 0.5
    assert float(ranks[1]) == pytest.approx(
        frame["stone.z"].corr(frame["bodies.stone.linear_velocity.2"], method="spearman"), abs=0.005
    )

    before = {path: path.stat().st_mtime_ns for path in SweepFile("a.parquet").path.iterdir()}
    assert main([*fall, "--show", "stone.x"]) == 0
    assert before == {path: path.stat().st_mtime_ns for path in before}
    assert main([*fall, "--seed", "1"]) == 2
    assert "a.parquet: contains a different sweep: seed 0 there and 1 here" in capsys.readouterr().err
    assert main(["sweep", "fall.yaml", "--list"]) == 0
    assert "bodies.stone.mass 1.0" in capsys.readouterr().out.splitlines()


@pytest.mark.turn(3)
def test_an_interrupted_sweep_keeps_its_runs(fall, capsys, monkeypatch):
    """The signal arrives while the third piece is written."""
    monkeypatch.setattr(sweeps, "FIRST", 0.0)
    monkeypatch.setattr(sweeps, "PIECE", 1e-9)
    add, calls = SweepFile.add, []

    def interrupted(file, columns):
        calls.append(columns)
        if len(calls) == 3:
            signal.raise_signal(signal.SIGINT)
        add(file, columns)

    with monkeypatch.context() as patch:
        patch.setattr(SweepFile, "add", interrupted)
        assert main([*fall, "--workers", "1"]) == 130
    err = capsys.readouterr().err
    assert "interrupted; a.parquet has 2 of 20 runs, the same command runs the others" in err
    assert main([*fall, "--workers", "1"]) == 0
    assert "a.parquet has 2 of 20 runs already" in capsys.readouterr().err
    assert main([*fall[:-1], "b.parquet"]) == 0
    tables = [SweepFile(name).table().drop_columns(["cpu_s"]) for name in ("a.parquet", "b.parquet")]
    assert tables[0].equals(tables[1])


def test_failed_runs_are_listed_by_reason(fall, capsys):
    """One third of the masses is negative; the command still succeeds."""
    fall[fall.index("mass=1:9:log")] = "mass=1~2"
    assert main(fall) == 0
    out = capsys.readouterr().out
    failed = int(re.search(r"; (\d+) failed", out)[1])
    frame = pandas.read_parquet("a.parquet")
    assert 3 <= failed == (frame["bodies.stone.mass"] <= 0.0).sum()
    assert f'{failed} failed: Body "stone": mass must be greater than 0, got -' in out
    assert frame["stone.z"].isna().sum() == failed


def test_an_inconsistent_start_suggests_assembly(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    arguments = ["sweep", "heavy_top", "--vary", "angular_velocity.2=-1:1", "--samples", "12", "--duration", "0.01"]
    assert main([*arguments, "--out", "a.parquet"]) == 1
    out, err = capsys.readouterr()
    assert "12 failed" in out and "the initial velocities violate the joint" in out
    assert "--assemble" in err
    assert main([*arguments, "--out", "b.parquet", "--assemble"]) == 0
    assert "0 failed" in capsys.readouterr().out
    assert main([*arguments, "--out", "b.parquet"]) == 2
    assert "assemble True there and False here" in capsys.readouterr().err


def test_a_sweep_to_an_accuracy_has_one_step_and_resumes(fall, capsys):
    """The step is that of the unchanged scene; every run controls its own error."""
    at = fall.index("--method")
    fall[at : at + 4] = ["--accuracy", "1e-6", "--horizon", "0.5"]
    assert main(fall) == 0
    said = "20 runs of 0.5 s, accuracy 1e-06 in 0.5 s, states at 10 ms; 0 failed"
    assert said in capsys.readouterr().out
    description = SweepFile("a.parquet").description
    assert description["settings"]["accuracy"] == 1e-6
    assert description["settings"]["horizon"] == 0.5
    frame = pandas.read_parquet("a.parquet")
    height = frame["gravity.2"] * 0.5**2 / 2 + frame["bodies.stone.linear_velocity.2"] * 0.5
    # Exact for a method of order 8; 50 steps, of at least one substep each.
    assert np.allclose(frame["stone.z"], height, rtol=0, atol=1e-12)
    assert main(fall) == 0
    assert SweepFile("a.parquet").description == description
    fall[fall.index("1e-6")] = "1e-7"
    assert main(fall) == 2
    assert "contains a different sweep" in capsys.readouterr().err


@pytest.mark.parametrize("keep, step", [("0.1", "10 ms"), ("0.0625", "8.93 ms")])
def test_states_are_kept_at_steps_of_an_accuracy(fall, capsys, keep, step):
    """A step that divides both the duration and the period of --keep."""
    for option in ("--method", "--step"):
        at = fall.index(option)
        del fall[at : at + 2]
    assert main([*fall, "--keep", keep]) == 0
    said = f"20 runs of 0.5 s, accuracy 0.0001 in 60 s, states at {step}; 0 failed"
    assert said in capsys.readouterr().out
    times = pandas.read_parquet("a.parquet")["samples.time"][0]
    assert np.allclose(times, np.arange(len(times)) * float(keep), rtol=1e-12, atol=0)


def test_a_missing_pyarrow_is_named(fall, capsys, monkeypatch):
    monkeypatch.setattr("liegroup_core.study.sweep.file.find_spec", lambda name: None)
    assert main(fall) == 2
    assert "pip install 'liegroup_sim_ros[many]'" in capsys.readouterr().err
