# SPDX-License-Identifier: Apache-2.0
"""Matrices as messages, std_msgs/Float64MultiArray, row by row.

Both dimensions are labelled by names separated by blanks; a blank in a name is %20, and a % is %25. The message has no
stamp; in a recording its log time is the stamp.
"""

from urllib.parse import unquote

import numpy as np

from liegroup_sim_ros.numbers import counted

from .cdr import Template
from .codecs import Fields, MessageError

TYPE = "std_msgs/msg/Float64MultiArray"


def encoder(names, columns):
    """Function (numbers row by row) -> serialized message.

    names : of the rows;  columns : their units or names
    """
    n, m = len(names), len(columns)
    template = Template()
    template.put("I", 2)
    for label, size, stride in ((" ".join(map(_quoted, names)), n, n * m), (" ".join(columns), m, m)):
        template.string(label)
        template.put("2I", size, stride)
    template.put("I", 0)  # data_offset
    template.put("I", n * m)
    template.slot(f"{n * m}d")
    return template.pack


def _quoted(name):
    return name.replace("%", "%25").replace(" ", "%20")


def decode(payload, known=None):
    """(names of the rows, names of the columns, numbers row by row). Raises MessageError, also for other columns."""
    fields = Fields(TYPE, payload)
    count = fields.number("I")
    if count != 2:
        raise MessageError(f"{TYPE}: has {counted(count, 'dimension')}, not 2")
    labels, shape = [], []
    for _ in range(2):
        labels.append(tuple(map(unquote, fields.text().split(" "))))
        shape.append(fields.number("I"))
        fields.number("I")
    fields.number("I")
    values = fields.numbers("d", fields.number("I"))
    if list(map(len, labels)) != shape or len(values) != shape[0] * shape[1]:
        raise MessageError(f"{TYPE}: {counted(len(values), 'number')} in the shape {shape}")
    if known is not None and labels[1] != known:
        raise MessageError(f"{TYPE}: its columns are not {' '.join(known)}")
    return *labels, values


def decode_rows(rows, bodies, units):
    """(m, n k) numbers of messages of one size about n bodies with k units, given as rows (m, size) uint8.

    Raises MessageError, also for messages about other bodies or in other units.
    """

    def numbers(payload):
        *labels, values = decode(payload)
        if labels != [tuple(bodies), tuple(units)]:
            raise MessageError(f"{TYPE}: values of other bodies, or in other units")
        return values

    return last_numbers(rows, len(bodies) * len(units), numbers)


def last_numbers(rows, count, numbers, changing=slice(0)):
    """(m, count) float64 values at the end of messages of one size, given as rows (m, size) uint8.

    numbers  : function payload -> its numbers, which raises MessageError; called for the first message only, if
               the heads of the others are the same
    changing : bytes that may differ in these heads
    """
    at = rows.shape[1] - 8 * count  # in messages of ROS the values come last
    heads = np.delete(rows[:, : max(at, 0)], changing, axis=1)
    if at >= 0 and (heads == heads[:1]).all():
        values = np.ascontiguousarray(rows[:, at:]).view(">f8" if rows[0, 1] == 0 else "<f8").astype(float)
        if values[0].tobytes() == np.array(numbers(rows[0].tobytes())).tobytes():
            return values
    return np.array([numbers(row.tobytes()) for row in rows])
