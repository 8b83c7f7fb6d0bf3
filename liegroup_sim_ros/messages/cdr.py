# SPDX-License-Identifier: Apache-2.0
"""CDR messages in which only some numbers change from one message to the next.

A Template is built once, field by field in the order of the .msg file. Fields that change are
slots. `pack` writes the numbers of all slots into the prepared bytes. The encoding is plain CDR,
little endian. Alignment counts from the end of the 4-byte encapsulation header; padding is zero.

The bytes equal those of rclpy.serialization.serialize_message (test_sample_messages.py), including
the length: rclpy reserves the padding of an empty sequence of numbers, which its serializer does
not insert, so a message with such a sequence ends in unused bytes.

Source: OMG DDS-RTPS 2.3 section 10 (encapsulation), CORBA 3.3 part 2, section 9.3 (CDR).
"""

import struct

ENCAPSULATION = b"\x00\x01\x00\x00"  # plain CDR, little endian


class Template:
    """Builder of a message type; `pack` serializes one message."""

    def __init__(self):
        self._data = bytearray(ENCAPSULATION)
        self._end = 0  # where the next field begins, behind the encapsulation
        self._reserved = 0  # bytes that rclpy reserves for the fields so far
        self._slots = []

    def _place(self, form):
        """(layout, offset) of a new field. An empty field reserves its padding without inserting it."""
        layout, item = struct.Struct("<" + form), struct.calcsize("<" + form[-1])
        start = self._end + (-self._end % item if layout.size else 0)
        self._end = start + layout.size
        self._reserved += -self._reserved % item + layout.size
        self._data += bytes(len(ENCAPSULATION) + self._reserved - len(self._data))
        return layout, len(ENCAPSULATION) + start

    def put(self, form, *values):
        """Append constant numbers of one type; `form` as in struct, such as "36d"."""
        layout, offset = self._place(form)
        layout.pack_into(self._data, offset, *values)

    def string(self, text):
        """Append a constant string."""
        characters = text.encode() + b"\0"
        self.put("I", len(characters))
        self.put(f"{len(characters)}s", characters)

    def slot(self, form):
        """Append a slot: numbers of one type, one sequence among the arguments of `pack`."""
        layout, offset = self._place(form)
        self._slots.append((layout.pack_into, offset))

    def header(self, frame_id):
        """Append a std_msgs/Header; its slot is the stamp, (s, ns)."""
        self.slot("iI")
        self.string(frame_id)

    def pack(self, *values):
        """Serialized message; values: one sequence of numbers for each slot, in order."""
        data = self._data
        for (pack_into, offset), numbers in zip(self._slots, values, strict=True):
            pack_into(data, offset, *numbers)
        return bytes(data)


def stamp(stamp_ns):
    """(s, ns) of a builtin_interfaces/Time."""
    return divmod(stamp_ns, 1_000_000_000)
