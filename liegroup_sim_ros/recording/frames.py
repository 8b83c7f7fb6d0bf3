# SPDX-License-Identifier: Apache-2.0
"""Contents of a recording as pandas DataFrames; pandas is an optional package."""

import numpy as np

from liegroup_sim_ros.messages.commands import MOTION_COLUMNS
from liegroup_sim_ros.messages.joint_modes import COLUMNS as MODE_COLUMNS

WRENCH = ["tx", "ty", "tz", "fx", "fy", "fz"]  # N m, N
ERRORS = ("position", "attitude", "velocity", "angular_velocity")  # m, rad, m/s, rad/s


def data_frame(recording, what):
    """DataFrame with the time in s as index; see Recording.to_pandas."""
    import pandas

    if what == "motion":
        parts = {}
        for body in recording.bodies:
            pose, twist = recording.pose[body], recording.twist[body]
            parts[body] = pandas.concat(
                [
                    pandas.DataFrame(np.hstack(pose[1:]), pose.time, ["x", "y", "z", "qx", "qy", "qz", "qw"]),
                    pandas.DataFrame(twist.twist, twist.time, ["wx", "wy", "wz", "vx", "vy", "vz"]),
                ],
                axis=1,
            )
        frame = pandas.concat(parts, axis=1)
    elif what == "inputs":
        none = (np.nan,) * 3
        rows = [
            (c.kind, c.name, c.source, c.axes, *(*c.values, *none, *none)[:6], *(c.point or none), c.start_ns, c.end_ns)
            for c in recording.inputs
        ]
        columns = ["kind", "name", "source", "axes", *WRENCH, "px", "py", "pz", "start", "end"]
        frame = pandas.DataFrame(rows, recording.inputs.stamp_ns * 1e-9, columns)
        frame[["start", "end"]] = frame[["start", "end"]].astype(float) * 1e-9
    elif what in ("joints", "servo_targets"):
        states = recording.joint_states if what == "joints" else recording.servo_targets
        parts = ("position", "velocity", "effort")[: 3 if what == "joints" else 2]
        frame = (
            pandas.DataFrame()
            if states is None
            else pandas.concat(
                {
                    name: pandas.DataFrame({part: getattr(states, part)[:, k] for part in parts}, states.time)
                    for k, name in enumerate(states.names)
                },
                axis=1,
            )
        )
    elif what == "motions":
        track = recording.motions
        frame = (
            pandas.DataFrame()
            if track is None
            else pandas.DataFrame(
                track.motion.reshape(len(track.motion), -1),
                track.stamp_ns * 1e-9,
                pandas.MultiIndex.from_product([track.names, MOTION_COLUMNS]),
            )
        )
    elif what == "joint_modes":
        track = recording.joint_modes
        frame = (
            pandas.DataFrame()
            if track is None
            else pandas.DataFrame(
                track.values.reshape(len(track.values), -1),
                track.time,
                pandas.MultiIndex.from_product([track.names, MODE_COLUMNS]),
            )
        )
    elif what in ("reactions", "impulses"):
        # (stamp_ns, time, wrench or impulse) of each joint.
        parts = {
            joint: pandas.DataFrame(track[-1], track.time, WRENCH) for joint, track in getattr(recording, what).items()
        }
        frame = pandas.concat(parts, axis=1) if parts else pandas.DataFrame()
    elif what == "errors":
        track = recording.errors
        columns = pandas.MultiIndex.from_product([recording.bodies, ERRORS])
        frame = (
            pandas.DataFrame()
            if track is None
            else pandas.DataFrame(track.errors.reshape(len(track.errors), len(columns)), track.time, columns)
        )
    elif what == "events":
        frame = pandas.DataFrame(
            [event[1:] for event in recording.events],
            [event.stamp_ns * 1e-9 for event in recording.events],
            ["name", "text"],
        )
    else:
        raise ValueError(
            "what must be motion, inputs, joints, motions, servo_targets, joint_modes, reactions, "
            f"impulses, errors or events, got {what!r}"
        )
    frame.index.name = "time_s"
    return frame
