# SPDX-License-Identifier: Apache-2.0
"""Assembly: initial poses and velocities that satisfy all joints, from guesses and joint rates.

A scene with `assemble: true` leaves part of its initial state to its joints. `assembled` returns a
scene in which every pose, velocity and joint frame is explicit:

1. A body without a pose is placed by a joint to a body that has one: both joint frames coincide.
2. An omitted joint frame is placed so that it coincides with the joint's other frame at these poses.
   An omitted length, or offset of a coupling, gets its value at these poses.
3. Poses: the nearest ones that satisfy all joints (Newton's method on the group). Bodies marked
   `fixed` keep their given pose, joints their given `coordinate`. If there are more given coordinates
   than degrees of freedom, they may be rounded numbers: each may change by COORDINATE_ROUNDING.
4. Velocities: the change of the given twists V0 that has the least kinetic energy,
       min (V - V0)^T M (V - V0)   subject to   J V = 0, the given joint rates, the velocities of
   `fixed` bodies, and the components listed in `kept`.

The same text gives bit-identical results on the same machine. The model does not depend on the
result of an iteration: frames and lengths come from steps 1 and 2, which only multiply poses.
"""

import numpy as np
import scipy

from liegroup_core.errors import SceneError
from liegroup_core.fields.frames import ROTATIONS, Frame
from liegroup_core.joints.coupling import rate_row, turns
from liegroup_core.joints.linkage import RANK_TOLERANCE, Linkage
from liegroup_core.lie.groups import SE3, SO3

from .centres import Offsets, at_centres_of_mass
from .consistency import (
    ResolvedCoupling,
    check_consistency,
    resolve_couplings,
    resolve_elements,
    resolve_frames,
    rigid_couplings,
)
from .description import WORLD
from .massless import NO_INERTIA

# Largest change of given coordinates that contradict each other, in rad or relative to the length of the
# linkage: angles with three decimals are accepted.
COORDINATE_ROUNDING = 1e-3

# Largest velocity residual that counts as round-off, relative to the velocities involved.
TOLERANCE = 1e-10

# Motions with a smaller square root of inertia, relative to the largest one, have no kinetic energy: it is round-off.
FLAT = 1e-12

# A joint with a larger position residual is violated. Units as above; far above round-off.
OPEN = 1e-9


def assembled(scene, kept=()):
    """Scene with consistent initial poses and velocities; its `assemble` is false.

    kept : [(body, component 0..5)]: components of the twists of body frames that keep the given value
    Raises SceneError with the joint that cannot be satisfied and its residual.
    """
    if not scene.assemble:
        return scene
    fixed = [body for body in scene.bodies if body.initial == "fixed"]
    rates = {j: joint.rate for j, joint in enumerate(scene.joints) if joint.rate is not None}
    # A prescribed coordinate is a coupling of ratio 0.
    kept_coordinates = [
        ResolvedCoupling(j, j, 0.0, joint.coordinate)
        for j, joint in enumerate(scene.joints)
        if joint.coordinate is not None
    ]
    scene = _with_joints_written_out(_with_bodies_placed(scene))
    centred = at_centres_of_mass(scene)
    frames, parts = resolve_frames(centred), resolve_elements(centred)
    joints, couplings = range(len(centred.joints)), rigid_couplings(centred)

    held = {b.name for b in fixed if b.has_pose}
    linkage = Linkage(centred, frames, parts, joints, held, [*couplings, *kept_coordinates])
    poses = linkage.nearest(linkage.start)
    if kept_coordinates and not linkage.is_closed(poses):
        linkage = Linkage(centred, frames, parts, joints, held, couplings)
        poses = with_nearest_coordinates(linkage, poses, kept_coordinates)
        if linkage.is_closed(poses):
            scene = _with_moved_coordinates(scene, linkage, poses, kept_coordinates)
    if not linkage.is_closed(poses):
        raise cannot_close(linkage, poses)
    linkage = Linkage(centred, frames, parts, joints, (), couplings)
    twists = consistent_velocities(
        centred,
        {body.name: body.twist for body in centred.bodies},
        linkage,
        poses,
        rates,
        {b.name for b in fixed if b.has_twist},
        _rows_of(scene, kept),
    )
    return _with_start(scene, centred, linkage.length, poses, twists)


def ready(scene):
    """Assembled and checked scene, and the same scene with frames at the centres of mass.

    Raises SceneError if poses or velocities violate a joint.
    """
    scene = assembled(scene)
    check_consistency(scene)
    return scene, at_centres_of_mass(scene)


