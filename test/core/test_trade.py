# SPDX-License-Identifier: Apache-2.0
"""Trade-off of accuracy and cost: repeatable errors, orders, cached measurements, kept promises."""

import json
from itertools import islice

import numpy as np
import pytest
from scene_files import text_of

from liegroup_core import Simulation, load_scene
from liegroup_core.mechanism.body_model import initial_state
from liegroup_core.methods.table import METHODS
from liegroup_core.reference import integrate
from liegroup_core.scene.load import scene_from_text
from liegroup_core.study.trade import cache as store
from liegroup_core.study.trade import configurations as settings
from liegroup_core.study.trade import reference_solution as truth
from liegroup_core.study.trade.trade import MARGIN, Trade

HORIZON = 0.5
MEASURED = ["rkmk2", "rkmk4", "constrained_rattle"]
# All but what is measured: the cost.
COSTS = ("cost_us", "timings")


@pytest.fixture(scope="module")
def scene():
    return load_scene("double_pendulum")


def made(scene, folder, horizon=HORIZON):
    return Trade(scene, horizon, store.Store(scene, folder))


def errors(trade):
    """Errors of all cells, which must be bit-identical in every measurement."""
    return [{key: value for key, value in cell.items() if key not in COSTS} for cell in trade.cells]


@pytest.fixture(scope="module")
def trade(scene, tmp_path_factory):
    """Trade measured in this process, without workers."""
    trade = made(scene, tmp_path_factory.mktemp("one"))
    for _ in trade.measure(MEASURED, stabilisations=["none"], budget=0.05, workers=1):
        pass
    return trade


@pytest.mark.slow
@pytest.mark.turn(3)
def test_errors_are_bit_identical_with_two_workers(scene, trade, tmp_path):
    """The number of step sizes depends on costs: only cells of both runs are compared."""
    other = made(scene, tmp_path)
    for _ in other.measure(["rkmk4"], stabilisations=["none"], budget=0.05, workers=2):
        pass

    def bits(cells):
        return {
            (cell["group"], cell["stabilisation"], cell["step"]): json.dumps(cell)
            for cell in cells
            if cell["method"] == "rkmk4"
        }

    one, two = bits(errors(trade)), bits(errors(other))
    both = one.keys() & two.keys()
    assert len(both) >= 12
    assert all(one[key] == two[key] for key in both)


@pytest.mark.parametrize("method", MEASURED)
@pytest.mark.turn(3)
def test_errors_decrease_at_the_order_of_the_method(trade, method):
    """Between rungs in the asymptotic range, in the middle: 0.2 of the order, as steps are no
    powers of each other and the next term of the error still counts. The reference is known to a
    hundredth of the errors: that changes a slope by 0.015 at most.
    """
    for group in {cell["group"] for cell in trade.cells if cell["method"] == method}:
        cells = [
            cell
            for cell in trade.cells
            if not cell["stopped"] and (cell["method"], cell["group"], cell["stabilisation"]) == (method, group, "none")
        ]
        slopes = [
            np.log(a["error"] / b["error"]) / np.log(a["step"] / b["step"])
            for a, b in zip(cells, cells[1:])
            if a["error"] < 1e-2 and b["error"] > 1e2 * trade.truth.known
        ]
        assert len(slopes) >= 3
        assert np.median(slopes) == pytest.approx(METHODS[method].order, abs=0.2)


def test_the_pareto_front_and_the_cheapest_configurations(trade):
    settled = dict((id(cell), error) for cell, error in trade.settled())
    front = trade.front()
    for cell in front:
        assert not any(
            other["cost_us"] <= cell["cost_us"] and settled[id(other)] < settled[id(cell)]
            for other, _ in trade.settled()
        )
    for wanted in (1e-2, 1e-4, 1e-6):
        cell = trade.cheapest(wanted)
        assert MARGIN * settled[id(cell)] <= wanted
        assert cell in front
        assert not any(
            MARGIN * error <= wanted and other["cost_us"] < cell["cost_us"] for other, error in trade.settled()
        )
    assert trade.cheapest(1e-15) is None


