# SPDX-License-Identifier: Apache-2.0
"""Consistent initial values: initial poses and twists must satisfy all joints.

With the pose C of a body (body to world) and the joint frames F_a, F_b in the frames of parent
and child,

    C_rel = F_a^-1 C_a^-1 C_b F_b                        must have a zero position residual
    V_rel = Ad(F_b^-1) V_b - Ad(C_rel^-1) Ad(F_a^-1) V_a   must satisfy A V_rel = 0

with A the rows of the velocities that the joint forbids. The chapter's index-1 equations preserve both
only if they hold initially. Plain NumPy, once per scene.
"""

from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from liegroup_core.errors import SceneError
from liegroup_core.fields.curve import counted_from, rise, slope
from liegroup_core.joints import distance
from liegroup_core.joints.coupling import coordinate, difference, gap, rate_row, turns
from liegroup_core.joints.kinds import forbidden_rows, position_residual
from liegroup_core.joints.motion import prescribed
from liegroup_core.joints.stops import BACKLASH, DISTANCE
from liegroup_core.lie.groups import SE3

from .description import WORLD
from .switches import coordinate_of, switches_of, unit_of

# Decimals and double precision results have a relative error of about 1e-15, sums over a long chain
# 1e-12. Values rounded to six digits are not consistent: they are refused, and the error gives
# consistent values.
# Beginnings of the texts about joints that the initial state violates.
AT_POSES, AT_VELOCITIES = "is violated at the initial poses", "the initial velocities violate the joint"
TOLERANCE = 1e-9
# Keys that set the stops of a coordinate without `limits`.
STOPPED_BY = {DISTANCE: "its length", BACKLASH: "its offset and gap"}


def _start(scene):
    """{name: (pose (4, 4), twist (6,))} of all bodies and the world at the start."""
    start = {body.name: (body.pose, body.twist) for body in scene.bodies}
    return start | {WORLD: (np.eye(4), np.zeros(6))}


def resolve_frames(scene):
    """Joint frames of every joint, in the order of scene.joints.

    returns list of (F_a, F_b), (4, 4) each, m: poses of the joint frames in the frames of parent and
    child. If the scene omits one of the two frames, both coincide at the initial poses.
    """
    start = _start(scene)
    frames = []
    for joint in scene.joints:
        C_a, C_b = start[joint.parent][0], start[joint.child][0]
        F_a = joint.parent_frame.pose if joint.parent_frame else None
        F_b = joint.child_frame.pose if joint.child_frame else None
        if F_a is None:
            F_a = SE3.inverse(C_a) @ C_b @ F_b
        elif F_b is None:
            F_b = SE3.inverse(C_b) @ C_a @ F_a
        frames.append((F_a, F_b))
    return frames


def resolve_elements(scene):
    """Constraint elements of every joint, in the order of scene.joints: list of tuples of Element.

    A length that the scene omits is the distance at the initial poses.
    """
    start = _start(scene)
    return [
        joint.elements(_relative(start, joint, *frames)) for joint, frames in zip(scene.joints, resolve_frames(scene))
    ]


class ResolvedCoupling(NamedTuple):
    """Coupling with its numbers: indices of its joints, ratio, offset, curve; see joints/coupling.py.

    If both are the same joint and the ratio is 0, the coordinate of this joint alone is given.
    further : ((index of a joint, c), ...);  loose : it has backlash, and the angle of `joint` is unwrapped, too
    """

    joint: int
    other: int
    ratio: float
    offset: float
    curve: tuple = ()
    further: tuple = ()
    loose: bool = False

    @property
    def is_given(self):
        """True if the coordinate of one joint alone is given."""
        return self.joint == self.other

    @property
    def joints(self):
        """Indices of its joints: joint, other and further ones; of one joint if it is given."""
        return (self.joint,) if self.is_given else (self.joint, self.other, *(j for j, _ in self.further))

    def rise(self, at):
        """Coordinate of `joint` without the offset; at: those of the others, {joint: q}."""
        return rise(self, at[self.other]) + sum(c * at[j] for j, c in self.further)

    def factors(self, q=0.0):
        """Factor of the rate of each of its joints in the row of the coupling; q: coordinate of `other`."""
        return (1.0,) if self.is_given else (1.0, -slope(self, q), *(-c for _, c in self.further))

    def counted_from(self, start):
        """The same relation with the coordinates of the others counted from {joint: q}."""
        shift = sum(c * start[j] for j, c in self.further)
        law = counted_from(self, start[self.other])
        return self._replace(**law | {"offset": law["offset"] + shift})

    def numbered(self, at):
        """The same relation with index at[j] for joint j."""
        further = tuple((at[j], c) for j, c in self.further)
        return self._replace(joint=at[self.joint], other=at[self.other], further=further)


