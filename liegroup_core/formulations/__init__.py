# SPDX-License-Identifier: Apache-2.0
"""Equations of motion of a model, one folder per choice of configuration space.

    absolute/   SE(3)^n or (SO(3) x R^3)^n: six coordinates per body, all joints as constraint
                equations
    relative/   product of the motion groups of the joints of a spanning tree: only joints that close
                loops as constraint equations

In: a model, poses, twists, applied wrenches. Out: accelerations, constraint residuals, projections.
A formulation knows no integrator, no time step and no scene file.
"""
