# SPDX-License-Identifier: Apache-2.0
"""Playback of recordings: publish the messages again, repeat the simulation, or continue from a state.

In: a recording. Out: topics, the states of a second run, or a simulation at an instant. This folder
imports no analysis and no display.
"""
