# SPDX-License-Identifier: Apache-2.0
"""Stress tests: where each method fails, and whether it reports so."""
