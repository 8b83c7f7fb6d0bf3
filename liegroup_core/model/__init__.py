# SPDX-License-Identifier: Apache-2.0
"""The constant model of a scene: arrays for kernels, found once at build.

In: a checked scene. Out: Model, with redundant constraint equations eliminated and the block
structure of the solve. A model knows no time step.
"""
