# SPDX-License-Identifier: Apache-2.0
"""Worlds of simulation_interfaces: scene files and robots in the folders that the node serves."""

import os
import re
from pathlib import Path
from urllib.parse import unquote

from liegroup_core import SceneError, load_scene
from liegroup_core.errors import MissingFileError
from liegroup_core.robots.access import is_permitted, permit, served_from
from liegroup_core.robots.read import is_robot_file
from liegroup_core.robots.resources import resolve
from liegroup_core.scene.load import example_scenes, find_scene, scene_from_text
from liegroup_core.scene.yaml_text import read_yaml

from .answers import begin, filled
from .standard_codes import (
    FAILED,
    MISSING_ASSETS,
    NO_RESOURCE,
    NOT_FOUND,
    NOT_SUPPORTED,
    OK,
    PARSE_ERROR,
    UNSUPPORTED_ELEMENTS,
    UNSUPPORTED_FORMAT,
    Refused,
)

SCHEMES = ("", "file", "package", "model")
MOST_BODIES = 200  # of a scene that a request loads
MOST_WORLDS, MOST_SOURCES = 1000, 100  # of a request, or of a folder
HEAD = 64 * 2**10  # bytes at the start of a scene file in which its description is searched
DESCRIPTION = re.compile(r"^description:.*(?:\n(?:[ \t].*)?$)*", re.MULTILINE)  # with its indented lines


class Worlds:
    """Callbacks of the services about worlds.

    node  : SimNode
    world : class of the message WorldResource
    """

    def __init__(self, node, world):
        self._node, self._world = node, world
        self._is_looking = False

    async def load_world(self, request, response):
        """Load a scene and stop at step 0; if it cannot be loaded, the previous scene continues."""
        # Versions before 2.1 have the two fields in the request itself.
        resource = getattr(request, "world_resource", request)
        uri, text = resource.uri, resource.resource_string
        if not (uri or text):
            raise Refused(NO_RESOURCE, "uri and resource_string are both empty")
        path = _path(uri) if uri else ""

        def make():
            scene = _scene(path, text)
            if len(scene.bodies) > MOST_BODIES:
                raise Refused(
                    FAILED,
                    f"{scene.source} has {len(scene.bodies)} bodies; a request loads at most "
                    f"{MOST_BODIES}, because creating the topics blocks the node: start a node with this scene",
                )
            _refuse_assets(scene, request)
            return scene

        scene, answer = await self._node.load(make, paused=True)
        if uri:
            self._node.set_scene(path)
        response.world = self._described(scene)
        return filled(response, OK, answer)

    def get_current_world(self, _, response):
        """Return the simulated scene."""
        response.world = self._described(self._node.scene_run.simulation.scene)
        return filled(response, OK, "")

    async def get_available_worlds(self, request, response):
        """Return the example scenes, and scenes and robots in additional files and folders."""
        if len(request.filter.tags):
            raise Refused(NOT_SUPPORTED, "worlds have no tags: leave the filter empty")
        sources = list(dict.fromkeys(request.additional_sources))
        if len(sources) > MOST_SOURCES:
            raise Refused(FAILED, f"{len(sources)} sources: give at most {MOST_SOURCES}")
        if self._is_looking:
            raise Refused(FAILED, "another request is searching for worlds: try again later")
        self._is_looking = True
        try:
            found = await self._look(sources, request.continue_on_error)
        finally:
            self._is_looking = False
        response.worlds = [self._entry(path.stem, str(path)) for path, _ in found]
        for world, (_, description) in zip(response.worlds, found):
            world.description = description
        return filled(response, OK, "")

    async def _look(self, sources, skips):
        return await self._node.wait(begin(_available, sources, self._node.folders, skips))

    def _entry(self, name, uri, text=""):
        world = self._world()
        world.name, world.world_resource.uri = name, uri
        world.world_resource.resource_string = text
        return world

    def _described(self, scene):
        is_file = os.path.isfile(scene.source)
        world = self._entry(scene.name, scene.source if is_file else "", "" if is_file else scene.text)
        world.description = scene.description.strip()
        return world


