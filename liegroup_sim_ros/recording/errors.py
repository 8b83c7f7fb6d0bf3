# SPDX-License-Identifier: Apache-2.0
"""Errors of recordings: one line of text each, exit code 2."""

from liegroup_core.errors import LieGroupSimError


class RecordingError(LieGroupSimError):
    """The file is not a readable recording, or a file recovered from it cannot be written."""


class RecorderError(LieGroupSimError):
    """The recording cannot start."""


class OutputError(LieGroupSimError):
    """A file of `liegroup_sim run` cannot be written."""


class AddressError(LieGroupSimError):
    """There is no readable file at an address."""


class FileLostError(LieGroupSimError):
    """A file was removed, replaced or truncated while it was written."""
