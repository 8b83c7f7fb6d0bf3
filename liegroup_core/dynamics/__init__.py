# SPDX-License-Identifier: Apache-2.0
"""Equations of motion on the product of the motion groups of a tree's joints, loops closed by cut joints.

In: a mechanism, coordinates and rates of its links, applied wrenches. Out: accelerations, residuals,
reactions, projections. The sweeps do not depend on the method, the time step or the scene file.
"""
