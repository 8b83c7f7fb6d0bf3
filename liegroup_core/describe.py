# SPDX-License-Identifier: Apache-2.0
"""Description of a mechanism: degrees of freedom, redundant rows, solve, conserved quantities.

JSON types, computed without taking a step; independent of the machine.
"""

import numpy as np

from liegroup_core.forces.law import states_of
from liegroup_core.joints.elements import WORLD
from liegroup_core.mechanism.body_model import initial_state
from liegroup_core.mechanism.mechanism import tree_of
from liegroup_core.mechanism.symmetry import body_groups, conserved_momentum
from liegroup_core.methods.families import fitting_methods
from liegroup_core.motion_groups.table import JOINTS
from liegroup_core.reports import notes_on_motions
from liegroup_core.robots.description import COORDINATES
from liegroup_core.scene.consistency import resolve_couplings

MOTION_GROUPS = {name: group.NAME for name, group in JOINTS.items()} | {"universal": "SO(2) x SO(2)"}
# Mass over the cube of the radius of gyration, sqrt(sum of moments / 2 m): 9 times the density for a ball, 8 for a
# cube, less for other bodies. Osmium has 22600 kg/m^3; a rod of 10 m and 0.1 kg has 0.004.
DENSE, THIN = 2.1e5, 1e-3
HEAVY, LARGE, FAR = 10.0, 30.0, 300.0  # kg; m; and distance of a joint in radii of gyration
SHOWN = 5  # names in a note


def describe(layout):
    """Return the properties of a mechanism.

    layout : layout.Layout, from `make_layout(scene)` or `Simulation.layout`
    returns dict of
        scene, description, gravity  of the scene; gravity in m/s^2
        notes               remarks of the scene, such as what an import merged and omitted, and
                            motions of driven joints beyond their limits or points, and units that look wrong
        masses              total mass, centre of mass and extents, see `masses`
        import              sizes of a robot's file and scene, see `imported`; None for other scenes
        bodies              [{name, mass, com, inertia}]: kg; centre of mass in m, and inertia about it in kg m^2,
                            body axes, as in the scene
        joints              [{name, type, parent, child, rows, dropped, rotor}]: names of all rows, wx..vz,
                            and of the redundant ones, which are eliminated; inertia of its rotor at the
                            joint, kg m^2 or kg, 0 without one
        stops_and_friction  [{joint, limits, friction, modes}]: as in the scene, None if there are none;
                            modes: which it can be in, as Sample.modes
        forces, sensors     [{name, type, on}]; on: names of its bodies, or of its joint; of a contact also `facts`
        undetermined        {joint: why components of its reaction are undetermined}
        degrees_of_freedom  6 n minus the number of independent rows; larger at singular poses
        rows, solved_rows   number of rows of all joints, with and without redundant ones
        dropped_rows        [[joint, row]] of redundant rows
        plane               normal of the plane in which the joints keep all bodies: x, y or z, or
                            its components in world axes as text; in relative coordinates
                            Munthe-Kaas methods integrate in that plane. None: no such plane
        formulation         configuration space, see `formulation`
        solve               size of the system of the cut joints, see `solve_structure`
        methods             names of the integration methods that can integrate the scene
        groups              [[body]]: bodies that joints or forces connect, not counting the world
        couplings           [{name, joint, other, ratio, curve, terms, offset}]; offset in rad or m
        kept_momentum       [{bodies, components}] of the momentum that all motions conserve, as text
    Raises SceneError.
    """
    scene, model = layout.scene, layout.model
    dropped, coupled = layout.dropped_rows, resolve_couplings(layout.centred)
    rows = {joint.name: [] for joint in scene.joints}
    for owner, names in zip(layout.owners, layout.row_names):
        rows[scene.joints[owner].name] += names
    return {
        "scene": scene.name,
        "description": scene.description,
        "gravity": list(scene.gravity),
        "notes": [*scene.notes, *notes_on_motions(layout), *_notes_on_units(layout)],
        "import": imported(layout),
        "masses": masses(layout),
        "bodies": [
            {"name": body.name, "mass": body.mass, "com": list(body.com), "inertia": list(body.inertia)}
            for body in scene.bodies
        ],
        "joints": [
            {
                "name": joint.name,
                "type": joint.type,
                "parent": joint.parent,
                "child": joint.child,
                "rows": rows[joint.name],
                "dropped": [row for name, row in dropped if name == joint.name],
                "driven": joint.driven,
                "rotor": joint.rotor_inertia,
                "switches": [key for key in ("limits", "friction") if getattr(joint, key) is not None],
            }
            for joint in scene.joints
        ],
        "stops_and_friction": [
            {
                "joint": switch.name,
                "limits": switch.limits and switch.limits.model_dump(),
                "friction": switch.friction and switch.friction.model_dump(),
                "modes": modes_of(switch),
            }
            for switch in layout.switches
        ],
        "couplings": [
            {"name": entry.name, "joint": entry.joint, "other": entry.other}
            | {"ratio": found.ratio, "curve": list(found.curve), "terms": entry.terms, "offset": found.offset}
            for entry, found in zip(scene.couplings, coupled)
        ],
        "forces": [
            {"name": force.name, "type": force.type, "on": _acts_on(force)}
            | ({"signals": force.as_law.shown} if hasattr(force, "as_law") else {})
            | (force.facts if force.type == "contact" else {})
            for force in scene.forces
        ],
        "sensors": [{"name": sensor.name, "type": sensor.type, "on": _acts_on(sensor)} for sensor in scene.sensors],
        "undetermined": layout.reactions.reasons(layout.reactions.undetermined),
        "degrees_of_freedom": 6 * len(model.bodies)
        - len(model.row_residual)
        - len(layout.relative.couplings)
        + sum(coupling.backlash is not None for coupling in scene.couplings),
        "rows": int(model.elements["rows"].sum()),
        "solved_rows": len(model.row_residual),
        "dropped_rows": [list(entry) for entry in dropped],
        "plane": _direction(layout.normal),
        "formulation": formulation(layout),
        "solve": solve_structure(layout.relative),
        "methods": fitting_methods(layout),
        "groups": [[scene.bodies[i].name for i in group] for group in body_groups(scene)],
        "kept_momentum": [
            {"bodies": list(kept.bodies), "components": list(kept.labels)} for kept in conserved_momentum(scene)
        ],
    }


