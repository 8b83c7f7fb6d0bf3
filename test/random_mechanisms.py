# SPDX-License-Identifier: Apache-2.0
"""Random mechanisms for tests of accelerations: a name and a seed give a scene and wrenches.

Trees and loops of all types of joints with full inertia tensors, all kinds of forces, wrenches in
body and in world axes, and consistent velocities.
"""

import functools
import itertools

import mechanisms
import naive
import numpy as np
from other_frames import described_elsewhere

from liegroup_core.errors import SceneError
from liegroup_core.joints.kinds import TYPES
from liegroup_core.joints.linkage import Linkage
from liegroup_core.layout import make_layout
from liegroup_core.lie.groups import SO3
from liegroup_core.scene.consistency import resolve_couplings, resolve_elements, resolve_frames
from liegroup_core.scene.description import (
    ConstantWrench,
    Drag,
    Law,
    LinearMotor,
    LinearServo,
    LinearSpringDamper,
    Motor,
    Servo,
    TorsionalSpringDamper,
)

# Independent motions that a type of joint allows; None: a body without a joint.
FREEDOMS = {kind: len(mechanisms.directions(kind)) for kind in mechanisms.FREE}
FREEDOMS |= {"universal": 2, "distance": 5, None: 6}
# Joints that do not leave a plane, and those that do not leave a point.
IN_PLANE, AT_POINT = {"revolute": 1, "fixed": 0}, {"revolute": 1, "spherical": 3}


def tree(rng, n, kinds=mechanisms.KINDS, grounded=0.2):
    """Links (parent, child, kind) of n bodies; a body hangs on one of the three before it.

    grounded : probability that a body hangs on the world instead, in one case of five without a joint
    """
    links = []
    for i in range(n):
        if i == 0 or rng.random() < grounded:
            free = None in kinds and rng.random() < 0.2
            links.append(("world", f"b{i}", None if free else _any(rng, kinds)))
        else:
            links.append((f"b{rng.integers(max(0, i - 3), i)}", f"b{i}", _any(rng, kinds)))
    return links


def _any(rng, kinds):
    return str(rng.choice([kind for kind in kinds if kind is not None]))


def closings(rng, links, count, freedoms=FREEDOMS, group=6):
    """Up to `count` loops (a, b, kind) that leave every loop a freedom.

    group : dimension of the group of all motions of the mechanism: 3 in a plane or about a point
    """
    up = {child: (parent, kind) for parent, child, kind in links}
    left = sum(freedoms.get(kind, FREEDOMS[kind]) for _, _, kind in links)
    found = []
    for _ in range(30 * count):
        a, b = rng.choice(["world", *up], 2, replace=False)
        kind = _any(rng, freedoms)
        if b == "world" or len(found) == count:
            continue
        lost = group - freedoms[kind]
        around = sum(freedoms.get(k, FREEDOMS[k]) for k in _between(up, a, b))
        if around - lost >= 1 and left - lost >= 1:
            found.append((str(a), str(b), kind))
            left -= lost
    return found


def _between(up, a, b):
    """Kinds of the joints between two bodies of a tree."""
    ways = []
    for body in (a, b):
        way = {}
        while body != "world":
            parent, way[body] = up[body]
            body = parent
        ways.append(way)
    return [kind for body, kind in (ways[0] | ways[1]).items() if (body in ways[0]) != (body in ways[1])]


def flat_frame(rng, size):
    """Frame (4, 4) whose z axis is that of the body."""
    pose = mechanisms.random_pose(rng, size)
    pose[:3, :3] = SO3.exp([0.0, 0.0, 3.0 * rng.normal()])
    return pose


def frame_at_origin(rng, size):
    """Frame (4, 4) with the origin of the body."""
    pose = mechanisms.random_pose(rng)
    pose[:3, 3] = 0.0
    return pose


