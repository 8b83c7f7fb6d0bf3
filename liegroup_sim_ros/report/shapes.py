# SPDX-License-Identifier: Apache-2.0
"""Visuals of a robot file as triangles for the 3D view, with a limit on their number.

This needs trimesh, and for Collada and decimation the other packages of the extra `meshes`. Without them,
and for missing mesh files, the view draws boxes that have the bodies' inertias. Mesh files are read in a
separate process, robots/apart.py.
"""

import base64
import os
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from liegroup_core.errors import SceneError
from liegroup_core.forces.contact import ROUND, drawn_by_contacts, faces, outline
from liegroup_core.robots.access import trees
from liegroup_core.robots.apart import triangulated
from liegroup_core.robots.options import BASES, Options
from liegroup_core.robots.read import is_robot_file
from liegroup_core.robots.resources import readable_mesh
from liegroup_core.scene.load import find_scene, scene_of
from liegroup_core.scene.robot_file import options_from
from liegroup_sim_ros.numbers import counted

MOST_TRIANGLES = 20_000  # in a page
HINT = "pip install 'liegroup_sim_ros[meshes]'"


def robot_shapes(robot, most=MOST_TRIANGLES):
    """({body or world: [shape]}, [remark]) for the visuals of a robot; robot : RobotNames of a scene.

    most    : largest number of triangles
    shape   : see liegroup_core.robots.meshes; None for a body for which the file has no visual, if others have one
    remarks : one line each on visuals that are not drawn
    """
    if find_spec("trimesh") is None:
        return {}, [f"visuals are drawn as boxes, because trimesh is not installed: {HINT}"]
    shapes, folders, missing, failed, names = [], set(), [], {}, {}
    visible = [each for each in robot.drawn() if each[2].color is None or each[2].color[3] > 0.0]
    for body, pose, visual in visible:
        path = ""
        if visual.asset >= 0:
            path = str(Path(robot.file).resolve())
            folders.update(trees(robot.file))
        elif visual.kind == "mesh":
            try:
                path = readable_mesh(visual.mesh, robot.file)
            except SceneError as error:
                failed[visual.mesh] = str(error)
                continue
            if path is None:
                missing.append(visual.mesh)
                continue
            folders.add(os.path.dirname(os.path.realpath(path)))
        names[str(path)] = visual.mesh or path
        size = list(map(float, visual.size))
        shapes.append((body, visual.kind, size, pose.tolist(), str(path), visual.color, visual.asset))
    try:
        found = triangulated({"shapes": shapes, "most": most}, folders)
    except SceneError as error:
        return {}, [f"visuals are drawn as boxes: {str(error).partition(': ')[2]}"]
    failed |= {names[path]: text for path, text in found["failed"].items()}
    if found["shapes"]:
        seen = {body for body, *_ in visible}
        found["shapes"] |= {body: None for body, _ in robot.frames.values() if body not in seen}
    return found["shapes"], list(_remarks(found, missing, failed, most))


def shapes_from(file, scene, mapped=None, most=MOST_TRIANGLES):
    """`robot_shapes` of a robot file for a scene that was made of it. Raises SceneError if their bodies differ.

    mapped : Options.mapped of the run; None: unknown, so that the root link is fixed or floats as in the scene
    """
    if not is_robot_file(find_scene(file)):
        ways = [None]
    elif isinstance(mapped, dict):
        ways = [options_from(mapped)]
    else:
        ways = [Options(base=base) for base in (None, *BASES)]
    names = {body.name for body in scene.bodies}
    for options in ways:
        robot = scene_of(file, options)
        if robot.robot is None:
            raise SceneError(f"--robot {file}: is not a robot file: give a URDF, SDF or MJCF file")
        own = {body.name for body in robot.bodies}
        if own == names:
            return robot_shapes(robot.robot, most)
    raise SceneError(
        f"--robot {file}: its bodies differ from those of the recording, for example in {min(names ^ own)}: give "
        "the file that was simulated, or the scene file that refers to it and has its options"
    )


def with_contacts(shapes, scene):
    """{body or world: [shape]} of `robot_shapes`, and of bodies that have none there those of their contacts."""
    found = {name: own for name, own in drawn_by_contacts(scene).items() if not shapes.get(name)}
    return shapes | {name: [_convex(shape) for shape in own] for name, own in found.items()}


def _convex(shape):
    """Shape as of `robot_shapes` of the shape of a contact."""
    points = outline(shape)
    corners = faces(points)
    if shape.type not in ROUND:  # corners of their own let the page draw sharp edges
        points, corners = points[corners].reshape(-1, 3), np.arange(corners.size).reshape(-1, 3)
    low, high = points.min(axis=0), points.max(axis=0)
    return {
        "points": base64.b64encode(points.astype("<f4").tobytes()).decode(),
        "faces": base64.b64encode(corners.astype("<i4").tobytes()).decode(),
        "at": (0.5 * (low + high)).tolist(),
        "size": (high - low).tolist(),
        "color": None,
    }


def box_of(shapes):
    """(centre (3,), edges (3,)) of the bounding box of shapes in the body's frame, m."""
    at, half = (np.array([shape[key] for shape in shapes]) for key in ("at", "size"))
    low, high = (at - 0.5 * half).min(axis=0), (at + 0.5 * half).max(axis=0)
    return 0.5 * (low + high), high - low


def decoded(shape):
    """Points (k, 3) in m, in the body's frame, and faces (m, 3) of a shape."""
    points, faces = (base64.b64decode(shape[key]) for key in ("points", "faces"))
    return np.frombuffer(points, "<f4").reshape(-1, 3), np.frombuffer(faces, "<i4").reshape(-1, 3)


def _remarks(found, missing, failed, most):
    if missing:
        yield f"missing mesh files: {len(missing)}, the first is {missing[0]}"
    if failed:
        name, text = next(iter(failed.items()))
        yield f"unreadable mesh files: {len(failed)}, the first is {name}: {text}"
    if found["boxes"]:
        advice = f"; {HINT} decimates them" if found["lacks"] else ""
        yield (
            f"drawn as their convex hulls or boxes: {counted(found['boxes'], 'body')}, because all visuals have "
            f"{found['triangles']} triangles and the page at most {most}{advice}"
        )
