# SPDX-License-Identifier: Apache-2.0
"""Process that compiles the kernels of an analysis while a simulation runs in another process."""

import os
import sys

import numpy as np

from liegroup_core import load_scene
from liegroup_core.layout import make_layout
from liegroup_core.mechanism.body_model import initial_state
from liegroup_core.reference import integrate


def main():
    """Integrate the scene given by the first argument for a millisecond; returns the exit code."""
    os.nice(10)
    scene = load_scene(sys.argv[1])
    integrate(scene, *initial_state(make_layout(scene).centred), np.array([1e-3]))
    return 0
