# SPDX-License-Identifier: Apache-2.0
"""Predicted cost of a stage of a Munthe-Kaas method, by formulation."""


def is_cheaper(relative):
    """True if relative coordinates cost less than SE(3)^n; relative: RelativeModel."""
    return True
