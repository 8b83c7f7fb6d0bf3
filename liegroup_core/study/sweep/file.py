# SPDX-License-Identifier: Apache-2.0
"""Results of a sweep as Parquet: a folder with a file for each finished batch of runs.

    NAME.parquet/runs-000000000-000000124.parquet       runs 0 to 124, one row per run

pandas, pyarrow, Dask and Spark read the folder as one table, in the order of the runs. The metadata of each file
describe the sweep, those of a field its unit. Files are written atomically, so an interruption loses no finished
batch, and the same command continues with the missing runs.
"""

import fcntl
import json
import os
import re
from contextlib import contextmanager, suppress
from functools import cached_property
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from liegroup_core.errors import LieGroupSimError

from . import sweep as sweeps

KEY = b"liegroup_sim.sweep"
PART = re.compile(r"runs-([0-9]+)-([0-9]+)\.parquet")


class SweepFileError(LieGroupSimError):
    """The folder cannot be read or written, or belongs to another sweep; one line, exit code 2."""


class SweepFile:
    """Folder of a sweep.

    path        : must end in .parquet
    description : JSON types, with at least the entries of sweep.describe; the folder must be empty
                  or contain this sweep. None: the folder must contain a sweep
    raises SweepFileError
    """

    def __init__(self, path, description=None):
        if find_spec("pyarrow") is None:
            raise SweepFileError("Parquet files need the package pyarrow: pip install 'liegroup_sim_ros[many]'")
        self.path = Path(path)
        if self.path.suffix != ".parquet":
            raise SweepFileError(f"{path}: the name must end in .parquet")
        if self.path.exists() and not self.path.is_dir():
            raise SweepFileError(f"{path}: is a file, but a sweep is written to a folder; choose another name")
        self._parts = self._found()
        if not self._parts and description is None:
            raise SweepFileError(f"{path}: no sweep found")
        self.description = (
            self._description(self._parts[0][2]) if description is None else json.loads(json.dumps(description))
        )
        for _, _, part in self._parts:
            self._check(part)

    @cached_property
    def sweep(self):
        """Sweep of the folder."""
        try:
            return sweeps.described(self.description)
        except (KeyError, TypeError, ValueError) as error:
            raise SweepFileError(f"{self.path}: cannot be read, because another version wrote it: {error}") from None

    @property
    def missing(self):
        """Numbers of the missing runs, in ascending order."""
        runs = np.ones(self.description["samples"], dtype=bool)
        for first, last, _ in self._parts:
            runs[first : last + 1] = False
        return np.flatnonzero(runs)

    def table(self, columns=None):
        """pyarrow.Table of all finished runs, in their order."""
        dataset = import_module("pyarrow.dataset")
        return dataset.dataset([part for *_, part in self._parts], format="parquet").to_table(columns=columns)

    @contextmanager
    def writing(self):
        """Create and lock the folder. Raises SweepFileError."""
        is_new = not self.path.exists()
        try:
            self.path.mkdir(exist_ok=True)
            handle = os.open(self.path, os.O_RDONLY)
        except OSError as error:
            raise SweepFileError(f"{self.path}: cannot be written: {error.strerror}") from None
        try:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise SweepFileError(f"{self.path}: another process is writing to it") from None
            self._parts = self._found()  # again, because another process may have written until now
            for left in self.path.glob(".runs-*.part"):
                left.unlink()
            yield self
        finally:
            os.close(handle)
            if is_new and not self._parts:  # no run could be written
                with suppress(OSError):
                    self.path.rmdir()

    def add(self, columns):
        """Write a batch of runs from sweep.Sweep.run. Raises SweepFileError."""
        pa, parquet = import_module("pyarrow"), import_module("pyarrow.parquet")
        kinds = {"int": pa.int64(), "float": pa.float64(), "text": pa.string(), "list": pa.list_(pa.float64())}
        of_fields = {name: {"unit": unit} for name, unit in self.sweep.units.items()}
        schema = pa.schema(
            [pa.field(name, kinds[kind], metadata=of_fields.get(name)) for name, kind in self.sweep.columns.items()],
            {KEY: json.dumps(self.description, allow_nan=False).encode()},
        )
        first, last = int(columns["run"][0]), int(columns["run"][-1])
        part = self.path / f"runs-{first:09d}-{last:09d}.parquet"
        hidden = self.path / f".{part.name}.part"  # readers of the folder ignore it
        try:
            parquet.write_table(pa.table(columns, schema), hidden)
            hidden.replace(part)
        except OSError as error:
            raise SweepFileError(f"{part}: cannot be written: {error.strerror or error}") from None
        self._parts = sorted([*self._parts, (first, last, part)])

    def _found(self):
        """[(first run, last run, path)] of the files in the folder."""
        parts = []
        try:
            files = sorted(self.path.iterdir()) if self.path.is_dir() else []
        except OSError as error:
            raise SweepFileError(f"{self.path}: cannot be read: {error.strerror}") from None
        for file in files:
            match = PART.fullmatch(file.name)
            if match:
                parts.append((int(match[1]), int(match[2]), file))
            elif not file.name.startswith("."):
                raise SweepFileError(f"{self.path}: is not the folder of a sweep: it contains {file.name}")
        return parts

    def _description(self, part):
        """Description in a file; checks that its number of runs fits its name."""
        parquet, pa = import_module("pyarrow.parquet"), import_module("pyarrow")
        try:
            metadata = parquet.read_metadata(part)
            found = json.loads((metadata.metadata or {})[KEY])
        except (pa.ArrowException, OSError, KeyError, ValueError):
            raise SweepFileError(
                f"{part}: is damaged or does not belong to a sweep; remove it, and the same command repeats its runs"
            ) from None
        first, last = map(int, PART.fullmatch(part.name).groups())
        if metadata.num_rows != last - first + 1:
            raise SweepFileError(
                f"{part}: its runs do not match its name; remove it, and the same command repeats them"
            )
        return found

    def _check(self, part):
        found = self._description(part)
        if found == self.description:
            return
        other = [key for key in {**self.description, **found} if self.description.get(key) != found.get(key)]
        shown = ", ".join(
            f"{key} {_short(found.get(key))} there and {_short(self.description.get(key))} here" for key in other[:3]
        )
        raise SweepFileError(f"{self.path}: contains a different sweep: {shown}; choose another name, or remove it")


def _short(value):
    text = " ".join(str(value).split())
    return text if len(text) <= 60 else f"{text[:57]}..."
