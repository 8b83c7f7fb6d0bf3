# SPDX-License-Identifier: Apache-2.0
"""Energy and spatial momentum of a state."""

from liegroup_core.compiling import kernel
from liegroup_core.forces import kinds
from liegroup_core.forces.gravity import energy as gravity_energy
from liegroup_core.forces.rotors import energy as rotor_energy
from liegroup_core.lie.vec3 import add3, cross3, dot3, load3, load9, matrix3, matvec3, scale3


@kernel
def energy(model, angle, pose, twist):
    """Kinetic energy, of rotors too, plus potential energy of gravity and springs, J.

    angle : (k,) rad, unwrapped, of each torsional spring; pose (n, 12), twist (n, 6)
    """
    total = gravity_energy(model, pose) + kinds.energy(model.forces, angle, pose)
    total += rotor_energy(model.rotors, pose, twist)
    for i in range(len(model.bodies)):
        w = load3(twist, i, 0)
        v = load3(twist, i, 3)
        total += 0.5 * (dot3(w, matvec3(matrix3(model.bodies[i]["inertia"]), w)) + model.bodies[i]["mass"] * dot3(v, v))
    return total


@kernel
def spatial_momentum(model, pose, twist):
    """Angular momentum about the world origin, N m s, and linear momentum, N s; world axes.

    Sum of (R Theta w + r x m R v, m R v) over all bodies.
    """
    angular = (0.0, 0.0, 0.0)
    linear = (0.0, 0.0, 0.0)
    for i in range(len(model.bodies)):
        rot = load9(pose, i, 0)
        p = scale3(model.bodies[i]["mass"], matvec3(rot, load3(twist, i, 3)))
        spin = matvec3(rot, matvec3(matrix3(model.bodies[i]["inertia"]), load3(twist, i, 0)))
        angular = add3(angular, add3(spin, cross3(load3(pose, i, 9), p)))
        linear = add3(linear, p)
    return angular, linear