def resolve_couplings(scene):
    """Couplings of a scene: list of ResolvedCoupling.

    An offset that the scene omits is computed from the initial poses.
    """
    if not scene.couplings:
        return []
    index = {joint.name: j for j, joint in enumerate(scene.joints)}
    found = []
    at = _coupled_coordinates(scene)
    for coupling in scene.couplings:
        further = tuple((index[name], c) for name, c in coupling.terms.items())
        joints = index[coupling.joint], index[coupling.other]
        loose = coupling.backlash is not None
        entry = ResolvedCoupling(*joints, coupling.ratio, coupling.offset, coupling.curve, further, loose)
        if coupling.offset is None:
            entry = entry._replace(offset=at[entry.joint] - entry.rise(at))
        found.append(entry)
    return found


def rigid_couplings(scene):
    """The couplings without backlash, as `resolve_couplings`. These are constraints."""
    return [entry for entry in resolve_couplings(scene) if not entry.loose]


def driven_joints(scene):
    """Numbers of the driven joints of a scene."""
    return [j for j, joint in enumerate(scene.joints) if joint.driven]


def resolve_drives(scene):
    """Prescribed motions of the driven joints of a scene: {joint index: (m, 7)}; see joints/motion.py."""
    driven = driven_joints(scene)
    if not driven:
        return {}
    start, frames, joints = _start(scene), resolve_frames(scene), scene.joints
    return {j: prescribed(joints[j].motion or True, *joint_state(start, joints[j], *frames[j])) for j in driven}


def joint_state(start, joint, F_a, F_b):
    """(coordinate, rate) of a joint with one coordinate: rad in (-pi, pi] or m; rad/s or m/s.

    start : {name: (pose (4, 4), twist (6,))} of the joint's bodies and the world
    """
    C_rel = _relative(start, joint, F_a, F_b)
    return coordinate(joint, C_rel), _rate(start, joint, F_a, F_b)


def _rate(start, joint, F_a, F_b):
    """Rate of a joint with one coordinate at the initial poses and twists."""
    C_rel = _relative(start, joint, F_a, F_b)
    from_parent = SE3.Ad(F_b @ SE3.inverse(C_rel) @ SE3.inverse(F_a))
    V_rel = start[joint.child][1] - from_parent @ start[joint.parent][1]
    return float(rate_row(joint, F_b) @ V_rel)


def _coupled_coordinates(scene):
    """{index: coordinate} of the joints of all couplings at the initial poses."""
    start, names = _start(scene), {name for coupling in scene.couplings for name in (coupling.joint, *coupling.others)}
    return {
        j: coordinate(joint, _relative(start, joint, *frames))
        for j, (joint, frames) in enumerate(zip(scene.joints, resolve_frames(scene)))
        if joint.name in names
    }


def _relative(start, joint, F_a, F_b):
    """C_rel of a joint at the initial poses."""
    return SE3.inverse(start[joint.parent][0] @ F_a) @ start[joint.child][0] @ F_b


