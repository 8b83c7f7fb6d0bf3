# SPDX-License-Identifier: Apache-2.0
"""Files that a robot file may refer to: those of its own tree and of the search paths of ROS and Gazebo.

The tree of a file is the nearest folder above it with a package.xml or a .git. Without one, it is the
parent of the file's folder, because robots keep their meshes there. It is never a home folder or a folder
above one. xacro also reads the packages beside that of the file (resources.packages_around). A server of
requests reads below given folders only (`served_from`). `anywhere` permits all files.
"""

import os
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar
from pathlib import Path

from liegroup_core.errors import SceneError

ROOTS = ("package.xml", ".git")  # one of them marks the folder of a tree
ANYWHERE = (Path("/"),)
# Environment variables that list folders with models, in search order.
MODEL_PATHS = ("GZ_SIM_RESOURCE_PATH", "IGN_GAZEBO_RESOURCE_PATH", "GAZEBO_MODEL_PATH", "SDF_PATH")
PACKAGE_PATHS = ("AMENT_PREFIX_PATH", "ROS_PACKAGE_PATH")

# Folders below which files may be read; None: the tree of the file that refers to them.
_served = ContextVar("served", default=None)


@contextmanager
def served_from(folders):
    """Permit only files below these folders and the search paths, whichever file refers to them."""
    before = _served.set(tuple(Path(os.path.realpath(folder)) for folder in folders))
    try:
        yield
    finally:
        _served.reset(before)


def anywhere(allowed=True):
    """Permit files in all folders, if `allowed`."""
    return served_from(ANYWHERE) if allowed else nullcontext()


def search_folders(variables=(*PACKAGE_PATHS, *MODEL_PATHS)):
    """Folders of the search paths, in search order."""
    return [
        Path(folder) for variable in variables for folder in os.environ.get(variable, "").split(os.pathsep) if folder
    ]


def trees(file):
    """Folders with the files that a file may refer to."""
    served = _served.get()
    own = served if served is not None else {tree_of(file), tree_of(os.path.realpath(file))}
    return [*own, *_searched()]


def permit(path, file=None):
    """Return the path of a file to read. Raises SceneError if it may not be read.

    file : file that refers to this path; None: a user or a request does
    """
    if not is_permitted(path, file):
        raise SceneError(f"{path}: is not read: {outside(file)}")
    return path


def is_permitted(path, file=None):
    """Whether a file may be read, see `permit`."""
    if _served.get() is None and file is None:
        return True
    real = Path(os.path.realpath(path))
    return any(real.is_relative_to(folder) for folder in trees(file))


def outside(file):
    """Message why a file may not be read, and what to do."""
    served = _served.get()
    if served is None:
        return (
            f"it is outside of {tree_of(file)}, the tree of the file that refers to it: move it there, "
            "or give --allow-files (for a node: -p world_folders:=/)"
        )
    listed = ", ".join(map(str, served)) or "none"
    return (
        f"it is outside of the folders that requests may read ({listed}): move it there, or start "
        "the node with its folder in the parameter world_folders"
    )


def tree_of(file):
    """Folder with the files that belong to a file; the file itself if it is in a home folder."""
    file = Path(os.path.abspath(file))
    folder = file.parent
    if holds_home(folder):
        return file
    tree = folder if holds_home(folder.parent) else folder.parent
    for above in (folder, *folder.parents):
        if holds_home(above):
            break
        if any((above / root).exists() for root in ROOTS):
            return above
    return tree


def holds_home(folder):
    """True for the user's home folder and the folders above it."""
    home = os.path.realpath(os.path.expanduser("~"))
    return Path(home).is_relative_to(os.path.realpath(folder))


def _searched():
    """Folders of the search paths, and the source folders of packages installed by symbolic links."""
    found = []
    for folder in search_folders():
        found.append(Path(os.path.realpath(folder)))
        for manifest in folder.glob("share/*/package.xml"):
            if manifest.is_symlink():
                found.append(Path(os.path.realpath(manifest)).parent)
    return found
