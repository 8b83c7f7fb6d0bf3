# SPDX-License-Identifier: Apache-2.0
"""Elements of SDF, and of <gazebo> in URDF, that a scene has no counterpart for: whether they change the motion."""

import re

# Elements that change the motion, those of ACTING only if one of their texts is neither false nor zero.
PARTS = ("joint", "link", "model", "population")
ACTING = ("wind", "enable_wind", "static", "kinematic", "velocity_decay", "dampingFactor", "fluid_added_mass", "state")
OF_GRAVITY = ("gravity", "enable_gravity")  # they change it if they say no
# Words in the names of plugins that measure, publish or draw.
PASSIVE = set(
    "altimeter audio battery broadcaster bumper camera commands comms contact depth dvl forcetorque ft gps gui imu "
    "kinect label laser lidar log magnetometer monitor navsat odometry openni p3d particle physics pressure projector "
    "publisher range ray realsense recorder scene sensor sensors shader sonar tactile thermal touch video".split()
)
_WORD = re.compile("[A-Z]?[a-z0-9]+|[A-Z]+")


def omit(robot, element, what, name):
    """Note an element that is left out; `what`: its kind in a note, name: of the element or of its owner."""
    tag = element.tag
    if tag == "plugin":
        file = element.get("filename") or ""
        name = element.get("name") or file or name
        if passive(file or name):
            robot.leave_out("plugin", name)
        else:
            robot.leave_out("plugins that may act on bodies or joints", name, changes_motion=True)
    elif tag in OF_GRAVITY:
        robot.leave_out(what, name, all(_is_nothing(text) for text in element.itertext()))
    elif tag not in ACTING:
        robot.leave_out(what, name, tag in PARTS)
    elif not all(_is_nothing(text) for text in element.itertext()):
        robot.leave_out(what, name, changes_motion=True)


def passive(file):
    """Whether a plugin neither moves nor holds anything without a command, by the name of its file."""
    words = {word.lower() for word in _WORD.findall(file)}
    # Controllers of ROS wait for commands.
    return bool(words & PASSIVE) or ("control" in words and any("ros" in word for word in words))


def _is_nothing(text):
    try:
        return text.strip().lower() == "false" or not any(map(float, text.split()))
    except ValueError:
        return False
