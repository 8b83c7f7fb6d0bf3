# SPDX-License-Identifier: Apache-2.0
"""Estimated errors as messages, std_msgs/Float64MultiArray; imports no ROS.

The array has m, rad, m/s, rad/s of every body, row by row (n, 4), as in Sample.errors. The message has
no stamp; in a recording its log time is the stamp.
"""

import numpy as np

from .cdr import Template
from .codecs import Fields, MessageError

TYPE = "std_msgs/msg/Float64MultiArray"
UNITS = "m rad m/s rad/s"  # of the columns
_COLUMNS = 4


def encoder(body_names):
    """Function sample -> serialized message, for samples with errors."""
    n = len(body_names)
    template = Template()
    template.put("I", 2)
    for label, size, stride in (
        (" ".join(body_names), n, n * _COLUMNS),
        (UNITS, _COLUMNS, _COLUMNS),
    ):
        template.string(label)
        template.put("2I", size, stride)
    template.put("I", 0)  # data_offset
    template.put("I", n * _COLUMNS)
    template.slot(f"{n * _COLUMNS}d")
    return lambda sample: template.pack(sample.errors.ravel().tolist())


def decode_rows(rows, body_names):
    """(m, 4 n) numbers of messages of one size, as the rows of an array (m, size) uint8.

    Raises MessageError, also if the messages are not about these bodies.
    """
    count = _COLUMNS * len(body_names)
    at = rows.shape[1] - 8 * count  # the numbers end a message of ROS
    if at >= 0 and (rows[:, :at] == rows[:1, :at]).all():
        order = ">" if rows[0, 1] == 0 else "<"
        values = np.ascontiguousarray(rows[:, at:]).view(f"{order}f8").astype(float)
        if values[0].tobytes() == np.array(_decode(rows[0].tobytes(), body_names)).tobytes():
            return values
    return np.array([_decode(row.tobytes(), body_names) for row in rows])


def _decode(payload, body_names):
    fields = Fields(TYPE, payload)
    shape = []
    for _ in range(fields.number("I")):
        label = fields.text()
        shape.append((label, fields.number("I")))
        fields.number("I")
    fields.number("I")
    values = fields.numbers("d", fields.number("I"))
    if shape != [(" ".join(body_names), len(body_names)), (UNITS, _COLUMNS)] or len(
        values
    ) != _COLUMNS * len(body_names):
        raise MessageError(f"{TYPE}: estimated errors of other bodies, or in another form")
    return values
