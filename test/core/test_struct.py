"""Kernels and Python read the same values of a Struct, at any time and in any copy."""

import copy
import gc
import json
import math
import os
import pickle
import platform
import resource
import subprocess
import sys

import numpy as np
import pytest
from scene_files import cases

from liegroup_core import Simulation, load_scene
from liegroup_core.compiling import Choice, Struct, backend, compiled, kernel, shared, stepper

PAIR = np.dtype([("number", "i8"), ("vector", "f8", (3,))], align=True)


class Inner(Struct):
    rows: np.ndarray
    shift: float


class Outer(Struct):
    flag: bool
    count: int
    inner: Inner
    pairs: np.ndarray
    cube: np.ndarray
    nothing: np.ndarray


@kernel
def read(outer, i):
    """One number of every field, and the shapes of the arrays; Python runs the same text."""
    return (
        outer.flag,
        outer.count,
        outer.inner.shift,
        outer.inner.rows[i, 1],
        outer.pairs[i]["number"],
        outer.pairs[i]["vector"][2],
        outer.cube[1, i, 2],
        outer.inner.rows.shape,
        outer.cube.shape,
        len(outer.pairs),
        len(outer.nothing),
    )


@kernel
def write(outer, value):
    """Set one number in an array and one in a record."""
    outer.inner.rows[1, 0] = value
    outer.pairs[1]["number"] = int(value)


@kernel
def of_inner(first, factor):
    return factor * first.shift


@kernel
def of_outer(first, factor):
    return factor * first.count


@kernel
def by_rows(first, factor):
    return factor + len(first.rows)


either = Choice("either", {Inner: of_inner, Outer: of_outer})


@kernel
def both(outer):
    """Calls of both alternatives of a Choice."""
    return either(outer, 2.0), either(outer.inner, 2.0)


@shared
def weighed(outer, factor, flag):
    """Compiled once; called by both kernels below."""
    return outer.count * factor if flag else -1


@kernel
def once(outer):
    return weighed(outer, 3, True) + weighed(outer, 3, outer.flag)


@kernel
def again(outer, factor):
    return weighed(outer, factor, outer.flag)


def made(flag=True, count=-7, shift=-0.25):
    rng = np.random.default_rng(3)
    pairs = np.zeros(4, dtype=PAIR)
    pairs["number"], pairs["vector"] = np.arange(4) - 2, rng.normal(size=(4, 3))
    inner = Inner(rows=rng.normal(size=(4, 2)), shift=shift)
    keys = {"flag": flag, "count": count, "inner": inner, "pairs": pairs, "nothing": np.zeros((0, 6))}
    return Outer(cube=rng.normal(size=(2, 4, 3)), **keys)


@pytest.mark.parametrize(
    "flag, count, shift", [(True, -7, -0.25), (False, 2**62, math.inf), (np.True_, np.int64(-1), np.float64(5e-324))]
)
def test_kernels_read_every_kind_of_field(flag, count, shift):
    outer = made(flag, count, shift)
    for i in range(4):
        assert read(outer, i) == read.function(outer, i)


def test_arrays_are_shared_with_python():
    outer = made()
    write(outer, 5.0)
    assert outer.inner.rows[1, 0] == 5.0 and outer.pairs["number"][1] == 5
    outer.cube[1, 2, 2] = 8.0
    assert read(outer, 2)[6] == 8.0


def test_a_generic_function_selects_by_type():
    outer = made()
    assert both(outer) == (-14.0, -0.5) == (either(outer, 2.0), either(outer.inner, 2.0))


def test_functions_of_the_same_name_are_kept_apart():
    other = Choice("either", {Inner: by_rows, Outer: of_outer})

    @kernel
    def difference(outer):
        return either(outer.inner, 2.0) - other(outer.inner, 2.0)

    outer = made()
    assert difference(outer) == of_inner(outer.inner, 2.0) - by_rows(outer.inner, 2.0) != 0.0


