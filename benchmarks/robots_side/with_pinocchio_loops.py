# SPDX-License-Identifier: Apache-2.0
"""Robots with closed loops compared with Pinocchio.

Pinocchio reads no SDF here. Its model is made from the bodies and joints of the scene, so the comparison
covers the equations of motion, not the reading of the file. Loops are cut at ball joints. Exact rows, from
Pinocchio's mass matrix, bias forces and Jacobians, give the two points of a cut the same acceleration. Its
constraintDynamics gives the same for independent rows. In a planar loop whose axes are parallel only to
1e-10, as in cassie_v2.sdf, it keeps the almost redundant row, and differs by 2e-3.
"""

import numpy as np
import pinocchio as pin

from liegroup_core.errors import SceneError
from liegroup_core.joints.linkage import Linkage, inverse
from liegroup_core.lie.groups import SE3
from liegroup_core.robots.mapping import exchanged
from liegroup_core.scene.assembly import consistent_velocities, ready
from liegroup_core.scene.consistency import resolve_couplings, resolve_elements, resolve_frames

from .accelerations import Accelerations, difference

MODELS = {"revolute": pin.JointModelRZ, "prismatic": pin.JointModelPZ, "spherical": pin.JointModelSpherical}
FARTHEST = 0.1  # rad and m: largest displacement of bodies to a random state
REDUNDANT = 1e-7  # singular values of the rows of loops, relative to the largest one


def against_pinocchio_loops(scene, states):
    """(largest relative difference of accelerations at random states, that scene and state).

    The states satisfy all joints. The scene has its frames at the centres of mass; the state has the
    form of that in with_pinocchio.py.

    Random poses are replaced by others if their loops cannot be closed, or if the joints do not determine
    the velocities to 1e-10.
    """
    _, scene = ready(scene)
    frames, parts = resolve_frames(scene), resolve_elements(scene)
    linkage = Linkage(scene, frames, parts, range(len(scene.joints)), (), resolve_couplings(scene))
    robot = _Robot(scene, frames)
    rng, solve, worst, found = np.random.default_rng(7), Accelerations(scene), (-1.0, None), 0
    names = [body.name for body in scene.bodies]
    while found < states:
        try:
            twists = _twists(scene, linkage, linkage.start, rng)
            moved = {name: linkage.start[name] @ SE3.exp(FARTHEST * twists[name]) for name in names}
            poses = linkage.closed(linkage.start | moved)
            twists = poses and _twists(scene, linkage, poses, rng)
        except SceneError:
            continue
        if poses is None:
            continue
        found += 1
        flat = [[*poses[name][:3, :3].ravel(), *poses[name][:3, 3]] for name in names]
        state = np.array(flat), np.array([twists[name] for name in names])
        state += solve(*state), robot.accelerations(poses, twists)
        error = difference(*state[2:], scene.bodies)
        if error > worst[0]:
            worst = error, (scene, *state)
    return worst


def _twists(scene, linkage, poses, rng):
    """Random twists {body: (6,)} that satisfy all joints, of the order of 1."""
    given = {body.name: rng.uniform(-1.0, 1.0, 6) for body in scene.bodies}
    found = consistent_velocities(scene, given, linkage, poses, {}, set())
    largest = max(np.abs(V).max() for V in found.values())
    return {name: V / max(1.0, largest) for name, V in found.items()}