def modes_of(switch):
    """Names of the modes that stops and friction allow, as Sample.modes."""
    limits, friction = switch.limits, switch.friction
    has_stops = limits and limits.least < limits.largest  # else a spring
    return [
        "free",
        *(end for end in ("lower", "upper") if has_stops and getattr(limits, end) is not None),
        *(["stick"] if friction and (friction.at_rest > 0.0 or friction.by_load[1] > 0.0) else []),
    ]


def _notes_on_units(layout):
    """Note of bodies whose mass, inertia and joints look as if in g or mm, by their radii of gyration."""
    mass, joints = layout.model.bodies["mass"], layout.model.elements
    radius = np.sqrt(layout.model.bodies["inertia"][:, [0, 4, 8]].sum(axis=1) / (2.0 * mass))
    arm = np.zeros(len(mass))
    for end in ("parent", "child"):
        own = joints[end] != WORLD
        np.maximum.at(arm, joints[end][own], np.linalg.norm(joints[f"{end}_point"][own], axis=1))
    dense = (mass > DENSE * radius**3) & (mass > HEAVY)  # lighter ones are often points
    thin = (mass < THIN * radius**3) & (mass > 1e-6 * mass.sum())  # lighter ones are no bodies
    wide = (arm > LARGE) & (arm > FAR * radius) | (radius > LARGE) & ((arm > LARGE) | ~thin)
    notes = []
    for which, what in (
        (dense, "denser than any metal: is a mass in g, not kg, or an inertia too small?"),
        (thin & ~wide, "lighter than air: is an inertia in g mm^2 or kg mm^2, or a length in mm?"),
        (wide, f"larger than {LARGE:g} m: are lengths in mm, not m, or masses in g?"),
    ):
        if which.any():
            names = [body.name for body, is_so in zip(layout.scene.bodies, which) if is_so]
            first = int(which.argmax())
            more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
            notes.append(
                f"units: {', '.join(names[:SHOWN])}{more}: {mass[first]:.4g} kg with a radius of gyration of "
                f"{radius[first]:.4g} m and joints up to {arm[first]:.4g} m away: {what}"
            )
    return notes


