# SPDX-License-Identifier: Apache-2.0
"""Checks of the names that entries of a scene refer to: they must exist and have a suitable type."""

from liegroup_core.errors import SceneError
from liegroup_core.fields.values import suggestion
from liegroup_core.joints.coupling import COUPLED
from liegroup_core.joints.kinds import TYPES
from liegroup_core.joints.stops import SLIDE, TURN, WITH_STOPS

WORLD = "world"


def refuse_twins(entries):
    """Refuse duplicate names among the (list, index, name) entries."""
    first = {}
    for key, i, name in entries:
        if name in first:
            raise SceneError(
                f'{key}[{i}] "{name}": this name is already used by {first[name]}: choose another',
                place=(key, i, "name"),
            )
        first[name] = f"{key}[{i}]"


def refuse_ends(link, bodies, key, i):
    """Refuse a joint or force that does not connect a body to another body or to the world."""
    where = f'{key}[{i}] "{link.name}": '
    if link.child == WORLD:
        hint = "name a body" if link.parent == WORLD else "swap parent and child"
        raise SceneError(f"{where}child must be a body, not {WORLD}: {hint}", place=(key, i, "child"))
    refuse_unknown("parent", link, [WORLD, *bodies], key, i)
    refuse_unknown("child", link, bodies, key, i)
    if link.parent == link.child:
        raise SceneError(f'{where}parent and child are both "{link.child}": they must differ', place=(key, i, "child"))


def refuse_unknown(end, link, known, key, i):
    """Refuse a joint or force whose `end` is not one of the known bodies."""
    name = getattr(link, end)
    if name not in known:
        raise SceneError(
            f'{key}[{i}] "{link.name}": {end} {name!r:.40} is not a body; {suggestion(name, known)}',
            place=(key, i, end),
        )


def refuse_joint(force, kinds, i):
    """Refuse a force whose joint does not exist or does not allow the motion that it acts on."""
    where, place = f'forces[{i}] "{force.name}": ', ("forces", i, "joint")
    if force.joint not in kinds:
        hint = suggestion(force.joint, list(kinds)) if kinds else "the scene has no joints"
        raise SceneError(f"{where}joint {force.joint!r:.40} is not a joint; {hint}", place=place)
    if not getattr(TYPES[kinds[force.joint]], force.joint_moves):
        fitting = [name for name, kind in TYPES.items() if getattr(kind, force.joint_moves)]
        raise SceneError(
            f'{where}joint "{force.joint}" is {kinds[force.joint]}, but {force.type} '
            f"requires a joint that is {' or '.join(fitting)}",
            place=place,
        )


def refuse_sensor(sensor, bodies, kinds, taken, i):
    """Refuse a sensor whose name is taken, or whose body or joint does not exist or is not suitable.

    bodies : names; kinds : {joint: type}; taken : all other names
    """
    where = f'sensors[{i}] "{sensor.name}": '
    if sensor.name in taken:
        raise SceneError(f"{where}this name is already used: choose another", place=("sensors", i, "name"))
    if hasattr(sensor, "body"):
        refuse_unknown("body", sensor, bodies, "sensors", i)
    elif hasattr(sensor, "child"):
        refuse_ends(sensor, bodies, "sensors", i)
    else:
        place = ("sensors", i, "joint")
        if sensor.joint not in kinds:
            hint = suggestion(sensor.joint, list(kinds)) if kinds else "the scene has no joints"
            raise SceneError(f"{where}joint {sensor.joint!r:.40} is not a joint; {hint}", place=place)
        if sensor.needs_coordinate and TYPES[kinds[sensor.joint]].coordinate is None:
            raise SceneError(
                f'{where}joint "{sensor.joint}" is {kinds[sensor.joint]}, which has no single angle '
                "or displacement: use a pose sensor",
                place=place,
            )