def tilted(rng, scene):
    """The mechanism of a scene in another position and attitude in the world; gravity stays."""
    pose = mechanisms.random_pose(rng)

    def at(place):
        placed = pose @ place.pose
        return {"position": placed[:3, 3], "rotation_vector": SO3.log(placed[:3, :3])}

    def moved(link):
        if link.parent != "world":
            return link
        if hasattr(link, "parent_point"):
            return link.remade(parent_point=pose[:3, :3] @ link.parent_point + pose[:3, 3])
        return link.remade(parent_frame=link.parent_frame.remade(**at(link.parent_frame)))

    return scene.remade(
        bodies=[body.remade(**at(body)) for body in scene.bodies],
        joints=[moved(joint) for joint in scene.joints],
        forces=[moved(force) for force in scene.forces],
    )


def heavier(rng, scene, decades):
    """Masses and inertias of all bodies times 10^x, x between -decades/2 and decades/2.

    x is uniform, or one of both ends: then a body is light between heavy ones, or the reverse.
    """
    bodies, ends = [], rng.random() < 0.5
    for body in scene.bodies:
        x = rng.choice([-0.5, 0.5]) if ends else rng.uniform(-0.5, 0.5)
        factor = 10.0 ** (decades * x)
        inertia = factor * np.array(body.inertia)
        bodies.append(body.remade(mass=factor * body.mass, inertia=inertia))
    return scene.remade(bodies=bodies)


def slender(rng, scene, thin):
    """Bodies with one moment of inertia that is `thin` times the others, axes in any direction."""
    bodies = []
    for body in scene.bodies:
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        matrix = 0.1 * body.mass * turn @ np.diag([1.0, 1.0, thin]) @ turn.T
        inertia = (*np.diag(matrix), matrix[0, 1], matrix[0, 2], matrix[1, 2])
        bodies.append(body.remade(inertia=inertia))
    return scene.remade(bodies=bodies)


def forced(rng, scene):
    """The scene with forces of all kinds; those at joints where the types of its joints allow it."""
    forces = list(scene.forces)

    def add(kind, chance, **keys):
        if rng.random() < chance:
            forces.append(kind(name=f"f{len(forces)}", **keys))

    for joint in scene.joints:
        some = rng.uniform(0.1, 3.0, size=8)
        if TYPES[joint.type].turns:
            coil = {"stiffness": 5 * some[0], "damping": some[1], "rest_angle": some[2] - 1.5}
            add(TorsionalSpringDamper, 0.3, joint=joint.name, **coil)
            add(Motor, 0.2, joint=joint.name, torque=some[3])
            add(Motor, 0.2, joint=joint.name, torque=-some[3], rate_limit=some[4])
        if TYPES[joint.type].slides:
            spring = {"stiffness": 20 * some[5], "damping": some[6], "rest_position": some[7] - 1.5}
            add(LinearSpringDamper, 0.3, joint=joint.name, **spring)
            add(LinearMotor, 0.2, joint=joint.name, force=-some[3])
            add(LinearMotor, 0.2, joint=joint.name, force=some[3], speed_limit=some[4])
    # Numbers of their own, so that those of the other forces are what they were without servos.
    own = np.random.default_rng([len(scene.joints), len(scene.bodies), len(forces)])
    for joint in scene.joints:
        some = own.uniform(0.1, 3.0, size=6)
        if joint.driven:
            continue
        moves = TYPES[joint.type].turns, TYPES[joint.type].slides
        for kind, allowed in zip((Servo, LinearServo), moves):
            if allowed and some[0] < 0.6:
                law = {"stiffness": 3 * some[1], "damping": some[2], "effort_limit": some[5]}
                law |= {"position": some[3] - 1.5, "velocity": some[4] - 1.5}
                forces.append(kind(name=f"f{len(forces)}", joint=joint.name, **law))
                break
    for body in scene.bodies:
        some = rng.uniform(0.0, 0.5, size=4)
        add(Drag, 0.2, body=body.name, linear=some[0], quadratic=some[1], angular=some[2], angular_quadratic=some[3])
        add(
            ConstantWrench,
            0.2,
            body=body.name,
            torque=body.mass * rng.normal(size=3),
            force=5.0 * body.mass * rng.normal(size=3),
            point=rng.normal(size=3),
            axes=str(rng.choice(["body", "world"])),
        )
    return scene.remade(forces=[*forces, *_laws(own, scene, len(forces))])


