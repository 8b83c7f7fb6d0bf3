# SPDX-License-Identifier: Apache-2.0
"""Accelerations of the bodies of a scene, and their comparison between two codes."""

import numpy as np

from liegroup_core.dynamics.inverse_dynamics import inverse_dynamics
from liegroup_core.dynamics.trees import move_links
from liegroup_core.engine import Engine
from liegroup_core.joints.elements import WORLD
from liegroup_core.methods.munthe_kaas import steps as relative
from liegroup_core.scene.consistency import resolve_couplings


class Accelerations:
    """Accelerations (n, 6) of all bodies of a scene, at their centres of mass, in body axes."""

    def __init__(self, scene):
        self.engine = Engine(scene, "rkmk4", group="relative", quiet=True, space="space")
        self.offsets = self.engine.layout.offsets

    def __call__(self, pose, twist):
        """At poses (n, 12) and twists (n, 6) of the body frames."""
        engine = self.engine
        engine.set_state(*self.offsets.to_centres(pose, twist))
        engine.advance(0)
        model, work = engine._integrator.mechanism
        pose, twist, external, status = relative.enter(model, work, *engine.state(), engine.inputs.acting.external)
        assert status == 0
        relative.begin(model, work, pose, twist)
        assert relative.accelerate(model, work, external) == -1
        # Near a singular pose the links remain displaced.
        rates = work.acceleration[:, :1].copy()
        move_links(model, work)
        inverse_dynamics(model, work, rates, np.zeros(len(rates)))
        found = np.zeros((len(model.bodies), 6))
        flat = engine.state()[0]
        for i, part in enumerate(model.bodies):
            if part["link"] == WORLD:  # held by a fixed joint
                continue
            turn, (w, v) = part["rotation"].reshape(3, 3), work.moved[part["link"]].reshape(2, 3)
            found[i, :3], found[i, 3:] = w @ turn, (v + np.cross(w, part["point"])) @ turn
            found[i, 3:] += model.gravity[0] @ flat[i, :9].reshape(3, 3)
        return found


def difference(ours, theirs, bodies):
    """Largest difference of accelerations (n, 6), relative to the largest ones of the mechanism.

    Linear ones are relative to those of all points within the radii of gyration. Speeds are of the
    order of 1, so accelerations below 1 count as 1.
    """
    radii = np.array([np.sqrt(np.trace(body.inertia_matrix) / body.mass) for body in bodies])
    turns = np.linalg.norm(theirs[:, :3], axis=1)
    sizes = turns.max(initial=1.0), (np.linalg.norm(theirs[:, 3:], axis=1) + radii * turns).max()
    error = np.abs(ours - theirs)
    return max(error[:, :3].max() / sizes[0], error[:, 3:].max() / max(sizes[1], 1.0))


def coupled(free, rows, mobility, bias=0.0):
    """Accelerations (nv,) with couplings rows (k, nv) a = bias, from the accelerations without couplings.

    mobility : (nv, k), M^-1 rows^T
    """
    return free - mobility @ np.linalg.lstsq(rows @ mobility, rows @ free - bias, rcond=None)[0]


def offsets_of(scene):
    """Offsets of the couplings of a scene."""
    return [found.offset for found in resolve_couplings(scene)]
