# SPDX-License-Identifier: Apache-2.0
"""What is known of the error of a run while it runs: step checks and constraint drift.

In: the states at the ends of steps. Out: warnings. A monitor changes no state.
"""
