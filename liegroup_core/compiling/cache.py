# SPDX-License-Identifier: Apache-2.0
"""Folder of the compiled kernels, renewed at every edit of a source.

Numba checks only the file that a kernel is defined in. An edit in a helper would leave its callers
with the old code. The name of this folder is a hash of all sources, so any edit starts a new one.
"""

import functools
import hashlib
import os
import re
import shutil
import sys
import tempfile
from pathlib import Path

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
    """User's cache folder; a folder in the temporary directory if that is not writable.

    Returns None if neither is writable.
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
            root.mkdir(parents=True, exist_ok=True, mode=0o777 if root is preferred else 0o700)
            tempfile.TemporaryFile(dir=root).close()
        except OSError:
            continue
        # Code from this folder is executed: reject a temporary folder that another user owns.
        if root is preferred or root.lstat().st_uid == os.getuid():
            return root
    return None


@functools.lru_cache(maxsize=None)
def cache_folder(versions):
    """Cache folder of these sources; created if necessary. Removes the oldest other folders.

    versions : text that also distinguishes compiled code: version and options of the compiler
    Returns None if no folder is writable.
    """
    root = cache_root()
    if root is None:
        return None
    text = f"{Path(__file__).parents[1]} {sys.version} {versions} {source_digest()}"
    folder = root / hashlib.sha256(text.encode()).hexdigest()[:16]
    if folder.exists() and not os.access(folder, os.W_OK):
        folder = root / f"{folder.name}-{os.getuid()}"  # the first one belongs to another user
    if not folder.exists():
        try:
            folder.mkdir(exist_ok=True)
        except OSError:  # the disk is full
            return None
        old = [each for each in root.iterdir() if each.is_dir() and each != folder]
        old = [each for each in old if COMPILED.fullmatch(each.name)]
        old.sort(key=lambda each: each.stat().st_mtime, reverse=True)
        for each in old[KEPT_CACHES:]:
            shutil.rmtree(each, ignore_errors=True)
    return folder
