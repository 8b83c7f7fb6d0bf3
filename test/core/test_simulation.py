# SPDX-License-Identifier: Apache-2.0
"""Simulation for users: stepping, options, errors that end an integration, and threads."""

import dataclasses
import functools
import threading
import time

import mechanisms
import numpy as np
import pytest
from scene_files import cases
from threadpoolctl import threadpool_info, threadpool_limits

from liegroup_core import SceneError, Simulation, engine, load_scene
from liegroup_core.compiling import compiled
from liegroup_core.engine import Engine
from liegroup_core.scene import Body, assembly
from liegroup_core.settings import SETTINGS


def test_a_sample_is_an_independent_copy_with_names():
    simulation = Simulation(load_scene("double_pendulum"), method="rkmk4")
    sample = simulation.sample()
    before = sample.pose.copy()
    simulation.advance(10)
    assert np.array_equal(sample.pose, before)
    assert list(sample.poses) == list(sample.twists) == [b.name for b in simulation.scene.bodies]
    assert set(sample.joint_residuals) == {joint.name for joint in simulation.scene.joints}
    with pytest.raises(ValueError):
        sample.pose[0, 0] = 2.0


@pytest.mark.parametrize("slack", [0.0, 1e-9, 10.0**-8.75])
@pytest.mark.volume(1)
def test_a_stretched_immobile_linkage_is_refused(slack):
    """Also where the links are off the line through their pins by angles, the root of `slack`,
    next to the tolerance of the rank, so that two ways to find the rank differ.
    """
    with pytest.raises(SceneError, match="stretched or folded and cannot move"):
        Simulation(mechanisms.two_links(1.0 + slack), method="rkmk4")
    assert Simulation(mechanisms.two_links(1.5), method="rkmk4").layout.dropped_rows == []


@pytest.mark.parametrize("setting, text", cases("wrong_options_are_refused_with_a_remedy"))
def test_wrong_options_are_refused_with_a_remedy(setting, text):
    with pytest.raises(ValueError, match=text):
        Simulation(load_scene("free_body"), **setting)


@pytest.mark.parametrize("steps", [-5, 1.7, "3", None, True])
def test_a_step_count_that_is_not_an_integer_is_refused(steps):
    simulation = Simulation(load_scene("free_body"), method="rkmk4")
    with pytest.raises(ValueError, match="whole number"):
        simulation.advance(steps)
    assert simulation.steps == 0
    simulation.advance(np.int64(2))
    assert simulation.steps == 2


def test_the_least_number_beside_zero_is_not_that_of_a_range_without_zero():
    """An accuracy of the node may be 1e-13, as its text says."""
    assert dataclasses.replace(SETTINGS["accuracy"], least=1e-9).check(1e-13) == 1e-13
    with pytest.raises(ValueError, match="must be 0, or a number from 1e-09 to 10 s, got 1e-12"):
        dataclasses.replace(SETTINGS["step"], low=0.0, least=1e-9, high=10.0).check(1e-12)


@pytest.mark.parametrize("settings", [{}, {"method": "rkmk54"}])
def test_a_run_beyond_the_largest_count_of_steps_is_refused(settings):
    """2^62 - 1 steps of the least step, 1 ns, last 4.6e9 s: less than the latest time, 9.2e9 s."""
    simulation = Simulation(load_scene("free_body"), step=1e-9, **settings)
    for advance in (lambda: simulation.advance(10**30), lambda: simulation.advance_to(4.7e9)):
        with pytest.raises(ValueError, match="a run has 4611686018427387903 steps at most: take a larger step"):
            advance()
        assert simulation.steps == 0
    simulation = Simulation(load_scene("free_body"), "rkmk4", 1e-9)
    simulation.set_state(*simulation.state(), (1 << 62) - 2)
    simulation.advance(1)
    with pytest.raises(ValueError, match="take a larger step than 1e-09 s"):
        simulation.advance(1)


@pytest.mark.parametrize("times", [{"start": np.inf}, {"start": np.nan}, {"duration": np.inf}])
def test_non_finite_wrench_times_are_refused(times):
    with pytest.raises(ValueError, match="must be finite"):
        Simulation(load_scene("free_body"), method="rkmk4").apply_wrench("body", (1, 0, 0, 0, 0, 0), **times)


@pytest.mark.turn(3)
def test_a_model_error_names_the_line_in_the_scene_file(tmp_path):
    links = mechanisms.two_links(1.0)
    path = tmp_path / "links.yaml"
    path.write_text(links.text)
    with pytest.raises(SceneError, match=r"links.yaml:\d+: .*stretched or folded"):
        Simulation(load_scene(path), method="rkmk4")


def test_an_invalid_state_is_refused():
    simulation = Simulation(load_scene("free_body"), method="rkmk4")
    pose, twist = simulation.state()
    with pytest.raises(ValueError, match=r"\(1, 12\)"):
        simulation.set_state(pose[:, :9], twist)
    with pytest.raises(ValueError, match="NaN or infinity"):
        simulation.set_state(pose, twist * np.nan)
    for factor in (0.0, 1.5, -1.0):
        with pytest.raises(ValueError, match="pose of body: the first nine numbers are not a rotation"):
            simulation.set_state(factor * pose, twist)


