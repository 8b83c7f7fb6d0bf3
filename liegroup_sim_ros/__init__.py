# SPDX-License-Identifier: Apache-2.0
"""ROS 2 side of the rigid body simulation: converts, paces, publishes, records, analyses.

No mechanics here: that is `liegroup_core`. `messages`, `schemas`, `recorder`, `recording`,
`analyze` and `report` do not import rclpy.
"""

__version__ = "0.2.0"
