# SPDX-License-Identifier: Apache-2.0
"""Forces of a scene, one file per kind, and the schedule of external wrenches.

In: poses and twists. Out: wrenches on bodies, energy, power. A force knows no constraint
equation and no integrator.
"""
