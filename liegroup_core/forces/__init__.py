# SPDX-License-Identifier: Apache-2.0
"""Forces of a scene, one file per kind, and the schedule of external wrenches.

Input: poses and twists. Output: wrenches on bodies, energy, power. This package does not depend on
constraint equations or integrators.
"""
