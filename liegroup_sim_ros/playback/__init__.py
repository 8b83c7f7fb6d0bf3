# SPDX-License-Identifier: Apache-2.0
"""Recordings played back: published again on topics, or simulated again and compared.

In: a recording. Out: topics, or the states of a second run. Knows no analysis and no display.
"""
