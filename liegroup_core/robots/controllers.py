# SPDX-License-Identifier: Apache-2.0
"""Controllers of Gazebo that act without a command and equal a servo of a scene: JointPositionController."""

import numpy as np

from .actuators import FREE, Actuator
from .description import ONE_COORDINATE
from .sdf_frames import text_of
from .xml import value_of

POSITION = "joint-position-controller"  # in the name of the plugin's file


def add_servos(reader, robot, plugin, full_name):
    """Give joints the servo that a plugin equals; returns False if the plugin is no such controller.

    It is a servo if its integral gain is 0, as its default is not, and if its limits are symmetric.
    full_name : function name in the file -> name of the joint in the Robot
    """
    joints = [robot.joint(full_name((part.text or "").strip())) for part in plugin.iterfind("joint_name")]
    if POSITION not in (plugin.get("filename") or "") or not joints or None in joints:
        return False
    p, i, d, low, high, offset, index, position = (
        value_of(reader, plugin, key, default)
        for key, default in (
            *(("p_gain", 1.0), ("i_gain", 0.1), ("d_gain", 0.01), ("cmd_min", -1000.0), ("cmd_max", 1000.0)),
            *(("cmd_offset", 0.0), ("joint_index", 0.0), ("initial_position", 0.0)),
        )
    )
    exact = i == offset == index == 0.0 and p >= 0.0 and d >= 0.0 and (low > high or high == -low > 0.0)
    exact = exact and text_of(plugin, "use_velocity_commands") in (None, "false", "0")
    held = {name for actuator in robot.actuators for name in actuator.shares}
    if not exact or any(joint.type not in ONE_COORDINATE or joint.name in held for joint in joints):
        return False
    law, limits = np.array([p * position, -p, -d]), FREE if low > high else (low, high)  # such limits do not act
    for joint in joints:
        shares, line = {joint.name: 1.0}, plugin.sourceline
        robot.actuators.append(Actuator(f"{joint.name}_servo", line, shares, 0.0, law, np.zeros(3), forces=limits))
    return True