def test_a_function_shared_by_several_kernels():
    outer = made(count=-7)
    assert once(outer) == -42 and again(outer, 5) == -35 == weighed(outer, 5, True)
    other = made(flag=False, count=2)
    assert once(other) == 5 and again(other, 5) == -1
    if compiled():
        assert len(weighed.dispatcher.overloads) == 1


@kernel
def halved(array):
    """Halve every number in place; True if there are any."""
    for i in range(len(array)):
        array[i] *= 0.5
    return len(array) > 0


@stepper
def halved_by_steps(array, steps):
    for _ in range(steps):
        if not halved(array):
            return False
    return True


@pytest.mark.skipif(
    not compiled() or platform.machine() not in ("x86_64", "AMD64"),
    reason="other processors are as fast with such numbers",
)
@pytest.mark.parametrize("numbers, ended", [((1.0, 2.0**-1022, -(2.0**-1021), 2.0**-1030), True), ((), False)])
def test_subnormals_are_flushed_to_zero_only_in_steps(numbers, ended):
    """Half of the smallest normal number 2^-1022 is subnormal, and about 100 times slower."""
    array = np.array(numbers)
    assert halved_by_steps(array, 2) == ended
    assert array.tolist() == [0.25, 0.0, 0.0, 0.0][: len(array)]
    array = np.array([2.0**-1022, 2.0**-1030])
    assert halved(array) and array.tolist() == [2.0**-1023, 2.0**-1031]
    assert (array * 0.5).tolist() == [2.0**-1024, 2.0**-1032]


@pytest.mark.slow
@pytest.mark.parametrize("harm", ["nothing", "empty", "code", "full"])
@pytest.mark.volume(2)
def test_cached_kernels_load_despite_a_damaged_cache(tmp_path, harm):
    """Also where a file of it is damaged, or no file can be written, as on a full disk; the caller
    of a shared function is loaded before that.
    """
    if not compiled() or backend.chosen().cache() is None:
        pytest.skip("nothing is compiled, or nothing is kept")
    (tmp_path / "kernels.py").write_text("""if True:
        import json
        import numpy as np
        from liegroup_core.compiling import kernel, shared
        from liegroup_core.compiling import Struct
        class One(Struct):
            count: int
        @shared
        def inner(one, factor):
            return one.count * factor
        @kernel
        def outer(one):
            return inner(one, 3) + 1
        results = [outer(One(count)) for count in (2, -4)]
        print(json.dumps([results, sum(each.dispatcher.stats.cache_misses != {}
                                       for each in (outer, inner))]))
        """)

    def nothing_is_written():
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))

    def run(prepare=None, told=0):
        said = subprocess.run(
            [sys.executable, "-c", f"import sys; sys.path.append({str(tmp_path)!r}); import kernels"],
            capture_output=True,
            text=True,
            check=True,
            preexec_fn=prepare,
            env={**os.environ, "LIEGROUP_CACHE_DIR": str(tmp_path / "cache")},
        )
        assert said.stderr.count("Compiled kernels cannot be cached") == told
        assert len(said.stderr.splitlines()) == told
        return json.loads(said.stdout)

    if harm == "full":
        for _ in range(2):
            assert run(nothing_is_written, told=1) == [[7, -11], 2]
        return
    assert run() == [[7, -11], 2]
    files = sorted(tmp_path.glob("cache/*/**/*.nbc"))
    assert len(files) >= 2
    if harm != "nothing":
        for file in files:
            file.write_bytes(file.read_bytes()[:40] if harm == "code" else b"")
        assert run() == [[7, -11], 2]
    assert run() == [[7, -11], 0]


