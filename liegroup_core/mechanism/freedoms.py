# SPDX-License-Identifier: Apache-2.0
"""Degrees of freedom of the spanning tree of a scene, by name."""

from typing import NamedTuple

from liegroup_core.scene.consistency import resolve_frames

from .arrays import OWN
from .links import find_links
from .mechanism import tree_of

COMPONENTS = ("rx", "ry", "rz", "x", "y", "z")


class Freedom(NamedTuple):
    """A degree of freedom of the spanning tree.

    name : of its joint with one coordinate, else JOINT.COMPONENT or BODY.COMPONENT
    unit : "rad" or "m"; "" of a state of a law, which is its rate
    sign : of its coordinate when that of the joint increases
    is_of_joint : whether it is the coordinate of a joint
    """

    name: str
    unit: str
    sign: float
    is_of_joint: bool = False


def freedoms_of(scene, normal):
    """[Freedom] of the spanning tree, in the order of all arrays.

    scene  : Scene with body frames at the centres of mass
    normal : of the plane of a planar mechanism, else None
    Components of other joints are a rotation vector rx, ry, rz and a shift x, y, z in the frame of the link.
    """
    links, _ = find_links(scene, resolve_frames(scene), tree_of(scene), normal)
    found = []
    for link in links:
        if link.state:
            found.append(Freedom(link.state, "", 1.0))
            continue
        if link.joint is None:
            name = next(iter(link.bodies))
        else:
            name = scene.joints[link.joint].name
        if link.coordinates != OWN:
            found.append(Freedom(f"{name}.{'12'[sum(f.name.startswith(name + '.') for f in found)]}", "rad", 1.0))
            continue
        one = link.joint is not None and len(link.components) == 1
        for component in link.components:
            label = name if one else f"{name}.{COMPONENTS[component]}"
            found.append(Freedom(label, "rad" if component < 3 else "m", link.sign if one else 1.0, one))
    return found
