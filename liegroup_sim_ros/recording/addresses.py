# SPDX-License-Identifier: Apache-2.0
"""Where recordings are: paths, globs, and addresses such as s3://bucket/run.mcap.

Addresses are read by fsspec, an optional package, with what it knows and what is installed for it
(aiohttp for http://, s3fs for s3://, and so on); a file behind one is copied to a temporary file
first, because a recording is gone through more than once.
"""

import glob
import shutil
import tempfile
from pathlib import Path

from liegroup_core.errors import LieGroupSimError


class AddressError(LieGroupSimError):
    """Nothing can be read there; one line of text."""


def is_remote(address):
    """Whether an address is one for fsspec."""
    return "://" in str(address)


def expand(addresses):
    """Paths and addresses, with what matches in place of every pattern, sorted.

    A folder stands for the *.mcap in it; any other name that exists is taken as it is. Raises
    AddressError for a pattern without a match.
    """
    found = []
    for address in map(str, addresses):
        if is_remote(address):
            found += _remote_matches(address) if glob.has_magic(address) else [address]
        elif Path(address).is_dir():
            matches = sorted(map(str, Path(address).glob("*.mcap")))
            if not matches:
                raise AddressError(f"{address}: a folder without *.mcap in it")
            found += matches
        elif glob.has_magic(address) and not Path(address).exists():
            matches = sorted(glob.glob(address, recursive=True))
            if not matches:
                raise AddressError(f"{address}: no file matches")
            found += matches
        else:
            found.append(address)
    return found


def fetch(address):
    """A temporary file with what is at a remote address, open for reading; closing removes it.

    Raises AddressError.
    """
    fsspec = _fsspec(address)
    copy = tempfile.NamedTemporaryFile(prefix="liegroup_sim_", suffix=".mcap")
    try:
        with fsspec.open(address, "rb") as stream:
            shutil.copyfileobj(stream, copy, 2**20)
        copy.flush()
        return copy
    except Exception as error:  # every file system has its own; none of them is known here
        copy.close()
        raise AddressError(f"{address}: cannot be read: {_reason(error)}") from None


def _remote_matches(address):
    fsspec = _fsspec(address)
    try:
        system, path = fsspec.core.url_to_fs(address)
        matches = sorted(map(str, system.glob(path)))
        matches = [system.unstrip_protocol(match) for match in matches]
    except Exception as error:  # likewise
        raise AddressError(f"{address}: cannot be read: {_reason(error)}") from None
    if not matches:
        raise AddressError(f"{address}: no file matches")
    return matches


def _fsspec(address):
    try:
        import fsspec
    except ImportError:
        raise AddressError(
            f"{address}: needs the package fsspec: pip install fsspec, or "
            "'liegroup_sim_ros[remote]'"
        ) from None
    return fsspec


def _reason(error):
    """What went wrong at the bottom of it, one line."""
    while error.__cause__ is not None:
        error = error.__cause__
    if isinstance(error, FileNotFoundError):  # has the address as its text, or part of it
        return "no such file"
    return " ".join(str(error).split())[:200] or type(error).__name__
