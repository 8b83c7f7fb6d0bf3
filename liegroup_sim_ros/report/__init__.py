# SPDX-License-Identifier: Apache-2.0
"""HTML reports, plots, images and tables of analyses and studies. Needs no ROS.

Input: figures and curves of analysis/ and liegroup_core.study. Output: text for a terminal, HTML, images.
This package computes no results.
"""