@pytest.mark.slow
@pytest.mark.turn(3)
def test_the_file_of_compiled_code_depends_on_the_types_alone(tmp_path):
    """Else processes that compile for different types at once would overwrite each other's code."""
    if not compiled() or backend.chosen().cache() is None:
        pytest.skip("nothing is compiled, or nothing is kept")
    (tmp_path / "kernels.py").write_text("""if True:
        import numpy as np
        from liegroup_core.compiling import kernel
        @kernel
        def first(values):
            return values[0] + 1
        """)

    def files(*types):
        folder = tmp_path / "-".join(types)
        calls = [f"first(np.zeros(2, dtype={kind!r}))" for kind in types]
        code = f"from kernels import *; {'; '.join(calls)}"
        subprocess.run(
            [sys.executable, "-c", f"import sys; sys.path.append({str(tmp_path)!r}); {code}"],
            check=True,
            env={**os.environ, "LIEGROUP_CACHE_DIR": str(folder)},
        )
        return {file.name for file in folder.glob("*/kernels*.nbc")}

    numbers, integers = files("f8"), files("i8")
    assert len(numbers) == len(integers) == 1 and not numbers & integers
    assert files("i8", "f8") == numbers | integers


@pytest.mark.parametrize("again", [copy.deepcopy, lambda x: pickle.loads(pickle.dumps(x))])
def test_copies_do_not_share_memory(again):
    outer = made()
    other = again(outer)
    before = read(outer, 1)
    write(other, 9.0)
    assert read(outer, 1) == before and read(other, 1)[4] == 9
    del outer
    gc.collect()
    [np.full(1000, np.nan) for _ in range(100)]  # would lie where freed memory was
    assert read(other, 3) == read.function(other, 3)


def test_replace_changes_only_the_named_fields():
    outer = made()
    other = outer.replace(count=3)
    assert read(other, 0)[1] == 3 and read(outer, 0)[1] == -7
    assert other.cube is outer.cube


def test_fields_cannot_be_assigned():
    with pytest.raises(AttributeError):
        made().count = 2


@pytest.mark.parametrize("array", [np.zeros((3, 4))[:, 1:], np.zeros((3, 4), order="F")])
def test_unsupported_arrays_are_refused(array):
    with pytest.raises(ValueError, match="Inner.rows must be a C-contiguous array"):
        Inner(rows=array, shift=0.0)


@pytest.mark.parametrize("scene, method", cases("a_copied_simulation_continues_independently"))
@pytest.mark.parametrize("again", [copy.copy, copy.deepcopy, lambda x: pickle.loads(pickle.dumps(x))])
def test_a_copied_simulation_continues_independently(scene, method, again):
    simulation = Simulation(load_scene(scene), method=method, step=1e-3)
    simulation.advance(20)
    other, before = again(simulation), simulation.state()
    other.advance(30)
    assert all((a == b).all() for a, b in zip(simulation.state(), before))
    simulation.advance(30)
    assert all((a == b).all() for a, b in zip(simulation.state(), other.state()))


@pytest.mark.parametrize("scene", ["four_bar", "ball_chain"])
def test_states_of_any_memory_layout_are_accepted(scene):
    one, other = (Simulation(load_scene(scene), method="rkmk4") for _ in range(2))
    one.advance(50)
    pose, twist = one.state()
    # Both find relative coordinates from the poses.
    one.set_state(pose, twist, 50)
    other.set_state(np.asfortranarray(pose), np.asfortranarray(twist), 50)
    for simulation in (one, other):
        simulation.advance(50)
    assert all((a == b).all() for a, b in zip(one.state(), other.state()))
    sample = one.layout.sample(np.asfortranarray(pose), np.asfortranarray(twist))
    assert sample.joint_residuals == one.layout.sample(pose, twist).joint_residuals


def test_unsupported_field_types_are_refused():
    with pytest.raises(TypeError, match="Inner.shift must be an array, a number or a Struct, got"):
        Inner(rows=np.zeros((2, 2)), shift="0.1")


@pytest.mark.slow
@pytest.mark.turn(3)
def test_a_pickled_sample_is_complete_in_another_process(tmp_path):
    """Pickled here and loaded there; derived quantities are computed there."""
    sample = Simulation(load_scene("four_bar"), method="rkmk4").sample()
    path = tmp_path / "sample"
    path.write_bytes(pickle.dumps(sample))
    code = "import pickle, sys; print(pickle.load(open(sys.argv[1], 'rb')).energy.hex())"
    said = subprocess.run([sys.executable, "-c", code, path], capture_output=True, text=True, check=True)
    assert float.fromhex(said.stdout) == sample.energy
