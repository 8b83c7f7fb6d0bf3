# SPDX-License-Identifier: Apache-2.0
"""What a recording carries besides messages, so that it can be simulated again from itself."""
import json
import os
import platform
import time
from importlib.metadata import PackageNotFoundError, version

from . import __version__

# Packages whose versions may matter to the numbers or to the file.
_PACKAGES = ("numpy", "scipy", "numba", "mcap", "ros-jazzy-rclpy")


def at_start(simulation, node, world_frame, sample_steps, topics, stamp_ns=0):
    """{name: (media type, bytes)}: scene, settings and initial state of a simulation at step 0.

    node         : fully qualified name
    sample_steps : steps between two samples
    topics       : as Outputs.topics()
    stamp_ns     : of the initial state
    """
    scene = simulation.scene
    pose, twist = simulation.state()
    described = settings(simulation, sample_steps) | {
        "node": node, "world_frame": world_frame, "topics": topics}
    # JSON writes the shortest text that reads back to the same float64: the state is exact.
    state = {"bodies": list(simulation.layout.body_names), "pose": pose.tolist(),
             "twist": twist.tolist(), "steps": simulation.steps, "stamp_ns": stamp_ns}
    return {"scene.yaml": ("application/yaml", scene.text.encode()),
            "settings.json": as_json(described),
            "initial_state.json": as_json(state)}


def settings(simulation, sample_steps):
    """What a run was made with, and on what, as JSON types."""
    return {
        "format": 1, "scene": simulation.scene.name, "method": simulation.method,
        "group": simulation.group, "step": simulation.step,
        "stabilisation": simulation.stabilisation, "baumgarte_time": simulation.baumgarte_time,
        "options": simulation.options, "steps_per_sample": sample_steps, "versions": versions(),
        "machine": {"system": platform.platform(), "processor": platform.machine(),
                    "cores": os.cpu_count()},
        "wall_start": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())}


def as_json(data):
    """(media type, bytes) of an attachment."""
    return "application/json", json.dumps(data, indent=1, allow_nan=False).encode()


def versions():
    versions = {"liegroup_sim_ros": __version__, "python": platform.python_version()}
    for package in _PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = None        # numba: the run was plain Python
    return versions
