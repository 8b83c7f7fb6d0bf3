# SPDX-License-Identifier: Apache-2.0
"""Recordings up to version 0.2: total wrenches on ~/applied_wrench are read as commands and repeat the run."""

import json

import numpy as np
import pytest

from liegroup_core import Simulation, load_scene
from liegroup_sim_ros.analysis.analyse import analyse
from liegroup_sim_ros.messages.codecs import PoseStampedCodec, TwistStampedCodec, WrenchStampedCodec
from liegroup_sim_ros.playback.branch import Branches
from liegroup_sim_ros.playback.resimulate import resimulate
from liegroup_sim_ros.recording import attachments
from liegroup_sim_ros.recording.read import RecordingError, read_recording
from liegroup_sim_ros.recording.write import Recorder

STEP, STEPS, EVERY = 1e-3, 200, 20
POINT, FORCE, TORQUE = np.array([0.1, -0.02, 0.3]), np.array([0.0, 50.0, 8.0]), np.array([0.3, 0.0, 0.0])
BODY, WORLD = (0.0, 0.0, 0.1, 9.0, 0.0, 0.0), np.array([0.1, 0.0, 0.0, 0.0, 0.0, 3.0])
# (stamp in ns, frame_id, total): the push at POINT from 30.1234 to 90.1234 ms, then WORLD from 41 to 141 ms is added,
# BODY acts from 40 to 90 ms.
PUSH = np.concatenate([TORQUE, FORCE])
TOTALS = [
    (30_123_400, "world/top", PUSH),
    *((30_123_400, f"world_{k}/top", (0, 0, 0, *(p * FORCE))) for k, p in zip("xyz", POINT)),
    (40_000_000, "top", BODY),
    (41_000_000, "world/top", PUSH + WORLD),
    (90_000_000, "top", (0,) * 6),
    (90_123_400, "world/top", WORLD),
    *((90_123_400, f"world_{k}/top", (0,) * 6) for k in "xyz"),
    (141_000_000, "world/top", (0,) * 6),
]


def record(path, method, totals=TOTALS):
    """Recording in the old format of a run with the commands."""
    simulation = Simulation(load_scene("heavy_top"), method, STEP, estimate=False)
    simulation.apply_wrench("top", PUSH, 0.0301234, 0.06, "fan", "world", POINT)
    simulation.apply_wrench("top", BODY, 0.04, 0.05, "other")
    simulation.apply_wrench("top", WORLD, 0.041, 0.1, "third", "world")
    topics = {kind: {"top": f"/sim_node/top/{kind}"} for kind in ("pose", "twist")}
    topics |= {"applied_wrench": "/sim_node/applied_wrench", "events": "/e", "clock": None, "diagnostics": "/d"}
    start = Simulation(load_scene("heavy_top"), method, STEP, estimate=False)
    files = attachments.at_start(start, "/sim_node", "world", EVERY, topics)
    state = json.loads(files["initial_state.json"][1])
    del state["state"]
    files["initial_state.json"] = attachments.as_json(state | {"memory": ""})
    codecs = {"pose": PoseStampedCodec("world"), "twist": TwistStampedCodec("top")}
    with Recorder(path, files) as recorder:
        channel = {kind: recorder.add_channel(topics[kind]["top"], codec.TYPE) for kind, codec in codecs.items()}
        wrench = recorder.add_channel(topics["applied_wrench"], WrenchStampedCodec.TYPE)
        for stamp, frame, total in totals:
            recorder.write(wrench, stamp, WrenchStampedCodec(frame).encode(stamp, total))
        for _ in range(STEPS // EVERY + 1):
            sample = simulation.sample()
            stamp = sample.time_ns
            pose = sample.positions["top"].tolist(), sample.quaternions["top"].tolist()
            recorder.write(channel["pose"], stamp, codecs["pose"].encode(stamp, *pose))
            recorder.write(channel["twist"], stamp, codecs["twist"].encode(stamp, sample.twists["top"].tolist()))
            simulation.advance(EVERY)
    return read_recording(path)


@pytest.mark.parametrize("method", ["rkmk4", "constrained_rattle"])
def test_a_recording_of_totals_repeats_to_the_bit_and_its_reference_has_the_forces_at_points(tmp_path, method):
    recording = record(tmp_path / "old.mcap", method)
    figures = resimulate(recording)
    assert figures["identical"] == figures["samples"] == STEPS // EVERY + 1
    assert Branches(recording).at(0.1, inputs=True)[0].steps == 100
    figures = analyse(recording).figures
    # rkmk4 at 1 ms under pushes of 50 N: some 1e-9 m; constrained_rattle is of second order.
    assert figures["reference"]["position"]["max"] < {"rkmk4": 1e-8, "constrained_rattle": 1e-4}[method]
    (push,) = figures["pushes"]
    assert (push["from_s"], push["to_s"]) == pytest.approx((0.0301234, 0.141))


def test_a_wrench_on_what_is_no_body_is_refused(tmp_path):
    with pytest.raises(RecordingError, match="a wrench acts on 'world_q/top', which is not a body of the scene"):
        record(tmp_path / "old.mcap", "rkmk4", [(0, "world_q/top", (0,) * 6)])
