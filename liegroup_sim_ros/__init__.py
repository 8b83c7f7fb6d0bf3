# SPDX-License-Identifier: Apache-2.0
"""ROS 2 side of the rigid body simulation: converts, paces, publishes, records, analyses.

    from liegroup_sim_ros import live, show

    show("run.mcap")                # in a notebook: the 3-D replay and the curves
    live(simulation)                # the live page: pull at bodies, command joints

No mechanics here: that is `liegroup_core`. Few rooms import rclpy, see test/contract/test_layers.py.
"""

from typing import TYPE_CHECKING

from .version import __version__

if TYPE_CHECKING:
    from .notebook import live, show

__all__ = ["__version__", "live", "show"]


def __getattr__(name):
    if name not in ("live", "show"):  # imported on first use, because the command line does not need it
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from . import notebook

    return getattr(notebook, name)
