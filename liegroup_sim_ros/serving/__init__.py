# SPDX-License-Identifier: Apache-2.0
"""A simulation that runs in real time: its thread, its inputs, its outputs and their rates.

In: a Simulation, and commands from other threads. Out: messages for topics and recordings. This folder imports no
rclpy, so the live page serves a simulation as the node does.
"""