def check_consistency(scene):
    """Raise SceneError for the first joint that the initial poses or twists violate."""
    start = _start(scene)
    problems = []
    for i, (joint, (F_a, F_b)) in enumerate(zip(scene.joints, resolve_frames(scene))):
        (C_a, V_a), (C_b, V_b) = start[joint.parent], start[joint.child]
        C_rel = _relative(start, joint, F_a, F_b)
        elements = joint.elements(C_rel)
        rows = forbidden_rows(elements, C_rel)
        text = (
            joint.singular(C_rel)
            or _open(joint, elements, rows, C_rel, (C_a, C_b, F_a, F_b))
            or _moving(joint, rows, C_rel, F_a, F_b, V_a, V_b)
        )
        if text:
            problems.append((i, f'joints[{i}] "{joint.name}": {text}'))
    if not problems:
        _check_couplings(scene, start)
        _check_drives(scene, start)
        _check_stops(scene, start)
    if problems:
        i, text = problems[0]
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise SceneError(text + more, place=("joints", i))


def _check_couplings(scene, start):
    """Raise SceneError for the first coupling that the initial poses or twists violate."""
    frames, at = (resolve_frames(scene), _coupled_coordinates(scene)) if scene.couplings else ([], {})
    for i, found in enumerate(resolve_couplings(scene)):
        if found.loose:
            continue
        ends = [scene.joints[j] for j in found.joints]
        rates = [_rate(start, scene.joints[j], *frames[j]) for j in found.joints]
        first, second = at[found.joint], at[found.other]
        off = gap(found, at, turns(ends[0]))
        slip = np.dot(found.factors(second), rates)
        size = 1.0 + abs(first) + abs(rise(found, second)) + abs(found.offset)
        size += sum(abs(c * at[j]) for j, c in found.further)
        if abs(off) > TOLERANCE * size or abs(slip) > TOLERANCE * (size + np.abs(rates).max()):
            unit = "rad" if turns(ends[0]) else "m"
            raise SceneError(
                f'couplings[{i}] "{scene.couplings[i].name}": is violated at the start by {off:.3g} '
                f"{unit} and {slip:.3g} {unit}/s: {ends[0].name} is at {first:.9g}, "
                + ", ".join(f"{scene.joints[j].name} at {at[j]:.9g}" for j in found.joints[1:])
                + "; correct ratio, curve, terms, offset or the start values, or omit offset",
                place=("couplings", i),
            )


def _check_drives(scene, start):
    """Raise SceneError for the first driven joint whose initial state differs from the start of its motion."""
    frames = resolve_frames(scene)
    for j, rows in resolve_drives(scene).items():
        joint = scene.joints[j]
        q, v = joint_state(start, joint, *frames[j])
        off, slip = difference(q, rows[0, 1], turns(joint)), v - rows[0, 2]
        size = 1.0 + abs(q) + abs(rows[0, 1])
        if abs(off) > TOLERANCE * size or abs(slip) > TOLERANCE * (size + abs(v)):
            unit = "rad" if turns(joint) else "m"
            raise SceneError(
                f'joints[{j}] "{joint.name}": its motion starts at {rows[0, 1]:.9g} {unit} with '
                f"{rows[0, 2]:.9g} {unit}/s, but the initial poses and velocities are {q:.9g} {unit} "
                f"and {v:.9g} {unit}/s; correct one of them",
                place=("joints", j, "motion"),
            )


def switch_coordinates(scene, start, frames, angles=MappingProxyType({})):
    """[(Switch, its coordinate)] at poses, rad or m; angles about z are unwrapped to the turn of the stops.

    start  : {name: (pose (4, 4), twist (6,))} of the bodies and the world;  frames : of `resolve_frames`
    angles : {joint: rad} near which the angles of the joints of a coupling are; else it is in (-pi, pi]
    """
    couplings, found = resolve_couplings(scene), []
    for switch in switches_of(scene):
        if switch.joint is not None:
            joint = scene.joints[switch.joint]
            C_rel = _relative(start, joint, *frames[switch.joint])
            found.append((switch, coordinate_of(switch, C_rel)))
            continue
        entry = couplings[switch.coupling]
        joints = {j: scene.joints[j] for j in entry.joints}
        at = {j: coordinate(joint, _relative(start, joint, *frames[j])) for j, joint in joints.items()}
        near = {j: angles.get(joint.name, at[j]) for j, joint in joints.items()}
        at = {j: near[j] + difference(at[j], near[j], turns(joint)) for j, joint in joints.items()}
        found.append((switch, gap(entry, at, False)))
    return found


