# SPDX-License-Identifier: Apache-2.0
"""Names of a scene from names of a file: letters, digits and _, unique."""

import re

_OTHER = re.compile(r"[^A-Za-z0-9_]")
LONGEST = 64


def scene_name(name):
    """Name that a scene accepts; the same one if it already is."""
    plain = _OTHER.sub("_", name)
    if not plain[:1].isascii() or not plain[:1].isalpha():
        plain = f"n{plain}"
    return plain[:LONGEST]


def unique_names(names, taken):
    """Names of a scene for names of a file, in order, none twice and none of `taken`."""
    found, used = [], set(taken)
    # Names that need no change keep theirs, whatever the others become.
    plain = {name for name in names if scene_name(name) == name and name not in taken}
    used |= plain
    kept = set()
    for name in names:
        own = scene_name(name)
        if own == name and name in plain and name not in kept:
            kept.add(name)
        else:
            base, number = own, 2
            while own in used:
                own = f"{base[: LONGEST - 6]}_{number}"
                number += 1
            used.add(own)
        found.append(own)
    return found
