# SPDX-License-Identifier: Apache-2.0
"""Trees on the product of the motion groups of their joints, loops closed by cut joints."""