class _Robot:
    """Pinocchio model of a scene with frames at the centres of mass."""

    def __init__(self, scene, frames):
        self.scene, self.model = scene, pin.Model()
        self.model.gravity.linear = np.array(scene.gravity)
        # {body: (number in Pinocchio, frame of the body in the frame of its joint)}
        self.place = {"world": (0, np.eye(4))}
        self.tree = []
        self.ends = [self._ends(k, *each) for k, each in enumerate(self._grow(scene, frames))]
        self.data = self.model.createData()

    def _grow(self, scene, frames):
        """Add a spanning tree, ball joints last; returns the joints that are cut.

        Pinocchio requires the joints in depth-first order.
        """
        left = sorted(zip(scene.joints, frames), key=lambda each: each[0].type == "spherical")
        held, cut, free = {"world": []}, [], [body.name for body in scene.bodies]
        while free:
            entry = next((e for e in left if (e[0].parent in held) != (e[0].child in held)), None)
            if entry is None:  # a floating part
                found = ("world", free[0], None, np.eye(4), np.eye(4))
            else:
                left.remove(entry)
                joint, (F_a, F_b) = entry
                found = (joint.parent, joint.child, joint, F_a, F_b)
                if joint.parent not in held:
                    F_a, F_b = exchanged(joint.type, F_a, F_b)
                    found = (joint.child, joint.parent, joint, F_a, F_b)
            held[found[0]].append(found)
            held[found[1]] = []
            free.remove(found[1])
            inside = [e for e in left if {e[0].parent, e[0].child} <= held.keys()]
            if any(joint.type != "spherical" for joint, _ in inside):
                raise ValueError("a loop without a ball joint")
            cut += inside
            left = [e for e in left if not {e[0].parent, e[0].child} <= held.keys()]
        pending = held["world"][::-1]
        while pending:
            entry = pending.pop()
            self._add(*entry)
            pending += held[entry[1]][::-1]
        return cut

    def _add(self, parent, name, joint, F_a, F_b):
        number, own = self.place[parent]
        kind = pin.JointModelFreeFlyer() if joint is None else MODELS[joint.type]()
        body = next(body for body in self.scene.bodies if body.name == name)
        new = self.model.addJoint(number, kind, _se3(own @ F_a), f"to_{name}")
        inertia = pin.Inertia(body.mass, np.zeros(3), body.inertia_matrix)
        self.place[name] = (new, inverse(F_b))
        self.model.appendBodyToJoint(new, inertia, _se3(inverse(F_b)))
        self.model.addFrame(pin.Frame(name, new, _se3(inverse(F_b)), pin.OP_FRAME))
        self.tree.append((parent, name, F_a, F_b, joint and joint.name))

    def _ends(self, k, joint, pair):
        """Numbers of two frames at the point of a ball joint, one in each body."""
        found = []
        for name, F in zip((joint.parent, joint.child), pair):
            number, own = self.place[name]
            frame = pin.Frame(f"loop_{k}_{name}", number, _se3(own @ F), pin.OP_FRAME)
            found.append(self.model.addFrame(frame))
        return found

    def _closed(self, q, v, free):
        """Accelerations (nv,) with the loops, from those without them."""
        model, data, axes = self.model, self.data, pin.LOCAL_WORLD_ALIGNED
        M = pin.crba(model, data, q)
        pin.computeJointJacobians(model, data, q)
        pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
        pin.updateFramePlacements(model, data)
        rows, bias = [], []
        for ends in self.ends:
            J = [pin.getFrameJacobian(model, data, end, axes)[:3] for end in ends]
            a = [pin.getFrameClassicalAcceleration(model, data, end, axes).linear for end in ends]
            rows.append(J[1] - J[0])
            bias.append(a[1] - a[0])
        left, sizes, right = np.linalg.svd(np.vstack(rows), full_matrices=False)
        kept = sizes > REDUNDANT * sizes[0]
        J, wanted = right[kept], -(left.T @ np.concatenate(bias))[kept] / sizes[kept]
        mobility = np.linalg.solve(np.triu(M) + np.triu(M, 1).T, J.T)
        return free + mobility @ np.linalg.solve(J @ mobility, wanted - J @ free)

    def accelerations(self, poses, twists):
        """(n, 6) of all bodies."""
        model, data = self.model, self.data
        q, v, tau = pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
        laws = {force.joint: force for force in self.scene.forces}
        twists = {"world": np.zeros(6)} | twists
        for number, (parent, name, F_a, F_b, joint) in enumerate(self.tree, 1):
            relative = inverse(poses[parent] @ F_a) @ poses[name] @ F_b
            own, base = SE3.Ad(inverse(F_b)) @ twists[name], SE3.Ad(inverse(F_a)) @ twists[parent]
            rate = own - SE3.Ad(inverse(relative)) @ base
            at, to = model.joints[number].idx_q, model.joints[number].idx_v
            kind = model.joints[number].shortname()
            if kind == "JointModelRZ":
                q[at], v[to] = np.arctan2(relative[1, 0], relative[0, 0]), rate[2]
            elif kind == "JointModelPZ":
                q[at], v[to] = relative[2, 3], rate[5]
            elif kind == "JointModelSpherical":
                q[at : at + 4] = pin.Quaternion(relative[:3, :3]).coeffs()
                v[to : to + 3] = rate[:3]
            else:
                q[at : at + 7] = pin.SE3ToXYZQUAT(_se3(relative))
                v[to : to + 6] = [*rate[3:], *rate[:3]]
            if joint in laws:
                law = laws[joint]
                tau[to] = -law.stiffness * (q[at] - law.rest_angle) - law.damping * v[to]
        a = self._closed(q, v, pin.aba(model, data, q, v, tau))
        pin.forwardKinematics(model, data, q, v, a)
        found = []
        for body in self.scene.bodies:
            frame = model.getFrameId(body.name)
            A = pin.getFrameAcceleration(model, data, frame, pin.LOCAL)
            found.append([*A.angular, *A.linear])
        return np.array(found)


def _se3(pose):
    return pin.SE3(pose[:3, :3], pose[:3, 3])
