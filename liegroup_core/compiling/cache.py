# SPDX-License-Identifier: Apache-2.0
"""Files of compiled kernels, in a folder for each compiler, Python and version of `compiling`.

The name of a file depends on the contents of its kernel (ingredients.py) and on the processor, but not on the
path of the sources. So all installations of a user share it.
"""

import fcntl
import functools
import hashlib
import logging
import os
import re
import shutil
import sys
import tempfile
from contextlib import contextmanager, suppress
from pathlib import Path

from .trust import close_to_others, doubt, is_private

log = logging.getLogger("liegroup_core")

CODE = ".nbc"  # ending of files with code
# Numbers of folders of other compilers and of kernel files to keep, those used last. A set of kernels has 10
# to 20 files of 0.1 to 1 MB, and a developer switches between a few versions.
KEPT_CACHES, KEPT_FILES = 6, 600
COMPILED = re.compile("[0-9a-f]{16}(-[0-9]+)?")  # names of the folders of compiled code


@functools.lru_cache(maxsize=None)
def source_digest(room="."):
    """Hash of the sources that results depend on, in folder `room`; by default in all but `study` (no kernels)."""
    root = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for path in sorted((root / room).rglob("*.py")):
        place = path.relative_to(root)
        if place.parts[0] != "study":
            digest.update(str(place).encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def cache_root():
    """User's cache folder; a folder in the temporary directory if that is not suitable.

    A suitable folder is writable for this user and for nobody else (trust.doubt), because code from it is
    executed. Returns None if neither folder is suitable.
    """
    default = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    preferred = Path(os.environ.get("LIEGROUP_CACHE_DIR") or Path(default) / "liegroup_core")
    roots = [preferred]
    try:
        roots.append(Path(tempfile.gettempdir()) / f"liegroup_core-{os.getuid()}")
    except FileNotFoundError:  # gettempdir writes a file: all disks are full
        pass
    for root in roots:
        try:
            root.mkdir(parents=True, exist_ok=True, mode=0o700)
            if root.name == "liegroup_core":
                close_to_others(root)
            tempfile.TemporaryFile(dir=root).close()
            reason = doubt(root)
        except OSError:
            continue
        if reason is None:
            return root
        _refuse(root, reason)
    return None


@functools.lru_cache(maxsize=None)
def _refuse(folder, reason):
    """Log once why a folder is not used."""
    log.warning("the kernel cache in %s is ignored, because its files are executed as code: %s", folder, reason)


@functools.lru_cache(maxsize=None)
def cache_folder(versions):
    """Cache folder of a compiler; created if necessary. Removes the oldest other folders.

    Only this user can access its files, whatever their modes are.

    versions : text that distinguishes compiled code: version and options of the compiler
    Returns None if no folder is suitable.
    """
    root = cache_root()
    if root is None:
        return None
    text = f"private {sys.version} {versions}"
    folder = root / hashlib.sha256(text.encode()).hexdigest()[:16]
    if folder.exists() and not os.access(folder, os.W_OK):
        folder = root / f"{folder.name}-{os.getuid()}"  # the first one belongs to another user
    try:
        new = not folder.exists()
        folder.mkdir(exist_ok=True, mode=0o700)
        if not is_private(folder):
            _refuse(folder, f"others can access it: rm -r {folder}")
            return None
    except OSError:  # the disk is full
        return None
    if new:
        old = [each for each in root.iterdir() if each.is_dir() and each != folder]
        old = [each for each in old if COMPILED.fullmatch(each.name)]
        old.sort(key=lambda each: each.stat().st_mtime, reverse=True)
        for each in old[KEPT_CACHES:]:
            shutil.rmtree(each, ignore_errors=True)
    return folder


def write(path, data):
    """Write a file of a cache folder atomically. Removes files that have not been used for long."""
    handle, name = tempfile.mkstemp(dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        os.replace(name, path)
    except BaseException:
        os.unlink(name)
        raise
    files = [(each.stat().st_mtime, each.path) for each in os.scandir(path.parent)]
    for _, old in sorted(files)[:-KEPT_FILES]:
        with suppress(OSError):
            os.unlink(old)


def lock(path):
    """Wait for a lock, and return its file. This process holds the lock until it closes the file or ends."""
    held = open(path.with_name(f"{path.stem}.lock"), "wb")
    fcntl.flock(held, fcntl.LOCK_EX)
    return held


@contextmanager
def cached_in(folder, config):
    """Set Numba's cache folder while it makes a dispatcher, whose files then are only in this folder.

    Restores the settings of the user and of other packages in the process, which have their own folders.
    """
    own = {"CACHE_DIR": str(folder or ""), "CACHE_LOCATOR_CLASSES": "UserProvidedCacheLocator"}
    before = {name: getattr(config, name, "") for name in own}
    vars(config).update(own)
    try:
        yield
    finally:
        vars(config).update(before)
