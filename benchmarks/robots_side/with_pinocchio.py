# SPDX-License-Identifier: Apache-2.0
"""Trees from URDF beside Pinocchio, which reads the file itself."""

import numpy as np
import pinocchio as pin

from .accelerations import Accelerations, coupled, difference, offsets_of


def against_pinocchio(path, scene, states):
    """(largest relative difference of accelerations at random states, that state).

    The state is (poses (n, 12), twists (n, 6), our accelerations (n, 6), Pinocchio's).
    """
    names = scene.robot
    # Pinocchio's reader wants a root link, not a world, for a floating base.
    floats = all(joint.parent != "world" for joint in scene.joints)
    model = (
        pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer())
        if floats
        else (pin.buildModelFromUrdf(str(path)))
    )
    kept = set(names.joints.values())
    held = [
        j
        for j in range(1, model.njoints)
        if model.names[j] not in kept and model.names[j] != "root_joint"
    ]
    if held:
        model = pin.buildReducedModel(model, held, pin.neutral(model))
    model.gravity.linear = np.array(scene.gravity)
    data = model.createData()
    number = {frame.name: i for i, frame in enumerate(model.frames) if frame.type == pin.BODY}
    frames = [number[names.links[body.name]] for body in scene.bodies]
    damping = {force.joint: force.damping for force in scene.forces}
    tau_of = np.zeros(model.nv)
    for joint in scene.joints:
        tau_of[model.joints[model.getJointId(names.joints[joint.name])].idx_v] = damping.get(
            joint.name, 0.0
        )
    rng, solve, worst = np.random.default_rng(7), Accelerations(scene), (-1.0, None)
    offsets = offsets_of(scene)
    for _ in range(states):
        q = pin.integrate(model, pin.neutral(model), rng.uniform(-1.5, 1.5, model.nv))
        v = rng.uniform(-1.0, 1.0, model.nv)
        rows = _coupled_pinocchio(scene, offsets, model, q, v)
        a = pin.aba(model, data, q, v, -tau_of * v)
        M = pin.crba(model, data, q)
        a = coupled(a, rows, np.linalg.solve(np.triu(M) + np.triu(M, 1).T, rows.T))
        pin.forwardKinematics(model, data, q, v, a)
        pin.updateFramePlacements(model, data)
        pose, twist, theirs = [], [], []
        for frame, body in zip(frames, scene.bodies):
            place = data.oMf[frame]
            pose.append([*place.rotation.ravel(), *place.translation])
            V = pin.getFrameVelocity(model, data, frame, pin.LOCAL)
            A = pin.getFrameAcceleration(model, data, frame, pin.LOCAL)
            twist.append([*V.angular, *V.linear])
            theirs.append([*A.angular, *(A.linear + np.cross(A.angular, body.com))])
        state = np.array(pose), np.array(twist)
        state += solve(*state), np.array(theirs)
        found = difference(*state[2:], scene.bodies)
        if found > worst[0]:
            worst = found, state
    return worst


def _coupled_pinocchio(scene, offsets, model, q, v):
    """Make a state of Pinocchio satisfy the couplings; returns their rows (k, nv)."""
    rows = np.zeros((len(scene.couplings), model.nv))
    for row, coupling, offset in zip(rows, scene.couplings, offsets):
        first, other = (
            model.joints[model.getJointId(scene.robot.joints[name])]
            for name in (coupling.joint, coupling.other)
        )
        at = q[other.idx_q : other.idx_q + other.nq]
        value = coupling.ratio * (at[0] if other.nq == 1 else np.arctan2(at[1], at[0])) + offset
        q[first.idx_q : first.idx_q + first.nq] = (
            [value] if first.nq == 1 else [np.cos(value), np.sin(value)]
        )
        v[first.idx_v] = coupling.ratio * v[other.idx_v]
        row[first.idx_v], row[other.idx_v] = 1.0, -coupling.ratio
    return rows
