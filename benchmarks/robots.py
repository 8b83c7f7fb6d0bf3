# SPDX-License-Identifier: Apache-2.0
"""Robots of public packages: which load, and their accelerations against Pinocchio and MuJoCo.

    python benchmarks/robots.py [--states 100] [--motion] [--json FILE] [--page FILE] [WORD ...]

Loads every URDF and SDF of example-robot-data and every MJCF of mujoco and dm_control, or those whose
path contains one of the words. Prints a table: bodies, degrees of freedom, joints that close loops,
merged links, kinds of things left out, time to load, and the largest relative difference of the
accelerations of all bodies at random states. Trees from URDF are compared with Pinocchio, MJCF with
MuJoCo (without contact, limits, friction and armature, which are left out on import). Couplings are
added to their accelerations as exact rows.
"""

import argparse
import json
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from liegroup_core import SceneError, SimulationError, load_scene
from liegroup_core.describe import describe
from liegroup_core.engine import Engine
from liegroup_core.integrators.rkmk import spaces
from liegroup_core.layout import make_layout
from liegroup_core.lie.groups import SE3

# Files of the packages that describe no robot of their own: parts that others include, schemas.
PARTS = ("/schema.xml", "attribute_test_schema", "/common/", "/testdata/msh.xml")


def files(words):
    """Paths of all robots of the installed packages."""
    found = []
    spec = find_spec("cmeel")
    if spec is not None:
        prefix = Path(spec.origin).parents[1] / "cmeel.prefix" / "share" / "example-robot-data"
        found += sorted([*prefix.rglob("*.urdf"), *prefix.rglob("*.sdf")])
    for package in ("mujoco", "dm_control"):
        spec = find_spec(package)
        if spec is not None:
            found += sorted(Path(spec.origin).parent.rglob("*.xml"))
    kept = [path for path in found if not any(part in str(path) for part in PARTS)]
    return [path for path in kept if not words or any(word in str(path) for word in words)]


class Accelerations:
    """Accelerations (n, 6) of all bodies of a scene, at their centres of mass, in body axes."""

    def __init__(self, scene):
        self.engine = Engine(scene, "rkmk4", group="relative", quiet=True, space="space")
        self.offsets = self.engine.layout.offsets

    def __call__(self, pose, twist):
        """At poses (n, 12) and twists (n, 6) of the body frames."""
        engine = self.engine
        engine.set_state(*self.offsets.to_centres(pose, twist))
        engine.advance(0)
        integrator = engine._integrator
        model, work = integrator._model, integrator._work
        pose, twist, external, status = spaces.enter(model, work, *engine.state(), engine._external)
        assert status == 0
        spaces.begin(model, work, integrator._group, pose, twist)
        assert spaces.accelerate(model, work, external) == -1
        found = np.zeros((len(model.parts), 6))
        flat = engine.state()[0]
        for i, part in enumerate(model.parts):
            turn, (w, v) = part["rotation"].reshape(3, 3), work.moved[part["link"]].reshape(2, 3)
            found[i, :3], found[i, 3:] = w @ turn, (v + np.cross(w, part["point"])) @ turn
            found[i, 3:] += model.gravity[0] @ flat[i, :9].reshape(3, 3)
        return found


def difference(ours, theirs, bodies):
    """Largest difference of accelerations (n, 6), relative to the largest ones of the mechanism.

    Linear ones are compared with those of all points within the radii of gyration. Speeds are of the
    order of 1: accelerations below 1 are compared with 1.
    """
    radii = np.array([np.sqrt(np.trace(body.inertia_matrix) / body.mass) for body in bodies])
    turns = np.linalg.norm(theirs[:, :3], axis=1)
    sizes = turns.max(initial=1.0), (np.linalg.norm(theirs[:, 3:], axis=1) + radii * turns).max()
    error = np.abs(ours - theirs)
    return max(error[:, :3].max() / sizes[0], error[:, 3:].max() / max(sizes[1], 1.0))


