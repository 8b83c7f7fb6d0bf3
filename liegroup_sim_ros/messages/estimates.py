# SPDX-License-Identifier: Apache-2.0
"""Estimated errors as messages, std_msgs/Float64MultiArray, and as variances.

The array has m, rad, m/s, rad/s of every body (n, 4), as in Sample.errors; see matrices.py.
"""

import math

from . import matrices

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


def covariance(linear, angular):
    """(36,) row by row, diagonal: the variances along and about x, y and z."""
    values = [0.0] * 36
    values[0:21:7] = (linear,) * 3
    values[21:36:7] = (angular,) * 3
    return values


def decode_rows(rows, names, _world_frame=None):
    """(m, 4 n) numbers of messages of one size, given as rows (m, size) uint8. Raises MessageError."""
    return matrices.decode_rows(rows, names, UNITS)
