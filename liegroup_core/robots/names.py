# SPDX-License-Identifier: Apache-2.0
"""Conversion of names of a file to unique names of a scene: letters, digits and _."""

import re

_OTHER = re.compile(r"[^A-Za-z0-9_]")
LONGEST = 64


def scene_name(name):
    """Name that a scene accepts; valid names do not change."""
    plain = _OTHER.sub("_", name)
    if not plain[:1].isascii() or not plain[:1].isalpha():
        plain = f"n{plain}"
    return plain[:LONGEST]


def unique_names(names, taken):
    """Names of a scene for names of a file, in the same order, all different and none in `taken`."""
    found, used = [], set(taken)
    # Valid names do not change, even if another name becomes equal to one of them.
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
