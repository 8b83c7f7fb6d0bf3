# SPDX-License-Identifier: Apache-2.0
"""Coefficients and memory of the generalised-alpha method, and its formulas for one step.

f is the number of freedoms: 6 n on SE(3)^n and (SO(3) x R^3)^n, those of the tree in relative
coordinates. N = f + rows is that of the unknowns: Vdot_1 on the group, then the multipliers.
"""

import math

import numpy as np

from liegroup_core.compiling import Struct, kernel, shaped
from liegroup_core.lie.vec3 import dot3, load3, vector3


class Coefficients(Struct):
    """Coefficients of the method, see generalized_alpha.py."""

    alpha_m: float
    alpha_f: float
    beta: float
    gamma: float


class AlphaMemory(Struct):
    """Memory of the method besides pose, twist and Work."""

    rate: np.ndarray = shaped("freedoms")  # Vdot_0 on the group
    mean: np.ndarray = shaped("freedoms")  # a_0
    old: np.ndarray = shaped("freedoms")  # (alpha_f Vdot_0 - alpha_m a_0) / (1 - alpha_m)
    velocity: np.ndarray = shaped("freedoms")  # V_0
    end: np.ndarray = shaped("freedoms")  # V_1
    psi: np.ndarray = shaped("freedoms", 1)  # displacement of the step
    body_rate: np.ndarray = shaped("freedoms", 1)  # Vdot_1 in body axes
    x: np.ndarray = shaped("unknowns")  # Vdot_1, then lambda
    start: np.ndarray = shaped("unknowns")  # x before the first iteration
    residual: np.ndarray = shaped("unknowns")
    base: np.ndarray = shaped("unknowns")  # unperturbed residual of the finite differences
    correction: np.ndarray = shaped("unknowns")  # last correction of x
    next: np.ndarray = shaped("unknowns")  # residual, then the next correction
    matrix: np.ndarray = shaped("unknowns", "unknowns")  # factors of the derivative of the residual
    pivots: np.ndarray  # (unknowns,) see lu_factorise
    factored: np.ndarray = shaped(1)  # 1.0: `matrix` holds factors
    size: np.ndarray  # (1,) m, largest coordinate of the state; at least 1


def make_memory(freedoms, rows):
    """Allocate an AlphaMemory."""
    sizes = {"freedoms": freedoms, "unknowns": freedoms + rows}
    pivots = np.zeros(sizes["unknowns"], dtype=np.int64)
    return AlphaMemory.zeros(sizes, pivots=pivots, size=np.ones(1))


@kernel
def sigma(numbers, h):
    """d psi / d Vdot_1, s^2."""
    return h * h * numbers.beta * (1.0 - numbers.alpha_f) / (1.0 - numbers.alpha_m)


@kernel
def set_old(memory, numbers):
    """Write memory.old, from Vdot and a at the start of a step."""
    inverse = 1.0 / (1.0 - numbers.alpha_m)
    for k in range(len(memory.rate)):
        memory.old[k] = inverse * (numbers.alpha_f * memory.rate[k] - numbers.alpha_m * memory.mean[k])


@kernel
def set_end(memory, numbers, h):
    """Write displacement and velocity at the end of a step, from the unknowns memory.x."""
    factor = (1.0 - numbers.alpha_f) / (1.0 - numbers.alpha_m)
    for k in range(len(memory.rate)):
        a0, v0 = memory.mean[k], memory.velocity[k]
        a1 = factor * memory.x[k] + memory.old[k]
        memory.psi[k, 0] = h * v0 + (h * h * (0.5 - numbers.beta) * a0 + h * h * numbers.beta * a1)
        memory.end[k] = h * (1.0 - numbers.gamma) * a0 + (h * numbers.gamma * a1 + v0)


@kernel
def keep_end(memory, numbers):
    """Continue from the end of a step: Vdot_0 and a_0 of the next one."""
    factor = (1.0 - numbers.alpha_f) / (1.0 - numbers.alpha_m)
    for k in range(len(memory.rate)):
        memory.rate[k] = memory.x[k]
        memory.mean[k] = memory.old[k] + factor * memory.rate[k]


@kernel
def set_size(model, memory, pose):
    """Write the largest coordinate of bodies and joints to memory.size; model: Model."""
    largest = 1.0
    for i in range(len(model.bodies)):
        r = load3(pose, i, 9)
        largest = max(largest, math.sqrt(dot3(r, r)))
    for e in range(len(model.elements)):
        for r in (vector3(model.elements[e]["parent_point"]), vector3(model.elements[e]["child_point"])):
            largest = max(largest, math.sqrt(dot3(r, r)))
    memory.size[0] = largest