def _with_bodies_placed(scene):
    """Step 1."""
    poses = {WORLD: np.eye(4)} | {body.name: body.pose for body in scene.bodies if body.has_pose}
    names = [body.name for body in scene.bodies]
    joints = list(enumerate(scene.joints))
    while len(poses) <= len(names):
        for j, joint in joints:
            if (joint.parent in poses) != (joint.child in poses) and joint.locates_child:
                break
        else:
            i = next(i for i, name in enumerate(names) if name not in poses)
            raise SceneError(
                f'bodies[{i}] "{names[i]}": cannot be placed: it has no position, no rotation '
                "and no joint to a placed body; give a position",
                ("bodies", i),
            )
        if joint.parent_frame is None or joint.child_frame is None:
            name = joint.child if joint.parent in poses else joint.parent
            raise SceneError(
                f'joints[{j}] "{joint.name}": must have both frames, because they determine the '
                f'pose of "{name}", which has no position and no rotation',
                ("joints", j),
            )
        between = joint.parent_frame.pose @ SE3.inverse(joint.child_frame.pose)
        if joint.parent in poses:
            poses[joint.child] = poses[joint.parent] @ between
        else:
            poses[joint.parent] = poses[joint.child] @ SE3.inverse(between)
    return scene.remade(
        bodies=[body if body.has_pose else body.remade(**_keys(poses[body.name])) for body in scene.bodies]
    )


def _with_joints_written_out(scene):
    """Step 2. Keys that only control assembly are removed from the scene."""
    poses = {body.name: body.pose for body in scene.bodies} | {WORLD: np.eye(4)}
    joints = []
    for joint, pair in zip(scene.joints, resolve_frames(scene)):
        found = {
            key: Frame(**_keys(frame))
            for key, frame in zip(("parent_frame", "child_frame"), pair)
            if getattr(joint, key) is None
        }
        if getattr(joint, "length", 0.0) is None:
            ends = [poses[name] @ F for name, F in zip((joint.parent, joint.child), pair)]
            found["length"] = float(np.linalg.norm((ends[1] - ends[0])[:3, 3]))
        joints.append(joint.remade(("rate", "coordinate"), **found))
    written = {"joints": joints}
    if scene.couplings:
        written["couplings"] = [
            entry.remade(offset=found.offset) for entry, found in zip(scene.couplings, resolve_couplings(scene))
        ]
    return scene.remade(("assemble",), **written, bodies=[body.remade(("initial",)) for body in scene.bodies])


def _rows_of(scene, kept):
    """[(body, (6,) row)]: row times the twist at the centre of mass is the kept component."""
    rows = []
    for body in scene.bodies:
        to_body = np.eye(6)  # v = v_com - w x com
        to_body[3:, :3] = SO3.hat(body.com)
        rows += [(body.name, to_body[part]) for name, part in kept if name == body.name]
    return rows


def consistent_velocities(scene, given, linkage, poses, rates, fixed, kept=()):
    """Step 4: twists {body: (6,)}, frames at the centres of mass.

    given : {body: (6,)} the twists V0
    rates : {index of a joint of the linkage: rate}; kept : see _rows_of
    """
    if not linkage.bodies:
        return given
    rates = dict(sorted(rates.items()))  # as their rows
    rate_rows = [np.zeros((0, 6))] * len(linkage.joints)
    for j in rates:
        joint, (_, F_b) = linkage.joints[j], linkage.frames[j]
        rate_rows[j] = rate_row(joint, F_b)[None]
    kept = [(name, row) for name, row in kept if name in linkage.place]
    keeping = np.zeros((len(kept), 6 * len(linkage.bodies)))
    for row, (name, part) in zip(keeping, kept):
        row[linkage.place[name] : linkage.place[name] + 6] = part
    closing = linkage.velocity_rows(poses)
    J = np.vstack([closing, linkage.relative_rows(poses, rate_rows), keeping])
    holders = [
        next(j for j, joint in enumerate(linkage.joints) if name in (joint.parent, joint.child)) for name, _ in kept
    ]
    owner = [
        *np.repeat(range(len(linkage.joints)), linkage.counts),
        *(coupling.joint for coupling in linkage.couplings),
        *rates,
        *holders,
    ]
    wanted = np.concatenate([np.zeros(len(closing)), list(rates.values()), [part @ given[name] for name, part in kept]])
    V = np.concatenate([given[name] for name in linkage.bodies])

    # The rank does not weigh the velocities (omega length, v) by inertia: slender and light bodies would
    # make independent conditions on other bodies look redundant.
    moves = np.repeat([name not in fixed for name in linkage.bodies], 6)
    unit = np.tile([1.0 / linkage.length] * 3 + [1.0] * 3, len(linkage.bodies))[moves]
    A = J[:, moves] * unit
    size = np.linalg.norm(A, axis=1)
    size[size == 0.0] = 1.0
    left, values, directions = np.linalg.svd(A / size[:, None])
    rank = int((values > RANK_TOLERANCE * values.max(initial=0.0)).sum())
    across, along = directions[:rank].T * unit[:, None], directions[rank:].T * unit[:, None]

    def correction():
        """Smallest change that satisfies the conditions."""
        return across @ (left[:, :rank].T @ ((wanted - J @ V) / size) / values[:rank])

    start = V[moves]
    V[moves] += correction()
    root = _root_of_inertia(scene, [name for name in linkage.bodies if name not in fixed])
    V[moves] -= along @ np.linalg.lstsq(root @ along, root @ (V[moves] - start), rcond=FLAT)[0]
    V[moves] += correction()  # once more for round-off
    miss = wanted - J @ V
    scale = np.abs(J) @ np.abs(V) + np.abs(wanted)
    if (np.abs(miss) > TOLERANCE * (scale.max(initial=0.0) + 1.0)).any():
        raise _contradiction(linkage, J, owner, miss)
    return given | dict(zip(linkage.bodies, V.reshape(-1, 6)))


