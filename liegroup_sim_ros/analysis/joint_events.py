# SPDX-License-Identifier: Apache-2.0
"""Events at joints with stops or friction: their numbers, and the energy lost at impacts."""

import numpy as np

from liegroup_core.scene.switches import unit_of
from liegroup_sim_ros.messages.joint_modes import ENERGY, IMPULSE, switching
from liegroup_sim_ros.recording.read import RecordingError

KINDS = ("impact", "stop", "leave", "stick", "slip")
MOST_TIMES = 200  # largest number of instants that plots mark


def joint_events(recording, layout, motion):
    """(figures, (k,) times in s of the recording that plots mark); (None, None) without such joints.

    Rest at a stop, release from it, sticking and slipping follow from the modes of successive messages.
    Raises RecordingError if the modes do not fit the scene.
    """
    track = recording.joint_modes
    switches = layout.switches
    if track is None or not switches:
        return None, None
    if track.values.shape[1] != len(switches):
        raise RecordingError(f"{recording.path}: the number of its joint modes does not fit its scene")
    found = happened(track, [stretch.begin_ns for stretch in motion.all])
    instants = found.any(axis=(1, 2))
    impulses, energies = track.values[:, :, IMPULSE], track.values[:, :, ENERGY]
    figures = {
        "instants": int(instants.sum()),
        "impact_energy_J": float(energies.sum()),
        "joints": {
            switch.name: {
                **{kind: int(found[:, k, i].sum()) for i, kind in enumerate(KINDS)},
                "impact_energy_J": float(energies[:, k].sum()),
                "largest_impulse": float(np.abs(impulses[:, k]).max(initial=0.0)),
                "unit": "N s" if unit_of(switch, layout.scene) == "m" else "N m s",
            }
            for k, switch in enumerate(switches)
        },
    }
    return figures, _spread(track.time[instants])


def happened(track, begins):
    """(m, k, 5) mask of the KINDS of events at k joints in the m messages of a ModeTrack.

    begins : stamps at which the run starts, or continues from a state that was set, ns
    """
    modes = switching(track.values)
    held, side = modes[:, :, 0] != 0.0, modes[:, :, 2]
    rest = held & (side == 0.0)
    found = np.zeros((*held.shape, len(KINDS)), dtype=bool)
    found[:, :, 0] = track.values[:, :, IMPULSE] != 0.0
    changed = side[1:] != side[:-1]
    found[1:, :, 1] = changed & (side[1:] != 0.0)
    found[1:, :, 2] = changed & (side[1:] == 0.0)
    found[1:, :, 3] = rest[1:] & ~held[:-1]
    found[1:, :, 4] = rest[:-1] & ~held[1:]
    stretch = np.searchsorted(begins, track.stamp_ns, "right")
    found[1:][np.diff(stretch) > 0] = False
    return found


def _spread(times):
    """At most MOST_TIMES of the times: the first one in each of equal intervals."""
    if len(times) <= MOST_TIMES:
        return times
    bins = np.linspace(times[0], times[-1], MOST_TIMES, endpoint=False)
    first = np.unique(np.searchsorted(times, bins))
    return times[first]
