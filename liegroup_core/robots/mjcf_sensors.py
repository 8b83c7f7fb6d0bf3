# SPDX-License-Identifier: Apache-2.0
"""Conversion of MJCF sensors: several sensors at a site become one sensor of a scene.

    accelerometer, gyro, framequat          imu
    force, torque                           force_torque in the joint that holds the body of the site
    framepos, framequat, velocimeter        pose
    jointpos                                encoder

MuJoCo's force and torque act on the body of the site. They include the efforts of actuators, springs and
dampers of its joint. MuJoCo adds no noise: its attribute noise only informs users.
"""

from .description import RobotSensor, place

# {sensor of a scene: (types of which one must be present, types that it replaces)}. The order matters: each
# sensor of MuJoCo is used once.
AT_SITES = {
    "imu": (("accelerometer", "gyro"), ("accelerometer", "gyro", "framequat")),
    "force_torque": (("force", "torque"), ("force", "torque")),
    "pose": (("framepos", "velocimeter"), ("framepos", "framequat", "velocimeter")),
}


def read_sensors(robot, model, names, rotation, lines):
    """Append the sensors of a compiled model to a Robot; sensors without counterpart are left out.

    names : names of the bodies; rotation : function quaternion w x y z -> (3, 3)
    lines : {(tag, name): line of the file}
    """
    at_sites, others = {}, []
    for sensor in model["sensors"]:
        if sensor["site"] is not None and sensor["plain"]:
            at_sites.setdefault(sensor["site"]["number"], []).append(sensor)
        else:
            others.append(sensor)
    for sensors in at_sites.values():
        for kind, (needed, taken) in AT_SITES.items():
            used = [each for each in sensors if each["type"] in taken]
            if any(each["type"] in needed for each in used):
                sensors = [each for each in sensors if each not in used]
                if not _at_site(robot, kind, used, names, rotation, lines):
                    others += used
        others += sensors
    labels = [joint["label"] for joint in model["joints"]]
    for sensor in others:
        joint = model["joints"][sensor["joint"]] if sensor["joint"] is not None else None
        if joint and sensor["type"] == "jointpos" and sensor["plain"] and joint["zero"] != 0.0:
            robot.leave_out("sensors", f"{sensor['name']}, whose angle MuJoCo counts from another zero, by ref")
        elif joint and sensor["type"] == "jointpos" and sensor["plain"]:
            label = labels[sensor["joint"]]
            line = lines.get((sensor["type"], sensor["name"]), 0)
            robot.sensors.append(RobotSensor(sensor["name"], "encoder", line, joint=label))
        else:
            robot.leave_out("sensors", sensor["name"])


def _at_site(robot, kind, used, names, rotation, lines):
    """Append a sensor at a site. Returns False at the world, and for force and torque without a joint."""
    site = used[0]["site"]
    if site["body"] == 0:
        return False
    link = names[site["body"] - 1]
    # The first sensor with a name determines the name.
    known = [lines[key] for each in used if (key := (each["type"], each["name"])) in lines]
    names_of = [each["name"] for each in used if (each["type"], each["name"]) in lines]
    found = RobotSensor(
        names_of[0] if names_of else site["name"] or used[0]["name"],
        kind,
        known[0] if known else 0,
        link=link,
        frame=place(site["pos"], rotation(site["quat"])),
    )
    if kind == "force_torque":
        joint = next((j for j in robot.joints if j.child == link and not j.closes), None)
        if joint is None:
            return False
        found.link, found.joint = None, joint.name
        if joint.type != "fixed":
            found.values["measures"] = "transmitted"
    robot.sensors.append(found)
    return True
