# SPDX-License-Identifier: Apache-2.0
"""Quantities computed from a state: samples, energy, momentum, joint coordinates.

Input: a layout and a state. Output: NumPy arrays with names. This package takes no steps.
"""
