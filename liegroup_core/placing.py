# SPDX-License-Identifier: Apache-2.0
"""Setting the state of an Engine by poses, twists or joint coordinates of some bodies and joints."""

import math

import numpy as np

from liegroup_core.events.switching import BEYOND
from liegroup_core.fields.arguments import check_name, got, is_finite, mapping
from liegroup_core.forces.commands import MOTION, Command, Commands
from liegroup_core.forces.formulas import UNKNOWN
from liegroup_core.forces.law import places_of_branches
from liegroup_core.joints.coupling import COUPLED, difference, turns
from liegroup_core.joints.limits import usable
from liegroup_core.joints.motion import at, uniform
from liegroup_core.scene.centres import pose_matrix
from liegroup_core.scene.consistency import joint_state, switch_coordinates
from liegroup_core.scene.description import WORLD
from liegroup_core.scene.rearrange import rearranged
from liegroup_core.scene.switches import unit_of

from .errors import SceneError

MOVED = 1e-9  # relative change of a driven joint's coordinate or rate above which `place` has moved it


def place(engine, poses=None, twists=None, joints=None) -> None:
    """Set poses and twists of bodies, and joint coordinates; all other bodies follow.

    poses  : {body: (4, 4)} homogeneous poses of body frames
    twists : {body: (6,)} omega rad/s, v m/s; body axes, v of the body frame's origin
    joints : {joint: (position, velocity)} of revolute, prismatic and screw joints, rad and rad/s,
             or m and m/s; None for one that is not set. Positions may exceed 2 pi
    Given values are kept exactly. Joints that are not given keep their coordinates and
    velocities if `joints` are given and no loop prevents it. Otherwise the other values are the
    nearest that satisfy all joints. Bodies without a path of joints to a given one are not changed. Step
    count and time continue; after an `advance_to` within a step, the step is taken to its end first. The
    wrenches of `apply_wrench` are cleared. A driven joint keeps its
    velocity unless the given values prevent it; if it is moved, it continues at its new velocity.
    Raises SceneError with the joint, and its residual or its stop, if the joints do not allow it,
    BeyondLimits, a ValueError, beyond LARGEST_NUMBER or the limits of commands (joints/limits.py), and ValueError for
    an unknown body or joint, NaN or a matrix that is not a rotation. The state is then unchanged.
    """
    poses = mapping("poses must be {body: pose}", poses)
    twists = mapping("twists must be {body: twist}", twists)
    joints = mapping("joints must be {joint: (position, velocity)}", joints)
    index = {name: i for i, name in enumerate(engine.layout.body_names)}
    for body in (*poses, *twists):
        check_name(body, index, "unknown body {}")
    com = engine.layout.offsets.com
    centred_poses, centred_twists = {}, {}
    for body, given in poses.items():
        pose = usable(f"expected a finite pose (4, 4) of {body}", given, (4, 4))
        position = pose[:3, 3] + pose[:3, :3] @ com[index[body]]
        centred_poses[body] = np.concatenate([pose[:3, :3].ravel(), position])
    for body, given in twists.items():
        twist = usable(f"expected a finite twist (6,) of {body}", given, (6,))
        twist[3:] += np.cross(twist[:3], com[index[body]])
        centred_twists[body] = twist
    known = [joint.name for joint in engine.scene.joints if joint.type in COUPLED]
    for joint, values in joints.items():
        check_name(joint, known, "joint {} is not a joint with one coordinate")
        if not (
            isinstance(values, (tuple, list, np.ndarray))
            and len(values) == 2
            and all(value is None or is_finite(value) for value in values)
        ):
            raise ValueError(f"{joint} must be (position, velocity), both finite or None, {got(values)}")
        usable(joint, [value or 0.0 for value in values], (2,))
    if engine.now.offset:
        engine.advance(1)
    counted = [joint for joint, _ in engine.scene.unwrapped]
    angles = dict(zip(counted, engine._work.angle.tolist()))
    motions = zip(engine.layout.motions, engine.inputs.acting.motions)
    driven = {name: at(motion, engine.time)[1] for name, motion in motions}
    *state, angles = rearranged(
        engine.layout.centred, *engine.state(), centred_poses, centred_twists, joints, angles, driven
    )
    _refuse_beyond_stops(engine, *state, joints, angles)
    _refuse_beyond_limits(engine, *state, joints)
    motions, before = engine.inputs.acting.motions.copy(), engine.inputs.commands
    present, applied, events = engine.sample(), engine.inputs.log, engine.events.pending
    kept = [*(angles[joint] for joint in counted), *engine._work.angle[len(counted) :]]
    kept = np.array(kept)
    kept[places_of_branches(engine.layout.model.forces.laws)] = UNKNOWN  # it may be beside its surfaces now
    engine.set_state(*state, engine.steps, kept)
    _keep_turns(engine, present, joints)
    engine.inputs.commands = _motions_after(engine, motions, before, joints)
    engine.inputs.log, engine.events.pending = applied, events  # the run goes on
    engine.inputs.update(engine.now)


