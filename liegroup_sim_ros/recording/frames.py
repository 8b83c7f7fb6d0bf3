# SPDX-License-Identifier: Apache-2.0
"""Contents of a recording as pandas DataFrames; pandas is an optional package."""

import numpy as np

from liegroup_core.forces.commands import PULL
from liegroup_core.observables.quantities import COORDINATE, POSITION, QUATERNION, TWIST, WRENCH
from liegroup_sim_ros.messages.commands import MOTION_COLUMNS
from liegroup_sim_ros.messages.joint_modes import COLUMNS as MODE_COLUMNS

# {what: (attribute of a Recording, columns of each of its names)}
WIDE = {
    "joints": ("joint_states", (*COORDINATE, "effort")),
    "servo_targets": ("servo_targets", COORDINATE),
    "motions": ("motions", MOTION_COLUMNS),
    "joint_modes": ("joint_modes", MODE_COLUMNS),
    "errors": ("errors", ("position", "attitude", "velocity", "angular_velocity")),  # m, rad, m/s, rad/s
}


# Of a pull, which has its torque in the columns of a wrench.
PULLED = ("stiffness", "damping", "to_x", "to_y", "to_z", "turning_damping")


def _wrench_of(command):
    values = command.values[5:8] if command.kind == PULL else command.values
    return (*values, *(np.nan,) * 6)[:6]


def _pull_of(command):
    return (*command.values[:5], command.values[8]) if command.kind == PULL else (np.nan,) * 6


def data_frame(recording, what):
    """DataFrame with the time in s as index; see Recording.to_pandas."""
    import pandas

    if what == "motion":
        parts = {}
        for body in recording.bodies:
            pose, twist = recording.pose[body], recording.twist[body]
            parts[body] = pandas.concat(
                [
                    pandas.DataFrame(np.hstack(pose[1:]), pose.time, [*POSITION, *QUATERNION]),
                    pandas.DataFrame(twist.twist, twist.time, [*TWIST]),
                ],
                axis=1,
            )
        frame = pandas.concat(parts, axis=1)
    elif what == "inputs":
        none = (np.nan,) * 3
        rows = [
            (c.kind, c.name, c.source, c.axes, *_wrench_of(c), *_pull_of(c), *(c.point or none), c.start_ns, c.end_ns)
            for c in recording.inputs
        ]
        columns = ["kind", "name", "source", "axes", *WRENCH, *PULLED, "px", "py", "pz", "start", "end"]
        frame = pandas.DataFrame(rows, recording.inputs.stamp_ns * 1e-9, columns)
        frame[["start", "end"]] = frame[["start", "end"]].astype(float) * 1e-9
    elif what in WIDE:
        attribute, columns = WIDE[what]
        track, frame = getattr(recording, attribute), pandas.DataFrame()
        if track is not None:
            names, *values = (recording.bodies, track.errors) if what == "errors" else track[1:]
            numbers = np.stack(values[: len(columns)], axis=2) if values[0].ndim == 2 else values[0]
            columns = pandas.MultiIndex.from_product([names, columns])
            frame = pandas.DataFrame(numbers.reshape(-1, len(columns)), track.stamp_ns * 1e-9, columns)
    elif what in ("reactions", "impulses"):
        # (stamp_ns, time, wrench or impulse) of each joint.
        parts = {
            joint: pandas.DataFrame(track[-1], track.time, [*WRENCH])
            for joint, track in getattr(recording, what).items()
        }
        frame = pandas.concat(parts, axis=1) if parts else pandas.DataFrame()
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
