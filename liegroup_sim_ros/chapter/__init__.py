# SPDX-License-Identifier: Apache-2.0
"""The figures and tables of Mueller and Terze's chapter, computed again."""
