# SPDX-License-Identifier: Apache-2.0
"""Vectors of three numbers as tuples, and body-fixed points and directions in world axes."""

from liegroup_core.compiling import kernel

FRAME = 18  # numbers per body: rotation row by row, position, velocity, angular velocity; world axes


@kernel
def three(table, row, column):
    """Three numbers of a row of a table, from a column on."""
    return table[row, column], table[row, column + 1], table[row, column + 2]


@kernel
def add_three(table, row, column, factor, x):
    """Add a multiple of a vector to three numbers of a row."""
    for c in range(3):
        table[row, column + c] += factor * x[c]


@kernel
def dot(a, b):
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def cross(a, b):
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def plus(a, factor, b):
    """Sum of a and a multiple of b."""
    return a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]


@kernel
def turned(frame, body, x):
    """World components of a body-fixed vector."""
    return (
        frame[body, 0] * x[0] + frame[body, 1] * x[1] + frame[body, 2] * x[2],
        frame[body, 3] * x[0] + frame[body, 4] * x[1] + frame[body, 5] * x[2],
        frame[body, 6] * x[0] + frame[body, 7] * x[1] + frame[body, 8] * x[2],
    )


@kernel
def turned_back(frame, body, x):
    """Body components of a world vector."""
    return (
        frame[body, 0] * x[0] + frame[body, 3] * x[1] + frame[body, 6] * x[2],
        frame[body, 1] * x[0] + frame[body, 4] * x[1] + frame[body, 7] * x[2],
        frame[body, 2] * x[0] + frame[body, 5] * x[1] + frame[body, 8] * x[2],
    )


@kernel
def direction(frame, body, fixed):
    """World components of a body-fixed direction and its first two time derivatives, without omegadot."""
    omega = three(frame, body, 15)
    e = turned(frame, body, fixed)
    rate = cross(omega, e)
    return e, rate, cross(omega, rate)


@kernel
def point(frame, body, fixed):
    """Position, velocity and acceleration of a body-fixed point, without rddot and omegadot."""
    arm, rate, change = direction(frame, body, fixed)
    return plus(three(frame, body, 9), 1.0, arm), plus(three(frame, body, 12), 1.0, rate), change


@kernel
def turning(frame, parent, child):
    """Angular velocity of the child relative to the parent, rad/s."""
    return plus(three(frame, child, 15), -1.0, three(frame, parent, 15))


@kernel
def slide(frame, parent, child, fixed, start, end):
    """Axis, position of its end, displacement and rate of a joint that slides.

    fixed, start : direction and point of the parent;  end : point of the child
    """
    axis, begin, end = turned(frame, parent, fixed), point(frame, parent, start), point(frame, child, end)
    d, d_rate = plus(end[0], -1.0, begin[0]), plus(end[1], -1.0, begin[1])
    return axis, end[0], dot(axis, d), dot(cross(three(frame, parent, 15), axis), d) + dot(axis, d_rate)


@kernel
def add_force(force, frame, body, position, factor, f):
    """Add a multiple of a force at a position, both in world axes, to the row (force, torque) of a body."""
    add_three(force, body, 0, factor, f)
    add_three(force, body, 3, factor, cross(plus(position, -1.0, three(frame, body, 9)), f))


@kernel
def place(state, frame_out):
    """Write the frames (n + 1, FRAME) of a state (n, 13), whose quaternions may have any norm; the last is the world's.

    state : quaternion (w, x, y, z), position, velocity (world axes), omega (body axes)
    """
    n = len(state)
    for i in range(n):
        w, x, y, z = state[i, 0], state[i, 1], state[i, 2], state[i, 3]
        s = 2.0 / (w * w + x * x + y * y + z * z)
        frame_out[i, 0], frame_out[i, 4] = 1.0 - s * (y * y + z * z), 1.0 - s * (x * x + z * z)
        frame_out[i, 8] = 1.0 - s * (x * x + y * y)
        frame_out[i, 1], frame_out[i, 3] = s * (x * y - w * z), s * (x * y + w * z)
        frame_out[i, 2], frame_out[i, 6] = s * (x * z + w * y), s * (x * z - w * y)
        frame_out[i, 5], frame_out[i, 7] = s * (y * z - w * x), s * (y * z + w * x)
        for c in range(6):
            frame_out[i, 9 + c] = state[i, 4 + c]
        omega = turned(frame_out, i, three(state, i, 10))
        for c in range(3):
            frame_out[i, 15 + c] = omega[c]
    for c in range(FRAME):
        frame_out[n, c] = 1.0 if c < 9 and c % 4 == 0 else 0.0
