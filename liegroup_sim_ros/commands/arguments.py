# SPDX-License-Identifier: Apache-2.0
"""Argument parser with errors of one line, and types of arguments."""

import argparse
import os
import sys


class Parser(argparse.ArgumentParser):
    """ArgumentParser that reports a wrong argument in one line, exit code 2."""

    def error(self, message):
        """Print the message in one line and exit."""
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


def has_display():
    """Whether a browser can open: a text browser would take the terminal."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