def _laws(rng, scene, first):
    """Laws at some joints with one coordinate and on some bodies: smooth formulas that decimals can evaluate."""
    laws = []
    for joint in scene.joints:
        k, c, a = rng.uniform(0.1, 2.0, size=3).tolist()
        if TYPES[joint.type].coordinate and not joint.driven and c < 0.7:
            inputs = {"q": f"{joint.name}.position", "w": f"{joint.name}.velocity"}
            output = {"joint": joint.name, "effort": "k*(a - q) - c*w*abs(c) + 0.1*q**3"}
            laws.append({"inputs": inputs, "parameters": {"k": k, "c": c, "a": a}, "outputs": [output]})
    for body in scene.bodies:
        k, c, a = rng.uniform(0.1, 2.0, size=3).tolist()
        if c < 0.5:
            point = rng.normal(size=3).tolist()
            inputs = {"x": {"quantity": f"{body.name}.x", "point": point}, "w": f"{body.name}.wz"}
            inputs["v"] = {"quantity": f"{body.name}.vy", "point": point}
            output = {"body": body.name, "force": ["-k*x", "c*w", "f"], "torque": ["f*a", "w - v", "1/k"]}
            output |= {"point": point, "axes": "world" if a > 1.0 else "body"}
            law = {"inputs": inputs, "parameters": {"k": k, "c": c, "a": a}, "outputs": [output]}
            laws.append(law | {"signals": {"f": "max(v, v - 1)*c - x*v if k > 0 else x"}})
    return [Law(name=f"f{first + number}", **law) for number, law in enumerate(laws)]


def coupled(rng, scene, most):
    """The scene with up to `most` couplings, in the ratios of the velocities that its joints have."""
    rates = {
        name: rate
        for name, (_, rate) in make_layout(scene).sample(*_start(scene)).joint_coordinates.items()
        if abs(rate) > 0.05
    }
    couplings = []
    for _ in range(most):
        if len(rates) < 2:
            break
        joint, other = rng.choice(list(rates), 2, replace=False).tolist()
        couplings.append(
            {"name": f"c{len(couplings)}", "joint": joint, "other": other, "ratio": rates.pop(joint) / rates[other]}
        )
    if not couplings:
        raise ValueError("no two joints move")
    scene = scene.remade(couplings=couplings)
    joints = resolve_frames(scene), resolve_elements(scene), range(len(scene.joints))
    ranks = [
        np.linalg.matrix_rank(linkage.velocity_rows(linkage.start), tol=1e-6)
        for linkage in (Linkage(scene, *joints), Linkage(scene, *joints, couplings=resolve_couplings(scene)))
    ]
    if ranks[1] - ranks[0] < len(couplings):
        raise ValueError("a coupling is satisfied already, or holds a loop that moves with it")
    return scene


def driven(rng, scene, most):
    """The scene with up to `most` driven joints, which start with an acceleration."""
    coordinates = make_layout(scene).sample(*_start(scene)).joint_coordinates
    joints = list(scene.joints)
    chosen = [j for j, joint in enumerate(joints) if joint.name in coordinates]
    if not chosen:
        raise ValueError("no joint has one coordinate")
    for j in rng.permutation(chosen)[:most].tolist():
        q, v = coordinates[joints[j].name]
        motion = {
            "times": [0.0, 0.5, 1.0],
            "positions": [q, *(q + rng.normal(size=2))],
            "velocities": [v, *rng.normal(size=2)],
            "accelerations": [20.0 * rng.normal(), rng.normal(), 0.0],
        }
        joints[j] = joints[j].remade(driven=True, motion=motion)
    return scene.remade(joints=joints)


def _start(scene):
    pose = naive.flat(np.array([body.pose for body in scene.bodies]))
    return pose, [body.twist for body in scene.bodies]


