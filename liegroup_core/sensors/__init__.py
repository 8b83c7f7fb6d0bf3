# SPDX-License-Identifier: Apache-2.0
"""Sensors of a scene and their measurements in a Sample. One file per kind, listed in kinds.py.

Input: a sensor of a scene, and a Sample. Output: numbers, with noise that depends only on seed, sensor
and step. This package does not depend on topics, files or its callers.
"""
