# SPDX-License-Identifier: Apache-2.0
"""Playback of recordings: publish the messages again, or repeat the simulation and compare.

In: a recording. Out: topics, or the states of a second run. This folder imports no analysis and no
display.
"""
