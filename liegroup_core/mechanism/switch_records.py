# SPDX-License-Identifier: Apache-2.0
"""Table of the switches of a RelativeModel: coordinates with stops or dry friction."""

import math

import numpy as np

from liegroup_core.joints.elements import WORLD
from liegroup_core.joints.kinds import COORDINATES
from liegroup_core.joints.stops import SLIDE, TURN
from liegroup_core.scene.switches import switches_of, unit_of

from .arrays import SWITCH

FRAMES = ("parent", "child", "parent_point", "parent_rotation", "child_point", "child_rotation")
FREEDOMS = (TURN, SLIDE)  # kinds that a degree of freedom of a link can be


def _links_of(links):
    return {link.joint: b for b, link in enumerate(links) if link.joint is not None}


def stop_rows(scene, links):
    """[(joint, Element)]: a row for each stop or friction whose coordinate is no degree of freedom of the tree."""
    in_tree = _links_of(links)
    return [
        (switch.joint, COORDINATES[switch.kind])
        for switch in switches_of(scene)
        if switch.joint is not None and not (switch.kind in FREEDOMS and switch.joint in in_tree)
    ]


def switch_arrays(scene, links, records, arrays, elements, places, size):
    """Arrays of a RelativeModel: its switches, in the order of `switches_of`, and which rows are theirs.

    links, records : links of the spanning tree, and their LINK records
    arrays         : of the rows (cuts.py);  elements : those of the cut joints, stops and couplings
    places         : {body: (link or WORLD, its pose there)};  size : characteristic length, m
    """
    in_tree, found = _links_of(links), switches_of(scene)
    freedoms, rows = int(records["freedoms"].sum()), len(arrays["row_residual"])
    of_element = {int(joint["element"]): int(joint["first"]) for joint in arrays["cuts"]}
    couplings = len(scene.couplings) + sum(joint.driven for joint in scene.joints)
    number = len(elements) - couplings - len(stop_rows(scene, links))
    table, switched = np.zeros(len(found), dtype=SWITCH), np.zeros(rows, dtype=np.int64)
    for record, switch in zip(table, found):
        record["row"] = record["joint"] = record["link"] = -1
        sign = 1.0
        if switch.kind in FREEDOMS and switch.joint in in_tree:
            b = record["link"] = in_tree[switch.joint]
            second = switch.kind == SLIDE and scene.joints[switch.joint].type == "cylindrical"
            record["component"], record["freedom"] = second, records[b]["freedom"] + second
            sign = links[b].sign
        else:
            element = number
            if switch.coupling is None:
                number += 1
                joint = scene.joints[switch.joint]
                # cuts.cut_elements exchanges the ends of a joint whose child is fixed.
                swapped = places[joint.child][0] == WORLD
                sign = -1.0 if switch.kind in FREEDOMS and swapped else 1.0
                record["joint"] = -1 if switch.joint in in_tree else switch.joint
            else:
                element = len(elements) - couplings + switch.coupling
            row = record["row"] = of_element[element]
            record["freedom"], switched[row] = freedoms + row, 1
        record["turned"], record["sign"] = switch.is_angle, sign
        record["unit"] = size if unit_of(switch, scene) == "m" else 1.0
        record["bearing"] = -1
        _set_numbers(record, switch, sign)
        if record["static_by_load"] and record["row"] >= 0:
            record["bearing"] = _bearing(arrays["cuts"], elements, record["row"])
    return {"switches": table, "switched": switched, "has_switched_rows": bool(switched.any())} | {
        "has_loads": bool(table["static_by_load"].any())
    }


def _bearing(joints, elements, row):
    """Index of the cut joint with the same frames as the joint of a row, but other rows."""
    (own,) = (elements[joint["element"]] for joint in joints if joint["first"] == row)
    for j, joint in enumerate(joints):
        element = elements[joint["element"]]
        same = all(np.array_equal(element[key], own[key]) for key in FRAMES)
        if same and joint["first"] != row:
            return j
    return -1


def _set_numbers(record, switch, sign):
    limits, friction = switch.limits, switch.friction
    stops = (-math.inf, math.inf) if limits is None else (limits.least, limits.largest)
    record["lower"], record["upper"] = stops if sign > 0.0 else (-stops[1], -stops[0])
    if limits is not None:
        record["expected"] = sign * limits.expected
        for key in ("restitution", "stiffness", "damping"):
            record[key] = getattr(limits, key) or 0.0
    if friction is not None:
        record["coulomb"], record["static"] = friction.coulomb, friction.at_rest
        record["viscous"] = friction.viscous
        record["sliding_by_load"], record["static_by_load"] = friction.by_load
