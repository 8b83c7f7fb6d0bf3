# SPDX-License-Identifier: Apache-2.0
"""Munthe-Kaas methods of Runge-Kutta tableaus, explicit and implicit."""
