# SPDX-License-Identifier: Apache-2.0
"""Argument parser with errors of one line, and types of arguments."""

import argparse
import difflib
import os
import re
import sys


class Parser(argparse.ArgumentParser):
    """ArgumentParser that reports a wrong argument in one line, exit code 2."""

    @property
    def names(self):
        """Names of its options, and of its commands and their options."""
        below = [action for action in self._actions if isinstance(action, argparse._SubParsersAction)]
        parsers = [parser for action in below for parser in action.choices.values()]
        own = [name for name in self._option_string_actions if name.startswith("--")]
        return {*own, *(name for action in below for name in action.choices), *(n for p in parsers for n in p.names)}

    def error(self, message):
        """Print the message in one line, with the similar name of a misspelt one, and exit."""
        unknown = re.match(r"unrecognized arguments: (--[\w-]+)|argument COMMAND: invalid choice: '([^']*)'", message)
        if unknown:
            word = unknown[1] or unknown[2]
            close = difflib.get_close_matches(word, self.names, n=1, cutoff=0.7)
            message = f"unknown {'option' if unknown[1] else 'command'} {word}" + (
                f": did you mean {close[0]}?" if close else f"; known are: {', '.join(sorted(self.names))}"
            )
        self.exit(2, f"{self.prog}: {' '.join(message.split())}; see {self.prog} --help\n")


def not_negative(text):
    """Number of 0 or more; it may be infinite."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not value >= 0.0:
        raise argparse.ArgumentTypeError(f"must be a number of 0 or more, got {text!r}")
    return value


def count(text):
    """Whole number of 1 or more."""
    if not (text.isdecimal() and int(text) > 0):
        raise argparse.ArgumentTypeError(f"must be a whole number of 1 or more, got {text!r}")
    return int(text)


def add_parallel(parser):
    """Add the options of work in parallel."""
    parser.add_argument("--workers", type=count, metavar="N", help="number of processes (default: one per core)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="scheduler of a Dask cluster, such as tls://host:8786")


def has_display():
    """Whether a browser can open: a text browser would take the terminal."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
