# SPDX-License-Identifier: Apache-2.0
"""Topics with rates that divide no step, over DDS: exact stamps, pushes between steps, recordings that repeat."""

import random
from fractions import Fraction

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from node_process import stamp_in, stamp_of
from rosgraph_msgs.msg import Clock
from scene_runs import Run
from sensor_msgs.msg import JointState

from liegroup_core import Simulation, load_scene
from liegroup_sim_ros.playback.resimulate import resimulate
from liegroup_sim_ros.recording.read import read_recording

NODE = "/sim_node"
# Runs ahead of its steps, takes substeps within them, or has steps of one size: each kind of interpolation.
RUNS = [("driven_arm", ()), ("stick_slip", ()), ("gripper", ()), ("four_bar", ("rkmk4", 0.004))]


def on_multiples(stamps, rate):
    """Whether all stamps in ns since step 0 are multiples of the period of a rate, rounded to ns."""
    parts = [round(stamp * Fraction(rate) / 10**9) for stamp in stamps]
    return all(abs(stamp - part * 10**9 / Fraction(rate)) <= Fraction(1, 2) for stamp, part in zip(stamps, parts))


@pytest.mark.parametrize("scene, settings", RUNS, ids=[scene for scene, _ in RUNS])
@pytest.mark.volume(2)
def test_every_topic_has_its_own_rate_and_the_recording_repeats(client, ros_node, tmp_path, scene, settings):
    rng = random.Random(scene)
    body = load_scene(scene).bodies[-1].name
    rates = {"publish_rate": 333.0, "joint_state_rate": 170.7, "clock_rate": 1000.0, "record_rate": 77.7}
    poses = client.listen(f"{NODE}/{body}/pose", PoseStamped)
    joints = client.listen(f"{NODE}/joint_states", JointState)
    clock = client.listen("/clock", Clock)
    simulation = Simulation(load_scene(scene), *settings) if settings else scene
    given = {"record": tmp_path / "run.mcap", "record_split_duration": 0.4}
    with Run(ros_node, simulation, **rates, **given) as run:
        client.until(lambda: len(poses) > 20, "poses")
        for _ in range(25):
            run.push(body, (0.0, 0.0, 0.0, *(rng.uniform(-0.3, 0.3) for _ in range(3))))
            run.pass_time(rng.uniform(0.0, 0.03))
        before = stamp_in(run.call("pause"))
        run.call("save", "one")
        run.call("step", 1)
        run.call("resume")
        run.pass_time(0.3)
        run.push(body, (0.0, 0.0, 0.0, 0.1, 0.0, 0.0))
        run.call("restore", "one")
        run.pass_time(0.3)
    client.until_stamp(before, poses, joints, clock)
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
        ([stamp_of(m) for m in poses], rates["publish_rate"]),
        ([stamp_of(m) for m in joints], rates["joint_state_rate"]),
        ([stamp_of(m) for m in clock], rates["clock_rate"]),
        (recorded, rates["record_rate"]),
    ):
        times = np.array(times)
        assert (np.diff(times) > 0).all()
        running = times[times <= before]
        assert len(running) > 10 and on_multiples(running.tolist(), rate)
        assert times.tolist() != recorded or (np.diff(running) <= 10**9 / rate + 1).all()
