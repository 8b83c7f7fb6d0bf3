# SPDX-License-Identifier: Apache-2.0
"""Freedoms of a tree that move no inertia.

In relative coordinates every degree of freedom needs inertia, D = s . U > 0 (trees.py): the mass matrix of the tree
must be regular. It is singular if a motion of the tree leaves all centres of mass at rest and rotates bodies
only about axes without inertia. Whether there is such a motion depends on geometry alone, not on the size of
masses and moments of inertia that are not zero. Such motions are the null space of

    [ v_c / l ]   velocities of the centres of mass; l a length
    [ a . w   ]   rotations about the principal axes a with inertia, of all bodies

per unit of the freedoms.
"""

import numpy as np

from liegroup_core.errors import SceneError
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.groups import SE3
from liegroup_core.scene.massless import axes_without_inertia, written

from .links import in_general_position, path_to_world

# Sine of the angle between a degree of freedom and those that move no inertia (for a point mass on a hinge: that
# between the axis and the line to the mass). D is a difference of moments of inertia, and its ratio to them is the
# square of the sine: below 1e-14 no digit of D is correct. Round-off of a pose gives a sine of 1e-15.
SMALLEST_SINE = 1e-7


def check_inertia(scene, links, places, world):
    """Raise SceneError for a degree of freedom of the tree without inertia, at the start.

    scene  : Scene with body frames at the centres of mass
    links  : list of links.TreeLink; places : {body or world: (link or WORLD, pose (4, 4) in it)}
    world  : {link: pose (4, 4) in the world}
    """
    found = _free_turns(scene, links, places, world)
    if found is None:
        return
    # At poses in general position it may have inertia, for example a rod on a universal joint.
    always = _free_turns(scene, links, places, in_general_position(links, np.random.default_rng(3))) is not None
    raise _refusal(scene, links, places, world, *found, always)


def _free_turns(scene, links, places, world):
    """(link, its angular velocities (k, 3) in world axes) of motions that move no inertia, or None.

    The link is the innermost of those that move. Arguments as for `check_inertia`.
    """
    if not links:  # all bodies are welded to the world
        return None
    columns = [SE3.Ad(world[i]) @ link.directions() for i, link in enumerate(links)]
    owner = np.repeat(np.arange(len(links)), [S.shape[1] for S in columns])
    origins = np.array([world[i][:3, 3] for i in owner])
    S = np.concatenate(columns, axis=1)
    shifts, turns, arms = [], [], []
    for body in scene.bodies:
        i, place = places[body.name]
        if i == WORLD:
            continue
        C = world[i] @ place
        moves = np.isin(owner, path_to_world(links, i))
        shifts.append((S[3:] + np.cross(S[:3].T, C[:3, 3]).T) * moves)
        turns.append(_axes_with_inertia(body) @ C[:3, :3].T @ S[:3] * moves)
        arms.append(np.linalg.norm(C[:3, 3] - origins, axis=1) * moves)
    # The arms of a degree of freedom are compared with the part of the tree that it moves: a small finger of a
    # large machine is not singular.
    arms = np.max(arms, axis=0)
    length = arms.max() or 1.0
    arms[~S[:3].any(axis=0) | (arms == 0.0)] = 1.0
    shifts, turns = np.concatenate(shifts), np.concatenate(turns)
    size = np.linalg.norm(np.concatenate([shifts / arms, turns]), axis=0)
    rows = np.concatenate([shifts / length, turns])
    rows[:, size <= SMALLEST_SINE] = 0.0
    norms = np.linalg.norm(rows, axis=0)
    norms[norms == 0.0] = 1.0
    _, values, motions = np.linalg.svd(rows / norms)
    values = np.concatenate([values, np.zeros(len(motions) - len(values))])
    motions = motions[values <= SMALLEST_SINE] / norms
    motions /= np.linalg.norm(motions, axis=1, keepdims=True)
    for i, link in enumerate(links):
        if not np.abs(motions[:, owner == i]).max(initial=0.0) > 1e-6:
            continue
        # The massless link of a universal joint: the body is beyond its second hinge.
        body = i if link.bodies else i + 1
        moves = (owner == i) | (owner == body)
        _, sizes, axes = np.linalg.svd(motions[:, moves] @ S[:3, moves].T)
        return body, axes[: (sizes > 1e-6 * sizes[0]).sum()]
    return None


def _axes_with_inertia(body):
    """(k, 3) orthonormal axes, body axes, about which a body has inertia."""
    without = axes_without_inertia(body)
    return np.linalg.svd(np.vstack([without, np.zeros((3, 3))]))[2][len(without) :]


def _refusal(scene, links, places, world, i, turns, always):
    """SceneError that names the joint and the body of link i; turns, always: see `check_inertia`."""
    link = links[i]
    number = max(
        (k for k, body in enumerate(scene.bodies) if body.name in link.bodies), key=lambda k: scene.bodies[k].mass
    )
    name = scene.bodies[number].name
    pose = world[i] @ places[name][1]
    axes = written(turns @ pose[:3, :3])
    if link.joint is None:
        return SceneError(
            f'bodies[{number}] "{name}": it is free to rotate about {axes}, where it has no inertia: '
            "give it inertia there, or hold it by a joint that prevents this rotation",
            ("bodies", number),
        )
    joint = scene.joints[link.joint]
    when = "" if always else " in its initial pose"
    other = ", such as a universal joint" if joint.type == "spherical" and len(turns) == 1 else ""
    return SceneError(
        f'joints[{link.joint}] "{joint.name}": it lets "{name}" rotate about {axes}{when}, where it '
        f"has no inertia: give it inertia there, or use another joint{other}",
        ("joints", link.joint),
    )
