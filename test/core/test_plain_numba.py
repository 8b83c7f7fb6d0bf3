# SPDX-License-Identifier: Apache-2.0
"""Plain Numba backend: bit-identical results, and selected with one warning if Numba changed."""

import json
import os
import platform
import subprocess
import sys

import pytest
from scene_files import cases

from liegroup_core.compiling import compiled

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not compiled(), reason="nothing is compiled")]

RUNS = """
import json, sys
from liegroup_core import Simulation, load_scene
from liegroup_core.compiling import backend
results = {}
for scene, method in json.loads(sys.argv[1]):
    simulation = Simulation(load_scene(scene), method=method, step=1e-3, estimate=False)
    simulation.advance(50)
    results[scene + " " + method] = [array.tobytes().hex() for array in simulation.state()]
json.dump([backend.chosen().name, results], sys.stdout)
"""
# Plain Numba needs one to four minutes to compile a family. Scenes of one family share a process, which compiles its
# kernels once.
CASES = cases("plain_numba_cases")


def run(code, *arguments, **environment):
    return subprocess.run(
        [sys.executable, "-c", code, *arguments],
        capture_output=True,
        text=True,
        check=True,
        timeout=1200,
        env={**os.environ, **environment},
    )


@pytest.mark.parametrize("scenes, method", CASES)
@pytest.mark.volume(0)  # `make plain` and `make verify` run it
def test_plain_numba_is_bit_identical_to_the_inlining_backend(scenes, method):
    """States after 50 steps. No subnormal numbers occur, which only `stepper` flushes to zero."""
    cases = json.dumps([(scene, method) for scene in scenes])
    name, expected = json.loads(run(RUNS, cases).stdout)
    assert name == "inlining" and len(expected) == len(scenes)
    assert json.loads(run(RUNS, cases, LIEGROUP_PLAIN_NUMBA="1").stdout) == ["plain", expected]


# Changes one internal part of Numba before liegroup_core is imported, then runs the self-check.
# Numba itself does not use that part, or works with the change as well.
SABOTAGE = """
import importlib, sys
import llvmlite.binding, numba, numba.extending
import numba.core.caching, numba.core.codegen, numba.core.compiler, numba.core.lowering
import numba.core.typed_passes, numba.np.arrayobj
def change(owner, part):  # adds an optional parameter; Numba itself still works
    original = getattr(owner, part)
    setattr(owner, part, lambda *args, added=None, **kwargs: original(*args, **kwargs))
exec(sys.argv[1])
from liegroup_core.compiling import backend
print(backend.chosen().name)
from liegroup_core.compiling import check
check = importlib.reload(check)  # if the self-check failed, its kernels were compiled by `inlining`
try:
    check.check()
except ArithmeticError as error:
    print(error)
from liegroup_core.lie import so3
print(so3.so3_exp((0.1, 0.2, 0.3)) == so3.so3_exp.function((0.1, 0.2, 0.3)))
"""
CHANGES = [
    # missing names
    "del numba.core.codegen.JITCodeLibrary",
    "del numba.core.compiler_machinery.register_pass",
    "del llvmlite.binding.create_new_module_pass_manager",
    # changed parameters
    "change(numba.core.codegen.JITCodeLibrary, '_optimize_functions')",
    "change(numba.core.lowering.Lower, 'setup_function')",
    "change(numba.core.typed_passes.NativeLowering, 'run_pass')",
    "change(numba.np.arrayobj, 'load_item')",
    # a part that fails only in the self-check
    "llvmlite.binding.newpassmanagers.ModulePassManager.add_always_inliner_pass = None",
]


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.volume(1)
def test_a_changed_numba_internal_selects_plain_numba(tmp_path, change):
    done = run(SABOTAGE, change, LIEGROUP_CACHE_DIR=str(tmp_path))
    lines = done.stdout.splitlines()
    assert lines[0] == "plain" and lines[-1] == "True"
    # Expected difference: plain `stepper` does not flush subnormals.
    x86 = platform.machine() in ("x86_64", "AMD64")
    assert lines[1:-1] == ["subnormal numbers are not flushed to zero in steps only"] * x86
    (warning,) = done.stderr.splitlines()
    assert "is not as expected: " in warning and "compiled by plain numba.njit" in warning


def test_every_assumed_numba_signature_is_checked(monkeypatch):
    from liegroup_core.compiling import assumed

    assumed.check_signatures()
    for owner, parts in assumed.ASSUMED.items():
        for part in parts:
            with monkeypatch.context() as changed:
                changed.setattr(owner, part, lambda another: None)
                with pytest.raises(TypeError, match=f"{owner.__name__}.{part} takes"):
                    assumed.check_signatures()


def test_without_extensions_kernels_run_as_plain_python(tmp_path):
    done = run(SABOTAGE, "del numba.extending.typeof_impl", LIEGROUP_CACHE_DIR=str(tmp_path))
    assert done.stdout.splitlines()[0] == "python" and done.stdout.endswith("True\n")
    assert "The simulation runs as plain Python" in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr
