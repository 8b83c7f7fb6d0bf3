# SPDX-License-Identifier: Apache-2.0
"""The simulation node: parameters, simulation thread, topics and services.

In: parameters, wrenches and service calls. Out: topics, diagnostics and a recording. This folder
contains no mechanics.
"""
