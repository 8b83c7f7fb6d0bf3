# SPDX-License-Identifier: Apache-2.0
"""Figures and tables of Mueller and Terze's chapter, recomputed."""
