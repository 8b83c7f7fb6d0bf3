# SPDX-License-Identifier: Apache-2.0
"""Bodies for the rotation methods: each rotates about one point, free or on a spherical joint.

A free body rotates about its centre of mass. A held body rotates about its spherical joint, with
I = I_com + m (|d|^2 1 - d d^T), d from the joint to the centre of mass. Its centre of mass follows
from R and w: r = pivot + R d, v = w x d. The joint is satisfied to machine precision.
"""

import numpy as np

from liegroup_core.compiling import kernel
from liegroup_core.forces.law import law_with_time, laws_of
from liegroup_core.joints.elements import PAIR, WORLD
from liegroup_core.lie.vec3 import (
    ZERO3,
    add3,
    cross3,
    load3,
    load9,
    matvec3,
    scale3,
    store3,
    store9,
    sub3,
    tmatvec3,
    vector3,
)

# Columns of the memory of a step, per body: three of each, nine of Q. LINEAR, VELOCITY and PLACE
# are the present values of m R v, w and r at the end of the step.
TURN, MOMENTUM, TORQUE, FORCE, LINEAR, VELOCITY, PLACE, Q = 0, 3, 6, 9, 12, 15, 18, 21
COLUMNS = 30

SPINNER = np.dtype(
    [
        ("held", "i8"),  # 1: on a spherical joint; 0: free
        ("inertia", "f8", (9,)),  # kg m^2, about the point of rotation, body axes
        ("inverse_inertia", "f8", (9,)),  # 1/(kg m^2)
        ("arm", "f8", (3,)),  # m, from the joint to the centre of mass, body axes
        ("pivot", "f8", (3,)),  # m, the joint in the world
        ("mass", "f8"),  # kg
    ],
    align=True,
)


@kernel
def place(spinner, i, rot, w, r, linear, pose_out, twist_out):
    """Set body i to rotation R and angular velocity w; a free body also to r and m R v = linear."""
    if spinner["held"] == 1:
        arm = vector3(spinner["arm"])
        r = add3(vector3(spinner["pivot"]), matvec3(rot, arm))
        v = cross3(w, arm)
    else:
        # R^T is the inverse of R up to round-off. This stays the same for many steps, so refine once.
        v = tmatvec3(rot, linear)
        v = scale3(1.0 / spinner["mass"], add3(v, tmatvec3(rot, sub3(linear, matvec3(rot, v)))))
    store9(rot, pose_out, i, 0)
    store3(r, pose_out, i, 9)
    store3(w, twist_out, i, 0)
    store3(v, twist_out, i, 3)


@kernel
def load(spinner, work, i):
    """Torque about the point of rotation, body axes, and force, world axes, from work.wrench."""
    force = load3(work.wrench, i, 3)
    torque = load3(work.wrench, i, 0)
    if spinner["held"] == 1:
        return add3(torque, cross3(vector3(spinner["arm"]), force)), ZERO3
    return torque, matvec3(load9(work.stage_pose, i, 0), force)


@kernel
def linear_momentum(spinner, pose, twist, i):
    """Linear momentum m R v of body i, world axes."""
    return scale3(spinner["mass"], matvec3(load9(pose, i, 0), load3(twist, i, 3)))


def misfit(layout):
    """Reason why the methods cannot integrate a scene (layout.Layout), or ""."""
    held = set()
    for element, owner in zip(layout.model.elements, layout.owners):
        joint = layout.scene.joints[owner]
        if element["parent"] != WORLD or element["kind"] != PAIR or not element["turns_freely"]:
            return (
                "it requires bodies that are free or held by one spherical joint to the "
                f"ground, but {joint.name} is a {joint.type} joint from {joint.parent} to "
                f"{joint.child}"
            )
        if element["child"] in held:
            return f"it allows one spherical joint per body, but {joint.child} has more"
        held.add(element["child"])
    if timed := law_with_time(layout.scene.forces):
        return f"its stages have no times, but the law {timed} depends on t"
    for law in laws_of(layout.scene.forces):
        if law.states and law.period is None:
            return f"it integrates bodies only, but the law of {law.name} has states"
    return ""


def make_spinners(model):
    """Create the (n,) records of SPINNER of a model."""
    spinners = np.zeros(len(model.bodies), dtype=SPINNER)
    for name in ("mass", "inertia", "inverse_inertia"):
        spinners[name] = model.bodies[name]
    for element in model.elements:
        spinner = spinners[element["child"]]
        d = -element["child_point"]
        inertia = spinner["inertia"].reshape(3, 3) + spinner["mass"] * (d @ d * np.eye(3) - np.outer(d, d))
        spinner["held"], spinner["arm"], spinner["pivot"] = 1, d, element["parent_point"]
        spinner["inertia"] = inertia.ravel()
        spinner["inverse_inertia"] = np.linalg.inv(inertia).ravel()
    return spinners
