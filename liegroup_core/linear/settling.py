# SPDX-License-Identifier: Apache-2.0
"""Motion to rest, for a trim of what stands on contacts: dynamic relaxation.

Where no point presses, nothing resists a displacement, and each point that touches or leaves changes the equations: so
Newton's method finds what carries a robot from a pose near it only. The motion leads there. Its rates are set to zero
whenever its kinetic energy has passed a maximum, so that it comes to rest without any damper.
"""

from types import SimpleNamespace

import numpy as np

from liegroup_core.accuracy import METHOD
from liegroup_core.engine import Engine
from liegroup_core.errors import SimulationError
from liegroup_core.mechanism.mechanism import tree_of
from liegroup_core.observables.sample import Sample

ACCURACY = 1e-4  # of the motion, relative
PARTS = 20  # steps in the time sqrt(size / g), at least
LONGEST = 40.0  # of these times
SLOW = 1e-3, 1e-4, 1e-5, 1e-6  # largest speeds since the rates were zero, of sqrt(size g), one after another
TIPPED = 1.0  # rad, from which on a floating part has tipped over: on its edge a cube turns by 0.8


def lifted(layout, base):
    """A Sample with the parts that are deep in planes moved out of them, along the normals; None: none is."""
    scene, names, (pose, twist) = layout.centred, layout.body_names, (each.copy() for each in base._state)
    tree, root, is_deep = tree_of(scene), {0: 0}, False
    for group, parent, joint in tree.links:
        root[group] = group if joint is None else root[parent]
    part = {body: root[group] for body, group in tree.group.items()}
    between = [{part[scene.joints[j].parent], part[scene.joints[j].child]} for j in tree.cut]
    held = {0}.union(*(ends for ends in between if len(ends) > 1))  # by loops with the world, or with other parts
    for contact in scene.forces:
        if contact.type == "contact" and part[contact.body] not in held:
            own, i = [part[name] == part[contact.body] for name in names], names.index(contact.body)
            place = SimpleNamespace(rotation=pose[i, :9].reshape(3, 3), position=pose[i, 9:])
            times, depth = contact.too_deep(place)
            if times:
                pose[own, 9:] += depth * contact.plane.unit
                is_deep = True
    return _sample(layout, base, pose, twist, base) if is_deep else None


def rests(simulation, base):
    """Generator of Samples at rest along the motion from a Sample on, each found at lower speeds than the one before.

    Raises SimulationError where a part tips over, or the motion does not come to rest.
    """
    layout = simulation.layout
    gravity = max(float(np.linalg.norm(layout.scene.gravity)), 1.0)
    unit = float(np.sqrt(layout.size / gravity))
    step = simulation.step / max(1.0, np.ceil(simulation.step * PARTS / unit))
    engine = Engine(layout.scene, METHOD, step, quiet=True, layout=layout, rtol=ACCURACY, atol=ACCURACY)
    engine.start_from(simulation)
    floating = [layout.body_names.index(members[0]) for members in _floating(layout.centred)]
    start, limits, sample, fastest = base.pose[floating, :9], list(SLOW), base, np.inf
    for _ in range(int(LONGEST * unit / step)):
        pose, twist = sample._state
        speed = _speed(layout.model.bodies, twist)
        if speed < fastest:
            _stop(engine, pose, sample.angles)
            if fastest <= limits[0] * unit * gravity:
                limits = [limit for limit in limits if fastest > limit * unit * gravity]
                yield _sample(layout, base, pose, 0.0 * twist, sample)
                if not limits:
                    break
            speed = 0.0
        fastest = speed
        engine.advance()
        sample = engine.sample()
        turns = (start * sample.pose[floating, :9]).sum(axis=1)  # 1 + 2 cos of the angle
        if (turns < 1.0 + 2.0 * np.cos(TIPPED)).any():
            raise SimulationError(
                f"left to itself {layout.body_names[floating[int(turns.argmin())]]} tips over or rolls away, by "
                f"{TIPPED:g} rad within {sample.time - base.time:.2g} s: on one or two points nothing stands"
            )
    raise SimulationError(f"left to itself it does not come to rest within {LONGEST * unit:.2g} s")


def _sample(layout, base, pose, twist, other):
    """Sample of a pose and a twist at the time of a Sample, with the angles and modes of another one."""
    found = Sample(layout, base.time, base.time_ns, base.steps, pose.copy(), twist.copy(), other.angles)
    found.acting, found.switching = base.acting, other.switching
    return found


def _stop(engine, pose, angles):
    """Set the rates of an Engine to zero; inputs, states of laws and modes of joints stay."""
    commands, modes = engine.inputs.commands, [each.copy() for each in engine._modes]
    engine._start_at(pose.copy(), np.zeros_like(pose[:, :6]), engine.now, angles)
    engine._modes, engine.inputs.commands = modes, commands


def _floating(scene):
    tree = tree_of(scene)
    return [tree.members[group] for group, _, joint in tree.links if joint is None]


def _speed(bodies, twist):
    """Speed in m/s at which the whole mass has the kinetic energy of twists (n, 6)."""
    turning = np.einsum("ni,nij,nj->", twist[:, :3], bodies["inertia"].reshape(-1, 3, 3), twist[:, :3])
    return float(np.sqrt((turning + bodies["mass"] @ (twist[:, 3:] ** 2).sum(axis=1)) / bodies["mass"].sum()))
