# SPDX-License-Identifier: Apache-2.0
"""Many runs of a scene with sampled parameters."""
