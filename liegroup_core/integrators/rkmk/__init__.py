# SPDX-License-Identifier: Apache-2.0
"""Munthe-Kaas methods of any explicit Runge-Kutta tableau, in absolute and in relative coordinates."""