def test_a_step_that_is_accurate_by_chance_is_not_chosen(scene, trade):
    """A coarse step with an accidentally zero error counts as accurate as the two finer steps."""
    lucky = made(scene, trade._store.folder.parent.parent)
    cells = [
        cell for cell in lucky.cells if not cell["stopped"] and (cell["method"], cell["group"]) == ("rkmk2", "se3")
    ]
    coarse = cells[0]
    assert coarse["error"] > 1e-3
    before = lucky.cheapest(1e-5)
    coarse["error"] = 0.0  # the dict that the trade holds
    assert min(lucky.cells, key=lambda cell: cell.get("error", 1.0)) is coarse
    settled = {id(cell): error for cell, error in lucky.settled()}
    assert settled[id(coarse)] == max(cell["error"] for cell in cells[1:3])
    assert lucky.cheapest(1e-5) is before


def test_an_interrupted_measurement_resumes_from_the_cache(scene, tmp_path):
    """An interrupted run continues, even with a truncated line in the cache."""
    first = made(scene, tmp_path)
    running = first.measure(["rkmk4"], budget=0.02, workers=1)
    taken = [cell for cell, _ in islice(running, 5)]
    running.close()
    (file,) = tmp_path.rglob("cells.jsonl")
    with open(file, "ab") as stream:
        stream.write(b'\n{"method": "rkm')
    second = made(scene, tmp_path)
    assert sorted(map(json.dumps, second.cells)) == sorted(map(json.dumps, taken))
    more = [cell for cell, _ in second.measure(["rkmk4"], budget=0.02, workers=1)]
    assert more and not [cell for cell in more if cell in taken]
    third = made(scene, tmp_path)
    assert len(third.cells) == len(taken) + len(more)
    assert list(third.measure(["rkmk4"], budget=0.02, workers=1)) == []
    assert third.truth.motion.position.tobytes() == first.truth.motion.position.tobytes()


def test_a_damaged_cache_is_measured_again(scene, trade, tmp_path):
    """Incomplete cells, invalid text, an invalid horizon."""
    here = made(scene, tmp_path)
    good = trade.cells[0]
    here._store.keep_cell(here.truth.horizon, good)
    (file,) = [*here._store.folder.rglob("truth.npz")]
    with open(file.with_name("cells.jsonl"), "ab") as stream:
        for damaged in (
            {"cpu": good["cpu"]},
            good | {"step": "1"},
            good | {"error": None},
            {name: good[name] for name in good if name != "cost_us"},
            [1],
            3,
        ):
            stream.write(b"\n" + json.dumps(damaged).encode())
        stream.write(b"\n\x00\xff\xfe\n")
    assert made(scene, tmp_path).cells == [good]
    for text, horizon in (("0.25", 0.25), ("-3", None), ("NaN", None), ('"a"', None), ("", None)):
        (here._store.folder / "horizon.json").write_text(text)
        assert store.Store(scene, tmp_path).horizon() == horizon
    file.write_bytes(file.read_bytes()[:5000])
    assert here._store.truth(here.truth.horizon) is None


def test_only_requested_methods_and_steps_are_used_whatever_is_cached(scene, trade):
    """Methods that do not fit are excluded; if none is left, the error says so."""
    asked = made(scene, trade._store.folder.parent.parent)
    asked.keep_only(["rkmk4", "stoermer_verlet"], ["se3"], steps=[1e-2, 5e-3])
    assert {(cell["method"], cell["group"], cell["step"]) for cell in asked.cells} == {
        ("rkmk4", "se3", 1e-2),
        ("rkmk4", "se3", 5e-3),
    }
    assert {cell["method"] for cell in asked.front()} <= {"rkmk4"}
    with pytest.raises(ValueError, match="double_pendulum: none of the .* use: rkmk1"):
        list(asked.measure(["stoermer_verlet"]))


