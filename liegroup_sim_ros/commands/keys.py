# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim keys`: print the keys of a scene file. No ROS."""

import sys

from rich.console import Console
from rich.text import Text

from liegroup_core.errors import LieGroupSimError
from liegroup_core.scene.keys import key_tables
from liegroup_sim_ros.report.tables import TextTable
from liegroup_sim_ros.report.terminal import printed


class UnknownWord(LieGroupSimError):
    """Word that selects no table; one line of text, exit code 2."""


def add_arguments(parser):
    """Arguments of the subcommand."""
    parser.description = "Print the keys of a scene file: meaning, unit and default of each."
    parser.add_argument(
        "words",
        metavar="WORD",
        nargs="*",
        help="part of a scene or type of an entry, such as bodies, forces or servo; default: all",
    )


def run(args):
    """Run the subcommand; returns the exit code. Raises UnknownWord."""
    tables = key_tables()
    known = list(dict.fromkeys(word for table in tables for word in _words(table)))
    for word in args.words:
        if word not in known:
            raise UnknownWord(f"keys: {word!r} is unknown; choose from: {', '.join(known)}")
    console = Console(file=sys.stdout)
    for table in tables:
        if args.words and not {*args.words} & {*_words(table)}:
            continue
        console.print(Text(table.title, style="bold"), Text(f"({table.summary.rstrip('.')})"))
        rows = [(key.name, key.default, key.meaning) for key in table.keys]
        console.print(printed(TextTable(None, ("key", "default", "meaning"), rows, 3)))
        console.print()
    return 0


def _words(table):
    """Words that select a table: the first word of its place, and its types."""
    return table.place.split()[0], *table.types
