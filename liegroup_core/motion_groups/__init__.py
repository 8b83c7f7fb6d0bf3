# SPDX-License-Identifier: Apache-2.0
"""Motion groups: relative motions of a link and its parent that a tree joint permits. One file per group.

In: the record of a link, its coordinates, rates and articulated inertia. Out: the quantities that
table.py lists. A motion group does not depend on the tree, cut joints or the integrator.
"""
