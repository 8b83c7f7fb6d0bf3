# SPDX-License-Identifier: Apache-2.0
"""Processes that benchmarks/node.py measures the simulation node with and against."""
