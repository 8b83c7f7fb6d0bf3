# SPDX-License-Identifier: Apache-2.0
"""Generalised-alpha method on the group, index 3, for stiff scenes."""
