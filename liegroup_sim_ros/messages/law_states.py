# SPDX-License-Identifier: Apache-2.0
"""States of laws as messages, std_msgs/Float64MultiArray: one row for each LAW.STATE, see matrices.py."""

from . import matrices

TYPE = matrices.TYPE
COLUMNS = ("value",)


def encoder(layout):
    """Function sample -> serialized message, of a layout with states of laws."""
    names, first = list(layout.states), len(layout.model.forces.counted)
    pack = matrices.encoder(names, COLUMNS)
    return lambda sample: pack(sample.angles[first:].tolist())


def decode_rows(rows, names, _world_frame=None):
    """(m, s) values of messages of one size, given as rows (m, size) uint8. Raises MessageError."""
    return matrices.decode_rows(rows, names, COLUMNS)
