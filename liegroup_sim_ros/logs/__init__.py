# SPDX-License-Identifier: Apache-2.0
"""Logs of real machines: bags of ROS 2, and maps that say what their topics are in a scene.

Input: a bag and a map. Output: a liegroup_core.identification.Log. No ROS, and nothing in a bag is executed.
"""
