# SPDX-License-Identifier: Apache-2.0
"""Exact rotations of a free body and of a heavy top in Jacobi's elliptic functions, to any precision.

They share no code with the engine and take no steps: the only error is round-off, at any time. They
need mpmath (pip install mpmath). R maps body axes to world axes; w is in body axes.

Source: Landau and Lifshitz, Mechanics, sections 35 to 37, with the precession angles as integrals
of the third kind. Accuracy: test/verification/test_elliptic.py, against Taylor series.
"""

import mpmath as mp
import numpy as np

GUARD = 20  # guard digits: next to a separatrix half of all digits cancel


def free_body(inertia, rotation, omega, time, digits=30):
    """Attitude and angular velocity of a free rigid body.

    inertia  : (3, 3) kg m^2, about the centre of mass; or (3,) its diagonal
    rotation : (3, 3) at time 0
    omega    : (3,) rad/s, at time 0
    time     : s
    digits   : number of correct digits; fewer are correct next to a separatrix
    returns (R (3, 3), w (3,)) as mpmath matrices; `to_floats` rounds them
    """
    with mp.workdps(digits + GUARD):
        I, R, w = _matrix(inertia), _matrix(rotation), _matrix(omega)
        if min(I.rows, I.cols) == 1:
            I = mp.diag(list(I))
        moments, axes = mp.eigsy(I)
        if mp.det(axes) < 0:
            axes[:, 2] = -axes[:, 2]
        rotation_since, w_end = _principal(list(moments), axes.T * w, mp.mpf(time))
        return R * axes * rotation_since * axes.T, axes * w_end


def _principal(I, w, time):
    """Rotation since time 0 and angular velocity, in principal axes with I[0] <= I[1] <= I[2]."""
    m = mp.matrix([i * c for i, c in zip(I, w)])
    L2, E2 = _dot(m, m), _dot(m, w)  # squared momentum, twice the energy
    # c is the axis about which the momentum circles in the body: that of the largest or of the
    # smallest moment of inertia, depending on the side of the separatrix L^2 = 2 E I_1.
    a, b, c = (0, 1, 2) if L2 >= E2 * I[1] else (2, 1, 0)
    parity = 1 if c == 2 else -1
    rate2 = (I[c] - I[b]) * (L2 - E2 * I[a]) / (I[0] * I[1] * I[2])
    if rate2 <= 0 or sum(x == 0 for x in m) >= 2:
        return _exp(w, time), w  # steady rotation
    amplitude = [
        mp.sqrt((E2 * I[c] - L2) / (I[a] * (I[c] - I[a]))),
        mp.sqrt((E2 * I[c] - L2) / (I[b] * (I[c] - I[b]))),
        mp.sqrt((L2 - E2 * I[a]) / (I[c] * (I[c] - I[a]))),
    ]
    k2 = (I[b] - I[a]) * (E2 * I[c] - L2) / ((I[c] - I[b]) * (L2 - E2 * I[a]))
    sign_c = mp.sign(w[c])
    sign_b = parity * mp.sign(I[c] - I[b]) * sign_c
    rate = mp.sqrt(rate2)
    start = mp.atan2(sign_b * w[b] / amplitude[1], w[a] / amplitude[0])
    tau = mp.ellipf(start, k2) + rate * time
    end = _amplitude(tau, k2)
    w_end = mp.matrix(3, 1)
    w_end[a] = amplitude[0] * mp.cos(end)
    w_end[b] = sign_b * amplitude[1] * mp.sin(end)
    w_end[c] = sign_c * amplitude[2] * mp.sqrt(1 - k2 * mp.sin(end) ** 2)
    # Precession of the plane of m and c about m: L (2 E - m_c^2/I_c) / (L^2 - m_c^2).
    D = (I[a] * amplitude[0]) ** 2
    n = -k2 * (I[c] * amplitude[2]) ** 2 / D
    L = mp.sqrt(L2)
    angle = L * time / I[c] + L * (E2 - L2 / I[c]) / (D * rate) * (mp.ellippi(n, end, k2) - mp.ellippi(n, start, k2))
    m_end = mp.matrix([i * x for i, x in zip(I, w_end)])
    axis = mp.matrix([int(i == c) for i in range(3)])
    return _node_axes(m, axis) * _about_z(angle) * _node_axes(m_end, axis).T, w_end


