# SPDX-License-Identifier: Apache-2.0
"""Messages of ~/inputs: the wrenches and efforts of a run as they were commanded, as JSON.

    {"base_ns": 0, "all": false, "commands": [{"kind": "wrench", "name": "top", "values": [0, 0, 0, 0, 5, 0],
     "start_ns": 3000000000, "end_ns": 3400000000, "source": "wind", "axes": "world", "point": [0, 0, 0.3]}]}

The entries of a command are those of liegroup_core.forces.commands.Command. Its times count from step 0, whose stamp
is base_ns. With "all" the message has all commands that act or wait, for subscribers that start later.
"""

import json
from functools import lru_cache

from liegroup_core.forces.commands import Command

from .codecs import Fields, MessageError
from .description import TYPE
from .description import encoded as string_message

__all__ = ["TYPE", "decode", "encode"]
_as_text = json.JSONEncoder(separators=(",", ":")).encode


def encode(base_ns, commands, everything=False):
    """Serialized message of Commands."""
    text = ",".join(map(_text_of, commands))
    return string_message(f'{{"base_ns":{base_ns},"all":{"true" if everything else "false"},"commands":[{text}]}}')


def _text_of(command):
    """The text of json for the entries of a command, in a quarter of the time: one is sent in each period."""
    kind, name, values, start_ns, end_ns, *last = command
    begin, end = _around(kind, name, *last)
    start = "" if start_ns is None else f',"start_ns":{start_ns}'
    stop = "" if end_ns is None else f',"end_ns":{end_ns}'
    return f'{begin}"values":[{",".join(map(float.__repr__, values))}]{start}{stop}{end}'


@lru_cache(4096)
def _around(kind, name, *last):
    """Texts before the values and after the times, which repeat."""
    text = _as_text(Command(kind, name, (), None, None, *last).as_json())
    return text.split('"values":[]')  # not in a name, whose quotes are escaped


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
