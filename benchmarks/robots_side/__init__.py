# SPDX-License-Identifier: Apache-2.0
"""Accelerations and motions of robots compared with Pinocchio and MuJoCo, for benchmarks/robots.py."""
