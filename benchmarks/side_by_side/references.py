# SPDX-License-Identifier: Apache-2.0
"""Exact attitudes at the end of each problem, by methods independent of all tested codes.

One rigid body: Taylor series of the quaternion equations in extended precision. Four-bar: one
degree of freedom, so the time to an angle is an integral of the energy equation. Chain: Lagrange's
equations in the rods' absolute angles, DOP853. Each takes a fineness, 0 or 1: the difference of
the two results is the uncertainty of the end state.
"""

from math import ceil, pi

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import cho_factor, cho_solve


def spinning_body(moments, omega, mass_arm, gravity, duration, fineness):
    """(1, 3, 3) attitude of a body about a fixed point, or of a free one, principal axes.

        I w' = I w x w + (m r) x gamma,   gamma' = gamma x w,   q' = q (0, w) / 2
    with gamma = R^T g. The right-hand sides are products, so each coefficient of the series follows from
    the previous ones. Uses extended precision if the machine has it.
    """
    order = 24
    moments, mass_arm = np.array(moments, np.longdouble), np.array(mass_arm, np.longdouble)
    # w h below 0.4: the first omitted term is below 0.4^25 / 25! of the sum.
    steps = ceil(duration * float(np.linalg.norm(omega)) / 0.4) * (1 + fineness)
    h = np.longdouble(duration) / steps
    w = np.zeros((order + 1, 3), np.longdouble)
    gamma, q = w.copy(), np.zeros((order + 1, 4), np.longdouble)
    w[0], gamma[0], q[0, 0] = omega, gravity, 1
    powers = h ** np.arange(order + 1)
    for _ in range(steps):
        for k in range(order):
            back = w[k::-1]
            w[k + 1] = (_cross(w[: k + 1] * moments, back).sum(axis=0) + _cross(mass_arm, gamma[k])) / moments / (k + 1)
            gamma[k + 1] = _cross(gamma[: k + 1], back).sum(axis=0) / (k + 1)
            scalar, vector = q[: k + 1, :1], q[: k + 1, 1:]
            q[k + 1, 0] = -(vector * back).sum() / (2 * (k + 1))
            q[k + 1, 1:] = (scalar * back + _cross(vector, back)).sum(axis=0) / (2 * (k + 1))
        w[0], gamma[0], q[0] = powers @ w, powers @ gamma, powers @ q
        q[0] /= np.sqrt((q[0] * q[0]).sum())
    s, v = q[0, 0], q[0, 1:]
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    rotation = (s * s - v @ v) * np.eye(3) + 2 * np.outer(v, v) + 2 * s * cross
    return rotation[None].astype(float)


def _cross(a, b):
    """Cross products along the last axis."""
    return np.stack(
        [
            a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
            a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
            a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0],
        ],
        axis=-1,
    )


def four_bar(fineness):
    """(3, 3, 3) attitudes of crank, coupler and rocker of P3 after 1 s, relative to the start.

    With the crank's angle p alone, T = A(p) p'^2 / 2 and T + V(p) = E, so that
        t(p) = integral of sqrt(A / (2 (E - V))) dp,
    a smooth integrand: Gauss-Legendre panels, and Newton's iteration for t(p) = 1.
    """
    crank, rod, base, width, density, g = 0.5, 1.0, 1.0, 0.05, 1000.0, 9.81
    m_crank, m_rod = density * width**2 * crank, density * width**2 * rod
    about_end = [m * (length**2 / 3 + width**2 / 12) for m, length in ((m_crank, crank), (m_rod, rod))]
    about_middle = m_rod * (rod**2 + width**2) / 12

    def angles(p):
        """Angles of coupler and rocker, with the elbow above the line from the crank's tip."""
        x, y = base - crank * np.cos(p), -crank * np.sin(p)
        line, turn = np.arctan2(y, x), np.arccos(np.hypot(x, y) / (2 * rod))
        return line + turn, line + pi - turn

    def inertia_and_height(p):
        coupler, rocker = angles(p)
        # d(angle)/dp, from equal velocities of the elbow on coupler and rocker.
        d_coupler = -crank * np.sin(rocker - p) / (rod * np.sin(rocker - coupler))
        d_rocker = crank * np.sin(coupler - p) / (rod * np.sin(coupler - rocker))
        middle = crank**2 + (rod / 2 * d_coupler) ** 2 + crank * rod * d_coupler * np.cos(p - coupler)
        inertia = about_end[0] + m_rod * middle + about_middle * d_coupler**2 + about_end[1] * d_rocker**2
        height = (
            m_crank * crank / 2 * np.sin(p)
            + m_rod * rod / 2 * np.sin(rocker)
            + m_rod * (crank * np.sin(p) + rod / 2 * np.sin(coupler))
        )
        return inertia, height

    start, rate, duration = pi / 2, 10 * pi, 1.0
    inertia, height = inertia_and_height(start)
    energy = inertia * rate**2 / 2 + g * height

    def slowness(p):
        inertia, height = inertia_and_height(p)
        return np.sqrt(inertia / (2 * (energy - g * height)))

    panels = 200 * (1 + fineness)
    nodes, weights = np.polynomial.legendre.leggauss(16)
    end = start + rate * duration
    for _ in range(50):
        edges = np.linspace(start, end, panels + 1)
        half = (end - start) / (2 * panels)
        points = (edges[:-1, None] + half) + half * nodes
        correction = (duration - half * (slowness(points) @ weights).sum()) / slowness(end)
        end += correction
        if abs(correction) < 1e-14:
            break
    turned = [end - start] + [after - before for after, before in zip(angles(end), angles(start))]
    return np.array([[[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]] for a in turned])


def planar_chain(links, mass, length, g, duration, fineness):
    """(n, 3, 3) attitudes of thin rods that start level and at rest.

    a_i is the angle of rod i below the horizontal, e(a) = (cos a, -sin a) in the plane of x and z.
    The centre of rod k is at sum_i c_ki e(a_i), c_ki = length before k, half of it at k. With
    A = m c^T c and J = m length^2 / 12, for every rod i
        sum_j (A_ij cos(a_i - a_j) + J d_ij) a_j'' + A_ij sin(a_i - a_j) a_j'^2
            = g m cos(a_i) sum_k c_ki
    """
    arm = length * (np.tril(np.ones((links, links)), -1) + np.eye(links) / 2)
    coupling = mass * arm.T @ arm
    own = mass * length**2 / 12 * np.eye(links)
    weight = g * mass * arm.sum(axis=0)

    def slope(_, state):
        angle, rate = state[:links], state[links:]
        difference = angle[:, None] - angle
        matrix = coupling * np.cos(difference) + own
        right = weight * np.cos(angle) - (coupling * np.sin(difference)) @ (rate * rate)
        factor = cho_factor(matrix, overwrite_a=True, check_finite=False)
        return np.concatenate([rate, cho_solve(factor, right, check_finite=False)])

    tolerance = (1e-12, 1e-13)[fineness]
    angle = solve_ivp(slope, (0.0, duration), np.zeros(2 * links), method="DOP853", rtol=tolerance, atol=tolerance).y[
        :links, -1
    ]
    c, s, zero = np.cos(angle), np.sin(angle), np.zeros(links)
    return np.array([[c, zero, s], [zero, zero + 1, zero], [-s, zero, c]]).transpose(2, 0, 1)
