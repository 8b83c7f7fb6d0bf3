# SPDX-License-Identifier: Apache-2.0
"""Figures of a recording: errors, drift, constraint residuals, conserved quantities.

In: a recording. Out: numbers, curves and a verdict. Knows no display.
"""

from .analyse import analyse

__all__ = ["analyse"]
