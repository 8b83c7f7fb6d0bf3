# SPDX-License-Identifier: Apache-2.0
"""Mechanisms whose joints hold every body in a plane: three scalars a body, on SE(2)^n."""
