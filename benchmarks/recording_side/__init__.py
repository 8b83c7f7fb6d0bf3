# SPDX-License-Identifier: Apache-2.0
"""Processes that benchmarks/recording.py starts."""
