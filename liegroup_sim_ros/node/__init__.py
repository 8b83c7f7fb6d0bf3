# SPDX-License-Identifier: Apache-2.0
"""The simulation node: parameters, topics and services of ROS 2, around a served simulation.

In: parameters, wrenches and service calls. Out: topics, diagnostics and a recording. This folder
contains no mechanics.
"""
