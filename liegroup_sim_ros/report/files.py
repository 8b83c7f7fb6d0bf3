# SPDX-License-Identifier: Apache-2.0
"""Output files of a command: checked before the computation, written after it."""

import os
import shutil
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

from liegroup_core.errors import LieGroupSimError

PICTURES = (".png", ".pdf", ".svg")
INPUTS = (".mcap", ".yaml", ".yml", ".urdf", ".sdf", ".xml", ".xacro", ".npz")


class ReportError(LieGroupSimError):
    """An output file cannot be written; one line of text, exit code 2."""


def check_files(*paths, picture=None):
    """Raise ReportError for a path that cannot be written; None or "" means no file.

    picture : path of an image; the suffix selects its format
    """
    for path in filter(None, (*paths, picture)):
        if Path(path).is_dir() or not Path(path).absolute().parent.is_dir():
            raise ReportError(f"{path}: cannot be written: give a file in an existing folder")
        if str(path).lower().endswith(INPUTS):
            raise ReportError(f"{path}: has the suffix of a recording or a scene: choose another name")
    if not picture:
        return
    if not picture.lower().endswith(PICTURES):
        raise ReportError(f"{picture}: the name must end in .png, .pdf or .svg")
    if find_spec("matplotlib") is None:
        raise ReportError("--png needs matplotlib: pip install 'liegroup_sim_ros[figures]'")


def write_file(path, write):
    """Call write(path) with the path of a new file in the same folder, which then replaces this one.

    So the file is never incomplete: if writing fails, an earlier file stays unchanged. A path that is not a
    regular file, such as /dev/stdout, is written directly. Raises ReportError.
    """
    place = Path(path).resolve()
    is_new = not os.path.exists(place)
    direct = not is_new and not (place.is_file() and os.access(place, os.W_OK) and os.access(place.parent, os.W_OK))
    part = place if direct else place.with_name(f".liegroup_sim.{os.getpid()}{place.suffix}")
    try:
        write(part)
        if not direct:
            if not is_new:
                shutil.copymode(place, part)
            part.replace(place)
    except OSError as error:
        raise ReportError(f"{path}: cannot be written: {error.strerror or error}") from None
    except ValueError as error:
        raise ReportError(f"{path}: {error}") from None
    finally:
        if not direct:
            with suppress(OSError):
                part.unlink()


def write_text(path, text):
    """Write a text file. Raises ReportError."""
    write_file(path, lambda path: Path(path).write_text(text, encoding="utf-8"))
