# SPDX-License-Identifier: Apache-2.0
"""What `liegroup_sim analyze` finds out of a recording, and how it is shown. Needs no ROS."""
