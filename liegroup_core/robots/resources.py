# SPDX-License-Identifier: Apache-2.0
"""Files of package:// and model:// addresses. Only local folders are searched."""

import os
import re
from contextlib import suppress
from pathlib import Path

from liegroup_core.errors import SceneError
from liegroup_core.fields.arguments import got

from .access import MODEL_PATHS, holds_home, permit, search_folders
from .description import FORBIDDEN_MESHES, MISSING_MESHES
from .xml import read_xml

MARKS = ("package.xml", "model.config")  # one of them is in the folder of a package or model
_NAME = re.compile(r"<name>\s*([^<\s]+)\s*</name>")  # in a package.xml; reading a workspace takes 20 us a package
LONGEST_HEAD = 2**16  # characters of a package.xml with its name
LARGEST_MESH = 64 * 2**20  # bytes of a mesh file
LATEST_SDF = (1, 12)  # latest version that the import supports


def resolve(name_or_path):
    """Path of a file from a path, a package://, model:// or file:// address.

    Raises SceneError if a package or model is not found, and for other addresses, such as http://.
    """
    if not isinstance(name_or_path, (str, os.PathLike)):
        raise SceneError(f"expected the path or the name of a scene, {got(name_or_path)}")
    text = os.fspath(name_or_path)
    for scheme, find in (("package://", _package), ("model://", _model)):
        if text.startswith(scheme):
            name, _, rest = text.removeprefix(scheme).partition("/")
            found = None if _leaves(name, rest) else find(name, rest)
            if found is None:
                raise SceneError(f"{text}: {_missing(scheme, name)}")
            return found
    scheme, separator, _ = text.partition("://")
    if separator and scheme.isalnum() and scheme != "file":
        raise SceneError(f"{text}: nothing is fetched from a network: download the file and give its path")
    return Path(text.removeprefix("file://"))


def find_resource(address, file):
    """Path of a mesh or other file that a robot file refers to, or None if it does not exist."""
    if "://" in address and not address.startswith(("package://", "model://", "file://")):
        return None
    try:
        path = resolve(address)
    except SceneError:
        # The package that contains the robot file need not be in a search path.
        path = _above(address.partition("://")[2], file)
        if path is None:
            return None
    path = path if path.is_absolute() else Path(file).resolve().parent / path
    return path if path.is_file() else None


def readable_resource(address, file):
    """As `find_resource`. Raises SceneError if the file may not refer to it, see access.py."""
    path = find_resource(address, file)
    if path is None:
        return None
    named = address.startswith(("package://", "model://"))
    return permit(path, path if named else file)


def readable_mesh(address, file):
    """As `readable_resource`. Raises SceneError also if the file is larger than LARGEST_MESH."""
    path = readable_resource(address, file)
    if path is not None and os.path.getsize(path) > LARGEST_MESH:
        raise SceneError(f"it is larger than {LARGEST_MESH >> 20} MiB")
    return path


def note_mesh(robot, address, link):
    """Note a mesh file of a link that does not exist, or that the robot file may not refer to."""
    try:
        what = MISSING_MESHES if readable_resource(address, robot.file) is None else None
    except SceneError:
        what = FORBIDDEN_MESHES
    if what:
        robot.leave_out(what, f"{address} of {link}")


def beside(source, name):
    """Path of a file that another file refers to; relative to the folder of `source`."""
    path = resolve(name)
    return permit(path if path.is_absolute() else Path(source).parent / path)


def _leaves(name, rest):
    """True if an address leads out of its package or model."""
    return name in ("", ".", "..") or rest.startswith("/") or ".." in Path(rest).parts


def _above(rest, file):
    """File of a package:// address whose package is a folder above the robot file, or beside one."""
    package, _, inner = rest.lstrip("/").partition("/")  # some files have package:///NAME
    if _leaves(package, inner):
        return None
    for folder in Path(file).resolve().parents:
        if holds_home(folder):
            break
        if folder.name == package and (folder / inner).is_file():
            return folder / inner
        beside = folder / package
        if (beside / inner).is_file() and any((beside / mark).is_file() for mark in MARKS):
            return beside / inner
    found = packages_around(file).get(package)
    return found / inner if found and (found / inner).is_file() else None


def find_package(name, file, around):
    """Folder of a package in the search paths, around a file (packages_around) or above it. Raises SceneError."""
    above = (folder for folder in Path(file).resolve().parents if folder.name == name and not holds_home(folder))
    found = None if _leaves(name, "") else _package(name, "") or around.get(name) or next(above, None)
    if found is None:
        raise SceneError(f"{_missing('package://', name)}, or put it beside the package of this file")
    return found


def packages_around(file):
    """{name: folder} of packages with a package.xml: those above a file, and those beside one of them."""
    found = {}
    for folder in Path(file).resolve().parents:
        if holds_home(folder):
            break
        manifests = [folder / MARKS[0]]
        if manifests[0].is_file() and not holds_home(folder.parent):
            manifests += sorted(folder.parent.glob(f"*/{MARKS[0]}"))
        for manifest in filter(Path.is_file, manifests):
            with suppress(OSError), manifest.open(encoding="utf-8", errors="replace") as text:
                for name in _NAME.findall(text.read(LONGEST_HEAD))[:1]:
                    found.setdefault(name, manifest.parent)
            found.setdefault(manifest.parent.name, manifest.parent)
    return found


def _package(name, rest):
    for prefix in search_folders(("AMENT_PREFIX_PATH",)):
        if (prefix / "share" / name).is_dir():
            return prefix / "share" / name / rest
    for folder in search_folders(("ROS_PACKAGE_PATH",)):
        for path in (folder, folder / name):
            if path.name == name and path.is_dir():
                return path / rest
    return None


def _model(name, rest):
    for folder in search_folders(MODEL_PATHS):
        if (folder / name).is_dir():
            return folder / name / rest if rest else model_file(folder / name)
    return None


def model_file(folder):
    """File of a model in a folder: the latest supported version in model.config, or model.sdf."""
    config, found = folder / "model.config", []
    if config.is_file():
        for entry in read_xml(config).iter("sdf"):
            version = entry.get("version", "0").split(".")
            if entry.text and all(part.isdigit() for part in version):
                found.append((tuple(map(int, version)), entry.text.strip()))
    known = [entry for entry in found if entry[0] <= LATEST_SDF] or found
    return folder / (max(known)[1] if known else "model.sdf")


def _missing(scheme, name):
    variables = "AMENT_PREFIX_PATH" if scheme == "package://" else " or ".join(MODEL_PATHS[:1])
    kind = "package" if scheme == "package://" else "model"
    return f"the {kind} {name!r:.60} is not found: source its workspace, or set {variables}"