def refuse_two_servos(forces):
    """Refuse a second servo at a joint, because commands address servos by their joint."""
    first = {}
    for i, force in enumerate(forces):
        if force.group != "servos":
            continue
        if force.joint in first:
            raise SceneError(
                f'forces[{i}] "{force.name}": joint "{force.joint}" already has the servo '
                f'"{first[force.joint]}": keep one of them',
                place=("forces", i, "joint"),
            )
        first[force.joint] = force.name


def refuse_motion(joint, forces, i):
    """Refuse a prescribed motion if the joint is not driven, cannot be driven, or has a servo."""
    if joint.motion is not None and not joint.driven:
        raise SceneError(f'joints[{i}] "{joint.name}": motion requires driven: true', place=("joints", i, "motion"))
    if not joint.driven:
        return
    place = ("joints", i, "driven")
    if joint.type not in COUPLED:
        raise SceneError(
            f'joints[{i}] "{joint.name}": a {joint.type} joint cannot be driven; only '
            f"{', '.join(COUPLED[:-1])} or {COUPLED[-1]} joints can",
            place=place,
        )
    for force in forces:
        if force.group == "servos" and force.joint == joint.name:
            raise SceneError(
                f'joints[{i}] "{joint.name}": a driven joint cannot have the servo "{force.name}": keep one of them',
                place=place,
            )


def refuse_switches(joint, i):
    """Refuse stops or friction of a joint whose type has none, or that is driven."""
    for key in ("limits", "friction"):
        if getattr(joint, key) is None:
            continue
        reason = None
        if joint.type not in WITH_STOPS and not (joint.type == "spherical" and key == "limits"):
            reason = _kinds_that_have(key, joint.type)
        elif key == "friction" and (text := _unfit_load(joint)):
            reason = text
        elif joint.driven:
            reason = f"a driven joint moves as prescribed; remove driven or {key}"
        if reason:
            raise SceneError(f'joints[{i}] "{joint.name}": {key}: {reason}', place=("joints", i, key))


def _kinds_that_have(key, kind):
    """Message that joints of this type have no stops or friction, with the types that do."""
    if key == "limits" and kind in ("cable", "strut"):
        return f"a {kind} has its length as its stop; give length, and restitution or stiffness"
    which = [*WITH_STOPS, "spherical"] if key == "limits" else WITH_STOPS
    return f"a {kind} joint has none; only {', '.join(which[:-1])} and {which[-1]} joints do"


def _unfit_load(joint):
    """Message why friction by load is not possible at a joint, or ""."""
    for switch in joint.switches:
        friction = switch.friction
        if friction is None or not friction.by_load[1]:
            continue
        if joint.type == "screw":
            return "mu: a screw joint has no friction by load; give coulomb and static"
        if switch.kind == TURN and friction.radius is None:
            return "mu requires the radius of the bearing, in m"
        if switch.kind == SLIDE and friction.radius is not None:
            return "radius: a translation has none; remove it"
    return ""


def refuse_coupling(coupling, kinds, i):
    """Refuse a coupling if a joint does not exist or has not exactly one coordinate."""
    where = f'couplings[{i}] "{coupling.name}": '
    ends = [("joint", coupling.joint), ("other", coupling.other), *(("terms", name) for name in coupling.terms)]
    for k, (end, name) in enumerate(ends):
        place = ("couplings", i, end)
        if name not in kinds:
            hint = suggestion(name, list(kinds)) if kinds else "the scene has no joints"
            raise SceneError(f"{where}{end} {name!r:.40} is not a joint; {hint}", place=place)
        if kinds[name] not in COUPLED:
            raise SceneError(
                f'{where}joint "{name}" is {kinds[name]}, but a coupling requires joints that are '
                f"{', '.join(COUPLED[:-1])} or {COUPLED[-1]}",
                place=place,
            )
        if same := [before for before, known in ends[:k] if known == name]:
            raise SceneError(f'{where}{same[0]} and {end} are both "{name}": they must differ', place=place)
