# SPDX-License-Identifier: Apache-2.0
"""Worlds of simulation_interfaces: scene files and robots."""

import os
import re
from pathlib import Path
from urllib.parse import unquote, urlparse

import yaml

from liegroup_core import SceneError, load_scene
from liegroup_core.errors import MissingFileError
from liegroup_core.robots.read import is_robot_file
from liegroup_core.scene.load import example_scenes, find_scene, scene_from_text

from .standard_codes import (
    FAILED,
    MISSING_ASSETS,
    NO_RESOURCE,
    NOT_FOUND,
    NOT_SUPPORTED,
    PARSE_ERROR,
    UNSUPPORTED_ELEMENTS,
    UNSUPPORTED_FORMAT,
    Refused,
    answering,
)

SCHEMES = ("", "file", "package", "model")
MOST_WORLDS = 10_000  # of a folder
DESCRIPTION = re.compile(
    r"^description:.*(?:\n(?:[ \t].*)?$)*", re.MULTILINE
)  # with what is indented


class Worlds:
    """Callbacks of the services about worlds.

    node  : SimNode
    world : class of the message WorldResource
    """

    def __init__(self, node, world):
        self._node, self._world = node, world

    @answering
    def load_world(self, request, response):
        """Load a scene and stop at step 0; if it cannot be loaded, the previous scene continues."""
        # Versions before 2.1 have the two fields in the request itself.
        resource = getattr(request, "world_resource", request)
        uri, text = resource.uri, resource.resource_string
        if not (uri or text):
            raise Refused(NO_RESOURCE, "uri and resource_string are both empty")
        path = _path(uri) if uri else ""
        scene = _scene(path, text)
        missing = scene.robot.missing if scene.robot else ()
        if missing and not request.ignore_missing_or_unsupported_assets:
            raise Refused(
                MISSING_ASSETS,
                f"{scene.source}: mesh files that are not there: {', '.join(missing)}; add them, or set "
                "ignore_missing_or_unsupported_assets",
            )
        if request.fail_on_unsupported_element and scene.differences:
            raise Refused(UNSUPPORTED_ELEMENTS, "; ".join(scene.differences))
        done, answer = self._node.load(scene, paused=True)
        if not done:
            raise Refused(FAILED, answer)
        if uri:
            self._node.set_scene(path)
        response.world = self._described(scene)
        return answer

    @answering
    def get_current_world(self, _, response):
        """The scene that is simulated."""
        response.world = self._described(self._node.scene_run.simulation.scene)

    @answering
    def get_available_worlds(self, request, response):
        """Example scenes, and the scene files and robots of further files and folders."""
        if len(request.filter.tags):
            raise Refused(NOT_SUPPORTED, "worlds have no tags: leave the filter empty")
        found = list(example_scenes().values())
        for source in request.additional_sources:
            try:
                found += _worlds_of(source)
            except Refused:
                if not request.continue_on_error:
                    raise
        response.worlds = [self._entry(path.stem, str(path)) for path in found]
        for world, path in zip(response.worlds, found):
            world.description = _description(path)

    def _entry(self, name, uri, text=""):
        world = self._world()
        world.name, world.world_resource.uri = name, uri
        world.world_resource.resource_string = text
        return world

    def _described(self, scene):
        is_file = os.path.isfile(scene.source)
        world = self._entry(
            scene.name, scene.source if is_file else "", "" if is_file else scene.text
        )
        world.description = scene.description.strip()
        return world


def _description(path):
    """Description of a scene file, without loading the scene; "" of a robot's file."""
    try:
        text = path.read_text(encoding="utf-8") if path.suffix in (".yaml", ".yml") else ""
        entry = DESCRIPTION.search(text)
        found = yaml.safe_load(entry.group())["description"] if entry else None
    except (OSError, ValueError, yaml.YAMLError):
        return ""
    return found.strip() if isinstance(found, str) else ""


def _path(uri):
    """Path or name in a uri; package:// and model:// stay for the reader of scenes."""
    parts = urlparse(uri)
    if parts.scheme not in SCHEMES:
        raise Refused(
            UNSUPPORTED_FORMAT,
            f"{uri}: cannot be read; give a path, the name of an example scene, or a file://, "
            "package:// or model:// address",
        )
    return unquote(parts.path) if parts.scheme == "file" else uri


def _scene(path, text):
    """Scene of a path, or without one of a text."""
    if not path:
        if text.lstrip().startswith("<"):
            raise Refused(
                UNSUPPORTED_FORMAT,
                "resource_string is XML: give a scene (YAML), or a robot's file by its uri",
            )
        try:
            return scene_from_text(text, "resource_string")
        except SceneError as error:
            raise Refused(PARSE_ERROR, str(error)) from None
    try:
        file = find_scene(path)
    except SceneError as error:
        raise Refused(NOT_FOUND, str(error)) from None
    if not _is_scene(file):
        raise Refused(
            UNSUPPORTED_FORMAT, f"{path}: is no scene file (.yaml) and no robot (URDF, SDF, MJCF)"
        )
    try:
        return load_scene(path)
    except MissingFileError as error:
        raise Refused(MISSING_ASSETS, str(error)) from None
    except SceneError as error:
        raise Refused(PARSE_ERROR, str(error)) from None


def _is_scene(path):
    return path.is_file() and (path.suffix in (".yaml", ".yml") or is_robot_file(path))


def _worlds_of(source):
    """Files of a path or file:// address that can be loaded; of a folder those directly in it."""
    path = Path(_path(source))
    if not path.exists():
        raise Refused(NOT_FOUND, f"{source}: no such file or folder")
    try:
        files = sorted(path.iterdir())[:MOST_WORLDS] if path.is_dir() else [path]
        return [file for file in files if _is_scene(file)]
    except OSError as error:
        raise Refused(FAILED, f"{source}: cannot be read: {error.strerror}") from None
