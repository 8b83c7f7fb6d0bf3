# SPDX-License-Identifier: Apache-2.0
"""Models from MJCF compared with MuJoCo, which reads the file itself."""

import mujoco
import numpy as np
from numpy.polynomial import Polynomial

from liegroup_core.lie.groups import SE3

from .accelerations import Accelerations, coupled, difference, offsets_of
from .motion import motion_against, radau

STEPS = 5e-5, 1e-5, 2e-6  # s, of MuJoCo's RK4


def against_mujoco(path, scene, states, key=None):
    """Largest relative difference of accelerations at random states, with the controls of a keyframe."""
    model = mujoco.MjModel.from_xml_path(str(path))
    _as_imported(model, scene)
    # Springs with a range of lengths are stops, which act in a motion but not in a single pose.
    model.tendon_stiffness[np.ptp(model.tendon_lengthspring, axis=1) > 0.0] = 0.0
    data = mujoco.MjData(model)
    if key is not None:
        mujoco.mj_resetDataKeyframe(model, data, model.key(key).id)
    rng, solve, worst = np.random.default_rng(7), Accelerations(scene), 0.0
    real = _bodies_of(model, scene)
    offsets = offsets_of(scene)
    for _ in range(states):
        data.qpos[:] = model.qpos0
        mujoco.mj_integratePos(model, data.qpos, rng.uniform(-1.0, 1.0, model.nv), 1.0)
        data.qvel[:] = rng.uniform(-1.0, 1.0, model.nv)
        coupling_rows, bias = _coupled_mujoco(scene, offsets, model, data)
        mujoco.mj_forward(model, data)
        mobility = np.zeros_like(coupling_rows)
        if len(mobility):
            mujoco.mj_solveM(model, data, mobility, coupling_rows)
        data.qacc[:] = coupled(data.qacc, coupling_rows, mobility.T, bias)
        poses, twists, theirs = _state(model, data, scene, real)
        rows = [i for i, body in enumerate(scene.bodies) if body.name in theirs]
        found = np.array([theirs[scene.bodies[i].name] for i in rows])
        ours = solve(*_arrays(scene, poses, twists))[rows]
        worst = max(worst, difference(ours, found, [scene.bodies[i] for i in rows]))
    return worst


def _state(model, data, scene, real):
    """Poses (4, 4), twists and accelerations (6,) of bodies by name, after mj_forward.

    real : see _bodies_of; massless links have no acceleration
    """
    mujoco.mj_rnePostConstraint(model, data)
    held = {joint.child: joint for joint in scene.joints if joint.type not in ("cable", "strut")}
    poses, twists, theirs = {"world": np.eye(4)}, {"world": np.zeros(6)}, {}
    for body in _parents_first(scene, held):
        name = body.name
        if name not in real:
            poses[name], twists[name] = _between(model, data, scene, held[name], poses, twists)
            continue
        i, V, A = real[name], np.zeros(6), np.zeros(6)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = data.xmat[i].reshape(3, 3), data.xpos[i]
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, i, V, 1)
        mujoco.mj_objectAcceleration(model, data, mujoco.mjtObj.mjOBJ_XBODY, i, A, 1)
        # MuJoCo gives the acceleration of a point without gravity; ours is the rate of the twist.
        A[3:] += pose[:3, :3].T @ scene.gravity - np.cross(V[:3], V[3:])
        A[3:] += np.cross(A[:3], body.com)
        poses[name], twists[name], theirs[name] = pose, V, A
    return poses, twists, theirs


def _arrays(scene, poses, twists):
    """Poses (n, 12) and twists (n, 6) of all bodies."""
    flat = [[*poses[b.name][:3, :3].ravel(), *poses[b.name][:3, 3]] for b in scene.bodies]
    return np.array(flat), np.array([twists[b.name] for b in scene.bodies])


def motion_against_mujoco(path, scene, seconds=1.0):
    """Differences after a motion from random speeds: see motion.py."""
    model = mujoco.MjModel.from_xml_path(str(path))
    _as_imported(model, scene)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    data, real = mujoco.MjData(model), _bodies_of(model, scene)
    start = np.random.default_rng(3).uniform(-1.0, 1.0, model.nv)
    data.qvel[:] = start
    mujoco.mj_forward(model, data)
    poses, twists, _ = _state(model, data, scene, real)
    rows = [i for i, body in enumerate(scene.bodies) if body.name in real]

    def their_end(step):
        mujoco.mj_resetData(model, data)
        data.qvel[:] = start
        _integrate(model, data, seconds, step)
        return data.xpos[[real[scene.bodies[i].name] for i in rows]]

    return motion_against(scene, *_arrays(scene, poses, twists), seconds, STEPS, their_end, rows)


def _integrate(model, data, seconds, step):
    """Move to the end of a motion; step: s, of RK4; None: SciPy's Radau with MuJoCo's accelerations."""
    if step is None:
        start = np.concatenate([data.qpos, data.qvel])
        end = radau(lambda _, y: _slope(model, data, *np.split(y, [model.nq])), start, seconds)
        data.qpos[:], data.qvel[:] = np.split(end, [model.nq])
    else:
        model.opt.timestep = step
        for _ in range(round(seconds / step)):
            mujoco.mj_step(model, data)
    mujoco.mj_kinematics(model, data)