def against_pinocchio(path, scene, states):
    """Largest relative difference of accelerations at random states, or text why there is none."""
    try:
        import pinocchio as pin
    except ImportError:
        return "Pinocchio is not installed"
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
    rng, solve, worst = np.random.default_rng(7), Accelerations(scene), 0.0
    for _ in range(states):
        q = pin.integrate(model, pin.neutral(model), rng.uniform(-1.5, 1.5, model.nv))
        v = rng.uniform(-1.0, 1.0, model.nv)
        rows = _coupled_pinocchio(scene, model, q, v)
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
        ours = solve(np.array(pose), np.array(twist))
        worst = max(worst, difference(ours, np.array(theirs), scene.bodies))
    return worst


def coupled(free, rows, mobility):
    """Accelerations (nv,) with the rows (k, nv) of couplings, from those without them.

    mobility : (nv, k), M^-1 rows^T
    """
    return free - mobility @ np.linalg.lstsq(rows @ mobility, rows @ free, rcond=None)[0]


def _coupled_pinocchio(scene, model, q, v):
    """Make a state of Pinocchio satisfy the couplings; returns their rows (k, nv)."""
    rows = np.zeros((len(scene.couplings), model.nv))
    offsets = [entry["offset"] for entry in describe(make_layout(scene))["couplings"]]
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


def _coupled_mujoco(scene, model, data):
    """Make a state of MuJoCo satisfy the couplings; returns their rows (k, nv)."""
    rows = np.zeros((len(scene.couplings), model.nv))
    offsets = [entry["offset"] for entry in describe(make_layout(scene))["couplings"]]
    for row, coupling, offset in zip(rows, scene.couplings, offsets):
        first, other = (
            _number(model, scene.robot.joints[name]) for name in (coupling.joint, coupling.other)
        )
        at, to = model.jnt_qposadr[other], model.jnt_qposadr[first]
        value = coupling.ratio * (data.qpos[at] - model.qpos0[at]) + offset
        data.qpos[to] = model.qpos0[to] + value
        at, to = model.jnt_dofadr[other], model.jnt_dofadr[first]
        data.qvel[to] = coupling.ratio * data.qvel[at]
        row[to], row[at] = 1.0, -coupling.ratio
    return rows


def _number(model, label):
    """Number of a joint in MuJoCo."""
    try:
        return model.joint(label).id
    except KeyError:
        return int(label.split("_")[1]) - 1


def against_mujoco(path, scene, states):
    """The same against MuJoCo, for MJCF."""
    try:
        import mujoco
    except ImportError:
        return "MuJoCo is not installed"
    model = mujoco.MjModel.from_xml_path(str(path))
    _as_imported(model, mujoco)
    data = mujoco.MjData(model)
    rng, solve, worst = np.random.default_rng(7), Accelerations(scene), 0.0
    real = _bodies_of(model, scene)
    for _ in range(states):
        data.qpos[:] = model.qpos0
        mujoco.mj_integratePos(model, data.qpos, rng.uniform(-1.0, 1.0, model.nv), 1.0)
        data.qvel[:] = rng.uniform(-1.0, 1.0, model.nv)
        coupling_rows = _coupled_mujoco(scene, model, data)
        mujoco.mj_forward(model, data)
        mobility = np.zeros_like(coupling_rows)
        if len(mobility):
            mujoco.mj_solveM(model, data, mobility, coupling_rows)
        data.qacc[:] = coupled(data.qacc, coupling_rows, mobility.T)
        poses, twists, theirs = _state(mujoco, model, data, scene, real)
        rows = [i for i, body in enumerate(scene.bodies) if body.name in theirs]
        found = np.array([theirs[scene.bodies[i].name] for i in rows])
        ours = solve(*_arrays(scene, poses, twists))[rows]
        worst = max(worst, difference(ours, found, [scene.bodies[i] for i in rows]))
    return worst