def _refuse_assets(scene, request):
    """Raise Refused for missing meshes and unsupported elements, if the LoadWorld request says so."""
    missing = scene.robot.missing if scene.robot else ()
    if missing and not request.ignore_missing_or_unsupported_assets:
        raise Refused(
            MISSING_ASSETS,
            f"{scene.source}: missing mesh files: {', '.join(missing)}; add them, or set "
            "ignore_missing_or_unsupported_assets",
        )
    if request.fail_on_unsupported_element and scene.differences:
        raise Refused(UNSUPPORTED_ELEMENTS, "; ".join(scene.differences))


def _available(sources, folders, skips):
    """[(path, description)] of the example scenes and of the worlds in the sources.

    folders : sources may be read from these folders and their subfolders; skips : skip unreadable sources
    """
    found = list(example_scenes().values())
    with served_from(folders):
        for source in sources:
            try:
                found += _worlds_of(source)
            except Refused:
                if not skips:
                    raise
            if len(found) > MOST_WORLDS:
                raise Refused(FAILED, f"more than {MOST_WORLDS} worlds: give fewer folders")
    return [(path, _description(path)) for path in found]


def _description(path):
    """Description of a scene file, without loading the scene; "" of a robot's file."""
    try:
        if path.suffix not in (".yaml", ".yml"):
            return ""
        with path.open("rb") as file:
            entry = DESCRIPTION.search(file.read(HEAD).decode(errors="replace"))
        found = read_yaml(entry.group(), "description").value["description"] if entry else None
    except (OSError, SceneError):
        return ""
    return found.strip() if isinstance(found, str) else ""


def _path(uri):
    """Path or name in a URI; package:// and model:// remain, the scene reader resolves them."""
    scheme, separator, rest = uri.partition("://")
    if not separator:
        return uri
    if scheme not in SCHEMES:
        raise Refused(
            UNSUPPORTED_FORMAT,
            f"{uri:.200}: cannot be read; give a path, the name of an example scene, or a file://, "
            "package:// or model:// address",
        )
    return unquote("/" + rest.partition("/")[2]) if scheme == "file" else uri


def _scene(path, text):
    """Scene from a file, or from a text if `path` is empty."""
    if not path:
        if text.lstrip().startswith("<"):
            raise Refused(UNSUPPORTED_FORMAT, "resource_string is XML: give a scene (YAML), or the uri of a robot file")
        try:
            return scene_from_text(text, "resource_string")
        except SceneError as error:
            raise Refused(PARSE_ERROR, str(error)) from None
    try:
        file = permit(find_scene(path))
    except SceneError as error:
        raise Refused(NOT_FOUND, str(error)) from None
    if not _is_scene(file):
        raise Refused(UNSUPPORTED_FORMAT, f"{path}: is neither a scene file (.yaml) nor a robot (URDF, SDF, MJCF)")
    try:
        return load_scene(path)
    except MissingFileError as error:
        raise Refused(MISSING_ASSETS, str(error)) from None
    except SceneError as error:
        raise Refused(PARSE_ERROR, str(error)) from None


def _is_scene(path):
    return path.is_file() and (path.suffix in (".yaml", ".yml") or is_robot_file(path))


def _worlds_of(source):
    """Loadable files at a path or file:// address; for a folder, those directly in it."""
    try:
        path = permit(Path(resolve(_path(source))))
    except SceneError as error:
        raise Refused(NOT_FOUND, str(error)) from None
    if not os.path.exists(path):
        raise Refused(NOT_FOUND, f"{source}: no such file or folder")
    try:
        files = sorted(path.iterdir())[:MOST_WORLDS] if path.is_dir() else [path]
        return [file for file in files if is_permitted(file) and _is_scene(file)]
    except OSError as error:
        raise Refused(FAILED, f"{source}: cannot be read: {error.strerror}") from None
