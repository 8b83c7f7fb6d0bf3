# SPDX-License-Identifier: Apache-2.0
"""Check whether others can write to a folder. Code from the cache is executed, so nobody else may."""

import os
import stat
from pathlib import Path

MOST_LINKS = 40
WRITABLE = stat.S_IWGRP | stat.S_IWOTH
OTHERS = stat.S_IRWXG | stat.S_IRWXO


def doubt(folder):
    """Reason why others could change the contents of a folder, in one line; None if they cannot.

    The folder and all folders and symbolic links of its path must belong to this user or to root, and only
    they may write there. A folder of the path that all may write to is allowed if each user may only move
    their own entries (/tmp), because the next folder is checked as well.
    """
    places = list(_way(folder))
    for place, status in places:
        if status.st_uid not in (0, os.getuid()):
            return f"{place} belongs to user {status.st_uid}: choose a folder of your own"
        last = place == places[-1][0]
        shared = status.st_mode & WRITABLE and not stat.S_ISLNK(status.st_mode)
        if shared and (last or not status.st_mode & stat.S_ISVTX):
            return f"others can write to {place}: chmod go-w {place}"
    return None


def close_to_others(folder):
    """Remove the permissions of others from a folder of this user; earlier versions made it with the umask."""
    status = os.stat(folder)
    if status.st_uid == os.getuid() and status.st_mode & OTHERS:
        os.chmod(folder, stat.S_IMODE(status.st_mode) & ~OTHERS)


def is_private(folder):
    """Whether only this user can access the contents of a folder."""
    status = os.lstat(folder)
    return stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid() and not status.st_mode & OTHERS


def _way(path):
    """Yield (path, status) of all folders and symbolic links from the root on."""
    place, links = Path("/"), 0
    yield place, os.lstat(place)
    parts = list(reversed(Path.cwd().joinpath(path).parts[1:]))
    while parts:
        part = parts.pop()
        place = place.parent if part == ".." else place / part
        status = os.lstat(place)
        yield place, status
        if stat.S_ISLNK(status.st_mode):
            links += 1
            if links > MOST_LINKS:
                raise OSError(f"too many symbolic links: {path}")
            target = Path(os.readlink(place))
            place = Path("/") if target.is_absolute() else place.parent
            parts += reversed(target.parts[1:] if target.is_absolute() else target.parts)