def _root_of_inertia(scene, names):
    """Matrix R (6 n, 6 n) of n bodies. R^T R is their mass matrix; it is singular if a body lacks inertia."""
    bodies = {body.name: body for body in scene.bodies}
    blocks = []
    for body in (bodies[name] for name in names):
        moments, axes = np.linalg.eigh(body.inertia_matrix)
        moments[moments <= NO_INERTIA * moments[2]] = 0.0
        blocks += [np.sqrt(moments)[:, None] * axes.T, np.sqrt(body.mass) * np.eye(3)]
    return scipy.linalg.block_diag(*blocks)


def _with_start(scene, centred, length, poses, twists):
    """Scene with the given poses and twists of the frames at the centres of mass."""
    pose = np.array([poses[body.name] for body in scene.bodies])
    twist = np.array([twists[body.name] for body in scene.bodies])
    # Poses and twists that assembly did not change keep the digits of the file.
    moved = [not np.array_equal(C, body.pose) for C, body in zip(pose, centred.bodies)]
    hurried = [not np.array_equal(V, body.twist) for V, body in zip(twist, centred.bodies)]
    fastest = np.abs(twist).max(axis=0).reshape(2, 3).max(axis=1).repeat(3)
    flat = np.concatenate([pose[:, :3, :3].reshape(-1, 9), pose[:, :3, 3]], axis=1)
    flat, twist = Offsets(scene).to_bodies(flat, twist)
    bodies = []
    for i, body in enumerate(scene.bodies):
        if moved[i]:
            body = body.remade(
                ROTATIONS,
                position=_tidy(flat[i, 9:], length),
                quaternion=_tidy(SO3.to_quaternion(flat[i, :9].reshape(3, 3)), 1.0),
            )
        if hurried[i]:
            w, v = np.split(_tidy(twist[i], fastest), 2)
            body = body.remade(angular_velocity=w, linear_velocity=v)
        bodies.append(body)
    return scene.remade(bodies=bodies)


def _tidy(values, size):
    """Values with round-off replaced by zero; `size`: scale of the round-off."""
    return np.where(np.abs(values) <= 1e-16 * size, 0.0, values)


def _keys(pose):
    """Keys of a scene for a pose (4, 4)."""
    return {"position": pose[:3, 3], "quaternion": SO3.to_quaternion(pose[:3, :3])}


def cannot_close(linkage, poses):
    """SceneError for the joint with the largest position residual.

    If the start violates joints, only these count: tree joints that it satisfies are not the cause.
    """
    gaps, before = ([linkage.gap(j, each) for j in range(len(linkage.joints))] for each in (poses, linkage.start))
    sizes, open_before = ([max(gap / linkage.length, tilt) for gap, tilt in each] for each in (gaps, before))
    if max(open_before, default=0.0) > OPEN:
        sizes = [size if was > OPEN else 0.0 for size, was in zip(sizes, open_before)]
    for i, entry in enumerate(linkage.couplings):
        off = abs(linkage.coupling_gap(entry, poses))
        if off > max(sizes):
            return SceneError(
                f"couplings[{i}]: cannot be assembled, it remains violated by {off:.3g}; correct "
                "ratio, curve or offset, or start from other poses",
                ("couplings", i),
            )
    k = int(np.argmax(sizes))
    (gap, tilt), j, joint = gaps[k], linkage.numbers[k], linkage.joints[k]
    wanted, length = getattr(joint, "length", None), ""
    if wanted is not None:
        apart = np.linalg.norm(linkage.relative(k, poses)[:3, 3])
        length = f": its length is {wanted:.6g} m, the nearest possible one {apart:.6g} m"
    ends = {name for each in linkage.joints for name in (each.parent, each.child)} - {WORLD}
    advice = (
        (gap > OPEN * linkage.length, "check the lengths"),
        (tilt > OPEN, "check the axes in both frames"),
        (True, "start from poses closer to the assembled ones"),
        (not ends <= linkage.place.keys(), "fix fewer bodies"),
    )
    return SceneError(
        f'joints[{j}] "{joint.name}": cannot be assembled, the remaining '
        f"constraint violation is {gap:.3g} m and {tilt:.3g} rad{length}; "
        + ", or ".join(text for applies, text in advice if applies),
        ("joints", j),
    )


