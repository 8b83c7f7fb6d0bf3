# SPDX-License-Identifier: Apache-2.0
"""Matrices as messages, std_msgs/Float64MultiArray, row by row; imports no ROS.

Both dimensions are labelled. The message has no stamp; in a recording its log time is the stamp.
"""

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
    for label, size, stride in ((" ".join(names), n, n * m), (" ".join(columns), m, m)):
        template.string(label)
        template.put("2I", size, stride)
    template.put("I", 0)  # data_offset
    template.put("I", n * m)
    template.slot(f"{n * m}d")
    return template.pack


def decode(payload):
    """(names of the rows, names of the columns, numbers row by row). Raises MessageError."""
    fields = Fields(TYPE, payload)
    count = fields.number("I")
    if count != 2:
        raise MessageError(f"{TYPE}: has {counted(count, 'dimension')}, not 2")
    labels, shape = [], []
    for _ in range(2):
        labels.append(tuple(fields.text().split(" ")))
        shape.append(fields.number("I"))
        fields.number("I")
    fields.number("I")
    values = fields.numbers("d", fields.number("I"))
    if list(map(len, labels)) != shape or len(values) != shape[0] * shape[1]:
        raise MessageError(f"{TYPE}: {counted(len(values), 'number')} in the shape {shape}")
    return *labels, values
