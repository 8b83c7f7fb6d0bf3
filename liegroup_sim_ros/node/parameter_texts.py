# SPDX-License-Identifier: Apache-2.0
"""Texts generated from the table of parameters: config/default.yaml, and a table for the documentation.

    python -m liegroup_sim_ros.node.parameter_texts FOLDER

writes the preset into the repository in FOLDER. test/ros/test_node.py compares it with the table.
"""

import sys
import textwrap
from pathlib import Path

import yaml

from .parameters import TABLE

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
        rows.append(
            f"| `{entry.name}` | {entry.shown_default} | {entry.allowed} | "
            f"{'yes' if entry.settable else 'no'} | {entry.meaning} |"
        )
    return "\n".join(rows)


def preset_text():
    """Text of config/default.yaml: every parameter with its meaning and its default."""
    text = PRESET_HEAD
    for entry in TABLE:
        value = entry.default if entry.name != "scene" else "heavy_top"
        meaning = entry.meaning + (f"; {entry.allowed}" if entry.choices else "")
        text += textwrap.indent(textwrap.fill(meaning, 90, break_on_hyphens=False), "    # ") + "\n"
        # A value in the file would be refused where the package is missing.
        text += f"    {'# ' * bool(entry.package)}{yaml.safe_dump({entry.name: value}, width=1000)}"
    return text


def write(folder):
    """Write the preset into the repository in a folder."""
    (Path(folder) / "config" / "default.yaml").write_text(preset_text(), encoding="utf-8")


if __name__ == "__main__":
    write(sys.argv[1])
