# SPDX-License-Identifier: Apache-2.0
"""Distance of samples from a reference, for tests and benchmarks."""

from liegroup_core.reference import Trajectory, distance


def distance_at(sample, exact, k):
    """Distance of a Sample from state k of a Trajectory, each part (n,) of n bodies."""
    pose, n = sample.pose[None], len(sample.pose)
    found = Trajectory(None, pose[..., :9].reshape(1, n, 3, 3), pose[..., 9:], sample.twist[None])
    there = Trajectory(None, *(part[k : k + 1] for part in exact[1:]))
    apart = distance(found, there)
    return apart._make(part[0] for part in apart)