def _state(mujoco, model, data, scene, real):
    """Poses (4, 4), twists and accelerations (6,) of bodies by name, after mj_forward.

    real : see _bodies_of; massless links have no acceleration
    """
    mujoco.mj_rnePostConstraint(model, data)
    held = {joint.child: joint for joint in scene.joints}
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
        # Theirs is the acceleration of a point without gravity, ours the rate of the twist.
        A[3:] += pose[:3, :3].T @ scene.gravity - np.cross(V[:3], V[3:])
        A[3:] += np.cross(A[:3], body.com)
        poses[name], twists[name], theirs[name] = pose, V, A
    return poses, twists, theirs


def _arrays(scene, poses, twists):
    """Poses (n, 12) and twists (n, 6) of all bodies."""
    flat = [[*poses[b.name][:3, :3].ravel(), *poses[b.name][:3, 3]] for b in scene.bodies]
    return np.array(flat), np.array([twists[b.name] for b in scene.bodies])


def motion_against_mujoco(path, scene, seconds=1.0):
    """(largest difference of positions, largest displacement), m, after a motion from random speeds.

    MuJoCo: RK4 with steps of 0.05 ms; ours: rkmk8 with steps of 1 ms.
    """
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(path))
    _as_imported(model, mujoco)
    model.opt.integrator, model.opt.timestep = mujoco.mjtIntegrator.mjINT_RK4, 5e-5
    data, real = mujoco.MjData(model), _bodies_of(model, scene)
    data.qvel[:] = np.random.default_rng(3).uniform(-1.0, 1.0, model.nv)
    mujoco.mj_forward(model, data)
    poses, twists, _ = _state(mujoco, model, data, scene, real)
    engine = Engine(scene, "rkmk8", 1e-3, group="relative", quiet=True)
    engine.set_state(*engine.layout.offsets.to_centres(*_arrays(scene, poses, twists)))
    engine.advance(round(seconds / 1e-3))
    for _ in range(round(seconds / 5e-5)):
        mujoco.mj_step(model, data)
    mujoco.mj_kinematics(model, data)
    found = engine.sample().positions
    error = max(np.abs(found[name] - data.xpos[i]).max() for name, i in real.items())
    moved = max(np.abs(found[name] - poses[name][:3, 3]).max() for name in real)
    return float(error), float(moved)


def _as_imported(model, mujoco):
    """Switch off in a MuJoCo model what an import leaves out."""
    model.dof_armature[:] = 0.0
    model.body_gravcomp[:] = 0.0
    model.opt.density = model.opt.viscosity = 0.0
    model.opt.disableflags |= (
        mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_ACTUATION
    )
    model.tendon_stiffness[:] = model.tendon_damping[:] = model.tendon_armature[:] = 0.0
    model.jnt_stiffnesspoly[:] = model.dof_dampingpoly[:] = 0.0
    for j in range(model.njnt):
        if model.jnt_type[j] in (0, 1):  # free and ball joints
            model.jnt_stiffness[j] = 0.0
            model.dof_damping[model.jnt_dofadr[j] :][: 6 if model.jnt_type[j] == 0 else 3] = 0.0


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


def row_of(path, states, motion=False):
    """Figures of one file as a dict."""
    row = {"robot": "/".join(path.parts[-3:]), "format": path.suffix[1:]}
    start = time.perf_counter()
    try:
        scene = load_scene(path)
        row["load_s"] = round(time.perf_counter() - start, 3)
        layout = make_layout(scene)
    except SceneError as error:
        text = str(error).replace(str(path), path.name).replace(f"{path.parent}/", "")
        return row | {"refused": text}
    held = set(scene.robot.links.values())  # links that are the frame of a body
    row |= {
        "bodies": len(scene.bodies),
        "freedoms": describe(layout)["degrees_of_freedom"],
        "couplings": len(scene.couplings),
        "loops": len(scene.joints) - sum(_held(scene, body) for body in scene.bodies),
        "merged": sum(link not in held for link in scene.robot.frames),
        "left_out": _left_out(scene),
    }
    against = {".urdf": against_pinocchio, ".xml": against_mujoco}.get(path.suffix)
    closed = row["loops"] or any(joint.type == "fixed" for joint in scene.joints)
    if states and against and not closed:
        found = against(path, scene, states)
        row["difference"] = found if isinstance(found, str) else float(found)
        if motion and path.suffix == ".xml" and not scene.couplings:
            try:
                row["motion_m"], row["moved_m"] = motion_against_mujoco(path, scene)
            except SimulationError as error:
                row["motion_m"] = str(error)
    return row


