# SPDX-License-Identifier: Apache-2.0
"""Logs of real machines against scenes: comparison, and identification of numbers of the scene."""

from .comparison import Comparison, compare
from .identification import Identification, identify
from .log import Given, Log, Measured
from .plan import Move, Plan, plan

__all__ = ["Comparison", "Given", "Identification", "Log", "Measured", "Move", "Plan", "compare", "identify", "plan"]
