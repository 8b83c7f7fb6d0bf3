# SPDX-License-Identifier: Apache-2.0
"""Planar mechanisms: equations of motion on SE(2)^n, three coordinates per body."""
