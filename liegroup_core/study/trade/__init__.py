# SPDX-License-Identifier: Apache-2.0
"""Accuracy against cost: configurations measured against a reference solution."""
