# SPDX-License-Identifier: Apache-2.0
"""Motion groups: how a joint of the tree lets a link move relative to its parent. A file is a group.

In: the record of a link, its coordinates, rates and articulated inertia. Out: what a sweep asks, see
table.py. A motion group knows no tree, no cut joint and no integrator.
"""
