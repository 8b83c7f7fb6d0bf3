# SPDX-License-Identifier: Apache-2.0
"""Quantities computed from a state: samples, energy, momentum, joint coordinates.

In: a layout and a state. Out: NumPy arrays with names. Nothing here takes a step.
"""
