# SPDX-License-Identifier: Apache-2.0
"""Folder of the compiled kernels, renewed at every edit of a source.

Numba checks only the file that a kernel is defined in. An edit in a helper would leave its callers
with the old code. The name of this folder is a hash of all sources, so any edit starts a new one.
"""

import functools
import hashlib
import logging
import os
import re
import shutil
import sys
import tempfile
from contextlib import contextmanager
from pathlib import Path

from .trust import close_to_others, doubt, is_private

log = logging.getLogger("liegroup_core")

# Folders of other versions that are kept: a developer switches between a few.
KEPT_CACHES = 6
COMPILED = re.compile("[0-9a-f]{16}(-[0-9]+)?")  # names of the folders of compiled code


@functools.lru_cache(maxsize=None)
def source_digest():
    """Hash of the sources that results depend on: all but `study`, which has no kernels."""
    root = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        place = path.relative_to(root)
        if place.parts[0] != "study":
            digest.update(str(place).encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def cache_root():
    """User's cache folder; a folder in the temporary directory if that is not suitable.

    Suitable is a folder in which this user can write and no other one can (trust.doubt): code from it
    is executed. Returns None if neither is.
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
    log.warning("the cache in %s is not used, because its code is executed: %s", folder, reason)


@functools.lru_cache(maxsize=None)
def cache_folder(versions):
    """Cache folder of these sources; created if necessary. Removes the oldest other folders.

    Only this user can reach what it holds, whatever the modes of the files are.

    versions : text that also distinguishes compiled code: version and options of the compiler
    Returns None if no folder is suitable.
    """
    root = cache_root()
    if root is None:
        return None
    text = f"private {Path(__file__).parents[1]} {sys.version} {versions} {source_digest()}"
    folder = root / hashlib.sha256(text.encode()).hexdigest()[:16]
    if folder.exists() and not os.access(folder, os.W_OK):
        folder = root / f"{folder.name}-{os.getuid()}"  # the first one belongs to another user
    try:
        new = not folder.exists()
        folder.mkdir(exist_ok=True, mode=0o700)
        if not is_private(folder):
            _refuse(folder, f"others can reach it: rm -r {folder}")
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


@contextmanager
def cached_in(folder, config):
    """Numba's settings while it makes a dispatcher: its files are in this folder, nowhere else.

    Those of the user and of other packages in the process are restored: they have their own folders.
    """
    own = {"CACHE_DIR": str(folder or ""), "CACHE_LOCATOR_CLASSES": "UserProvidedCacheLocator"}
    before = {name: getattr(config, name, "") for name in own}
    vars(config).update(own)
    try:
        yield
    finally:
        vars(config).update(before)
