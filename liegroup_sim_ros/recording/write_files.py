# SPDX-License-Identifier: Apache-2.0
"""Names of the files of a recording: run.mcap, run_part2.mcap, ..."""

import re
import time
from pathlib import Path

from .errors import FileLostError, RecorderError


def new_file_path(path):
    """Path of a new file, in a folder that is created if needed. Raises RecorderError.

    path : *.mcap, or an existing folder, in which the file is named by the wall time
    """
    path = Path(path).expanduser()
    try:
        if path.is_dir():
            path /= time.strftime("recording_%Y_%m_%d-%H_%M_%S.mcap")
        elif path.suffix != ".mcap":
            raise RecorderError(f"cannot record to {path}: the path must end in .mcap or be an existing folder")
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecorderError(f"cannot record to {path}: {reason(error)}") from None
    return path


def part_path(path, number, part):
    """Path of another part of a recording, from the path of part `number`."""
    stem = path.stem if number == 1 else path.stem.removesuffix(f"_part{number}")
    return path.with_name(f"{stem}_part{part}.mcap" if part > 1 else f"{stem}.mcap")


def refuse_old_parts(path, number):
    """Raise RecorderError if files exist that would be parts of the same recording."""
    if number > 1:  # earlier parts belong to this recording
        return
    pattern = re.compile(re.escape(path.stem) + r"_part[0-9]+\.mcap")
    old = sorted(each.name for each in path.parent.iterdir() if pattern.fullmatch(each.name))
    if old:
        raise RecorderError(
            f"cannot record to {path}: {old[0]} already exists and could be a part of "
            "this recording; remove it or choose another name"
        )


def reason(error):
    """Text of an error, one line; for an OSError the text of the operating system."""
    if isinstance(error, FileLostError):
        return str(error)
    return getattr(error, "strerror", None) or f"{type(error).__name__}: {error}"
