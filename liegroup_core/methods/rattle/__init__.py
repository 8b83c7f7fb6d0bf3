# SPDX-License-Identifier: Apache-2.0
"""RATTLE for mechanisms: symmetric; satisfies constraints of positions and velocities."""
