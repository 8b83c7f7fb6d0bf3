# SPDX-License-Identifier: Apache-2.0
"""Momenta and displacements of links, for a RATTLE step; halves.py has the equations."""

from liegroup_core.compiling import kernel
from liegroup_core.dynamics.algebra import by_space, link_of, load, of_group, size, store
from liegroup_core.dynamics.couplings import add_pair, add_rotors
from liegroup_core.dynamics.links import momentum

from . import plane_links, space_links

_move_coordinates = of_group("move_coordinates")
displace_links, place_ends, weigh, transport = (
    by_space(name, space_links, plane_links) for name in ("displace_links", "place_ends", "weigh", "transport")
)


@kernel
def move_coordinates(model, b, psi, coordinates):
    """Displace the coordinates of link b by its part of psi, in place."""
    link, row = link_of(model, b), len(model.bodies) + b
    # Unlike `displace`, as `displace_links`: rotation and translation of floating and planar links are
    # independent of each other.
    _move_coordinates(model, link, coordinates, row, psi, link["freedom"], coordinates)


@kernel
def add_applied(model, work, memory):
    """Add the applied wrenches on the links to memory.load."""
    for b in range(len(model.links)):
        for c in range(size(model)):
            memory.load[b, c] += work.applied[b, c]


@kernel
def set_momentum(model, work, memory, h):
    """Write M V + (h/2) Q of all links at the start to memory.impulse."""
    for b in range(len(model.links)):
        V = load(model, work.velocities, b)
        store(model, momentum(model, link_of(model, b), V), memory.impulse, b)
        for c in range(size(model)):
            memory.impulse[b, c] += 0.5 * h * memory.load[b, c]


@kernel
def add_rotor_impulses(model, work, memory, h):
    """Add the impulses that rotors need, from the rates at the start to psi / h, to work.force."""
    for b in range(len(model.links)):
        link = link_of(model, b)
        if link["rotor"] > 0.0:
            change = memory.psi[link["freedom"], 0] / h - work.stage_twist[len(model.bodies) + b, 0]
            add_pair(model, work, b, 0, link["rotor"] * change, work.force, 1)


@kernel
def set_at_rest(model, work, memory, h):
    """Set all links and rotors to rest under the impulses M V'+ + (h/2) Q+ as applied wrenches."""
    for b in range(len(model.links)):
        for c in range(work.drift.shape[1]):
            work.drift[b, c] = 0.0
        for c in range(size(model)):
            work.velocities[b, c] = 0.0
            work.applied[b, c] = memory.impulse[b, c] + 0.5 * h * memory.load[b, c]
            # In a plane the bias forces are already set: replace them.
            work.force[b, c] = -work.applied[b, c]
    add_rotors(model, work, memory.psi, 1.0 / h, work.applied)
    add_rotors(model, work, memory.psi, -1.0 / h, work.force)
