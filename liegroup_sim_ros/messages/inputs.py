# SPDX-License-Identifier: Apache-2.0
"""Messages of ~/inputs: the wrenches and efforts of a run as they were commanded, as JSON.

    {"base_ns": 0, "all": false, "commands": [{"kind": "wrench", "name": "top", "values": [0, 0, 0, 0, 5, 0],
     "start_ns": 3000000000, "end_ns": 3400000000, "source": "wind", "axes": "world", "point": [0, 0, 0.3]}]}

The entries of a command are those of liegroup_core.forces.commands.Command. Its times count from step 0, whose stamp
is base_ns. With "all" the message has all commands that act or wait, for subscribers that start later.
"""

import json

from liegroup_core.forces.commands import Command

from .codecs import Fields, MessageError
from .description import TYPE
from .description import encoded as string_message

__all__ = ["TYPE", "decode", "encode"]
_as_text = json.JSONEncoder(separators=(",", ":")).encode


def encode(base_ns, commands, everything=False):
    """Serialized message of Commands."""
    entries = {"base_ns": base_ns, "all": everything, "commands": [command.as_json() for command in commands]}
    return string_message(_as_text(entries))


def decode(payload):
    """(base_ns, [Command]) of a message. Raises MessageError."""
    try:
        entries = json.loads(Fields(TYPE, payload).text())
        if not (isinstance(entries, dict) and isinstance(entries.get("commands"), list)):
            raise ValueError("it has no list of commands")
        base_ns = entries.get("base_ns")
        if not isinstance(base_ns, int):
            raise ValueError(f"its base_ns is {base_ns!r:.40}")
        return base_ns, [Command.from_json(entry) for entry in entries["commands"]]
    except (ValueError, RecursionError) as error:
        raise MessageError(f"inputs: {error}") from None