def heavy_top(inertia, spin_inertia, moment, axis, gravity, rotation, omega, time, digits=30):
    """Attitude and angular velocity of a symmetric heavy top (Lagrange's) about its fixed point.

    inertia      : kg m^2, about the fixed point, perpendicular to the axis of symmetry
    spin_inertia : kg m^2, about the axis of symmetry
    moment       : kg m, mass times distance of the centre of mass from the fixed point, positive
    axis         : (3,) from the fixed point to the centre of mass, unit vector in body axes
    gravity      : (3,) m/s^2, world axes, not zero
    rotation, omega, time, digits, returns: as in `free_body`
    Raises ValueError if the axis is or becomes vertical, where the angles are undefined.
    """
    with mp.workdps(digits + GUARD):
        I1, I3, e = mp.mpf(inertia), mp.mpf(spin_inertia), _matrix(axis)
        R, w, g = _matrix(rotation), _matrix(omega), _matrix(gravity)
        g_norm = mp.sqrt(_dot(g, g))
        S, P = _completed(-g / g_norm), _completed(e)
        start = S.T * R * P
        u = start[2, 2]
        # u = cos theta: u'^2 = (1 - u^2)(alpha - beta u) - (b - a u)^2
        a, beta = I3 * _dot(w, e) / I1, 2 * mp.mpf(moment) * g_norm / I1
        across = w - _dot(w, e) * e
        b = _dot(S.T[2, :].T, R * (across + I3 / I1 * _dot(w, e) * e))
        alpha = _dot(across, across) + beta * u
        u_rate = (S.T * R * _cross(w, e))[2]
        u1, u2, u3 = _cubic_roots(beta, -(alpha + a * a), 2 * a * b - beta, alpha - b * b)
        if 1 - u2 <= mp.mpf(10) ** (-digits) or 1 + u1 <= mp.mpf(10) ** (-digits):
            raise ValueError("the axis of the top becomes vertical")
        rate = mp.sqrt(beta * (u3 - u1)) / 2
        k2 = (u2 - u1) / (u3 - u1)
        sine_start = mp.sqrt(min(max((u - u1) / (u2 - u1), 0), 1)) if u2 > u1 else mp.mpf(0)
        first = mp.asin(sine_start) * (-1 if u_rate < 0 else 1)
        last = _amplitude(mp.ellipf(first, k2) + rate * mp.mpf(time), k2)
        u = u1 + (u2 - u1) * mp.sin(last) ** 2
        # Integrals of (b -+ a) / (2 (1 -+ u)) over time: the two parts of phi' = (b - a u)/(1 - u^2)
        lower = (b - a) / (2 * (1 - u1) * rate) * _third_kind((u2 - u1) / (1 - u1), first, last, k2)
        upper = (b + a) / (2 * (1 + u1) * rate) * _third_kind(-(u2 - u1) / (1 + u1), first, last, k2)
        spin = _dot(w, e)
        phi = mp.atan2(start[0, 2], -start[1, 2]) + lower + upper
        chi = mp.atan2(start[2, 0], start[2, 1]) + (spin - a) * mp.mpf(time) - lower + upper
        sine = mp.sqrt(1 - u * u)
        slope = 2 * (u2 - u1) * rate * mp.sin(last) * mp.cos(last) * mp.sqrt(1 - k2 * mp.sin(last) ** 2)
        phi_rate, theta_rate = (b - a * u) / sine**2, -slope / sine
        tilt = mp.matrix([[1, 0, 0], [0, u, -sine], [0, sine, u]])
        w_end = mp.matrix(
            [
                phi_rate * sine * mp.sin(chi) + theta_rate * mp.cos(chi),
                phi_rate * sine * mp.cos(chi) - theta_rate * mp.sin(chi),
                spin,
            ]
        )
        return S * _about_z(phi) * tilt * _about_z(chi) * P.T, P * w_end


def to_floats(matrix):
    """Convert an mpmath matrix to an array, a column to a vector."""
    array = np.array(matrix.tolist(), dtype=float)
    return array[:, 0] if array.shape[1] == 1 else array


def _matrix(values):
    """Convert numbers of any type exactly to an mpmath matrix or column."""
    if isinstance(values, mp.matrix):
        return values.copy()
    rows = np.asarray(values, dtype=object)
    rows = rows[:, None] if rows.ndim == 1 else rows
    return mp.matrix([[mp.mpf(x) for x in row] for row in rows.tolist()])


def _cubic_roots(a, b, c, d):
    """Real roots of a u^3 + b u^2 + c u + d, a > 0, in increasing order, by Viete's formula."""
    with mp.extradps(mp.mp.dps):  # double roots lose half of the digits
        p = (b * b - 3 * a * c) / (9 * a * a)
        q = (b * (2 * b * b - 9 * a * c) + 27 * a * a * d) / (54 * a**3)
        angle = mp.acos(min(max(q / mp.sqrt(p) ** 3, -1), 1)) if p > 0 else mp.mpf(0)
        return sorted(-2 * mp.sqrt(max(p, 0)) * mp.cos((angle + 2 * k * mp.pi) / 3) - b / (3 * a) for k in range(3))


def _third_kind(n, first, last, k2):
    """Elliptic integral of the third kind, of 1 / (1 - n sn^2), between two amplitudes."""
    return mp.ellippi(n, last, k2) - mp.ellippi(n, first, k2)


def _amplitude(tau, k2):
    """Jacobi amplitude am(tau | k2): the unwrapped angle with sine sn and cosine cn."""
    if k2 == 1:
        return 2 * mp.atan(mp.tanh(tau / 2))
    quarter = mp.ellipk(k2)
    turns = mp.floor(tau / (4 * quarter) + mp.mpf(1) / 2)
    remainder = tau - 4 * quarter * turns
    return 2 * mp.pi * turns + mp.atan2(mp.ellipfun("sn", remainder, m=k2), mp.ellipfun("cn", remainder, m=k2))


def _dot(a, b):
    return (a.T * b)[0]


def _cross(a, b):
    return mp.matrix([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _columns(*vectors):
    return mp.matrix([[vector[i] for vector in vectors] for i in range(3)])


def _node_axes(m, axis):
    """Columns: axes along the node m x axis, perpendicular to it, and along m."""
    node = _cross(m, axis)
    node, up = node / mp.sqrt(_dot(node, node)), m / mp.sqrt(_dot(m, m))
    return _columns(node, _cross(up, node), up)


def _completed(z):
    """Rotation matrix with z, normalised, as its last column."""
    z = z / mp.sqrt(_dot(z, z))
    smallest = min(range(3), key=lambda i: abs(z[i]))
    return _node_axes(z, mp.matrix([int(i == smallest) for i in range(3)]))


def _about_z(angle):
    c, s = mp.cos(angle), mp.sin(angle)
    return mp.matrix([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def _exp(w, time):
    """Rotation matrix exp(w time)."""
    speed = mp.sqrt(_dot(w, w))
    if speed == 0:
        return mp.eye(3)
    axes = _completed(w / speed)
    return axes * _about_z(speed * time) * axes.T
