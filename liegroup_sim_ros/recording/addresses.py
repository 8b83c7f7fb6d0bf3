# SPDX-License-Identifier: Apache-2.0
"""Addresses of recordings: paths, globs, and URLs such as s3://bucket/run.mcap.

URLs are read by fsspec, an optional package, and its file systems (aiohttp for http://, s3fs for
s3://, and so on). The file is copied to a temporary file first, because a recording is read more
than once.
"""

import glob
import shutil
import tempfile
from pathlib import Path

from .errors import AddressError


def is_remote(address):
    """Whether an address is a URL for fsspec."""
    return "://" in str(address)


def expand(addresses):
    """Paths and URLs, with the sorted matches in place of each pattern.

    A folder stands for the *.mcap files in it. A name that exists is not treated as a pattern.
    Raises AddressError for a pattern without a match.
    """
    paths = []
    for address in map(str, addresses):
        if is_remote(address):
            paths += _remote_matches(address) if glob.has_magic(address) else [address]
        elif Path(address).is_dir():
            matches = sorted(map(str, Path(address).glob("*.mcap")))
            if not matches:
                raise AddressError(f"{address}: the folder has no *.mcap file")
            paths += matches
        elif glob.has_magic(address) and not Path(address).exists():
            matches = sorted(glob.glob(address, recursive=True))
            if not matches:
                raise AddressError(f"{address}: no file matches")
            paths += matches
        else:
            paths.append(address)
    return paths


def fetch(address):
    """Temporary copy of a remote file, open for reading; closing removes it.

    Raises AddressError.
    """
    fsspec = _fsspec(address)
    copy = tempfile.NamedTemporaryFile(prefix="liegroup_sim_", suffix=".mcap")
    try:
        with fsspec.open(address, "rb") as stream:
            shutil.copyfileobj(stream, copy, 2**20)
        copy.flush()
        return copy
    except Exception as error:  # each file system raises its own errors
        copy.close()
        raise AddressError(f"{address}: cannot be read: {_reason(error)}") from None


def _remote_matches(address):
    fsspec = _fsspec(address)
    try:
        system, path = fsspec.core.url_to_fs(address)
        matches = sorted(map(str, system.glob(path)))
        matches = [system.unstrip_protocol(match) for match in matches]
    except Exception as error:  # as in `fetch`
        raise AddressError(f"{address}: cannot be read: {_reason(error)}") from None
    if not matches:
        raise AddressError(f"{address}: no file matches")
    return matches


def _fsspec(address):
    try:
        import fsspec
    except ImportError:
        raise AddressError(
            f"{address}: needs the package fsspec: pip install fsspec, or 'liegroup_sim_ros[remote]'"
        ) from None
    return fsspec


def _reason(error):
    """Text of the root cause, one line."""
    while error.__cause__ is not None:
        error = error.__cause__
    if isinstance(error, FileNotFoundError):  # its text is the address, or a part of it
        return "no such file"
    return " ".join(str(error).split())[:200] or type(error).__name__
