# SPDX-License-Identifier: Apache-2.0
"""Characteristic length of a mechanism, to which position errors and constraint residuals refer."""

import numpy as np

from liegroup_core.joints import distance
from liegroup_core.joints.elements import WORLD
from liegroup_core.joints.stops import DISTANCE


def mechanism_size(model, joints):
    """Characteristic length in m: the largest of the following lengths, or 1 m if all are zero.

    Radii of gyration, distances from a joint or a rim to a centre of mass, and the lengths of massless rods,
    cables and struts.

    model, joints : Model and the joints of its scene
    """
    bodies, elements = model.bodies, model.elements
    gyration = np.sqrt(bodies["inertia"][:, [0, 4, 8]].sum(axis=1) / bodies["mass"])
    arms = [
        np.linalg.norm(elements[f"{end}_point"][elements[end] != WORLD], axis=1).max(initial=0.0)
        for end in ("parent", "child")
    ]
    rods = elements["parameter"][elements["kind"] == distance.KIND].max(initial=0.0)
    cables = [joint.length for joint in joints if any(switch.kind == DISTANCE for switch in joint.switches)]
    return float(max(gyration.max(), *arms, rods, *cables)) or 1.0
