# SPDX-License-Identifier: Apache-2.0
"""Picture of the scenes with stops and friction, docs/stops.png: coordinates over time, events marked.

python benchmarks/stops_picture.py [FILE]    needs matplotlib
"""

import sys

import numpy as np
from matplotlib.figure import Figure

from liegroup_core import Simulation, load_scene

COLOURS = ("tab:blue", "tab:orange", "tab:green")
MARKS = {"impact": "v", "stop": "s", "leave": "^", "stick": "o", "slip": "x"}


def angle_of(joint):
    """Coordinate of a joint of a sample."""
    return lambda sample: sample.joint_coordinates[joint][0]


def rate_of(joint):
    """Velocity of a joint of a sample."""
    return lambda sample: sample.joint_coordinates[joint][1]


def distance(first, second=None):
    """Distance of two bodies of a sample, or of one from the origin, m."""

    def found(sample):
        other = sample.poses[second][:3, 3] if second else np.zeros(3)
        return np.linalg.norm(sample.poses[first][:3, 3] - other)

    return found


# scene, duration in s, axis, {what has events: coordinate}
PANELS = (
    ("door", 25.0, "angle of the door, rad", {"hinges": angle_of("hinges")}),
    ("stick_slip", 10.0, "velocity of the block on the belt, m/s", {"contact": rate_of("contact")}),
    ("cable", 6.0, "length, m", {"rope": distance("bob"), "rubber": distance("bob", "weight")}),
    (
        "gripper",
        0.15,
        "distance from the block, m",
        {"left_pad": distance("left", "block"), "right_pad": distance("right", "block")},
    ),
)


def draw(axes, scene, duration, label, curves):
    """Curves of a scene, with a mark at each event."""
    simulation = Simulation(load_scene(scene), step=duration / 2000)
    times, values, events = [], {name: [] for name in curves}, []
    for _ in range(2000):
        simulation.advance(1)
        sample = simulation.sample()
        times.append(sample.time)
        events += simulation.drain_events()
        for name, found in values.items():
            found.append(curves[name](sample))
    for (name, found), colour in zip(values.items(), COLOURS):
        axes.plot(times, found, color=colour, linewidth=1.0, label=name)
        for kind, mark in MARKS.items():
            at = [event.time for event in events if (event.joint, event.kind) == (name, kind)]
            axes.plot(at, np.interp(at, times, found), mark, color=colour, markersize=3)
    axes.set_title(scene, fontsize=10, loc="left")
    axes.set_xlabel("time, s", fontsize=8)
    axes.set_ylabel(label, fontsize=8)
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.3)
    if len(curves) > 1:
        axes.legend(fontsize=8)


def main(path="docs/stops.png"):
    """Write the picture."""
    figure = Figure(figsize=(10.0, 6.0), layout="constrained")
    for axes, panel in zip(figure.subplots(2, 2).ravel(), PANELS):
        draw(axes, *panel)
    figure.savefig(path, dpi=90)


if __name__ == "__main__":
    main(*sys.argv[1:])
