# SPDX-License-Identifier: Apache-2.0
"""Many runs of scenes, in parallel: the trade between speed and accuracy, and what is like it."""
