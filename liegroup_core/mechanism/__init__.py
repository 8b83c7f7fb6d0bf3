# SPDX-License-Identifier: Apache-2.0
"""The mechanism of a scene as arrays for kernels, found once at build.

In: a checked scene. Out: the spanning tree, the motion group of every link, the cut joints with their
independent rows, as RelativeModel and its scratch memory. It does not depend on the method.
"""
