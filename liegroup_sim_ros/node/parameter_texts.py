# SPDX-License-Identifier: Apache-2.0
"""Texts generated from the table of parameters: config/default.yaml, and a table for the documentation.

    python -m liegroup_sim_ros.node.parameter_texts FOLDER

writes the preset into the repository in FOLDER. test/ros/test_node.py compares it with the table.
"""

import sys
import textwrap
from pathlib import Path

import yaml

from .parameters import TABLE, allowed_values

PRESET_HEAD = """\
# All parameters of the simulation node with their defaults (the scene is an example). To use other
# values, copy this file, change it, and start the node with --ros-args --params-file FILE.
# Generated from the table in liegroup_sim_ros/node/parameters.py.
/**:
  ros__parameters:
"""


def table_text():
    """Table of the parameters in Markdown."""
    rows = ["| parameter | default | allowed | settable while running | meaning |", "|---|---|---|---|---|"]
    for entry in TABLE:
        default = {"": "empty", False: "false", True: "true"}.get(
            entry.default if isinstance(entry.default, (str, bool)) else None, entry.default
        )
        rows.append(
            f"| `{entry.name}` | {default} | {allowed_values(entry)} | "
            f"{'no' if entry.read_only else 'yes'} | {entry.text} |"
        )
    return "\n".join(rows)


def preset_text():
    """Text of config/default.yaml: every parameter with its meaning and its default."""
    text = PRESET_HEAD
    for entry in TABLE:
        value = entry.default if entry.name != "scene" else "heavy_top"
        meaning = entry.text + (f"; one of {', '.join(entry.choices)}" if entry.choices else "")
        text += textwrap.indent(textwrap.fill(meaning, 90), "    # ") + "\n"
        # A value in the file would be refused where the package is missing.
        text += f"    {'# ' * bool(entry.package)}{yaml.safe_dump({entry.name: value}, width=1000)}"
    return text


def write(folder):
    """Write the preset into the repository in a folder."""
    (Path(folder) / "config" / "default.yaml").write_text(preset_text(), encoding="utf-8")


if __name__ == "__main__":
    write(sys.argv[1])
