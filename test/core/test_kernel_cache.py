# SPDX-License-Identifier: Apache-2.0
"""The cache of compiled code: what its names depend on, and where it may be."""

import dis
import importlib
import logging
import os
import pkgutil
import subprocess
import sys
import tempfile

import pytest

import liegroup_core
from liegroup_core.compiling import Kernel, backend, cache, compiled, ingredients, trust

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


# Compiled code is read from folders only that no other user can write to.


OTHER = 12345


@pytest.fixture(autouse=True)
def nothing_known(monkeypatch, tmp_path):
    """No variable names a folder; the temporary one is empty."""
    for name in ("LIEGROUP_CACHE_DIR", "XDG_CACHE_HOME", "NUMBA_CACHE_DIR"):
        monkeypatch.delenv(name, raising=False)
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    for function in (cache.cache_folder, cache._refuse):
        function.cache_clear()
    yield
    cache.cache_folder.cache_clear()


def made(path, mode=0o755):
    path.mkdir(parents=True)
    path.chmod(mode)
    return path


def of_another_user(monkeypatch, *paths):
    """Let lstat say that these places are of another user."""
    lstat = os.lstat

    def told(path, **options):
        found = lstat(path, **options)
        if str(path) in map(str, paths):
            found = os.stat_result([*found[:4], OTHER, *found[5:10]])
        return found

    monkeypatch.setattr(os, "lstat", told)


def chosen_with(monkeypatch, caplog, variable, value):
    """(folder of the cache, warnings) where a variable names a folder."""
    monkeypatch.setenv(variable, str(value))
    caplog.clear()
    with caplog.at_level(logging.WARNING, logger="liegroup_core"):
        return cache.cache_root(), [each.getMessage() for each in caplog.records]


@pytest.mark.parametrize(
    "variable, name",
    [("LIEGROUP_CACHE_DIR", "."), ("XDG_CACHE_HOME", "liegroup_core"), ("HOME", ".cache/liegroup_core")],
)
@pytest.mark.parametrize(
    "mode, allowed", [(0o755, True), (0o700, True), (0o775, False), (0o757, False), (0o777, False)]
)
def test_a_folder_that_others_can_write_to_is_refused(tmp_path, monkeypatch, caplog, variable, name, mode, allowed):
    """Whatever variable names it. The reason is one line, said once; the temporary folder is used.

    The project's own folder, as earlier versions made it, is closed to others and used.
    """
    named = made(tmp_path / "named")
    folder = named / name
    if name != ".":
        made(folder)
    folder.chmod(mode)
    found, said = chosen_with(monkeypatch, caplog, variable, named)
    if allowed or name != ".":
        assert found == folder and said == []
        assert name == "." or folder.stat().st_mode & 0o777 == 0o700
        return
    assert found == tmp_path / "temporary" / f"liegroup_core-{os.getuid()}"
    assert found.stat().st_mode & 0o777 == 0o700
    assert len(said) == 1 and f"others can write to {folder}: chmod go-w {folder}" in said[0]
    assert chosen_with(monkeypatch, caplog, variable, named) == (found, [])


def test_the_whole_way_to_a_folder_is_checked(tmp_path, monkeypatch):
    """Folders above, and symbolic links with the folders that they lead through."""
    folder = made(tmp_path / "a" / "b" / "c")
    assert trust.doubt(folder) is None
    (tmp_path / "a").chmod(0o777)
    assert f"others can write to {tmp_path / 'a'}:" in trust.doubt(folder)
    (tmp_path / "a").chmod(0o1777)  # as /tmp: others cannot move b
    assert trust.doubt(folder) is None
    assert f"others can write to {tmp_path / 'a'}:" in trust.doubt(tmp_path / "a")
    (tmp_path / "a").chmod(0o755)
    open_ = made(tmp_path / "open", 0o777)
    (open_ / "there").symlink_to(folder)
    (tmp_path / "link").symlink_to("open/there")
    assert f"others can write to {open_}:" in trust.doubt(tmp_path / "link")
    assert f"others can write to {open_}:" in trust.doubt(open_ / ".." / "a" / "b")
    open_.chmod(0o755)
    assert trust.doubt(tmp_path / "link") is None
    for place in (folder, folder.parent, open_ / "there"):
        with monkeypatch.context() as patch:
            of_another_user(patch, place)
            assert f"{place} belongs to user {OTHER}" in trust.doubt(tmp_path / "link")
    (tmp_path / "circle").symlink_to("circle")
    with pytest.raises(OSError):
        trust.doubt(tmp_path / "circle")


def test_without_a_suitable_folder_nothing_is_cached(tmp_path, monkeypatch, caplog):
    (tmp_path / "temporary").chmod(0o777)
    named = made(tmp_path / "named", 0o777)
    found, said = chosen_with(monkeypatch, caplog, "LIEGROUP_CACHE_DIR", named)
    assert found is None and len(said) == 2
    assert cache.cache_folder("x") is None


@pytest.mark.parametrize("harm", ["mode", "owner", "link"])
def test_the_folder_of_compiled_code_is_private(tmp_path, monkeypatch, caplog, harm):
    """So the modes of what it holds do not matter. Another one is not read."""
    found, said = chosen_with(monkeypatch, caplog, "LIEGROUP_CACHE_DIR", made(tmp_path / "named"))
    folder = cache.cache_folder("x")
    assert folder.parent == found and folder.stat().st_mode & 0o777 == 0o700 and said == []
    cache.cache_folder.cache_clear()
    assert cache.cache_folder("x") == folder
    cache.cache_folder.cache_clear()
    if harm == "mode":
        folder.chmod(0o755)
    elif harm == "owner":
        of_another_user(monkeypatch, folder)
    else:
        folder.rmdir()
        folder.symlink_to(made(tmp_path / "elsewhere", 0o700))
    with caplog.at_level(logging.WARNING, logger="liegroup_core"):
        assert cache.cache_folder("x") is None
    assert [each.getMessage() for each in caplog.records] == [
        f"the kernel cache in {folder} is ignored, because its files are executed as code: "
        f"others can access it: rm -r {folder}"
    ]


@pytest.mark.slow
@pytest.mark.skipif(not compiled(), reason="nothing is compiled")
@pytest.mark.parametrize("plain", ["0", "1"])
@pytest.mark.turn(3)
def test_no_variable_of_numba_moves_the_cache(tmp_path, plain):
    """Neither its own folder nor the choice of its kinds of places."""
    (tmp_path / "kernels.py").write_text(
        "from liegroup_core.compiling import kernel\n@kernel\ndef twice(x):\n    return 2.0 * x\n"
    )
    for name in ("numba", "own"):
        made(tmp_path / name)
    code = f"import sys; sys.path.append({str(tmp_path)!r}); import kernels; print(kernels.twice(3.0))"
    done = subprocess.run(
        [sys.executable, "-B", "-c", code],
        capture_output=True,
        text=True,
        timeout=300,
        env=os.environ
        | {
            "LIEGROUP_CACHE_DIR": str(tmp_path / "own"),
            "NUMBA_CACHE_DIR": str(tmp_path / "numba"),
            "NUMBA_CACHE_LOCATOR_CLASSES": "InTreeCacheLocator",
            backend.PLAIN: plain,
        },
    )
    assert done.stdout == "6.0\n", done.stderr
    assert list((tmp_path / "own").rglob("kernels.twice*.nbc"))
    assert not list((tmp_path / "numba").iterdir()) and not (tmp_path / "__pycache__").exists()
