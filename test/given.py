# SPDX-License-Identifier: Apache-2.0
"""Commands of a run as inputs of the reference integration."""

from liegroup_core.forces.commands import EFFORT, MOTION, TARGET
from liegroup_core.reference import JointChange, WrenchSpan
from liegroup_sim_ros.recording.input_track import FOREVER, KINDS, InputTrack


def reference_inputs(layout, commands):
    """[WrenchSpan or JointChange] of Commands from `drain_applied`."""
    found, track = [], InputTrack()
    for command in commands:
        if command.kind in (TARGET, MOTION):
            found.append(JointChange(command.start, command.name, command.values))
        elif command.kind in KINDS:
            track.add(0, 0, command)
    for start, end, k in zip(*(part.tolist() for part in track.spans())):
        times = start * 1e-9, float("inf") if end == FOREVER else end * 1e-9
        command = track[k]
        if command.kind != EFFORT:
            found.append(WrenchSpan(*times, command.name, command.values, command.axes, command.point))
            continue
        for body, unit in layout.unit_efforts[command.name]:
            found.append(WrenchSpan(*times, layout.body_names[body], tuple(command.values[0] * unit)))
    return found
