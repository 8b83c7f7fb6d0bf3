# SPDX-License-Identifier: Apache-2.0
"""Methods of a Simulation that packages above it carry out: entry points of a distribution, see setup.py."""

from importlib.metadata import entry_points

from .errors import LieGroupSimError

GROUP = "liegroup_core.simulation"


def attached(name):
    """Function that an installed package attaches as `name`. Raises LieGroupSimError if none does."""
    for entry in entry_points(group=GROUP, name=name):
        return entry.load()
    raise LieGroupSimError(f"Simulation.{name}: no installed package has it: install liegroup_sim_ros")
