# SPDX-License-Identifier: Apache-2.0
"""Files of a run without a clock: arrays for NumPy, or a recording like that of the node.

Both have sample(sample), finish(simulation, stopped, failed, wall_seconds), `count`, `last_step`,
and are closed at the end of their `with` block; `stopped` is why the run came to no end, or None.
They are new files: none is overwritten.
"""

import json
from pathlib import Path

import numpy as np

from liegroup_core.errors import LieGroupSimError
from liegroup_sim_ros.messages import schemas
from liegroup_sim_ros.messages.codecs import (
    LogCodec,
    PoseStampedCodec,
    TwistStampedCodec,
    WrenchStampedCodec,
)
from liegroup_sim_ros.messages.samples import poses_and_twists

from . import attachments
from .write import Recorder, RecorderError

NODE = "/sim_node"  # names the topics, as a run of the node would
WORLD_FRAME = "world"


class OutputError(LieGroupSimError):
    """The file cannot be written; one line of text, exit code 2."""


class ArrayFile:
    """NumPy file *.npz of k samples of n bodies; read it with numpy.load(path).

    time (k,) s, steps (k,), bodies (n,) names, poses (k, n, 4, 4) body -> world, m,
    twists (k, n, 6) (omega, v) rad/s and m/s in body axes, energy (k,) J,
    residual (k,) largest joint residual, m or rad; scene and settings: texts, YAML and JSON
    """

    def __init__(self, path, simulation, every, samples):
        self.count, self.last_step = 0, -1
        self._path, self._every = Path(path), every
        n = len(simulation.layout.body_names)
        try:
            self._arrays = {
                "time": np.empty(samples),
                "steps": np.empty(samples, dtype=np.int64),
                "poses": np.empty((samples, n, 4, 4)),
                "twists": np.empty((samples, n, 6)),
                "energy": np.empty(samples),
                "residual": np.empty(samples),
            }
            self._stream = open(self._path, "xb")
        except MemoryError:
            raise OutputError(
                f"{path}: {samples} samples of {n} bodies do not fit into memory: "
                "take fewer, --every, or write *.mcap"
            ) from None
        except FileExistsError:
            raise OutputError(
                f"{path}: the file already exists; remove it or choose another name"
            ) from None
        except OSError as error:
            raise OutputError(f"{path}: cannot be written: {error.strerror}") from None

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        self._stream.close()

    def sample(self, sample):
        """Take up a sample."""
        for name, value in (
            ("time", sample.time),
            ("steps", sample.steps),
            ("poses", sample.pose_matrices),
            ("twists", sample.twist),
            ("energy", sample.energy),
            ("residual", sample.constraint_residual),
        ):
            self._arrays[name][self.count] = value
        self.count, self.last_step = self.count + 1, sample.steps

    def finish(self, simulation, stopped, failed, wall_seconds):
        """Write everything. Raises OutputError."""
        settings = attachments.settings(simulation, self._every)
        settings |= {"stopped": stopped, "failed": failed, "wall_seconds": wall_seconds}
        try:
            np.savez(
                self._stream,
                **{name: array[: self.count] for name, array in self._arrays.items()},
                bodies=np.array(simulation.layout.body_names),
                scene=np.array(simulation.scene.text),
                settings=np.array(json.dumps(settings, indent=1)),
            )
        except OSError as error:
            raise OutputError(f"{self._path}: cannot be written: {error.strerror}") from None


class LogFile:
    """Recording *.mcap in the node's format, without clock and diagnostics (docs/node.md)."""

    def __init__(self, path, simulation, every, _samples):
        self.count, self.last_step = 0, -1
        bodies = simulation.layout.body_names
        topics = {
            "pose": {b: f"{NODE}/{b}/pose" for b in bodies},
            "twist": {b: f"{NODE}/{b}/twist" for b in bodies},
            "applied_wrench": f"{NODE}/applied_wrench",
            "events": f"{NODE}/events",
            "clock": None,
            "diagnostics": "/diagnostics",
        }
        try:
            for codec in (PoseStampedCodec, TwistStampedCodec, WrenchStampedCodec, LogCodec):
                schemas.definition(codec.TYPE)
                schemas.type_hash(codec.TYPE)
            self._recorder = Recorder(
                path, attachments.at_start(simulation, NODE, WORLD_FRAME, every, topics)
            )
        except schemas.SchemaError as error:
            raise OutputError(f"{path}: {error}; *.npz needs no ROS") from None
        except RecorderError as error:
            raise OutputError(str(error)) from None
        add = self._recorder.add_channel
        self._encode = poses_and_twists(bodies, WORLD_FRAME)
        self._channels = [
            (
                add(topics["pose"][b], PoseStampedCodec.TYPE),
                add(topics["twist"][b], TwistStampedCodec.TYPE),
            )
            for b in bodies
        ]
        add(topics["applied_wrench"], WrenchStampedCodec.TYPE)
        self._events = add(topics["events"], LogCodec.TYPE, "transient_local")
        self._event(0, "start", f"{simulation.scene.name} at step 0, without a clock")

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        self._recorder.close()
        # A failure of the disk is no exception there: a simulation in real time goes on.
        if exception[0] is None and self._recorder.failure:
            raise OutputError(self._recorder.failure)

    def _event(self, stamp_ns, name, text, level=LogCodec.INFO):
        self._recorder.write(self._events, stamp_ns, LogCodec.encode(stamp_ns, level, name, text))

    def sample(self, sample):
        """Record poses and twists of all bodies."""
        stamp = sample.time_ns
        for channels, messages in zip(self._channels, self._encode(stamp, sample)):
            for channel, message in zip(channels, messages):
                self._recorder.write(channel, stamp, message)
        self.count, self.last_step = self.count + 1, sample.steps

    def finish(self, simulation, stopped, failed, wall_seconds):
        """Say how the run ended, and how fast it was."""
        stamp = simulation.time_ns
        if failed:
            self._event(stamp, "fault", stopped, LogCodec.ERROR)
        self._event(stamp, "stop", stopped or f"stopped at step {simulation.steps}")
        self._recorder.add_attachment(
            "pacing.json",
            *attachments.as_json(
                {
                    "ticks": None,
                    "overruns": None,
                    "reanchored": None,
                    "lateness_us": {"p50": None, "p99": None, "max": None},
                    "real_time_factor_wanted": 0.0,
                    "real_time_factor": simulation.time / wall_seconds
                    if wall_seconds > 0.0
                    else None,
                    "wall_seconds": wall_seconds,
                    "sim_seconds": simulation.time,
                }
            ),
        )
