# SPDX-License-Identifier: Apache-2.0
"""Estimated errors as messages, std_msgs/Float64MultiArray, and as variances; imports no ROS.

The array has m, rad, m/s, rad/s of every body (n, 4), as in Sample.errors; see matrices.py.
"""

import math

import numpy as np

from . import matrices
from .codecs import MessageError

TYPE = matrices.TYPE
UNITS = "m", "rad", "m/s", "rad/s"  # of the columns
# Largest variance, also for unknown errors. Filters ignore values that are so uncertain, whereas NaN or
# infinity makes their states NaN.
UNKNOWN = 1e10


def encoder(body_names):
    """Function sample -> serialized message, for samples with errors."""
    pack = matrices.encoder(body_names, UNITS)
    return lambda sample: pack(sample.errors.ravel().tolist())


def variances(sample, body):
    """Variances of position m2, attitude rad2, velocity and angular velocity of a body.

    Squares of the estimated errors; zero without an estimate. Before the first estimate, variances of the
    pose are the squares of the errors that the accuracy permits.
    """
    if sample.errors is None:
        return [0.0] * len(UNITS)
    errors = sample.error[body].tolist()
    if sample.bound is not None and math.isnan(errors[0]):
        errors[:2] = sample.bound
    squares = (error * error for error in errors)
    return [square if square < UNKNOWN else UNKNOWN for square in squares]


def decode_rows(rows, body_names):
    """(m, 4 n) numbers of messages of one size, given as rows (m, size) uint8.

    Raises MessageError, also for messages about other bodies.
    """
    count = len(UNITS) * len(body_names)
    at = rows.shape[1] - 8 * count  # in messages of ROS the numbers come last
    if at >= 0 and (rows[:, :at] == rows[:1, :at]).all():
        order = ">" if rows[0, 1] == 0 else "<"
        values = np.ascontiguousarray(rows[:, at:]).view(f"{order}f8").astype(float)
        if values[0].tobytes() == np.array(_decode(rows[0].tobytes(), body_names)).tobytes():
            return values
    return np.array([_decode(row.tobytes(), body_names) for row in rows])


def _decode(payload, body_names):
    bodies, units, values = matrices.decode(payload)
    if bodies != tuple(body_names) or units != UNITS:
        raise MessageError(f"{TYPE}: estimated errors of other bodies, or in other units")
    return values
