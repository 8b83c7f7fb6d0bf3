# SPDX-License-Identifier: Apache-2.0
"""Sensors of a scene: what they measure in a Sample. One file per kind, listed in kinds.py.

In: a sensor as the scene describes it, and a Sample. Out: numbers, with noise that depends on seed,
sensor and step only. Must not know: who asks, topics, files.
"""
