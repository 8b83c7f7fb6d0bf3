# SPDX-License-Identifier: Apache-2.0
"""Rotors of joints in URDF and SDF files, the extensions rotor_inertia and gear_ratio of Drake; rotors of loops."""

from lxml import etree

from .description import ONE_COORDINATE

OF_ROTOR = ("rotor_inertia", "gear_ratio")


def add_rotor(reader, robot, element, joint, text_of_part):
    """Give a joint the rotor that children of an element describe, in any namespace; of Drake.

    text_of_part : function (child) -> text of its number
    """
    parts = [element.find(f"{{*}}{name}") for name in OF_ROTOR]
    inertia, ratio = (
        None if part is None else reader.number(part, text_of_part(part), f"<{etree.QName(part).localname}>")
        for part in parts
    )
    if not inertia or ratio == 0.0:
        return
    if inertia < 0.0:
        raise reader.error(parts[0], f'rotor inertia of joint "{joint.name}" must not be negative, got {inertia:g}')
    if joint.type not in ONE_COORDINATE:
        robot.leave_out(f"rotors of {joint.type} joints", joint.name, changes_motion=True)
        return
    joint.rotor = {"inertia": inertia} | ({} if ratio is None else {"ratio": ratio})


def cut_rotors(robot, grouping, closing):
    """Leave out the smallest rotor of a loop that a weld closes if all its joints have one: a scene cuts one."""
    holders = {id(grouping.of_link[joint.child]): joint for joint in grouping.moving if joint not in closing}
    for weld in (joint for joint in closing if joint.type == "fixed"):
        loop = {}
        for link in (weld.parent, weld.child):
            while (joint := holders.get(id(grouping.of_link[link]))) is not None:
                link = joint.parent
                if loop.pop(joint.name, None) is None:
                    loop[joint.name] = joint
        if loop and all(joint.rotor for joint in loop.values()):
            joint = min(loop.values(), key=lambda j: j.rotor["inertia"] * j.rotor.get("ratio", 1.0) ** 2)
            joint.rotor = {}
            robot.leave_out("rotors of loops in which all joints have one", joint.name, changes_motion=True)
