# SPDX-License-Identifier: Apache-2.0
"""RATTLE for mechanisms: symmetric, keeps constraints at the positions and velocities."""
