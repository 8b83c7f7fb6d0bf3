# SPDX-License-Identifier: Apache-2.0
"""The catalogue of quantities: each name means the same numbers in every place."""

import csv
from types import SimpleNamespace

import numpy as np
import pandas
import pyarrow.parquet
import pytest
from numpy.testing import assert_allclose
from scene_files import text_of
from waiting import wait_for

from liegroup_core import Simulation, load_scene
from liegroup_core.errors import SceneError
from liegroup_core.identification import Log, Measured, compare
from liegroup_core.linear import linearise, sensitivities
from liegroup_core.observables.quantities import GROUPS, NO_STATE
from liegroup_core.scene.load import scene_from_text
from liegroup_sim_ros.analysis.analyse import analyse
from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.logs.load import outputs_of
from liegroup_sim_ros.recording.read import read_recording
from liegroup_sim_ros.report.plots import make_plots
from liegroup_sim_ros.view.local import Local
from liegroup_sim_ros.view.page import Page

# A servo, a drive, a spring, a loop-free tree, and a sensor of each type.
ARM = text_of("arm_quantities.yaml")
SETTINGS = {"method": "rkmk4", "step": 2e-3}
COMMAND = ["--method", "rkmk4", "--step", "2e-3", "--duration", "0.2"]
EVERY = 25  # steps between samples: five of them
CLOSE = {"rtol": 1e-9, "atol": 1e-9}  # recorded attitudes are quaternions, which round; reactions amplify it


@pytest.fixture(scope="module", params=["arm", "diff_drive", "four_bar"])
def made(request, tmp_path_factory):
    """Scene, its file, catalogue, all columns, times, and their values (5, k)."""
    folder = tmp_path_factory.mktemp(request.param)
    path = folder / "scene.yaml"
    text = ARM if request.param == "arm" else load_scene(request.param).text
    path.write_text(text)
    scene = load_scene(path)
    simulation = Simulation(scene, **SETTINGS, quiet=True)
    catalogue, rows, times = simulation.layout.catalogue, [], []
    columns = catalogue.columns(GROUPS)
    for _ in range(5):
        times.append(simulation.time)
        rows.append(columns.of(simulation.sample()))
        simulation.advance(EVERY)
    return SimpleNamespace(
        scene=scene,
        path=str(path),
        folder=folder,
        catalogue=catalogue,
        columns=columns,
        times=np.array(times),
        values=np.array(rows),
        of_state=[name for name, depends in zip(columns.names, columns.depends) if depends != NO_STATE],
    )


def test_groups_are_those_of_the_catalogue_and_names_are_unique(made):
    assert set(made.catalogue.groups) == set(GROUPS)
    names = [name for quantity in made.catalogue.quantities.values() for name in quantity.names]
    assert len(set(names)) == len(names) == len(made.columns.names)
    for group, quantity in made.catalogue.quantities.items():
        assert len(quantity.names) == len(quantity.units), group
        assert made.catalogue.columns([group]).of(Simulation(made.scene, **SETTINGS).sample()).shape == (
            len(quantity.names),
        )


def test_each_quantity_is_a_column_of_tables_and_arrays(made):
    for ending in ("csv", "npz"):
        out = ["--every", str(EVERY), "--out", str(made.folder / f"run.{ending}"), "--columns", *GROUPS]
        assert main(["run", made.path, *COMMAND, *out]) == 0
    with open(made.folder / "run.csv", newline="") as file:
        head, *rows = csv.reader(file)
    names = ["time", *(name for name in made.columns.names if name != "time")]
    assert [label.partition(" [")[0] for label in head] == names
    assert "energy [J]" in head and all(f"{joint.name}.fx [N]" in head for joint in made.scene.joints)
    order = [made.columns.names.index(name) for name in names]
    assert np.array_equal(np.array(rows, dtype=float), made.values[:, order], equal_nan=True)
    arrays = np.load(made.folder / "run.npz")
    assert arrays["columns"].tolist() == made.columns.names and arrays["units"].tolist() == made.columns.units
    for name, values in zip(made.columns.names, made.values.T):
        assert np.array_equal(arrays[name], values, equal_nan=True), name


def test_each_quantity_is_a_column_of_a_sweep(made, capsys):
    body = made.scene.bodies[0].name
    mass = f"bodies.{body}." + ("mass" if made.scene.bodies[0].shape is None else "shape.mass")
    value = made.scene.bodies[0].mass
    folder = made.folder / "sweep.parquet"
    more = ["--samples", "1", "--keep", "0.05", "--out", str(folder), "--record", *GROUPS]
    assert main(["sweep", made.path, *COMMAND, "--vary", f"{mass}={value!r}", *more]) == 0
    capsys.readouterr()
    table = pandas.read_parquet(folder)
    for name, values in zip(made.columns.names, made.values.T):
        kept = table[f"samples.{name}"][0]
        assert_allclose(kept, values, err_msg=name, **CLOSE)
        assert np.array_equal(kept[-1], table[name][0], equal_nan=True)
    (part,) = folder.iterdir()
    schema = pyarrow.parquet.read_schema(part)
    assert schema.field("energy").metadata == {b"unit": b"J"}
    assert schema.field(f"samples.{body}.vx").metadata == {b"unit": b"m/s"}


