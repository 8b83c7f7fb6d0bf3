# SPDX-License-Identifier: Apache-2.0
"""Conserved components of the spatial momentum of a scene, and their values along a motion.

A group consists of bodies that are connected by joints and forces, not counting the world. Inside
a group forces come in pairs, and joints do no work on a common rigid motion of its bodies, nor do their
stops, friction, motors, drives, rotors and couplings. So
along a screw (xi, eta) about the world origin, the rate of the group's momentum is the power of
the world's wrench W on that screw:

    d/dt (xi . L + eta . P) = W . (xi, eta),     W = joints to the world + gravity + springs to it

The component is conserved in every motion if the right-hand side vanishes at all poses. A joint to
the world transmits wrenches in its forbidden directions A. A cable, strut or rod to it transmits a force through
its end there. All wrenches are assumed of other joints to it that are no lower pairs, or have a stop, friction, a
drive, a rotor or a coupling, and of a plane with friction; a smooth one pushes along its normal. All other forces are
evaluated at generic poses of the mechanism. The conserved screws
are the null space of these wrenches. Examples:
  free in space               angular momentum in 3 directions, linear momentum in 3
  free in gravity             angular momentum about its own centre of mass in 3, linear in the 2
                              directions across gravity
  ball joint at o, gravity    angular momentum about o along gravity
  the same with a ground spring of zero rest length from p0 to the centre of mass: the spring is
                              a central force towards o and the uniform force k (p0 - o), so the
                              component along k (p0 - o) + m g is conserved: the chapter's heavy
                              top is a top in that field
  the same, with a rest length or with the spring elsewhere on the body: none, unless p0 is above
                              or below o
Generic poses of closed loops ignore the closing joint; this never adds a component. Components
that only particular motions conserve (a plane pendulum) are not found.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from liegroup_core.forces import gravity, kinds
from liegroup_core.forces.applied_wrench import wrenches_of
from liegroup_core.forces.external import set_external_wrenches
from liegroup_core.joints.cable import CableJoint
from liegroup_core.joints.distance import DistanceJoint
from liegroup_core.joints.elements import PAIR
from liegroup_core.lie.groups import SE3
from liegroup_core.scene.assembly import ready
from liegroup_core.scene.centres import Offsets
from liegroup_core.scene.consistency import resolve_elements, resolve_frames
from liegroup_core.scene.description import WORLD

from .body_model import build_model
from .links import find_links, in_general_position
from .spanning_tree import spanning_tree

# More poses than unknowns. Each is generic with probability one; the seed is fixed.
POSES = 12
# Work of unit wrenches on unit screws below this is round-off (about 1e-15). A relatively smaller
# force has no visible effect in a run.
CUTOFF = 1e-11


@dataclass(frozen=True, eq=False)
class KeptMomentum:
    """Conserved momentum components of one group of bodies, while no external wrench acts on it."""

    bodies: tuple  # names
    point: np.ndarray | None  # (3,) m, world: angular momentum is about it; None: about the
    #                             group's own centre of mass
    angular: np.ndarray  # (k, 3) unit directions, world axes
    linear: np.ndarray  # (l, 3) unit directions, world axes

    @property
    def labels(self):
        """Text of each component, in the order of `values`."""
        about = "the centre of mass" if self.point is None else _written(self.point)
        return (
            *(f"angular momentum about {about} along {_written(d)}" for d in self.angular),
            *(f"linear momentum along {_written(d)}" for d in self.linear),
        )

    @property
    def units(self):
        """N m s or N s per component."""
        return ("N m s",) * len(self.angular) + ("N s",) * len(self.linear)


def conserved_momentum(scene):
    """Conserved momentum components of a scene: tuple of KeptMomentum, without groups that have none.

    Raises SceneError for a scene that cannot be simulated.
    Verified along independent integrations, with counterexamples: test/core/test_symmetry.py.
    """
    _, scene = ready(scene)
    model, *_ = build_model(scene)
    frames = resolve_frames(scene)
    transmitted = _rows(scene)
    size, rng = _size(scene, frames), np.random.default_rng(6)
    drawn = list(_generic_poses(scene, frames, size))
    wrenches = np.array([_outer_wrenches(scene, model, pose, rng) for pose in drawn])  # (POSES, n, 6)
    kept = []
    for group in body_groups(scene):
        acting = _without_round_off(wrenches[:, group])
        mass = np.array([scene.bodies[i].mass for i in group])
        centre = np.array([mass @ pose[group, 9:] for pose in drawn]) / mass.sum()
        reactions = _reactions(scene, frames, transmitted, group)
        names = tuple(scene.bodies[i].name for i in group)
        kept += [
            KeptMomentum(names, *found)
            for found in _kept(acting, reactions, centre, size)
            if len(found[1]) + len(found[2]) > 0
        ]
    return tuple(kept)


def _kept(acting, reactions, centre, size):
    """Conserved components of a group: list of (point or None, angular, linear).

    acting (POSES, 6) and reactions (r, 6) about the world origin, centre of mass (POSES, 3)
    """
    found = []
    force = acting[:, 3:]
    spin = acting[:, :3] - np.cross(centre, force)
    if not len(reactions) and np.all(np.abs(spin) <= CUTOFF * size * np.abs(force).max()):
        found.append((None, np.eye(3), _tidy(_null_space(force))))
        if np.all(np.abs(force - force[0]) <= CUTOFF * np.abs(force).max()):
            return found  # uniform: its other components follow from these
    # Lengths in units of the characteristic length, so that torques and forces are comparable.
    scale = np.array([1.0, 1.0, 1.0, size, size, size])
    screws = _null_space(np.vstack([acting, reactions]) * scale) * scale
    if len(screws):
        found.append(_split(screws, _reaction_point(reactions), size))
    return found


def _split(screws, start, size):
    """(point, angular, linear) of a space of screws (m, 6); the point is taken near `start`."""
    # Combinations without rotation are translations: linear momentum.
    combinations = _null_space(screws[:, :3].T)
    linear = _tidy(combinations @ screws[:, 3:])
    axes = _tidy(screws[:, :3])
    if not len(axes):
        return np.zeros(3), axes, linear
    # A rotation about p has eta = p x xi. One point p for all, nearest to the origin or to a joint.
    moments = (np.linalg.lstsq(screws[:, :3].T, axes.T, rcond=None)[0].T @ screws)[:, 3:]
    across = np.eye(3) - linear.T @ linear
    system = np.vstack([-across @ _hat(axis) for axis in axes])
    wanted = np.concatenate([across @ (eta - np.cross(start, axis)) for eta, axis in zip(moments, axes)])
    shift = np.linalg.lstsq(system, wanted, rcond=CUTOFF)[0]
    if np.abs(system @ shift - wanted).max() > 1e3 * CUTOFF * size:
        return np.zeros(3), np.zeros((0, 3)), linear  # helical: no angular momentum on its own
    return _clean(start + shift, size), axes, linear


def _reaction_point(reactions):
    """The point of the first joint to the world, from its three unit forces (p x e_i, e_i)."""
    if not len(reactions):
        return np.zeros(3)
    torque, force = reactions[:, :3], reactions[:, 3:]
    pure = np.linalg.norm(force, axis=1) > 0.0
    system = np.vstack([-_hat(f) for f in force[pure][:3]])
    return np.linalg.lstsq(system, np.concatenate(torque[pure][:3]), rcond=None)[0]


def _outer_wrenches(scene, model, pose, rng):
    """Wrenches (n, 6) of gravity and all forces at a pose with random twists; world origin."""
    wrench = np.zeros((len(pose), 6))
    index = {body.name: i for i, body in enumerate(scene.bodies)}
    set_external_wrenches(wrenches_of(scene.forces, index, Offsets(scene)), pose, np.zeros_like(wrench), wrench)
    gravity.add_wrench(model, pose, wrench)
    forces = model.forces
    kinds.add_wrenches(
        forces,
        angles := rng.normal(size=kinds.count(forces)),
        kinds.target_values(forces),
        kinds.registers_at(forces, rng.uniform(0.0, 10.0), angles),
        pose,
        rng.normal(size=(len(pose), 6)),
        wrench,
    )
    turn, place = pose[:, :9].reshape(-1, 3, 3), pose[:, 9:]
    force = np.einsum("nij,nj->ni", turn, wrench[:, 3:])
    torque = np.einsum("nij,nj->ni", turn, wrench[:, :3]) + np.cross(place, force)
    return np.hstack([torque, force])


def _without_round_off(wrenches):
    """Sum (POSES, 6) of the wrenches on the bodies of a group; round-off of zero is removed."""
    total = wrenches.sum(axis=1)
    for part in (slice(0, 3), slice(3, 6)):
        total[:, part][np.abs(total[:, part]) <= CUTOFF * np.abs(wrenches[..., part]).max()] = 0.0
    return total


def _reactions(scene, frames, transmitted, group):
    """Rows of wrenches about the world origin that joints to the world can exert on a group."""
    names = {scene.bodies[i].name for i in group}
    rows = [np.zeros((0, 6))]
    for joint, (F_a, _), A in zip(scene.joints, frames, transmitted):
        if joint.parent == WORLD and joint.child in names:
            # The power on a world screw equals that on the same screw in the joint frame.
            rows.append(A @ SE3.Ad(SE3.inverse(F_a)))
    for force in scene.forces:  # few of the poses touch a plane
        if force.type == "contact" and force.other is None and force.body in names:
            normal = np.array(force.plane.normal)[None] / np.linalg.norm(force.plane.normal)
            across = _null_space(normal)
            smooth = np.vstack([np.hstack([0.0 * normal, normal]), np.hstack([across, 0.0 * across])])
            rows.append(np.eye(6) if force.friction else smooth)
    return np.vstack(rows)


def _rows(scene):
    """Wrenches (k, 6) that every joint transmits, as rows."""
    coupled = {name for coupling in scene.couplings for name in (coupling.joint, *coupling.others)}
    transmitted = []
    for joint, elements in zip(scene.joints, resolve_elements(scene)):
        is_pair = len(elements) == 1 and elements[0].kind == PAIR
        bears = joint.driven or joint.switches or joint.rotor or joint.name in coupled
        if isinstance(joint, (CableJoint, DistanceJoint)):
            transmitted.append(np.eye(6)[3:])
        else:
            transmitted.append(elements[0].forbidden if is_pair and not bears else np.eye(6))
    return transmitted


def _generic_poses(scene, frames, size):
    """POSES poses (n, 12) of the bodies, with the links of the spanning tree in general position."""
    links, places = find_links(scene, frames, spanning_tree(scene), None)
    rng = np.random.default_rng(6)
    for _ in range(POSES):
        world = in_general_position(links, rng, size)
        poses = np.array([world[link] @ place for link, place in (places[body.name] for body in scene.bodies)])
        yield np.concatenate([poses[:, :3, :3].reshape(-1, 9), poses[:, :3, 3]], axis=1)


def body_groups(scene):
    """Index lists of bodies that joints, couplings or forces connect, not counting the world."""
    label = {body.name: i for i, body in enumerate(scene.bodies)}
    # Forces at a joint connect the same bodies as the joint; forces on one body connect none.
    pairs = [(getattr(link, "child", WORLD), getattr(link, "parent", WORLD)) for link in (*scene.joints, *scene.forces)]
    child_of = {joint.name: joint.child for joint in scene.joints}
    child_of |= {force.name: child_of[force.joint] for force in scene.forces if force.joint_moves}
    for sensor in scene.sensors:
        if sensor.type == "distance":
            pairs.append((sensor.child, sensor.parent))
        own = [getattr(sensor, key) for key in ("body", "child") if hasattr(sensor, key)]
        child_of[sensor.name] = own[0] if own else child_of[sensor.joint]
    for force in scene.forces:
        if hasattr(force, "as_law"):  # it connects all that it reads and acts on
            bodies = [name for name in force.on_bodies(child_of) if name in label]
            pairs += zip(bodies, bodies[1:])
    pairs += [(child_of[entry.joint], child_of[other]) for entry in scene.couplings for other in entry.others]
    for child, parent in pairs:
        if WORLD not in (parent, child):
            old, new = label[child], label[parent]
            label = {name: new if value == old else value for name, value in label.items()}
    groups = {}
    for i, body in enumerate(scene.bodies):
        groups.setdefault(label[body.name], []).append(i)
    return list(groups.values())


def _size(scene, frames):
    """Characteristic length, m: the largest coordinate, or 1 if all are zero."""
    points = [body.position for body in scene.bodies]
    points += [frame[:3, 3] for pair in frames for frame in pair]
    points += [
        getattr(force, name)
        for force in scene.forces
        for name in ("parent_point", "child_point", "point")
        if hasattr(force, name)
    ]
    return float(np.abs(np.array(points)).max()) or 1.0


def _null_space(rows):
    """Orthonormal rows that span {x : rows x = 0}; rows are normalised first."""
    norms = np.linalg.norm(rows, axis=1)
    rows = rows[norms > 0.0] / norms[norms > 0.0, None]
    if not len(rows):
        return np.eye(rows.shape[1])
    return scipy.linalg.null_space(rows, rcond=CUTOFF).T


def _tidy(rows):
    """Orthonormal rows of the same span in R^3, along the axes if possible."""
    _, values, span = np.linalg.svd(np.reshape(rows, (-1, 3)), full_matrices=False)
    span = span[values > 1e-8 * max(values.max(initial=0.0), 1e-300)]
    basis, _, order = scipy.linalg.qr(span.T @ span, pivoting=True)
    basis = basis[:, np.argsort(order[: len(span)])].T
    signs = [np.sign(row[np.argmax(np.abs(row))]) for row in basis]
    return _clean(basis * np.reshape(signs, (-1, 1)), 1.0)


def _clean(values, size):
    """Values with round-off next to zero removed."""
    return np.where(np.abs(values) < 1e-12 * size, 0.0, values)


def _hat(x):
    return np.array([[0.0, -x[2], x[1]], [x[2], 0.0, -x[0]], [-x[1], x[0], 0.0]])


def _written(vector):
    return "(" + ", ".join(f"{x:.4g}" for x in vector) + ")"
