# SPDX-License-Identifier: Apache-2.0
"""Accelerations of all bodies at a state, from one evaluation of the equations of motion."""

import numpy as np

from liegroup_core.compiling import SameTypes, borrowed, stepper, warm_up
from liegroup_core.errors import SimulationError
from liegroup_core.forces.external import no_wrenches, set_wrench
from liegroup_core.forces.timetable import ROUNDING, acting_at
from liegroup_core.formulations.relative.arrays import PlaneModel
from liegroup_core.integrators.link_state import model_and_work
from liegroup_core.integrators.methods import GROUPS, RELATIVE, SE3
from liegroup_core.integrators.rkmk import spaces
from liegroup_core.model.build import initial_state
from liegroup_core.status import DEPENDENT_ROWS, MESSAGES, OK


@stepper
def _accelerate(model, work, group, pose_in, twist_in, external_in):
    """Accelerations of the state, to `work`. Returns a status."""
    pose_in, twist_in = borrowed(pose_in), borrowed(twist_in)
    external_in = borrowed(external_in)
    pose, twist, external, status = spaces.enter(model, work, pose_in, twist_in, external_in)
    if status != OK:
        return status
    spaces.begin(model, work, group, pose, twist)
    dependent = spaces.accelerate(model, work, external)
    return OK if dependent < 0 else DEPENDENT_ROWS + (dependent << 8)


class Accelerations:
    """Accelerations of the bodies of a scene, found on demand.

    layout : Layout of the scene
    The equations are those on SE(3)^n, or in relative coordinates if a scene needs them. The
    constructor compiles their kernels on the first use on a machine.
    """

    def __init__(self, layout):
        self._layout = layout
        group = RELATIVE if layout.needs_relative else "se3"
        self._group = GROUPS.get(group, SE3)
        self._model, self._work, self._bodies, ending = model_and_work(
            layout, group, {"space": "auto"}, 1
        )
        self._accelerate = SameTypes(_accelerate)
        self._place = {name: i for i, name in enumerate(layout.body_names)}
        state = initial_state(layout.centred)
        warm_up(lambda: self._solve(*state, no_wrenches(layout.offsets)), "accelerations" + ending)

    def of(self, sample, acting=()):
        """(n, 6) angular rad/s^2, then linear acceleration m/s^2 of the body frames; world axes.

        sample : Sample of the same scene
        acting : [(body, axes, wrench (6,))] external wrenches at its time, see Engine.acting
        Linear: the second derivative of the position of the body frame's origin.
        Raises SimulationError if the constraints leave the accelerations undetermined.
        """
        layout, work = self._layout, self._bodies
        pose, twist = layout.offsets.to_centres(sample.pose, sample.twist)
        pose, twist = np.array(pose), np.array(twist)  # contiguous, and not those of the sample
        external = no_wrenches(layout.offsets)
        for body, axes, wrench in acting:
            set_wrench(external, self._place[body], wrench, axes)
        work.angle[:] = sample.angles
        rows = layout.model.forces.applied_wrench
        work.acting[:] = acting_at(rows, sample.time * (1.0 + ROUNDING))
        status = self._solve(pose, twist, external)
        if status != OK:
            joint = layout.scene.joints[layout.owners[status >> 8]].name
            raise SimulationError(
                f"no accelerations at t = {sample.time:.9g} s: "
                + MESSAGES[DEPENDENT_ROWS].format(joint=joint),
                DEPENDENT_ROWS,
            )
        return self._in_world(pose, twist)

    def _solve(self, pose, twist, external):
        if self._work is not self._bodies:
            self._work.known[0] = 0.0  # find the coordinates of the links again
        return self._accelerate(self._model, self._work, self._group, pose, twist, external)

    def _in_world(self, pose, twist):
        """Accelerations of the body frames from those at the centres of mass."""
        rotation = pose[:, :9].reshape(-1, 3, 3)
        rate, linear = (
            (self._work.acceleration[:, :3], self._work.acceleration[:, 3:])
            if self._work is self._bodies
            else self._of_links(rotation)
        )
        spin, arm = twist[:, :3], -self._layout.offsets.com
        # d/dt (R v) = R (dv/dt + omega x v), at the centre of mass; then the body frame's origin.
        linear = linear + np.cross(spin, twist[:, 3:])
        linear = linear + np.cross(rate, arm) + np.cross(spin, np.cross(spin, arm))
        return np.concatenate(
            [np.einsum("nij,nj->ni", rotation, part) for part in (rate, linear)], axis=1
        )

    def _of_links(self, rotation):
        """Derivatives of (omega, v) of the bodies in body axes, from those of their links.

        The solver leaves out the acceleration of gravity, which is that of every link.
        """
        model, work = self._model, self._work
        gravity, links = model.gravity[0], work.moved
        if isinstance(model, PlaneModel):
            normal = model.axes[0, 2::3]
            gravity = gravity - normal * (normal @ gravity)
            links = np.zeros((len(work.moved), 6))
            links[:, 2:5] = work.moved
            links[:, 3:5] += work.drift
        found = np.zeros((len(rotation), 6))
        for i, part in enumerate(model.parts):
            if part["link"] >= 0:
                turn = part["rotation"].reshape(3, 3)
                w, v = links[part["link"]].reshape(2, 3)
                found[i, :3], found[i, 3:] = w @ turn, (v + np.cross(w, part["point"])) @ turn
                found[i, 3:] += gravity @ rotation[i]
        return found[:, :3], found[:, 3:]
