# SPDX-License-Identifier: Apache-2.0
"""Equations of motion in absolute coordinates: index-1 saddle point, projection, energy, momentum."""
