# SPDX-License-Identifier: Apache-2.0
"""Contacts of a robot's collision shapes with the ground: planes of the file, or a horizontal plane of the world."""

import os
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field

from liegroup_core.errors import SceneError
from liegroup_core.fields import values
from liegroup_core.fields.values import Described, NotNegative, Number, Positive, Text

from .access import trees
from .apart import triangulated
from .description import WORLD, frame_keys, listed, place
from .names import scene_name
from .resources import readable_mesh

MOST_POINTS = 64  # of a hull in a scene
# {kind of a shape: keys of its sizes in a scene}; a mesh becomes a hull
SHAPES = {"box": ("size",), "sphere": ("radius",), "cylinder": ("radius", "length"), "capsule": ("radius", "length")}
FRICTION = 1.0  # of a shape without friction in its file: the default of SDF and MJCF


def _restitution(value):
    if not 0.01 <= value <= 1.0:
        raise ValueError("must be from 0.01 to 1")
    return value


class Ground(Described):
    """Ground that the collision shapes of a robot touch."""

    links: Annotated[tuple[Text, ...], BeforeValidator(values.listed)] = Field(
        (), description="links whose collision shapes touch it; default: all"
    )
    height: Number | None = Field(
        None, description="height of the ground in m, z of the world; default: the planes of an MJCF file, else 0"
    )
    friction: NotNegative | None = Field(
        None, description=f"coefficient of friction; default: that of each shape in the file, else {FRICTION:g}"
    )
    sinks: Positive = Field(1e-3, description="depth in m of a point of contact under `load`")
    load: Positive | None = Field(None, description="N; default: the weight of all bodies of the scene")
    restitution: Annotated[Number, AfterValidator(_restitution)] = Field(
        0.1, description="0.01 to 1, at an impact with 1 m/s"
    )


def add_contacts(robot, options, grouping, parts, body_of, taken):
    """Append a contact of each collision shape that moves, if the options have a ground. Returns notes."""
    ground, every = options.ground, [link.name for link in robot.links.values() for _ in link.collisions]
    if ground is None or ground.height is not None:
        for name, *_ in robot.planes:
            robot.leave_out("planes that touch: those of --ground if it has no height", name)
    if ground is None and every:
        return [f"changes the motion: no contact, bodies pass through each other: without effect {_counted(every)}"]
    if ground is None:
        return []
    touching = [link for link in robot.links.values() if grouping.of_link[link.name] is not grouping.world]
    touching = {link.name: link for link in touching if link.collisions}
    for name in ground.links:
        if name not in touching:
            raise options.unknown(("ground", "links"), "ground: moving link with a collision shape", name, touching)
    if not touching:
        text = "ground: no link that moves has a collision shape: give the file one, or omit the ground"
        raise options.error(("ground",), text)
    floors = robot.planes if ground.height is None else ()
    floors = floors or [("", place((0.0, 0.0, ground.height or 0.0)), 0.0)]
    links = [link for name, link in touching.items() if name in (ground.links or touching)]
    pairs = [(link, collision, collision.shape()) for link in links for collision in link.collisions]
    hulls, left, depths = _hulls(robot, pairs, ground.sinks), [], []
    for link, collision, visual in pairs:
        shape, what = _shape(visual, hulls)
        if shape is None:
            left.append(f"{what} of {link.name}")
            continue
        group = grouping.of_link[link.name]
        pose = group.places[link.name] @ visual.pose
        for _, floor, rubs in floors:
            depths.append((-_lowest(shape, np.linalg.solve(floor, group.pose @ pose)), link.name))
            friction = ground.friction
            if friction is None:  # that of MuJoCo; others have no planes
                friction = max(FRICTION if collision.friction is None else collision.friction(), rubs)
                if friction > values.MOST_FRICTION:
                    most = f"friction of contacts above {values.MOST_FRICTION:g}, taken as that"
                    robot.remark(most, f"{friction:.3g} of {link.name}")
                    friction = values.MOST_FRICTION
            entry = {"name": f"{scene_name(link.name)[:50]}_ground", "type": "contact", "body": body_of[id(group)]}
            entry |= {"shape": shape | frame_keys(pose), "sinks": ground.sinks, "restitution": ground.restitution}
            entry |= {"friction": friction} if friction else {}
            entry |= {"load": ground.load} if ground.load else {}
            plane = {"point": floor[:3, 3].tolist()} if floor[:3, 3].any() else {}
            plane |= {"normal": floor[:3, 2].tolist()} if floor[2, 2] != 1.0 else {}
            entry |= {"plane": plane} if plane else {}
            line = f"line {collision.line}" if collision.line else f"of the {robot.kind} file"
            parts.add("forces", entry, collision.line, line, taken)
    notes = ["changes the motion: only the ground is touched: bodies pass through each other"]
    if ground.height is None and robot.planes:
        notes.append(f"ground: {listed([name for name, *_ in robot.planes])}")
    others = [name for name in every if name in touching and ground.links and name not in ground.links]
    if others:
        notes.append(f"changes the motion: the ground does not touch {_counted(others)}")
    if left:
        notes.append(f"changes the motion: collision shapes that do not touch the ground: {listed(left)}")
    depth, name = max(depths, default=(0.0, ""))
    if depths and _may_be_placed(robot, options, grouping):
        for group, body in zip((each for each in grouping.groups if each is not grouping.world), parts.bodies):
            group.pose[2, 3] += depth
            body |= frame_keys(group.pose)
        root = next(link for link in grouping.of_link if link in robot.roots)
        group = grouping.of_link[root]
        height = (group.pose @ group.places[root])[2, 3]
        notes.append(f"starts on the ground: {name} touches it, the origin of the root link is at {height:.3g} m")
    return notes


