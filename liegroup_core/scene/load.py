# SPDX-License-Identifier: Apache-2.0
"""Scene files: find, read and check them; every error is one line with file and line number.

    config/x.yaml:12: bodies[0] "top": mass must be greater than 0, got -1

A robot file (URDF, SDF, MJCF, or YAML with the key robot) is first converted to the text of a scene.
"""

import math
import os
import sys
from pathlib import Path

from liegroup_core.errors import SceneError
from liegroup_core.fields.values import shown, suggestion
from liegroup_core.forces.contact import note_of_starts
from liegroup_core.robots.access import anywhere, permit
from liegroup_core.robots.read import is_robot_file
from liegroup_core.robots.resources import resolve

from .assembly import assembled
from .consistency import check_consistency
from .description import Scene
from .robot_file import robot_beside, robot_text
from .yaml_text import Lines, read_yaml

SHARE = Path("share", "liegroup_sim_ros", "config", "scenes")

# A scene file has about 200 bytes a body; this is far above the largest one that can be simulated.
LARGEST_FILE = 64 * 2**20  # bytes


def load_scene(name_or_path: str | os.PathLike[str], *, allow_files: bool = False) -> Scene:
    """Read a scene from a file, given by its path or, for an example scene, by its name.

    The file is a scene file or a robot file (URDF, xacro, SDF or MJCF). Paths may begin with
    package:// or model://.

    allow_files : robot files may refer to files outside of their trees, see liegroup_core.robots.access
    """
    with anywhere(allow_files):
        return scene_of(name_or_path)


def scene_of(name_or_path, options=None):
    """As `load_scene`, with additions to a robot file: robots.options.Options, or None."""
    path = find_scene(name_or_path)
    permit(path)
    try:
        if not os.path.isfile(path):
            raise SceneError(f"{path}: is not a file: give the path of a scene file (.yaml)")
        if is_robot_file(path):
            return scene_from_robot(path, options)
        if options is not None:
            raise SceneError(
                f"{path}: is a scene file: these options are for robot files; change the bodies, "
                "joints and forces in the scene itself"
            )
        if os.path.getsize(path) > LARGEST_FILE:
            raise SceneError(f"{path}: is larger than {LARGEST_FILE >> 20} MiB: give the path of a scene file (.yaml)")
        content = path.read_bytes()
    except OSError as error:
        raise SceneError(f"{path}: cannot be read: {error.strerror}") from None
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise SceneError(f"{path}:{line}: is not UTF-8 text: give a scene file (.yaml), saved as UTF-8") from None
    return _read(text, str(path), True, may_name_files=True)


def scene_from_robot(path, options=None):
    """Scene of a robot file; options: robots.options.Options or None."""
    return _made(*robot_text(path, options), source=str(path), complete=True)


def scene_from_text(text: str, source: str = "scene") -> Scene:
    """Scene of a YAML text, such as that of a recording; assembled if it has `assemble: true`.

    Only a scene file on this machine may refer to other files. A text may not.

    source : path or name at the start of error messages; becomes scene.source
    """
    return _read(text, source, True)


def scene_as_written(text, source="scene"):
    """Scene of a YAML text before assembly: the given numbers; joints may be violated."""
    return _read(text, source, False)


def _read(text, source, complete, may_name_files=False):
    root = read_yaml(text, source)
    if not isinstance(root.value, dict):
        raise SceneError(
            f"{source}:{root.line}: a scene must be a mapping with the keys "
            f"{', '.join(Scene.model_fields)}, got {shown(root.value)}"
        )
    if "robot" in root.value:
        if not may_name_files:
            raise SceneError(
                f"{source}:{root.parts['robot'].line}: a scene given as text cannot refer to a robot file: "
                "give the scene that liegroup_sim import writes for this robot"
            )
        return _made(*robot_beside(root, source), source, complete)
    return _made(text, root.value, Lines(source, root), None, source, complete)


def _made(text, values, where, robot, source, complete):
    """Scene of a text with these values; where: Lines, or an object with its methods."""
    try:
        scene = Scene(**values)
        doubts = list(_doubtful_angles(scene, robot is not None)) if complete else []
        scene = assembled(scene) if complete else scene
        doubts += note_of_starts(scene) if complete else []
        scene = scene.remade(notes=[*scene.notes, *doubts]) if doubts else scene
        scene._text, scene._source, scene._where, scene._robot = text, source, where, robot
        if complete:
            check_consistency(scene)
    except SceneError as error:
        raise where.located(error) from None
    return scene


def _doubtful_angles(scene, of_robot):
    """Notes on angles of joints that look like degrees: more than two turns, and at most 360."""
    followers = {coupling.joint for coupling in scene.couplings}
    for joint in scene.joints:
        if joint.type != "revolute":
            continue
        values = {"coordinate": getattr(joint, "coordinate", None)}
        for end in ("lower", "upper"):
            value, own = getattr(joint.limits, end, None), (joint.data or {}).get(end)
            if of_robot and value != own:  # the limits of a follower act on its leader, in other numbers
                value = own if joint.name in followers else None
            values[f"{end} limit"] = value
        for what, value in values.items():
            if value is not None and 4.0 * math.pi < abs(value) <= 360.0:
                turns = abs(value) / (2.0 * math.pi)
                yield (
                    f"{what} of joint {joint.name}: {value:g} rad are {turns:.3g} turns; if these are degrees, write "
                    f"{math.radians(value):.6g}"
                )


def find_scene(name_or_path: str | os.PathLike[str]) -> Path:
    """Path of a scene file: an existing file, else an example scene of that name."""
    given = resolve(name_or_path)
    if os.path.isfile(given):
        return given
    known = example_scenes()
    name = str(given).removesuffix(".yaml")
    if name in known:
        return known[name]
    if os.path.exists(given):
        return given
    hint = suggestion(name, sorted(known)) if known else "give the path of a scene file (.yaml)"
    raise SceneError(f"{given}: is neither a file nor a known scene; {hint}")


def example_scenes() -> dict[str, Path]:
    """{name: path} of the example scenes."""
    return {path.stem: path for folder in reversed(_folders()) for path in sorted(folder.glob("*.yaml"))}


def _folders():
    """Folders with example scenes, the nearest to this file first."""
    here = Path(__file__).resolve()
    prefixes = [*here.parents, *os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
    folders = [here.parents[2] / "config" / "scenes"]
    folders += [Path(prefix) / SHARE for prefix in prefixes if prefix]
    return [folder for folder in folders if folder.is_dir()]