def test_a_full_disk_does_not_prevent_measuring(scene, tmp_path, caplog):
    trade = made(scene, tmp_path)
    file = trade._store.folder / "0.5s" / "cells.jsonl"
    file.mkdir()  # as good as a disk that takes nothing
    found = list(islice(trade.measure(["rkmk4"], budget=0.02, workers=1), 3))
    assert len(found) == len(trade.cells) == 3
    assert [text for text in caplog.messages if "cannot be cached" in text] == [
        f"measurements cannot be cached: {file}: Is a directory"
    ]


def test_the_cache_is_specific_to_scene_version_and_processor(scene, trade, monkeypatch):
    """The key of the cache changes with each; the first entries are found again afterwards."""
    root = trade._store.folder.parent.parent
    horizon = trade.truth.horizon
    here = store.Store(scene, root)
    assert len(here.cells(horizon)) == len(trade.cells) and here.truth(horizon) is not None
    heavier = scene_from_text(scene.text.replace("mass: 1.0", "mass: 1.0001"))
    assert heavier.text != scene.text
    other = store.Store(heavier, root)
    assert other.cells(horizon) == [] and other.truth(horizon) is None
    with monkeypatch.context() as patch:
        patch.setattr(store, "source_digest", lambda: "another version")
        assert store.Store(scene, root).truth(horizon) is None
    with monkeypatch.context() as patch:
        patch.setattr(store, "cpu_name", lambda: "another processor")
        assert store.Store(scene, root).cells(horizon) == []
    assert len(store.Store(scene, root).cells(horizon)) == len(trade.cells)


@pytest.mark.parametrize("wrong", [-1.0, float("nan"), 0.123456])
def test_a_wrong_horizon_is_refused(wrong):
    with pytest.raises(ValueError, match="horizon"):
        Trade(load_scene("double_pendulum"), wrong)


STIFF = text_of("damped.yaml")


def test_a_transient_before_the_first_sample_counts(tmp_path):
    """Critically damped at 1000 1/s: it decays within 10 ms, the first 1 % of the horizon.
    The error that is measured is that of all steps: the early samples of steps of 0.5 ms are 0.5,
    1, 2, ... ms, and the error, about as wide as the motion, is largest between two of them.
    """
    scene = scene_from_text(STIFF)
    trade = made(scene, tmp_path, 1.0)
    ((cell, _),) = trade.measure(["rkmk4"], ["se3"], ["none"], [5e-4], workers=1)
    simulation = Simulation(scene, "rkmk4", 5e-4)
    places = []
    for _ in range(100):
        simulation.advance(1)
        places.append(simulation.sample().pose[0, 9])
    times = 5e-4 * np.arange(1, 101)
    true = 0.3 * (1.0 + 1e3 * times) * np.exp(-1e3 * times)
    largest = np.abs(np.array(places) - true).max()
    assert 0.5 * largest <= cell["position"] <= largest * (1.0 + 1e-6)
    late = np.abs(np.array(places) - true)[19::20].max()
    assert late < 0.1 * largest  # what the hundredths alone would tell


def test_step_sizes_divide_the_sampling_interval():
    for horizon in ("10", "1", "0.5", "0.02", "6", "0.037"):
        horizon = settings.as_time(float(horizon))
        found = [step for step, _ in zip(settings.steps(horizon), range(12))]
        assert found == sorted(found, reverse=True)
        for step in found:
            spacing = settings.sample_spacing(step, horizon)
            assert spacing % step == 0 and spacing % (horizon / settings.SAMPLES) == 0
            assert horizon % spacing == 0 and horizon / spacing >= settings.LEAST_SAMPLES


def test_the_default_horizon_ends_where_the_reference_is_uncertain(scene, tmp_path, monkeypatch):
    """Cached with the scene; samples equal those of a reference for these times only."""
    monkeypatch.setattr(truth, "HORIZONS", truth.HORIZONS[-5:-2])
    found = Trade(scene, None, store.Store(scene, tmp_path))
    assert found.truth.known <= truth.KNOWN
    assert store.Store(scene, tmp_path).horizon() == found.truth.horizon
    motion, _ = integrate(scene, *initial_state(found.layout.centred), found.truth.motion.times)
    # Both are dense output of the same steps but for the last one.
    assert np.abs(motion.position - found.truth.motion.position).max() <= 2.0 * truth.KNOWN
