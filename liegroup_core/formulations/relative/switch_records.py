# SPDX-License-Identifier: Apache-2.0
"""Table of the switches of a RelativeModel: freedoms with stops or dry friction."""

import math

import numpy as np

from liegroup_core.errors import SceneError

from .arrays import SWITCH


def switch_records(scene, links, records):
    """(k,) of SWITCH, in the order of the joints of a scene.

    links, records : links of the spanning tree, and their LINK records
    Raises SceneError for a joint with stops or friction that is no joint of the tree.
    """
    of_joint = {link.joint: b for b, link in enumerate(links) if link.joint is not None}
    rows = []
    for j, joint in enumerate(scene.joints):
        if not joint.switches:
            continue
        if j not in of_joint:
            key = "limits" if joint.limits else "friction"
            raise SceneError(
                f'joints[{j}] "{joint.name}": it has {key}, but so have all joints of a loop that it '
                "closes, or its bodies are welded; leave one joint of each loop without stops and "
                "friction",
                ("joints", j, key),
            )
        b = of_joint[j]
        rows.append(_record(joint, j, b, int(records[b]["freedom"]), links[b].sign))
    return np.array(rows, dtype=SWITCH)


def _record(joint, j, link, freedom, sign):
    limits, friction = joint.limits, joint.friction
    stops = (-math.inf, math.inf) if limits is None else (limits.least, limits.largest)
    if sign < 0.0:
        stops = -stops[1], -stops[0]
    expected = 0.0 if limits is None else sign * limits.expected
    restitution = stiffness = damping = 0.0
    if limits is not None:
        restitution, stiffness, damping = (
            value or 0.0 for value in (limits.restitution, limits.stiffness, limits.damping)
        )
    dry = (0.0, 0.0, 0.0)
    if friction is not None:
        dry = friction.coulomb, friction.at_rest, friction.viscous
    return j, link, freedom, 0, sign, *stops, expected, restitution, stiffness, damping, *dry
