# SPDX-License-Identifier: Apache-2.0
"""Random recordings at the edges of what a report can be asked for; the same ones for a seed."""

import math
import random

import numpy as np
from made_run import PACING, PAIR, record
from scene_files import text_of

from liegroup_core import Simulation, load_scene
from liegroup_core.scene.load import scene_from_text
from liegroup_sim_ros.recording.write_run import LogFile

# One number per body, joint and force as they come, and extremes. 1e30 and 1e300 overflow when squared.
ODD = (0.0, -0.0, 5e-324, 1e-300, -1.0, 1e9, 1e30, -1e300, np.nan, np.inf, -np.inf)
STOPPED = text_of("stopped_random_recordings.yaml")
SCENES = ("heavy_top", "free_body", "double_pendulum", PAIR, STOPPED)
FEW = (0, 1, 2, 3, 30)  # samples, beside that of the start


def random_recording(seed, folder):
    """Path of a new recording *.mcap."""
    chance = random.Random(seed)
    text = chance.choice(SCENES)
    scene = scene_from_text(text) if "\n" in text else load_scene(text)
    path = folder / f"{seed}.mcap"
    make = _of_the_node if chance.random() < 0.4 else _offline
    make(chance, text, scene, path)
    return path


def _spoiler(chance, bodies):
    """Function (topic, data) -> data or None, of one of several kinds of damage."""
    kind = chance.choice(("none", "estimates", "estimates", "numbers", "one number", "inputs", "gaps"))
    value = chance.choice((0.0, 0.0, 0.0, 0.0, *ODD))

    def spoil(topic, data):
        if kind == "gaps":
            return None if chance.random() < 0.2 else data
        if kind == "inputs" and topic.endswith("/inputs"):
            # Other digits in the text, of the same length.
            return bytes(
                chance.choice(b"0123456789") if byte in b"0123456789" and chance.random() < 0.1 else byte
                for byte in data
            )
        hit = {
            "estimates": topic.endswith("/errors"),
            "numbers": topic.endswith(("/pose", "/twist")) and chance.random() < 0.2,
            "one number": topic.endswith(("/twist", "/errors")) and chance.random() < 0.05,
        }.get(kind, False)
        if not hit:
            return data
        # Messages of poses, twists and errors end with their numbers.
        number = chance.choice(ODD) if kind == "numbers" else value
        count = 4 * bodies if topic.endswith("/errors") else chance.choice((1, 4, 6))
        return data[: -8 * count] + np.full(count, number).tobytes()

    return spoil


def _offline(chance, text, scene, path):
    """Recording of `liegroup_sim run`: estimates of the error, events at joints."""
    settings = chance.choice(
        (
            {"accuracy": 1e-4},
            {"accuracy": 1e-9},
            {"method": "rkmk54", "step": 1e-3},
            {"method": "rkmk4", "step": 1e-3, "estimate": False},
        )
    )
    simulation = Simulation(scene, **settings)
    count, every = chance.choice(FEW), chance.choice((1, 7))
    spoil, start = _spoiler(chance, len(scene.bodies)), chance.random() < 0.2
    if start:  # as a later part of a recording
        simulation.advance(3)
    reactions = chance.random() < 0.3
    with LogFile(path, simulation, every, count + 1, reactions) as file:
        write = file._recorder.write
        names = {channel.id - 1: channel.info["name"] for channel in file._recorder._channels}

        def damaged(channel, stamp_ns, data):
            data = spoil(names[channel], data)
            if data is not None:
                write(channel, stamp_ns, data)

        file._recorder.write = damaged
        if chance.random() < 0.9:
            file.sample(simulation.sample())
            for k in range(count):
                simulation.advance(every)
                if k == 1 and chance.random() < 0.3:
                    file._event(simulation.time_ns, "fault", "", 40)
                file.sample(simulation.sample())
        stopped = chance.choice((None, "interrupted", "a <b>fault</b>"))
        seconds = chance.choice((0.0, 1e-300, 1.0))
        file.finish(simulation, stopped, stopped is not None, seconds)


def _of_the_node(chance, text, scene, path):
    """Recording as of the node: wrenches, resets, requested speeds, pacing, no end."""
    steps = chance.choice((0, 1, 5, 40))
    spoil = _spoiler(chance, len(scene.bodies))
    body = chance.choice(scene.bodies).name
    pushes = [
        (at, (body, (0, 0, chance.choice((0.0, 1.0, 1e-300)), 0, 0, 0)))
        for at in range(0, steps, 3)
        if chance.random() < 0.3
    ]
    pacing = dict(PACING, real_time_factor=chance.choice((None, 0.0, 1.0, 1e300)))
    late = chance.choice((None, *filter(math.isfinite, ODD)))
    pacing["lateness_us"] = dict.fromkeys(("p50", "p99", "max"), late)
    record(
        path,
        scene,
        steps,
        per_sample=chance.choice((1, 10)),
        group="relative" if text == STOPPED else chance.choice(("se3", "so3xr3")),
        resets=[at for at in range(1, steps) if chance.random() < 0.05],
        pushes=pushes,
        spoil=lambda topic, k, data: spoil(topic, data),
        pacing=pacing,
        end=chance.random() < 0.7,
        factors=chance.choice((None, {0: 0.0}, {0: 1.0, 1: 1e-300}, {0: 1.0, 3: 0.0, 5: np.inf})),
    )