def _slope(model, data, position, velocity):
    """Rates of qpos and of qvel."""
    data.qpos[:], data.qvel[:] = position, velocity
    mujoco.mj_forward(model, data)
    rate = np.empty(model.nq)
    kinds = map(mujoco.mjtJoint, model.jnt_type.tolist())  # `in` fails with NumPy's integers
    for kind, at, dof in zip(kinds, model.jnt_qposadr, model.jnt_dofadr):
        if kind == mujoco.mjtJoint.mjJNT_FREE:
            rate[at : at + 3] = velocity[dof : dof + 3]
            at, dof = at + 3, dof + 3
        if kind in (mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL):
            # The angular velocity is in the axes of the body.
            turned, spin = np.empty(4), np.array([0.0, *velocity[dof : dof + 3]])
            mujoco.mju_mulQuat(turned, position[at : at + 4], 0.5 * spin)
            rate[at : at + 4] = turned
        else:
            rate[at] = velocity[dof]
    return np.concatenate([rate, data.qacc])


def _coupled_mujoco(scene, offsets, model, data):
    """Make a state of MuJoCo satisfy the couplings; returns their rows (k, nv) and biases (k,)."""
    rows, bias = np.zeros((len(scene.couplings), model.nv)), np.zeros(len(scene.couplings))
    for k, (row, coupling, offset) in enumerate(zip(rows, scene.couplings, offsets)):
        first, other = (_number(model, scene.robot.joints[name]) for name in (coupling.joint, coupling.other))
        at, to = model.jnt_qposadr[other], model.jnt_qposadr[first]
        law, q = Polynomial([offset, coupling.ratio, *coupling.curve]), data.qpos[at] - model.qpos0[at]
        data.qpos[to] = model.qpos0[to] + law(q)
        at, to = model.jnt_dofadr[other], model.jnt_dofadr[first]
        data.qvel[to] = law.deriv()(q) * data.qvel[at]
        row[to], row[at], bias[k] = 1.0, -law.deriv()(q), law.deriv(2)(q) * data.qvel[at] ** 2
    return rows, bias


def _number(model, label):
    """Number of a joint in MuJoCo."""
    try:
        return model.joint(label).id
    except KeyError:
        return int(label.split("_")[1]) - 1


def _as_imported(model, scene):
    """Switch off those features of a MuJoCo model that an import omits."""
    for note in scene.differences:
        head, _, names = note.partition(", left out: ")
        if "actuators" in head or "servos" in head:
            for name in names.split(", "):
                i = next(i for i in range(model.nu) if name in (model.actuator(i).name, f"actuator_{i}"))
                model.actuator_gainprm[i] = model.actuator_biasprm[i] = 0.0
    model.opt.density = model.opt.viscosity = 0.0
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    for i in range(model.ntendon):
        part = slice(model.tendon_adr[i], model.tendon_adr[i] + model.tendon_num[i])
        if model.wrap_type[part].tolist() != [mujoco.mjtWrap.mjWRAP_SITE] * 2:
            model.tendon_stiffness[i] = model.tendon_damping[i] = 0.0
    model.tendon_armature[:] = model.tendon_stiffnesspoly[:] = model.tendon_dampingpoly[:] = 0.0
    model.jnt_stiffnesspoly[:] = model.dof_dampingpoly[:] = 0.0
    for j in range(model.njnt):
        if model.jnt_type[j] in (0, 1):  # free and ball joints
            model.jnt_stiffness[j] = 0.0
            first = model.jnt_dofadr[j]
            own = slice(first, first + (6 if model.jnt_type[j] == 0 else 3))
            model.dof_damping[own] = model.dof_armature[own] = 0.0


def _bodies_of(model, scene):
    """{body of the scene: number in MuJoCo} of all but the massless links between joints."""
    found = {}
    for scene_name, link in scene.robot.links.items():
        for i in range(1, model.nbody):
            if link == (model.body(i).name or f"body_{i}"):
                found[scene_name] = i
    return found


def _parents_first(scene, held):
    """Bodies of a tree, parents before children."""
    done, left = {"world"}, list(scene.bodies)
    while left:
        ready = [b for b in left if b.name not in held or held[b.name].parent in done]
        yield from ready
        done |= {b.name for b in ready}
        left = [b for b in left if b.name not in done]


def _between(model, data, scene, joint, poses, twists):
    """Pose and twist of a massless link, from those of its parent and its joint."""
    number = _number(model, scene.robot.joints[joint.name])
    at, dof = model.jnt_qposadr[number], model.jnt_dofadr[number]
    S = np.eye(6)[2 if joint.type == "revolute" else 5]
    F_a, F_b = joint.parent_frame.pose, joint.child_frame.pose
    relative = F_a @ SE3.exp(S * (data.qpos[at] - model.qpos0[at])) @ SE3.inverse(F_b)
    twist = SE3.Ad(SE3.inverse(relative)) @ twists[joint.parent] + SE3.Ad(F_b) @ S * data.qvel[dof]
    return poses[joint.parent] @ relative, twist