def _keep_turns(engine, before, joints):
    """Unwrap the angles of joints with stops or friction: near given ones, or those of an earlier Sample.

    joints : {joint: (position, velocity)} that were given, with their whole turns
    """
    if engine._switching is None:
        return
    now, were = engine.sample().joint_coordinates, before.joint_coordinates
    near = before.switching[:, 3].copy()
    for k, switch in enumerate(engine.layout.switches):
        given, _ = joints.get(switch.name, (None, None))
        if given is not None:
            near[k] = given
        elif switch.name in engine.layout.coordinates.counted:
            near[k] += now[switch.name][0] - were[switch.name][0]
    engine._switching.expect(near)


def switch_places(layout, pose, twist):
    """[(Switch, its coordinate)] of a state at the centres of mass, rad or m; angles up to whole turns."""
    return switch_coordinates(layout.centred, _start_of(layout, pose, twist), layout.joint_frames)


def _refuse_beyond_stops(engine, pose, twist, joints, angles):
    """Raise SceneError if a rigid stop does not allow a state, or a coordinate that was given."""
    layout, start = engine.layout, _start_of(engine.layout, pose, twist)
    coordinates = switch_coordinates(layout.centred, start, layout.joint_frames, angles)
    for (switch, q), size in zip(coordinates, layout.switch_sizes):
        limits, (given, _) = switch.limits, joints.get(switch.name, (None, None))
        if limits is None or limits.stiffness is not None:
            continue
        q = q if given is None else given
        if limits.excess(q) > BEYOND * size:
            unit = unit_of(switch, engine.scene)
            what = "joint" if switch.coupling is None else "coupling"
            raise SceneError(
                f"{what} {switch.name} would be beyond its stop: its position {q:.9g} {unit} is not "
                f"between {limits.least:g} and {limits.largest:g}; set a state between the stops"
            )


def _refuse_beyond_limits(engine, pose, twist, joints):
    """Raise BeyondLimits if a joint leaves the limits of its commands, or a given value is beyond them."""
    all_limits = engine.layout.limits
    before = dict(_positions(engine, *engine.state()))
    for joint, near in _positions(engine, pose, twist):
        limits, (given, velocity) = all_limits[joint], joints.get(joint, (None, None))
        if given is not None or not limits.holds(near) and limits.holds(before[joint]):
            limits.check_position(near if given is None else given)
        if velocity is not None:
            limits.check_velocity(velocity)


def _positions(engine, pose, twist):
    """(joint, position in the turn nearest to its limits) of the joints with limits of commands, at a `state()`."""
    for joint, (q, _) in _joint_states(engine, pose, twist, lambda joint: joint.name in engine.layout.limits):
        limits = engine.layout.limits[joint.name]
        middle = 0.5 * (limits.lower + limits.upper)
        yield joint.name, middle + difference(q, middle, turns(joint)) if math.isfinite(middle) else q


def _start_of(layout, pose, twist):
    """{name: (pose (4, 4), twist (6,))} of the bodies and the world, at a state of `state()`."""
    start = {WORLD: (np.eye(4), np.zeros(6))}
    for body, *of_body in zip(layout.centred.bodies, pose, twist):
        start[body.name] = pose_matrix(of_body[0]), of_body[1]
    return start


def _joint_states(engine, pose, twist, wanted):
    """(joint of the scene, (position, velocity)) of joints for which `wanted` is true, at a `state()`."""
    start = _start_of(engine.layout, pose, twist)
    for joint, frames in zip(engine.layout.centred.joints, engine.layout.joint_frames):
        if wanted(joint):
            yield joint, joint_state(start, joint, *frames)


def _motions_after(engine, motions, before, joints):
    """Commands after a new state: those of driven joints that it does not move, constant rates of the others.

    motions : (d, 7) of the driven joints before
    before  : Commands before
    joints  : {joint: (position, velocity)} that were given, with their whole turns
    """
    acting, waiting = [], []
    driven = _joint_states(engine, *engine.state(), lambda joint: joint.driven)
    for (joint, (q, v)), motion in zip(driven, motions):  # in the order of the joints, too
        was = at(motion, engine.time)
        near, _ = joints.get(joint.name, (None, None))
        near = was[0] if near is None else near
        off = near + difference(q, near, turns(joint)) - was[0]
        if max(abs(off), abs(v - was[1])) > MOVED * (1.0 + abs(was[0]) + abs(v)):
            row = uniform(engine.time, was[0] + off, v)
            acting.append(Command(MOTION, joint.name, tuple(map(float, row)), engine.time_ns))
            continue
        for part, commands in ((acting, before.acting), (waiting, before.waiting)):
            part += [c for c in commands if c.kind == MOTION and c.name == joint.name]
    return Commands(tuple(acting), tuple(waiting))
