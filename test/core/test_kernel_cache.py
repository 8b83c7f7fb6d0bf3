# SPDX-License-Identifier: Apache-2.0
"""Files of compiled kernels: what they are named by, and who compiles."""

import dis
import importlib
import os
import pkgutil
import subprocess
import sys

import pytest

import liegroup_core
from liegroup_core.compiling import Kernel, compiled, ingredients

pytestmark = pytest.mark.skipif(not compiled(), reason="nothing is compiled")


def kernels():
    """All kernels of the core, some of whose modules nothing has imported yet."""
    for module in pkgutil.walk_packages(liegroup_core.__path__, "liegroup_core."):
        if module.name != "liegroup_core.compiling.plain":  # it selects a compiler
            importlib.import_module(module.name)
    ours = [module for name, module in sys.modules.items() if name.startswith("liegroup_core.")]
    found = {id(each): each for module in ours for each in vars(module).values()}
    return [each for each in found.values() if isinstance(each, Kernel)]


def test_it_is_known_what_every_kernel_is_made_of():
    """And the names that its code reads are those that dis finds."""
    found = kernels()
    assert len(found) > 500
    for each in found:
        assert len(ingredients.digest(each)) == 64
        code, last, names = each.function.__code__, None, set()
        for step in dis.get_instructions(code):
            if step.opname == "LOAD_GLOBAL":
                last = step.argval
                names.add((last, None))
            elif step.opname in ("LOAD_ATTR", "LOAD_METHOD") and last is not None:
                names.add((last, step.argval))
                last = None
            else:
                last = None
        assert names <= ingredients.names_in(code)


HELPER = '''
from liegroup_core.compiling import kernel, shared
FACTOR = 2.0

@kernel
def inner(x):
    """Doubled."""
    return FACTOR * x

@shared
def apart(x, n):
    return n + 3
'''
OUTER = """
import math
import helper_{tag} as helper
from liegroup_core.compiling import kernel, stepper

TABLE = (1.0, 2.5)

@stepper
def outer(x):
    return helper.inner(x) + TABLE[1] + helper.apart(x, 4) + math.sqrt(x)
"""


@pytest.mark.parametrize(
    "old, new, changes",
    [
        ("Doubled.", "Twice x.", False),
        ("FACTOR = 2.0", "# two\nFACTOR = 2.0", False),
        ("return n + 3", "return n + 4", False),  # a function with code of its own
        ("FACTOR = 2.0", "FACTOR = 3.0", True),
        ("return FACTOR * x", "return x * FACTOR", True),
        ("(1.0, 2.5)", "(1.0, 2.25)", True),
        ("math.sqrt", "math.exp", True),
        ("TABLE[1]", "TABLE[0]", True),
        ("@kernel\ndef inner", "@shared\ndef inner", True),
    ],
)
def test_what_changes_the_code_changes_its_name(tmp_path, monkeypatch, old, new, changes):
    found = []
    for edit in (False, True):
        tag = f"{tmp_path.name}_{edit}".lower()
        (tmp_path / tag).mkdir()
        monkeypatch.syspath_prepend(tmp_path / tag)
        for name, text in (("helper", HELPER), ("outer", OUTER)):
            text = text.format(tag=tag) if name == "outer" else text
            (tmp_path / tag / f"{name}_{tag}.py").write_text(text.replace(old, new) if edit else text)
        module = importlib.import_module(f"outer_{tag}")
        # The modules differ in their names: only they may.
        for kernel in (module.outer, module.helper.inner, module.helper.apart):
            kernel.function.__module__ = "same"
        monkeypatch.setattr(module.helper, "__name__", "helper")
        found.append(ingredients.digest(module.outer))
    assert (found[0] != found[1]) == changes


SLOW = """
from liegroup_core.compiling import kernel, shared

@shared
def part(x, n):
    total = 0
    for k in range(n):
        total += k % 7
    return total

@kernel
def whole(x, n):
    return part(x, n) + 1
"""
ONE = """
import sys, time
sys.path.append({folder!r})
from liegroup_core.compiling import backend, inlining
backend.chosen()
saved = []
save = inlining._Cache.save_overload
def saves(self, signature, data):
    time.sleep(0.5)  # others arrive
    saved.append(self._name)
    save(self, signature, data)
inlining._Cache.save_overload = saves
import slow
assert slow.whole(1.0, 10) == sum(k % 7 for k in range(10)) + 1
print(len(saved))
"""


@pytest.mark.slow
@pytest.mark.turn(3)
def test_of_many_processes_one_compiles(tmp_path):
    """Also from copies of the sources at different places."""
    environment = os.environ | {"LIEGROUP_CACHE_DIR": str(tmp_path / "cache")}
    (tmp_path / "cache").mkdir(mode=0o700)
    # The small kernels of the compiler's own check first.
    first = "from liegroup_core.compiling import backend; backend.chosen()"
    subprocess.run([sys.executable, "-c", first], check=True, env=environment)
    running = []
    for k in range(6):
        place = tmp_path / f"place{k}"
        place.mkdir()
        (place / "slow.py").write_text(SLOW)
        command = [sys.executable, "-B", "-c", ONE.format(folder=str(place))]
        running.append(subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment))
    found = [int(each.communicate(timeout=120)[0].split()[-1]) for each in running]
    assert sum(found) == 2, found
    assert not list(tmp_path.glob("cache/*/*.lock"))
