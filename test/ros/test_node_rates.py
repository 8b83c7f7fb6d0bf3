# SPDX-License-Identifier: Apache-2.0
"""Topics with rates that divide no step, over DDS: exact stamps, pushes between steps, recordings that repeat."""

import random
import signal
from fractions import Fraction

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from node_process import COMPILING, NodeProcess, stamp_ns
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from liegroup_core.scene.load import load_scene
from liegroup_sim_ros.playback.resimulate import resimulate
from liegroup_sim_ros.recording.read import read_recording

NODE = "/rates"
# Runs ahead of its steps, takes substeps within them, or has steps of one size: each kind of interpolation.
RUNS = [("driven_arm", {}), ("stick_slip", {}), ("gripper", {}), ("four_bar", {"method": "rkmk4", "step": 0.004})]


def on_multiples(stamps, rate):
    """Whether all stamps in ns since step 0 are multiples of the period of a rate, rounded to ns."""
    parts = [round(stamp * Fraction(rate) / 10**9) for stamp in stamps]
    return all(abs(stamp - part * 10**9 / Fraction(rate)) <= Fraction(1, 2) for stamp, part in zip(stamps, parts))


@pytest.mark.parametrize("scene, settings", RUNS, ids=[scene for scene, _ in RUNS])
def test_every_topic_has_its_own_rate_and_the_recording_repeats(client, tmp_path, scene, settings):
    rng = random.Random(scene)
    body = load_scene(scene).bodies[-1].name
    rates = {"publish_rate": 333.0, "joint_state_rate": 170.7, "clock_rate": 1000.0, "record_rate": 77.7}
    deep = QoSProfile(depth=10000)
    poses = client.listen(f"{NODE}/{body}/pose", PoseStamped, deep)
    joints = client.listen(f"{NODE}/joint_states", JointState, deep)
    clock = client.listen("/clock", Clock, deep)
    given = {"scene": scene, **rates, **settings, "record": tmp_path / "run.mcap", "record_split_duration": 0.4}
    with NodeProcess(given, remap=[f"__node:={NODE[1:]}"]) as process:
        push = client.pusher(NODE, "wrench")
        client.until(lambda: len(poses) > 20, COMPILING, "poses")
        for _ in range(25):
            push(body, force=tuple(rng.uniform(-0.3, 0.3) for _ in range(3)))
            client.spin(rng.uniform(0.0, 0.03))
        client.until(lambda: stamp_ns(clock[-1].clock) > 300_000_000)  # 23 periods of the recording
        before = stamp_ns(clock[-1].clock)
        assert client.call(f"{NODE}/pause").success
        assert client.call(f"{NODE}/save_snapshot").success
        assert client.call(f"{NODE}/step").success
        assert client.call(f"{NODE}/resume").success
        client.until(lambda: stamp_ns(clock[-1].clock) > before + 300_000_000)
        push(body, force=(0.1, 0.0, 0.0))
        assert client.call(f"{NODE}/restore_snapshot").success
        client.until(lambda: stamp_ns(clock[-1].clock) > before + 600_000_000)
        process.send(signal.SIGINT)
        code, errors = process.wait()
    assert code == 0 and "Traceback" not in errors, errors
    parts = sorted(tmp_path.glob("*.mcap"), key=lambda path: (len(path.stem), path.stem))
    assert len(parts) > 1
    recorded = []
    for part in parts:
        recording = read_recording(part)
        same = resimulate(recording)
        assert same["identical"] == same["samples"] >= 1, (part, same)
        recorded += recording.pose[body].stamp_ns.tolist()
    # Up to the state that was restored, time is counted from zero; a paused state is sent at its step, too.
    # A subscriber on a busy machine may lose messages, the recording loses none.
    for times, rate in (
        ([stamp_ns(m.header.stamp) for m in poses], rates["publish_rate"]),
        ([stamp_ns(m.header.stamp) for m in joints], rates["joint_state_rate"]),
        ([stamp_ns(m.clock) for m in clock], rates["clock_rate"]),
        (recorded, rates["record_rate"]),
    ):
        times = np.array(times)
        assert (np.diff(times) > 0).all()
        running = times[times <= before]
        assert len(running) > 10 and on_multiples(running.tolist(), rate)
        assert times.tolist() != recorded or (np.diff(running) <= 10**9 / rate + 1).all()
