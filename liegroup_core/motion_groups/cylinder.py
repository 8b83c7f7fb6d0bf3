# SPDX-License-Identifier: Apache-2.0
"""SO(2) x R: a link turns about z and moves along it."""

JOINTS = ("cylindrical",)
COMPONENTS = (2, 5)
MAY_BE_HELD = True
