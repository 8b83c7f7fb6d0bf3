# SPDX-License-Identifier: Apache-2.0
"""Figures and tables of the chapter by Mueller and Terze, recomputed."""
