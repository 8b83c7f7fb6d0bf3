# SPDX-License-Identifier: Apache-2.0
"""Energy and momentum of a state."""

import numpy as np

from liegroup_core.compiling import kernel
from liegroup_core.forces import kinds
from liegroup_core.forces.gravity import energy as gravity_energy
from liegroup_core.forces.rotors import energy as rotor_energy
from liegroup_core.lie.vec3 import dot3, load3, matrix3, matvec3
from liegroup_core.scene.centres import Offsets


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


def momenta(mass, inertia, pose, twist, about):
    """Angular momentum about points (..., 3), N m s, and linear momentum, N s, of n bodies; (..., 3), world axes.

    mass (n,), inertia (n, 3, 3); pose (..., n, 12), twist (..., n, 6) of frames at the centres of mass
    Sums of (R Theta w + (r - about) x m R v, m R v).
    """
    turn, place = pose[..., :9].reshape(*pose.shape[:-1], 3, 3), pose[..., 9:]
    linear = mass[:, None] * np.einsum("...ij,...j->...i", turn, twist[..., 3:])
    spin = np.einsum("...ij,...jl,...l->...i", turn, inertia, twist[..., :3])
    return (spin + np.cross(place - about[..., None, :], linear)).sum(axis=-2), linear.sum(axis=-2)


def momentum_values(scene, kept, rotation, position, twist):
    """Values of the conserved components of one group along a motion.

    kept     : KeptMomentum
    rotation : (k, n, 3, 3), position (k, n, 3) m, twist (k, n, 6) of the body frames, all n bodies
    returns (k, components), N m s or N s
    """
    pose = np.concatenate([rotation.reshape(*rotation.shape[:2], 9), position], axis=2)
    pose, twist = Offsets(scene).to_centres(pose, twist)
    index = [i for i, body in enumerate(scene.bodies) if body.name in kept.bodies]
    mass = np.array([scene.bodies[i].mass for i in index])
    inertia = np.array([scene.bodies[i].inertia_matrix for i in index])
    pose, twist = pose[:, index], twist[:, index]
    about = np.einsum("n,kni->ki", mass, pose[..., 9:]) / mass.sum() if kept.point is None else kept.point[None]
    angular, linear = momenta(mass, inertia, pose, twist, about)
    return np.concatenate((angular @ kept.angular.T, linear @ kept.linear.T), axis=1)
