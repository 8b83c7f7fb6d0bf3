# SPDX-License-Identifier: Apache-2.0
"""CDR of messages that are the same from one time to the next but for some numbers.

A Template is built once, field by field in the order of the .msg file; what changes is left as
slots, and `pack` writes the numbers of all slots into the bytes that are ready. Plain CDR,
little endian; alignment counts from behind the 4-byte encapsulation, gaps are zero
(test_sample_messages.py compares every type with rclpy's serialization).

Source: OMG DDS-RTPS 2.3 section 10 (encapsulation), CORBA 3.3 part 2, section 9.3 (CDR).
"""

import struct

ENCAPSULATION = b"\x00\x01\x00\x00"  # plain CDR, little endian


class Template:
    """A message under construction, then the function that completes it."""

    def __init__(self):
        self._data = bytearray(ENCAPSULATION)
        self._slots = []

    def _align(self, size):
        self._data += bytes((len(ENCAPSULATION) - len(self._data)) % size)

    def put(self, form, *values):
        """Constant numbers of one size: `form` as in struct, such as "36d"; no number, no gap."""
        layout = struct.Struct("<" + form)
        if layout.size:
            self._align(struct.calcsize("<" + form[-1]))
            self._data += layout.pack(*values)

    def string(self, text):
        """Constant text."""
        characters = text.encode() + b"\0"
        self.put("I", len(characters))
        self._data += characters

    def slot(self, form):
        """Numbers of one size that `pack` will be given as one sequence."""
        layout = struct.Struct("<" + form)
        if layout.size:
            self._align(struct.calcsize("<" + form[-1]))
        self._slots.append((layout.pack_into, len(self._data)))
        self._data += bytes(layout.size)

    def header(self, frame_id):
        """std_msgs/Header; its slot is the stamp, (s, ns)."""
        self.slot("iI")
        self.string(frame_id)

    def pack(self, *values):
        """The message, with a sequence of numbers for every slot, in their order."""
        data = self._data
        for (pack_into, offset), numbers in zip(self._slots, values, strict=True):
            pack_into(data, offset, *numbers)
        return bytes(data)


def stamp(stamp_ns):
    """(s, ns) of builtin_interfaces/Time."""
    return divmod(stamp_ns, 1_000_000_000)
