# SPDX-License-Identifier: Apache-2.0
"""Processes that benchmarks/node.py compares with the simulation node."""
