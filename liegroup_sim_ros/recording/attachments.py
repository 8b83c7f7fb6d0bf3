# SPDX-License-Identifier: Apache-2.0
"""Attachments of a recording: scene, settings and state, from which the run can be repeated.

docs/reference/recording.md describes every entry.
"""

import json
import os
import platform
import time
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version

import numpy as np

from liegroup_core.forces.commands import Commands
from liegroup_core.settings import of_engine
from liegroup_core.state import encoded
from liegroup_core.study.machine import cpu_name
from liegroup_sim_ros.version import __version__

# Packages whose versions may affect the numbers or the file.
_PACKAGES = ("numpy", "scipy", "numba", "llvmlite", "mcap", "zstandard", "ros-jazzy-rclpy")


def at_start(simulation, node, world_frame, sample_steps, topics, stamp_ns=0, **more):
    """{name: (media type, bytes)}: scene, settings and current state of a simulation.

    node         : fully qualified name
    sample_steps : steps between two samples
    topics       : {kind: resolved topic name, or {body: name} for "pose" and "twist"}
    stamp_ns     : of the state
    more         : further entries of settings.json, JSON types
    """
    described = settings(simulation, sample_steps) | {"node": node, "world_frame": world_frame, "topics": topics} | more
    if simulation.layout.states:
        described["laws"] = list(simulation.layout.states)
    return {
        "scene.yaml": ("application/yaml", simulation.scene.text.encode()),
        "settings.json": as_json(described),
        "initial_state.json": as_json(state(simulation, stamp_ns)),
    }


def state(simulation, stamp_ns):
    """State of a simulation as JSON types; `restore` is the inverse.

    It has the pose and twist that the integration has reached, at `at_ns` after step 0 if that is within a step.
    """
    parts = dict(simulation.snapshot().parts)
    within = {} if simulation.base_ns is None else {"at_ns": simulation.base_ns}
    # JSON writes the shortest text that is read as the same float64: the state is exact.
    return {
        "bodies": list(simulation.layout.body_names),
        "pose": parts.pop("pose").tolist(),
        "twist": parts.pop("twist").tolist(),
        "angles": parts.pop("angles").tolist(),
        "steps": parts.pop("steps"),
        "stamp_ns": stamp_ns,
        "base_ns": stamp_ns - simulation.time_ns,
        "state": encoded(parts),
    } | within


def restore(simulation, entries, exactly=True):
    """Set a simulation to the state in an initial_state.json, with the commands that act and wait in it.

    exactly : False: for a simulation with another method or step; the step count of the simulation is
              that of the entries
    returns True if it continues bit-identically; False if the state is that of another version or
    simulation, so that method and error estimate start anew
    raises ValueError, KeyError, TypeError for entries that are not a state of the simulation
    """
    pose, twist = (np.array(entries[key], dtype=float) for key in ("pose", "twist"))
    angles, parts = entries.get("angles"), entries.get("state")
    simulation.set_state(pose, twist, int(entries.get("steps", 0)), angles)
    if isinstance(within := entries.get("at_ns"), (int, float)):
        simulation.begin_at(within)
    if not isinstance(parts, dict):
        return False
    if exactly:
        given = {
            "pose": pose,
            "twist": twist,
            "angles": np.array([] if angles is None else angles, dtype=float),
            "steps": simulation.steps,
        }
        try:
            simulation.restore_parts(encoded(given) | parts)
            return True
        except ValueError:
            pass
    simulation.take(commands_in(entries), parts.get("modes"))
    return False


def commands_in(entries):
    """Commands in the entries of a state, or None for a reset. Raises ValueError."""
    parts = (entries or {}).get("state")
    given = parts.get("inputs") if isinstance(parts, dict) else None
    return Commands() if given is None else Commands.from_json(given.get("commands"), "inputs of the state")


def settings(simulation, sample_steps):
    """Configuration of a run, versions and machine, as JSON types."""
    return {
        "format": 1,
        "scene": simulation.scene.name,
        "method": simulation.method,
        **of_engine(simulation),
        "options": simulation.options,
        "promise": _promise(simulation),
        "robot": simulation.scene.robot and simulation.scene.robot.options.mapped,
        "steps_per_sample": sample_steps,
        "versions": versions(),
        "machine": machine(),
        "part": 1,
        "wall_start": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    }


def steps_per_sample(rate, step):
    """Steps of a size in s between two samples of a rate in Hz; an int if it is whole."""
    steps = 1.0 / (rate * step)
    return round(steps) if abs(steps - round(steps)) <= 1e-9 * steps else steps


def _promise(simulation):
    """The requested accuracy, even if real time has made it coarser: a reset returns to it."""
    promise = simulation.promise
    return promise and promise | {"accuracy": simulation.options["rtol"]}


def as_json(data):
    """(media type, bytes) of an attachment."""
    return "application/json", json.dumps(data, indent=1, allow_nan=False).encode()


@lru_cache(maxsize=None)
def versions():
    """{package: version}; None if not installed, such as numba in a run in plain Python."""
    result = {"liegroup_sim_ros": __version__, "python": platform.python_version()}
    for package in _PACKAGES:
        try:
            result[package] = version(package)
        except PackageNotFoundError:
            result[package] = None
    return result


@lru_cache(maxsize=None)
def machine():
    """Properties that affect the bits of a run: system, C library, processor, its features."""
    return {
        "system": platform.platform(),
        "libc": " ".join(platform.libc_ver()),
        "processor": platform.machine(),
        "cores": os.cpu_count(),
        **_compiled_for(),
        "cpu": cpu_name(),
    }


def _compiled_for():
    """Processor and features that numba compiles for; None without numba."""
    try:
        from llvmlite import binding

        features = binding.get_host_cpu_features()
        return {
            "target": binding.get_host_cpu_name(),
            "features": sorted(name for name, is_there in features.items() if is_there),
        }
    except (ImportError, RuntimeError):
        return {"target": None, "features": None}
