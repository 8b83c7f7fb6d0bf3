# SPDX-License-Identifier: Apache-2.0
"""Equations of motion in absolute coordinates: index-1 form, projection, energy, momentum."""
