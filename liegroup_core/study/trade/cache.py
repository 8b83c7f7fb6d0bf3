# SPDX-License-Identifier: Apache-2.0
"""Cache of measurements: files in the cache folder of the user.

    trades/NAME-KEY/horizon.json        default horizon of a scene
    trades/NAME-KEY/HORIZON/truth.npz       reference solution, see reference_solution.py
    trades/NAME-KEY/HORIZON/cells.jsonl     one measured cell per line, see measure.py
    extremes/KEY/cells.jsonl                cells of the robustness map, see extremes.py

KEY is a digest of the scene text, of the sources and of the versions that affect the numbers, so other
scenes and versions have separate files. Each cell contains the name of its processor. A cell is written
as soon as it is measured, so an interruption loses none. The cache may be deleted at any time.
"""

import hashlib
import json
import logging
import os
import platform
import re
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from zipfile import BadZipFile

from liegroup_core.compiling import cache_root, source_digest
from liegroup_core.fields.arguments import is_finite
from liegroup_core.study.machine import cpu_name

from .configurations import as_time
from .measure import is_whole
from .reference_solution import as_bytes, truth_from

log = logging.getLogger("liegroup_core")

# Version of the files and of the measurement.
FORMAT = 2
PACKAGES = ("numpy", "scipy", "numba")


def key_of(text):
    """Key of a scene text with the current sources and versions."""
    digest = hashlib.sha256(f"{FORMAT} {source_digest()} {platform.python_version()}".encode())
    for package in PACKAGES:
        try:
            digest.update(f" {package} {version(package)}".encode())
        except PackageNotFoundError:
            digest.update(f" no {package}".encode())
    digest.update(text.encode())
    return digest.hexdigest()[:16]


class Folder:
    """Folder of cached files; without write access nothing is cached.

    name : name of the folder
    root : its parent; None: the cache folder of the user
    """

    def __init__(self, name, root=None):
        root = cache_root() if root is None else Path(root)
        self.folder = root and root / name

    def lines(self, name):
        """Dicts that `keep_line` has written to a file, in the same order."""
        try:
            lines = (self.folder / name).read_bytes().splitlines()
        except (OSError, TypeError):
            return []
        found = []
        for line in lines:
            try:
                entry = json.loads(line)
            except ValueError:  # truncated when a process was killed, or damaged
                continue
            if isinstance(entry, dict):
                found.append(entry)
        return found

    def keep_line(self, name, entry):
        """Append a dict of JSON types to a file, immediately and atomically."""
        line = "\n" + json.dumps(entry)  # newline first, because the last line may be truncated

        def write():
            path = self.folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            with open(path, "ab", buffering=0) as stream:
                stream.write(line.encode())

        self._try(write)

    def _try(self, write):
        """Call write(). After the first failure, warn and write nothing more: the cache is optional."""
        if self.folder is None:
            return
        try:
            write()
        except OSError as error:
            log.warning("measurements cannot be cached: %s: %s", error.filename or self.folder, error.strerror)
            self.folder = None


class Store(Folder):
    """Folder with the files of one scene."""

    def __init__(self, scene, root=None):
        name = re.sub(r"[^A-Za-z0-9_.]", "_", scene.name)[:40]
        super().__init__(Path("trades", f"{name}-{key_of(scene.text)}"), root)

    def horizon(self):
        """Default horizon of the scene, or None."""
        try:
            found = json.loads((self.folder / "horizon.json").read_text())
        except (OSError, ValueError, TypeError):
            return None
        return as_time(found) if is_finite(found) and found > 0.0 else None

    def truth(self, horizon):
        """ReferenceSolution over a horizon, or None."""
        try:
            return truth_from(self._of(horizon) / "truth.npz")
        except (OSError, TypeError, ValueError, KeyError, BadZipFile):
            return None

    def keep_truth(self, truth, suits):
        """Write a ReferenceSolution; suits : whether its horizon is the default of the scene."""

        def write():
            self._of(truth.horizon).mkdir(parents=True, exist_ok=True)
            _write(self._of(truth.horizon) / "truth.npz", as_bytes(truth))
            if suits:
                _write(self.folder / "horizon.json", str(float(truth.horizon)).encode())

        self._try(write)

    def cells(self, horizon):
        """Cells measured on this processor, in order of measurement."""
        return [
            cell for cell in self.lines(f"{_name(horizon)}/cells.jsonl") if is_whole(cell) and cell["cpu"] == cpu_name()
        ]

    def keep_cell(self, horizon, cell):
        """Write a cell, immediately and atomically."""
        self.keep_line(f"{_name(horizon)}/cells.jsonl", cell)

    def _of(self, horizon):
        return self.folder / _name(horizon)


def _name(horizon):
    return f"{float(horizon):g}s"


def _write(path, data):
    """Write a file atomically."""
    part = path.with_name(f"{path.name}.{os.getpid()}")
    try:
        part.write_bytes(data)
        part.replace(path)
    except OSError:
        part.unlink(missing_ok=True)
        raise
