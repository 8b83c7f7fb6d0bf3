# SPDX-License-Identifier: Apache-2.0
"""Figures of a recording: errors, drift, constraint residuals, conserved quantities.

Input: a recording. Output: numbers, curves and a verdict. This package displays nothing.
"""

from .analyse import analyse

__all__ = ["analyse"]