def test_each_quantity_of_the_state_is_an_output(made):
    simulation = Simulation(made.scene, **SETTINGS, quiet=True)
    system = linearise(simulation, outputs=made.of_state)
    assert list(system.outputs) == made.of_state and len(system.C) == len(made.of_state)
    for name in set(made.columns.names) - set(made.of_state):
        with pytest.raises(SceneError, match=f"{name} is no function of the state"):
            linearise(simulation, outputs=[name])
    # The slope of an output by a rate is the difference quotient that neighbouring starts show.
    found = sensitivities(made.scene, ["gravity.2"], [0.1], ["energy", "twists"], **SETTINGS)
    energies = []
    for change in (-1e-4, 1e-4):
        other = made.scene.remade(gravity=(*made.scene.gravity[:2], made.scene.gravity[2] + change))
        energies.append(next(iter(Simulation(other, **SETTINGS, quiet=True).samples([0.1]))).energy)
    assert found.derivatives[0, 0, 0] == pytest.approx((energies[1] - energies[0]) / 2e-4, rel=1e-5, abs=1e-7)


@pytest.mark.volume(1)
def test_each_quantity_of_the_state_is_measured_in_a_log(made):
    """Noise of 1e-3 of what a column does: the scene that made the log agrees with it."""
    simulation = Simulation(made.scene, accuracy=1e-9, quiet=True)
    turns = simulation.sample().pose[:, :9].reshape(-1, 3, 3)
    determined = np.isfinite(made.values).all(axis=0)
    names = [name for name, known in zip(made.columns.names, determined) if known and name in made.of_state]
    assert [channel for name in names for channel in outputs_of(name, made.scene)] == names
    columns = simulation.layout.catalogue.columns(names, turns=turns, ideal=True)
    times = np.arange(0.0, 0.4, 0.01)
    values = np.array([columns.of(sample) for sample in simulation.samples(times)])
    noise = 1e-3 * np.ptp(values, axis=0) + 1e-6
    values += noise * np.random.default_rng(3).standard_normal(values.shape)
    found = compare(made.scene, Log((), (Measured("log", times, tuple(names), values, noise, 0.0),)), workers=1)
    assert found.agrees, found.verdict


def test_each_quantity_is_in_plots_frames_and_on_the_page(made):
    path = str(made.folder / "run.mcap")
    assert main(["run", made.path, *COMMAND, "--every", str(EVERY), "--out", path]) == 0
    analysis = analyse(read_recording(path), reference=False)
    frame = analysis.to_pandas(GROUPS)
    assert list(frame.columns) == made.columns.labels
    for label, name, values in zip(frame.columns, made.columns.names, made.values.T):
        if name != "steps":  # of the run, not of the recording
            assert_allclose(frame[label], values, err_msg=name, **CLOSE)
    plots = make_plots(analysis, GROUPS)
    drawn = {trace["name"] for *_, plot in plots for trace in plot["data"]}
    for name, values in zip(made.columns.names, made.values.T):
        assert not np.isfinite(values).any() or (name.rpartition(".")[0] or name) in drawn
    source = Local(Simulation(made.scene, **SETTINGS, quiet=True), "page", paused=True)
    page = Page(source, port=8230)
    try:
        panel, sample = page._panel, source.frame()
        expected = dict(zip(made.columns.names, made.columns.of(sample.sample)))
        shown = [name for owners in panel._choices.values() for names in owners.values() for name in names]
        assert sorted(shown) == sorted(made.columns.names)
        assert all(len(names) <= 4 for owners in panel._choices.values() for names in owners.values())
        for name in shown:
            assert_allclose(panel._function(name)(sample), expected[name], err_msg=name)
        source.ask("step", 20)
        wait_for(lambda: len(source.history.times) > 1, "frames")
        what, owner, plot = panel._chosen
        what.value, owner.value = "energy, J", "energy"
        panel.update(source.frame())
        assert plot._title == "energy, J" and plot._plot.series[1]["label"] == "energy"
    finally:
        page.stop()
        source.close()


def test_other_names_of_columns_are_read_and_unknown_ones_refused():
    scene = scene_from_text(ARM)
    catalogue = Simulation(scene, **SETTINGS, quiet=True).layout.catalogue
    former = "hinge.torque_x rail.force_z rail.drive_effort residual imu.wx encoder.position hinge.fx".split()
    now = ["hinge.tx", "rail.fz", "rail.effort", "constraint_residual", "imu.4", "encoder.0", "hinge.fx"]
    assert catalogue.names(former) == now and catalogue.names([*now, *former]) == now
    assert [each for name in former for each in outputs_of(name, scene)] == now
    assert outputs_of("wrist.wrench", scene) == [f"wrist.{part}" for part in ("tx", "ty", "tz", "fx", "fy", "fz")]
    with pytest.raises(SceneError, match="unknown column 'hinge.tq'; did you mean"):
        catalogue.names(["hinge.tq"])
    with pytest.raises(SceneError, match="columns must be a list of names"):
        catalogue.names("energy")


def test_commanded_efforts_reach_what_is_measured_directly():
    """A revolute joint transmits no reaction about its axis: a sensor there shows the command and the servo alone."""
    simulation = Simulation(scene_from_text(ARM), **SETTINGS, quiet=True)
    found = linearise(simulation, ["wrist.effort", "hinge.effort"], ["hinge.effort", "cell.2"])
    assert_allclose(found.D, [[0, 1], [1, 0]], atol=1e-7)
