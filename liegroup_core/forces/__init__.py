# SPDX-License-Identifier: Apache-2.0
"""Forces between bodies, one file a kind, and the wrenches that are applied from outside.

In: poses and twists. Out: wrenches on bodies, energy, power. A force knows no joint constraint
equations and no integrator.
"""
