# SPDX-License-Identifier: Apache-2.0
"""ROS 2 side of the rigid body simulation: converts, paces, publishes, records, analyses.

    from liegroup_sim_ros import show

    show("run.mcap")                # in a notebook: the 3-D replay and the curves

No mechanics here: that is `liegroup_core`. Only `node` and the publishing part of `playback` import
rclpy.
"""

from typing import TYPE_CHECKING

from .version import __version__

if TYPE_CHECKING:
    from .notebook import show

__all__ = ["__version__", "show"]


def __getattr__(name):
    if name != "show":  # imported on first use, because the command line does not need it
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from .notebook import show

    return show
