# SPDX-License-Identifier: Apache-2.0
"""HTML reports, plots, images and tables of analyses and studies. Needs no ROS.

In: figures and curves of analysis/ and liegroup_core.study. Out: text for a terminal, HTML, images.
Computes no results of its own.
"""
