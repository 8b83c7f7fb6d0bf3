# SPDX-License-Identifier: Apache-2.0
"""MuJoCo: RK4, all steps of a run in one call of mj_step.

Contacts, limits and friction are switched off. It closes loops by springs: a `connect` must be as stiff
as the step permits, or it converges to a motion other than that of the mechanism.
"""

import mujoco
import numpy as np

from .measure import Entry, geometric
from .problems import BALL, CYLINDRICAL, FREE, GROUND, HINGE, SLIDE, UNIVERSAL

CODE = "mujoco"
# Time constant of a loop's spring in steps, and its impedance: the largest that MuJoCo accepts.
LOOP_STEPS, LOOP_IMPEDANCE = 2.0, 0.9999
OFF = (
    mujoco.mjtDisableBit.mjDSBL_CONTACT
    | mujoco.mjtDisableBit.mjDSBL_LIMIT
    | mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS
    | mujoco.mjtDisableBit.mjDSBL_AUTORESET
)

mujoco.set_mju_user_warning(lambda message: None)


def version():
    """Version of the package."""
    return mujoco.__version__


def _joints(joint):
    """[(type, axis)] of a tree joint, from the parent on; None: of a free body."""
    kinds = mujoco.mjtJoint
    if joint is None or joint.kind == FREE:
        return [(kinds.mjJNT_FREE, np.zeros(3))]
    return {
        BALL: [(kinds.mjJNT_BALL, np.zeros(3))],
        HINGE: [(kinds.mjJNT_HINGE, joint.axis)],
        SLIDE: [(kinds.mjJNT_SLIDE, joint.axis)],
        UNIVERSAL: [(kinds.mjJNT_HINGE, joint.axis), (kinds.mjJNT_HINGE, joint.second)],
        CYLINDRICAL: [(kinds.mjJNT_HINGE, joint.axis), (kinds.mjJNT_SLIDE, joint.axis)],
    }[joint.kind]


def model_of(problem, step):
    """MuJoCo model of the problem, with body frames at the joints."""
    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.integrator = step, mujoco.mjtIntegrator.mjINT_RK4
    spec.option.gravity, spec.option.disableflags = problem.gravity, int(OFF)
    made, origins = {GROUND: spec.worldbody}, {GROUND: np.zeros(3)}
    for i, body in enumerate(problem.bodies):
        joint = problem.tree[i] if problem.tree else None
        parent = joint.parent if joint else GROUND
        origins[i] = joint.point if joint else body.position
        made[i] = made[parent].add_body(
            name=f"b{i}",
            pos=origins[i] - origins[parent],
            mass=body.mass,
            ipos=body.position - origins[i],
            explicitinertial=True,
            fullinertia=body.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]],
        )
        for kind, axis in _joints(joint):
            made[i].add_joint(type=kind, axis=axis)
    for loop in problem.loops:
        anchor = np.zeros(mujoco.mjNEQDATA)
        anchor[:3] = loop.point - origins[loop.parent]
        spec.add_equality(
            type=mujoco.mjtEq.mjEQ_CONNECT,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            data=anchor,
            name1="world" if loop.parent == GROUND else f"b{loop.parent}",
            name2=f"b{loop.child}",
            solref=[LOOP_STEPS * step, 1.0],
            solimp=[LOOP_IMPEDANCE, LOOP_IMPEDANCE, 1.0, 0.5, 2.0],
        )
    return spec.compile()


class _Run:
    """RK4 with a number of steps per duration."""

    def __init__(self, problem, steps):
        self.problem, self.steps = problem, steps
        self.model = model_of(problem, problem.duration / steps)
        self.data = mujoco.MjData(self.model)
        self.ids = [self.model.body(f"b{i}").id for i in range(len(problem.bodies))]

    def reset(self):
        bodies, speed = self.problem.bodies, self.data.qvel
        mujoco.mj_resetData(self.model, self.data)
        if not self.problem.tree:
            speed[:] = [*bodies[0].velocity, *bodies[0].omega]
        for i in range(len(self.problem.tree)):
            rates = self.problem.rates(i)
            first = self.model.body_dofadr[self.ids[i]]
            speed[first : first + len(rates)] = rates

    def advance(self, times):
        mujoco.mj_step(self.model, self.data, nstep=times * self.steps)

    def end(self):
        mujoco.mj_forward(self.model, self.data)
        gap = np.abs(self.data.efc_pos).max() if self.problem.loops else 0.0
        return self.data.xmat[self.ids].reshape(-1, 3, 3), gap

    def steps_per_duration(self):
        return self.steps


def entries(problem, ratio):
    """RK4 with joint coordinates; loops are closed by springs."""
    yield Entry(
        CODE, f"RK4 {problem.joints}".strip(), geometric(problem.coarsest, ratio), lambda steps: _Run(problem, steps)
    )


def stepper(problem, step):
    """Function take_steps(n) of RK4 steps, to measure the cost of a step."""
    run = _Run(problem, round(problem.duration / step))
    run.reset()
    return lambda count: mujoco.mj_step(run.model, run.data, nstep=count)
