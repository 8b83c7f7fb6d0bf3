# SPDX-License-Identifier: Apache-2.0
"""The same problems in this package and in others: exact ends, native loops, one measure."""

import importlib

PEERS = ("mujoco", "pinocchio", "exudyn")


def load_peers(console):
    """Modules of the peers that can run here; of the others it is said why they cannot."""
    found = []
    for name in PEERS:
        try:
            found.append(importlib.import_module(f"{__name__}.{name}_code"))
        except ImportError as error:
            console.print(f"[yellow]Left out: {name}: {error}[/yellow]")
    return found