def _may_be_placed(robot, options, grouping):
    """Whether nothing says at which height a robot starts: a URDF file has no pose of its root link."""
    ends = {grouping.of_link[end] is grouping.world for each in grouping.moving for end in (each.parent, each.child)}
    given = options.placed_links(robot) or options.roll or options.joints
    return robot.kind == "URDF" and not given and not any(ends) and grouping.world.links in ([], [WORLD])


def _shape(visual, hulls):
    """(keys of the shape of a contact without its frame, None), or (None, what it is)."""
    if visual is None:
        return None, "unknown shape"
    if visual.kind == "mesh":
        points, why = hulls[_key(visual)]
        return ({"type": "hull", "points": points}, None) if points else (None, f"{_called(visual)} ({why})")
    if visual.kind not in SHAPES:
        return None, visual.kind
    if min(visual.size) <= 0.0:
        return None, f"{visual.kind} without volume"
    sizes = (visual.size,) if visual.kind == "box" else visual.size
    return {"type": visual.kind} | dict(zip(SHAPES[visual.kind], sizes)), None


def _lowest(shape, pose):
    """Height of the lowest point of a shape at a pose (4, 4) in the world, m."""
    down, radius = pose[2, :3], shape.get("radius", 0.0)
    if shape["type"] == "hull":
        return pose[2, 3] + (np.array(shape["points"]) @ down).min()
    if shape["type"] == "box":
        return pose[2, 3] - 0.5 * np.abs(down) @ shape["size"]
    round_part = radius * np.hypot(*down[:2]) if shape["type"] == "cylinder" else radius
    return pose[2, 3] - 0.5 * shape.get("length", 0.0) * abs(down[2]) - round_part


def _key(visual):
    return visual.mesh, visual.asset, tuple(visual.size)


def _called(visual):
    return visual.mesh or f"mesh {visual.asset}"


def _hulls(robot, pairs, within):
    """{key of a mesh: (points (k, 3) of its hull, None) or (None, why it is not read)}; within: see hull_of."""
    order, folders, found, names = [], set(), {}, {}
    for link, _, visual in pairs:
        if visual is None or visual.kind != "mesh" or _key(visual) in found:
            continue
        key = _key(visual)
        names.setdefault(key, link.name)
        try:
            path = Path(robot.file).resolve() if visual.asset >= 0 else readable_mesh(visual.mesh, robot.file)
        except SceneError as error:
            found[key] = None, str(error)
            continue
        found[key] = None, "it does not exist"
        if path is not None:
            folders.update(trees(robot.file) if visual.asset >= 0 else [os.path.dirname(os.path.realpath(path))])
            order.append((key, list(visual.size), str(path), visual.asset))
    if not order:
        return found
    wanted = {"hulls": [rest for _, *rest in order], "most": MOST_POINTS, "within": within}
    try:
        hulls = triangulated(wanted, folders)["hulls"]
    except SceneError as error:
        return found | {key: (None, str(error).partition(": ")[2]) for key, *_ in order}
    for (key, _, path, _), hull in zip(order, hulls):
        found[key] = hull["points"], hull["failed"]
        if hull["points"]:
            text = f"{Path(key[0] or f'mesh {key[1]}').name} of {names[key]} by {len(hull['points'])} points"
            if hull["loss"] > 0.0:
                text += f", up to {hull['loss']:.2g} m inside of it"
            robot.remark("hulls of collision meshes", text)
    return found


def _counted(names):
    """Text with the number of collision shapes and their links."""
    links = list(dict.fromkeys(names))
    return f"{len(names)} collision shape{'s'[: len(names) != 1]} of {listed(links)}"
