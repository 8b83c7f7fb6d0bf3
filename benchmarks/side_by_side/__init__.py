# SPDX-License-Identifier: Apache-2.0
"""The same problems in several codes: exact end states, native loops, one error measure."""

import importlib

PEERS = ("mujoco", "pinocchio", "exudyn")


def load_peers(console):
    """Modules of the available peers; prints why the others are unavailable."""
    found = []
    for name in PEERS:
        try:
            found.append(importlib.import_module(f"{__name__}.{name}_code"))
        except ImportError as error:
            console.print(f"[yellow]Omitted: {name}: {error}[/yellow]")
    return found