def pushes(rng, scene):
    """External wrenches [(body, (6,) torque and force, axes)] on up to two bodies."""
    found = []
    for axes in ("body", "world"):
        body = scene.bodies[rng.integers(len(scene.bodies))]
        if rng.random() < 0.5:
            found.append((body.name, 3.0 * body.mass * rng.normal(size=6), axes))
    return found


def with_centres(rng, scene):
    """The mechanism in body frames that are not at the centres of mass."""
    return described_elsewhere(scene, {body.name: rng.normal(size=3) * 0.2 for body in scene.bodies})


def _tree(rng, low=1, high=8):
    links = tree(rng, int(rng.integers(low, high + 1)), (*mechanisms.KINDS, None))
    return mechanisms.mechanism(rng, links, springs=int(rng.integers(4)))


def _loops(rng, low=2, high=8, most=3):
    links = tree(rng, int(rng.integers(low, high + 1)), (*mechanisms.KINDS, None))
    loops = closings(rng, links, int(rng.integers(1, most + 1)))
    return mechanisms.mechanism(rng, links, int(rng.integers(4)), loops)


def _overconstrained(rng, freedoms, place):
    """Loops of hinges with parallel axes or with axes through one point: redundant rows."""
    n = int(rng.integers(3, 8))
    links = [(f"b{i - 1}" if i else "world", f"b{i}", "revolute") for i in range(n)]
    for i in range(3, n):
        if rng.random() < 0.4:
            links[i] = (f"b{rng.integers(i)}", f"b{i}", _any(rng, freedoms))
    loops = closings(rng, links, int(rng.integers(1, 3)), freedoms, group=3)
    return mechanisms.mechanism(rng, links, int(rng.integers(3)), loops, place)


def _flat(rng):
    scene = _overconstrained(rng, IN_PLANE, flat_frame)
    return tilted(rng, scene) if rng.random() < 0.7 else scene


def _at_point(rng):
    scene = _overconstrained(rng, AT_POINT, frame_at_origin)
    return scene.remade(bodies=[body.remade(com=rng.normal(size=3) * 0.3) for body in scene.bodies])


def _ratios(rng):
    scene = _tree(rng, 2) if rng.random() < 0.6 else _loops(rng)
    return heavier(rng, scene, 8.0)


def _slender(rng):
    scene = _tree(rng, 2) if rng.random() < 0.6 else _loops(rng)
    return slender(rng, scene, 10.0 ** rng.uniform(-6.0, -1.0))


def _large(rng):
    return _tree(rng, 20, 40) if rng.random() < 0.5 else _loops(rng, 20, 40, 6)


def _coupled(rng):
    if rng.random() < 0.6:
        return coupled(rng, _tree(rng, 2), int(rng.integers(1, 4)))
    return coupled(rng, _loops(rng, 3) if rng.random() < 0.5 else _flat(rng), 1)


def _driven(rng):
    if rng.random() < 0.6:
        return driven(rng, _tree(rng, 2), int(rng.integers(1, 4)))
    return driven(rng, _loops(rng, 3) if rng.random() < 0.5 else _flat(rng), 1)


CLASSES = {
    "tree": _tree,
    "loops": _loops,
    "planar loops": _flat,
    "spherical loops": _at_point,
    "mass ratios": _ratios,
    "slender": _slender,
    "large": _large,
    "couplings": _coupled,
    "driven": _driven,
}


@functools.lru_cache(maxsize=None)
def random_mechanism(name, seed):
    """(scene, wrenches) of a class of CLASSES. Loops that do not fit are drawn again."""
    for attempt in itertools.count():
        rng = np.random.default_rng([seed, attempt, len(name)])
        try:
            scene = forced(rng, CLASSES[name](rng))
            if name in ("tree", "loops", "large") and rng.random() < 0.4:
                scene = with_centres(rng, scene)
            make_layout(scene)
        except (SceneError, ValueError, np.linalg.LinAlgError):
            continue
        return scene, pushes(rng, scene)