def masses(layout):
    """Total mass, centre of mass and extents of a mechanism at the start, of a Layout.

    returns dict of
        mass            kg
        centre_of_mass  [x, y, z] in m, world axes
        extents         [[x, y, z], [x, y, z]]: least and largest coordinates in m, world axes, of the joints
                        and of homogeneous boxes with the masses and inertias of the bodies
    """
    pose, _ = initial_state(layout.centred)
    bodies, elements = layout.model.bodies, layout.model.elements
    mass, R, p = bodies["mass"], pose[:, :9].reshape(-1, 3, 3), pose[:, 9:]
    moments, axes = np.linalg.eigh(bodies["inertia"].reshape(-1, 3, 3))
    # Edges L of a box: Ix = m (Ly^2 + Lz^2) / 12.
    half = np.sqrt(np.maximum(0.0, 1.5 * (moments.sum(axis=1, keepdims=True) - 2.0 * moments) / mass[:, None]))
    reach = np.einsum("nij,nj->ni", np.abs(R @ axes), half)
    points = [p - reach, p + reach]
    for end in ("parent", "child"):
        at, local = elements[end], elements[f"{end}_point"]
        own = at != WORLD
        points += [local[~own], p[at[own]] + np.einsum("nij,nj->ni", R[at[own]], local[own])]
    points = np.concatenate(points)
    return {
        "mass": float(mass.sum()),
        "centre_of_mass": (mass @ p / mass.sum()).tolist(),
        "extents": [points.min(axis=0).tolist(), points.max(axis=0).tolist()],
    }


def formulation(layout):
    """Configuration space of the relative coordinates, and why the scene needs it.

    returns dict of
        coordinates      dimension of the relative configuration space, before cut joints, without states of laws
        tree             [{bodies, joint, parent, group}] of every link: its bodies, welded if several;
                         the joint that holds it and the bodies of its parent link, and its motion
                         group; None for a floating link
        cut              [{joint, rows, dropped}] of the joints that close loops: names of the rows that
                         are solved for, and of the redundant ones
        only             reason why the scene needs relative coordinates, or ""
    """
    scene, relative = layout.centred, layout.relative
    tree = tree_of(scene)
    cut = {}
    for element, (owner, names) in enumerate(zip(layout.owners, layout.row_names)):
        if owner in tree.cut:
            entry = cut.setdefault(owner, {"joint": scene.joints[owner].name, "rows": [], "dropped": []})
            for r, name in enumerate(names):
                kept = r in relative.kept_rows(element)
                entry["rows" if kept else "dropped"].append(name)
    return {
        "coordinates": int(relative.links["freedoms"].sum()) - len(states_of(scene.forces)),
        "tree": [
            {
                "bodies": list(tree.members[group]),
                "joint": None if j is None else scene.joints[j].name,
                "parent": list(tree.members[parent]) or ["world"],
                "group": "SE(3)" if j is None else MOTION_GROUPS[scene.joints[j].type],
            }
            for group, parent, j in tree.links
        ],
        "cut": list(cut.values()),
        "only": layout.needs_relative,
    }


def imported(layout):
    """Return how much smaller the scene of a robot is than its file: a dict, or None for other scenes.

    links, bodies       number of links of the file, and of bodies of the scene: links that fixed or
                        locked joints connect are one body; those connected to the world are none
    file_coordinates, coordinates  of the joints of the file's tree, and of the scene's spanning tree;
                        a part that floats has six
    """
    robot = layout.scene.robot
    if robot is None:
        return None
    links, coordinates = robot.size
    return {
        "links": links,
        "bodies": len(layout.scene.bodies),
        "file_coordinates": coordinates,
        "coordinates": sum(
            COORDINATES["floating" if j is None else layout.scene.joints[j].type]
            for _, _, j in tree_of(layout.centred).links
        ),
    }


def solve_structure(relative):
    """Size of the system of the cut joints, W lambda = b, that every acceleration solves.

    relative : RelativeModel
    returns dict of
        rows            number of its rows
        numbers         float64 numbers of its factor, within the envelope of W
        dense_share     ratio of `numbers` to those of a dense factor
        refinements     number of iterative refinements of each solve
    """
    rows = len(relative.row_residual)
    numbers = int((np.arange(rows) - relative.first_column + 1).sum())
    return {
        "rows": rows,
        "numbers": numbers,
        "dense_share": 2 * numbers / (rows * (rows + 1)) if rows else 0.0,
        "refinements": int(relative.refinements),
    }


def _direction(normal):
    """Name of a world axis, or components of another unit vector as text; None without one."""
    if normal is None:
        return None
    if np.abs(normal).max() == 1.0:
        return "xyz"[int(np.abs(normal).argmax())]
    return " ".join(f"{value:.6g}" for value in normal)


def _acts_on(force):
    """Names of the two ends of a force, of its joint or its body, or of all joints and bodies that a law acts on."""
    if hasattr(force, "as_law"):
        force = force.as_law
        return list(dict.fromkeys(each.joint or each.body for each in force.outputs))
    if hasattr(force, "joint"):
        return [force.joint]
    return [force.body] if hasattr(force, "body") else [force.parent, force.child]