@pytest.mark.parametrize(
    "given, message",
    [
        (("heavy_top",), "expected a Scene, got 'heavy_top'; use load_scene to read one from a file"),
        ((load_scene("free_body"), ["rkmk4"]), "unknown method"),
    ],
)
def test_arguments_that_are_no_scene_or_method_are_refused(given, message):
    with pytest.raises(ValueError, match=message):
        Simulation(*given)


def test_messages_print_numpy_scalars_as_plain_numbers():
    with pytest.raises(SceneError, match=r"got \(-0.1, 0.1, 0.1\)$"):
        Body(name="a", mass=1.0, inertia=tuple(np.array([-0.1, 0.1, 0.1])))
    with pytest.raises(SceneError, match=r"got -1.0$"):
        Body(name="a", mass=np.float64(-1.0), inertia=(0.1, 0.1, 0.1))


@pytest.mark.parametrize("settings", [{"method": "rkmk4"}, {"accuracy": 1e-5, "step": 1e-3}])
@pytest.mark.parametrize("scene", ["four_bar", "gripper"])
def test_blocks_of_steps_do_not_change_a_bit(scene, settings, monkeypatch):
    states = []
    for block in (1, 7, 10**6):
        monkeypatch.setattr(engine, "_next_block", lambda *_, size=block: size)
        simulation = Simulation(load_scene(scene), **settings)
        simulation._block = block
        simulation.advance(60)
        states.append(np.concatenate([part.ravel() for part in simulation.state()]))
    assert np.array_equal(states[0], states[1]) and np.array_equal(states[0], states[2])


def test_advance_ends_early_where_enough_says_so():
    simulation = Simulation(load_scene("heavy_top"), "rkmk4", 1e-7, estimate=False)
    asked = []
    simulation.advance(10**9, lambda: asked.append(simulation.steps) or len(asked) == 3)
    assert simulation.steps == asked[-1] < 10**9 and asked == sorted(set(asked))


def test_a_halted_step_leaves_the_last_valid_state_and_can_be_taken_again():
    """A step of 20 000 substeps takes some 0.1 s, and is halted after a hundredth of that."""
    make = functools.partial(
        Simulation, load_scene("heavy_top"), "rkmk54", 20.0, rtol=1e-13, atol=1e-13, estimate=False
    )
    halted, whole = make(), make()
    before = halted.state()
    for _ in range(20):
        timer = threading.Timer(1e-3, halted.halt)
        timer.start()
        halted.advance(1)
        timer.join()
        if halted.steps == 0:
            break
        halted.reset()
    assert halted.steps == 0
    assert all(map(np.array_equal, halted.state(), before))
    halted.advance(1)
    whole.advance(1)
    assert whole.substeps[0] > 5000
    assert all(map(np.array_equal, halted.state(), whole.state()))


def test_a_halted_run_to_an_accuracy_ends_after_a_step_that_another_run_has():
    """No step is taken with a larger tolerance because the attempts were limited from another thread."""
    make = functools.partial(Simulation, load_scene("heavy_top"), accuracy=1e-3, horizon=60.0, quiet=True)
    other = make()
    for k in range(12):
        halted = make()
        thread = threading.Thread(target=halted.advance, args=(10**7,))
        thread.start()
        thread.join(2e-3 * (k + 1))
        while thread.is_alive():  # a halt before the thread advances has no effect
            halted.halt()
            thread.join(0.02)
        other.reset()
        other.advance(halted.steps)
        assert all(map(np.array_equal, halted.state(), other.state())), halted.steps


def blas_threads():
    return [found["num_threads"] for found in threadpool_info() if found["user_api"] == "blas"]


def test_a_model_is_built_with_one_blas_thread(monkeypatch):
    seen, assembled = [], assembly.assembled

    def watched(*arguments):
        seen.append(blas_threads())
        return assembled(*arguments)

    monkeypatch.setattr(assembly, "assembled", watched)
    with threadpool_limits(2, "blas"):
        before = blas_threads()
        Engine(load_scene("four_bar"), quiet=True)
        assert blas_threads() == before
    assert seen and all(set(threads) == {1} for threads in seen)


# Steps are taken without the interpreter lock: other threads of the process keep running.


@pytest.mark.slow
@pytest.mark.skipif(not compiled(), reason="nothing is compiled")
def test_other_threads_run_during_compiled_steps():
    """If the GIL were held, this thread would block for the whole duration of the steps.

    The longest observed pause must stay below half of it.
    """
    simulation = Simulation(load_scene("heavy_top"), "rkmk4", estimate=False)
    steps, span = 500_000, []  # half a second in one compiled call

    def advance():
        start = time.perf_counter()
        simulation.advance(steps)
        span.append(time.perf_counter() - start)

    thread = threading.Thread(target=advance)
    thread.start()
    longest, last = 0.0, time.perf_counter()
    while not span:
        now = time.perf_counter()
        longest, last = max(longest, now - last), now
    thread.join()
    assert simulation.steps == steps
    assert longest < 0.5 * span[0]