def _left_out(scene):
    """[(what, number, changes the motion)] of what a file has and its scene has not."""
    found = []
    for note in scene.notes:
        text = note.removeprefix("changes the motion: ")
        changes = text != note
        what, separator, names = text.partition(", left out: ")
        if separator:
            found.append((what, _number_of(names), True))
        elif text.startswith("left out: "):
            count, _, what = text.removeprefix("left out: ").partition(" ")
            found.append((what.partition(" (")[0], int(count), False))
        elif changes and text.startswith("no contact, "):
            found.append(("collision shapes", int(text.split()[2]), True))
        elif changes and ": " in text:
            what, _, names = text.rpartition(": ")
            what = what.removesuffix(" are not enforced").removesuffix(" is not simulated")
            found.append((what.partition(" (")[0], _number_of(names), True))
    return found


def _number_of(names):
    """Number of names of a note, which lists the first ones and counts the others."""
    names, _, more = names.partition(" and ")
    return names.count(", ") + 1 + int(more.removesuffix(" more") or 0)


def page_of(rows):
    """Text of a page with one line for each file."""
    loaded = [row for row in rows if "refused" not in row]
    lines = [
        "# Robots that were tried",
        "",
        "Written by `python benchmarks/robots.py --states 0 --page docs/reference/robots.md`: "
        f"{len(loaded)} of "
        f"{len(rows)} files load. How to use your own: [bring your robot](../how-to/robot.md).",
        "",
        "* *merged*: links that are no body of their own: held by fixed joints to another link or to "
        "the world, or without mass at the end of a chain.",
        "* *left out*: what the file has and the scene has not. **Bold**: it changes the motion.",
        "",
        "| file | bodies | degrees of freedom | loops | couplings | merged | left out | time to load, s |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in loaded:
        out = ", ".join(
            f"**{count} {what}**" if changes else f"{count} {what}"
            for what, count, changes in row["left_out"]
        )
        cells = [
            row[key] for key in ("robot", "bodies", "freedoms", "loops", "couplings", "merged")
        ]
        cells += [out or "-", f"{row['load_s']:.2f}"]
        lines.append(f"| {' | '.join(map(str, cells))} |")
    lines += ["", "## Refused", ""]
    lines += [
        "Many files of the packages are no robots: arenas, parts that others include, tests.",
        "",
    ]
    lines += ["| file | reason |", "|---|---|"]
    lines += [
        f"| {row['robot']} | {row['refused'].replace('|', '/').replace('<', '`<').replace('>', '>`')} |"
        for row in rows
        if "refused" in row
    ]
    return "\n".join([*lines, ""])


def _held(scene, body):
    """True if a joint has this body as its child."""
    return any(joint.child == body.name for joint in scene.joints)


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("words", nargs="*")
    parser.add_argument("--states", type=int, default=100)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--page", type=Path, help="write the table as a page of the documentation")
    parser.add_argument("--motion", action="store_true", help="MJCF: also compare 1 s of motion")
    args = parser.parse_args()
    rows = []
    found = files(args.words)
    row_of(found[0], 0)  # imports and compiles
    for path in found:
        rows.append(row_of(path, args.states, args.motion))
        print(rows[-1], flush=True)
    loaded = [row for row in rows if "refused" not in row]
    print(f"{len(loaded)} of {len(rows)} loaded")
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1) + "\n")
    if args.page:
        args.page.write_text(page_of(rows), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