def _check_stops(scene, start):
    """Raise SceneError for the first joint or coupling that starts beyond a stop."""
    if not switches_of(scene):
        return
    for switch, q in switch_coordinates(scene, start, resolve_frames(scene)):
        limits = switch.limits
        if limits is None or limits.stiffness and (switch.kind in STOPPED_BY or limits.least == limits.largest):
            continue  # a spring, or a compliant cable, strut or coupling, may bear load at the start
        q = limits.at_start(q) if switch.is_angle else q
        off = limits.excess(q)
        if off > TOLERANCE * (1.0 + abs(q)):
            unit = unit_of(switch, scene)
            key, i = ("joints", switch.joint) if switch.coupling is None else ("couplings", switch.coupling)
            raise SceneError(
                f'{key}[{i}] "{switch.name}": it starts at {q:.6g} {unit}, {off:.3g} {unit} beyond a '
                f"stop; correct the initial poses or {STOPPED_BY.get(switch.kind, 'its limits')}",
                place=(key, i),
            )


def _parts(rows, values):
    """Norms of the linear and the angular part of a residual with these constraint rows."""
    angular = rows[:, :3].any(axis=1) & ~rows[:, 3:].any(axis=1)
    return np.linalg.norm(values[~angular]), np.linalg.norm(values[angular])


def _open(joint, elements, rows, C_rel, poses):
    """Text of a violation at position level, or None."""
    gap, tilt = _parts(rows, position_residual(elements, C_rel))
    size = max(np.abs(pose[:3, 3]).max() for pose in poses)
    if max(gap, tilt) <= TOLERANCE * (1.0 + size):
        is_distance = any(element.kind == distance.KIND for element in elements)
        if is_distance and np.linalg.norm(C_rel[:3, 3]) <= TOLERANCE * (1.0 + size):
            return (
                "the two points coincide, so the distance has no direction; use a spherical "
                "joint, or move one of the frames"
            )
        return None
    return f'{AT_POSES}: gap {gap:.3g} m, tilt {tilt:.3g} rad; {joint.remedy}, or move "{joint.child}" or the frames'


def _moving(joint, A, C_rel, F_a, F_b, V_a, V_b):
    """Text of a violation at velocity level of a joint with rows A, or None."""
    to_child, to_joint = SE3.Ad(F_b), SE3.Ad(SE3.inverse(F_b))
    from_parent = SE3.Ad(SE3.inverse(C_rel)) @ SE3.Ad(SE3.inverse(F_a))
    V_rel = to_joint @ V_b - from_parent @ V_a
    slip, turn = _parts(A, A @ V_rel)
    # The round-off of the sums above is proportional to their terms.
    size = max((np.abs(to_joint) @ np.abs(V_b)).max(), (np.abs(from_parent) @ np.abs(V_a)).max())
    if max(slip, turn) <= TOLERANCE * (1.0 + size):
        return None
    # Smallest change of V_rel that satisfies the joint.
    V_ok = to_child @ (V_rel - np.linalg.pinv(A) @ (A @ V_rel) + from_parent @ V_a)
    return (
        f"{AT_VELOCITIES} by {slip:.3g} m/s and {turn:.3g} "
        f'rad/s; consistent values for "{joint.child}" are angular_velocity '
        f"{_written(V_ok[:3], size)} and linear_velocity {_written(V_ok[3:], size)}"
    )


def _written(vector, size):
    """Text of a vector to copy into a scene: twelve digits, round-off written as 0."""
    rounded = (0.0 if abs(x) < 1e-14 * size else float(f"{x:.12g}") for x in vector)
    return f"[{', '.join(f'{x:.12g}' for x in rounded)}]"
