# SPDX-License-Identifier: Apache-2.0
"""What was measured, kept between runs: files in the cache folder of the user.

    trades/NAME-KEY/horizon.json        the horizon that suits a scene
    trades/NAME-KEY/HORIZON/truth.npz       the true motion, see truth.py
    trades/NAME-KEY/HORIZON/cells.jsonl     a measured cell a line, see measure.py
    extremes/KEY/cells.jsonl                cells of the map of extremes, see extremes.py

KEY is of the scene's text, of our sources and of the versions that numbers depend on: what is
another scene or version finds nothing. The processor stands in each cell. A cell is written as
soon as it is measured, so whatever ends a run loses none. All of it may be deleted at any time.
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
from liegroup_core.integrators.methods import is_positive
from liegroup_core.study.machine import cpu_name

from .configurations import as_time
from .measure import is_whole
from .reference_solution import as_bytes, truth_from

log = logging.getLogger("liegroup_core")

# Of what the files hold and of how it is measured.
FORMAT = 2
PACKAGES = ("numpy", "scipy", "numba", "mpmath")


def key_of(text):
    """The key of a scene's text with these sources and versions."""
    digest = hashlib.sha256(f"{FORMAT} {source_digest()} {platform.python_version()}".encode())
    for package in PACKAGES:
        try:
            digest.update(f" {package} {version(package)}".encode())
        except PackageNotFoundError:
            digest.update(f" no {package}".encode())
    digest.update(text.encode())
    return digest.hexdigest()[:16]


class Folder:
    """A folder of files; where it cannot be written, nothing is kept.

    name : of the folder
    root : where it is; None: in the user's cache
    """

    def __init__(self, name, root=None):
        root = cache_root() if root is None else Path(root)
        self.folder = root and root / name

    def lines(self, name):
        """What `keep_line` has put into a file, in that order: dicts."""
        try:
            lines = (self.folder / name).read_bytes().splitlines()
        except (OSError, TypeError):
            return []
        found = []
        for line in lines:
            try:
                entry = json.loads(line)
            except ValueError:  # cut off when a process was killed, or damaged
                continue
            if isinstance(entry, dict):
                found.append(entry)
        return found

    def keep_line(self, name, entry):
        """Write a dict of JSON types to the end of a file, at once and as a whole."""
        line = "\n" + json.dumps(entry)  # first: the last one may be cut

        def write():
            path = self.folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            with open(path, "ab", buffering=0) as stream:
                stream.write(line.encode())

        self._try(write)

    def _try(self, write):
        """Write; from the first failure on nothing more: what is measured is of use without."""
        if self.folder is None:
            return
        try:
            write()
        except OSError as error:
            log.warning(
                "measurements cannot be cached: %s: %s",
                error.filename or self.folder,
                error.strerror,
            )
            self.folder = None


class Store(Folder):
    """The files of one scene, see Folder."""

    def __init__(self, scene, root=None):
        name = re.sub(r"[^A-Za-z0-9_.]", "_", scene.name)[:40]
        super().__init__(Path("trades", f"{name}-{key_of(scene.text)}"), root)

    def horizon(self):
        """The horizon that suits the scene, or None."""
        try:
            found = json.loads((self.folder / "horizon.json").read_text())
        except (OSError, ValueError, TypeError):
            return None
        return as_time(found) if is_positive(found) else None

    def truth(self, horizon):
        """The Truth over a horizon, or None."""
        try:
            return truth_from(self._of(horizon) / "truth.npz")
        except (OSError, TypeError, ValueError, KeyError, BadZipFile):
            return None

    def keep_truth(self, truth, suits):
        """Keep a Truth; suits : its horizon is that which suits the scene."""

        def write():
            self._of(truth.horizon).mkdir(parents=True, exist_ok=True)
            _write(self._of(truth.horizon) / "truth.npz", as_bytes(truth))
            if suits:
                _write(self.folder / "horizon.json", str(float(truth.horizon)).encode())

        self._try(write)

    def cells(self, horizon):
        """Cells that were measured on this processor, in the order in which they were."""
        return [
            cell
            for cell in self.lines(f"{_name(horizon)}/cells.jsonl")
            if is_whole(cell) and cell["cpu"] == cpu_name()
        ]

    def keep_cell(self, horizon, cell):
        """Write a cell, at once and as a whole."""
        self.keep_line(f"{_name(horizon)}/cells.jsonl", cell)

    def _of(self, horizon):
        return self.folder / _name(horizon)


def _name(horizon):
    return f"{float(horizon):g}s"


def _write(path, data):
    """Write a file that is either there as a whole or not at all."""
    part = path.with_name(f"{path.name}.{os.getpid()}")
    try:
        part.write_bytes(data)
        part.replace(path)
    except OSError:
        part.unlink(missing_ok=True)
        raise
