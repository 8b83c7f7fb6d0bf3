# SPDX-License-Identifier: Apache-2.0
"""Compile the kernels of all method families in two processes, before tests that would wait for each other.

python test/compile_kernels.py
"""

import logging
import subprocess
import sys

FAMILIES = "rkmk4 radau5 generalized_alpha constrained_rattle".split()
SCENES = ("bricard", "four_bar")  # in space and in a plane


def compile_in(scene):
    """Compile every family for a scene, and the reference integration."""
    from liegroup_core import load_scene
    from liegroup_core.engine import Engine
    from liegroup_core.reference import integrate

    logging.disable(logging.WARNING)
    for method in FAMILIES if scene == SCENES[0] else reversed(FAMILIES):
        engine = Engine(load_scene(scene), method)
        engine.layout.reactions.warm_up()
    if scene == SCENES[1]:
        Engine(load_scene("lagrangian_top"), "rattle")
        integrate(engine.scene, *engine.state(), [1e-3])


if __name__ == "__main__":
    if sys.argv[1:]:
        compile_in(sys.argv[1])
    else:
        running = [subprocess.Popen([sys.executable, "-P", __file__, scene]) for scene in SCENES]
        sys.exit(max(each.wait() for each in running))