def with_nearest_coordinates(linkage, tried, entries):
    """Poses that satisfy the joints of a linkage, with coordinates near those of entries; not closed if none are found.

    tried   : poses with these coordinates, which do not satisfy the joints; found from them or from the start
    entries : ResolvedCoupling of each given coordinate
    """
    found = linkage.nearest(linkage.start), linkage.nearest(tried)

    def off(poses):
        return max(abs(linkage.coupling_gap(entry, poses)) / _unit(linkage, entry.joint) for entry in entries)

    return min((poses for poses in found if linkage.is_closed(poses)), key=off, default=found[0])


def _unit(linkage, j):
    """Unit of the coordinate of a joint of a linkage: rad, or its length."""
    return 1.0 if turns(linkage.joints[j]) else linkage.length


def _with_moved_coordinates(scene, linkage, poses, entries):
    """Scene with a note that lists the coordinates used instead of the given, rounded ones.

    poses   : nearest poses that satisfy the joints without the given coordinates
    entries : ResolvedCoupling of each given coordinate
    Raises SceneError if a coordinate would move by more than COORDINATE_ROUNDING.
    """
    off = {entry.joint: linkage.coupling_gap(entry, poses) for entry in entries}
    given = {entry.joint: entry.offset for entry in entries}
    if any(abs(off[j]) > COORDINATE_ROUNDING * _unit(linkage, j) for j in off):
        raise not_kept(linkage, poses, entries)
    moved = ", ".join(
        f"{linkage.joints[j].name} by {off[j]:.3g} {'rad' if turns(linkage.joints[j]) else 'm'} to "
        f"{given[j] + off[j]:.12g}"
        for j in off
    )
    note = f"changes the motion: start values contradict each other, changed to satisfy all joints: {moved}"
    return scene.remade(notes=[*scene.notes, note])


def not_kept(linkage, poses, entries):
    """SceneError for coordinates that no pose has; poses, entries: as in _with_moved_coordinates."""
    off = {entry.joint: linkage.coupling_gap(entry, poses) for entry in entries}
    given = {entry.joint: entry.offset for entry in entries}
    k = max(off, key=lambda each: abs(off[each]))
    # Ten times finer than what `place` accepts (rearrange.ROUNDED); finer ones are round-off.
    rounding = {i: 1e-7 * _unit(linkage, i) for i in off}
    near = {i: round((given[i] + off[i]) / rounding[i]) * rounding[i] for i in off}
    nearest = ", ".join(f"{linkage.joints[i].name} {value:.9g}" for i, value in near.items())
    j = linkage.numbers[k]
    return SceneError(
        f'joints[{j}] "{linkage.joints[k].name}": no pose near the start satisfies all joints with the '
        f"coordinate {given[k]:.12g}; give fewer coordinates, or the nearest ones: {nearest}",
        ("joints", j, "coordinate"),
    )


def _contradiction(linkage, J, owner, miss):
    """SceneError for the joint with the largest velocity residual."""
    k = int(owner[int(np.argmax(np.abs(miss)))])
    j = linkage.numbers[k]
    turning = ~J.reshape(len(J), -1, 6)[:, :, 3:].any(axis=(1, 2))
    slip, turn = (
        max((abs(x) for x, i, t in zip(miss, owner, turning) if i == k and t == kind), default=0.0)
        for kind in (False, True)
    )
    return SceneError(
        f'joints[{j}] "{linkage.joints[k].name}": the given joint velocities and '
        "velocities of fixed bodies contradict each other: the closest motion violates "
        f"this joint by {slip:.3g} m/s and {turn:.3g} rad/s; give fewer velocities",
        ("joints", j),
    )
