# SPDX-License-Identifier: Apache-2.0
"""Topics with rates that divide no step, over DDS: exact stamps, pushes between steps, recordings that repeat."""

import random
from fractions import Fraction

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from node_process import NodeProcess, figures_of, stamp_in, stamp_of
from rosgraph_msgs.msg import Clock
from scene_runs import Run
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from liegroup_core import Simulation, load_scene
from liegroup_sim_ros.analysis import analyse
from liegroup_sim_ros.messages.estimates import UNKNOWN
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


# A node that carries an estimate of its error: topics, diagnostics, covariances, the event.


@pytest.mark.turn(2)
def test_estimates_are_served_recorded_and_end_with_an_event(client, tmp_path):
    """A double pendulum at 8 ms leaves its motion within seconds."""
    path = tmp_path / "run.mcap"
    states = client.listen("/doubtful/state", DiagnosticArray)
    events = client.events("/doubtful")
    parameters = {
        "scene": "double_pendulum",
        "method": "rkmk4",
        "accuracy": 1e-4,  # the defaults, as in a dump of all parameters
        "accuracy_horizon": 60.0,
        "step": 8e-3,
        "publish_rate": 125.0,
        "odometry_rate": 125.0,
        "pose_with_covariance_rate": 62.5,
        "clock_rate": 125.0,
        "state_rate": 12.5,
        "record": path,
        "start_paused": True,
        "step_count": 250,
    }
    body = "upper"
    errors = client.listen("/doubtful/errors", Float64MultiArray)
    poses = client.listen(f"/doubtful/{body}/pose_with_covariance", PoseWithCovarianceStamped)
    odometry = client.listen(f"/doubtful/{body}/odometry", Odometry)
    with NodeProcess(parameters, remap=["__node:=doubtful"]) as node:

        def step():
            client.until_stamp(client.command("/doubtful/step"), states, poses, odometry)

        step()
        step()
        figures = figures_of(states[-1])
        assert {"position_error_m", "attitude_error_rad", "predictable_until_s"} <= set(figures)
        assert figures["worst_body"] in ("upper", "lower")
        # In the first steps the error is not known.
        assert max(odometry[-1].pose.covariance) < UNKNOWN
        covariance = np.reshape(odometry[-1].pose.covariance, (6, 6))
        assert (np.diag(covariance) > 0.0).all() and np.count_nonzero(covariance) == 6
        both = client.until(lambda: _at_one_stamp(poses, odometry), "a stamp of both")
        assert both[0].header == both[1].header and both[0].pose == both[1].pose
        while not any(e.name == "unpredictable" for e in events):
            step()
        client.until(lambda: errors)
        assert np.isfinite([m.pose.covariance for m in (*poses, *odometry)]).all()
        node.end()
    recording = read_recording(path)
    (event,) = [event for event in recording.events if event.name == "unpredictable"]
    assert "too large for the motion to be known" in event.text
    figures = resimulate(recording)
    assert figures["identical"] == figures["samples"] > 100
    _check_errors(recording, errors)
    _check_worst_body(recording, states)


def _at_one_stamp(poses, odometry):
    """The last pose and odometry with the same stamp, or None."""
    by_stamp = {stamp_of(message): message for message in list(odometry)}
    both = [(pose, by_stamp.get(stamp_of(pose))) for pose in list(poses)]
    return next((pair for pair in reversed(both) if pair[1] is not None), None)


def _check_errors(recording, published):
    """One estimate with every sample, those of the simulation in Python, and those published."""
    track = recording.errors
    assert np.array_equal(track.stamp_ns, recording.pose["lower"].stamp_ns)
    simulation = Simulation(load_scene("double_pendulum"), "rkmk4", 8e-3)
    for errors in track.errors:
        assert errors.tobytes() == simulation.sample().errors.tobytes()
        simulation.advance()
    recorded = {errors.tobytes() for errors in track.errors}
    for message in published:
        rows, columns = message.layout.dim
        assert (rows.label, rows.size, rows.stride) == ("upper lower", 2, 8)
        assert (columns.label, columns.size, columns.stride) == ("m rad m/s rad/s", 4, 4)
        assert np.array(message.data).tobytes() in recorded
    figures = analyse(recording).figures
    for entry in figures["estimate"].values():
        assert entry["samples"] > 100 and entry["max"] > 0.0
        # Measured over many mechanisms: benchmarks/estimate_coverage.py.
        assert entry["covering"] > 0.8 and entry["close"] > 0.5


def _check_worst_body(recording, states):
    """That of the errors at the same stamp."""
    errors = dict(zip(recording.errors.stamp_ns.tolist(), recording.errors.errors))
    named = set()
    for message in states:
        figures = figures_of(message)
        position = errors[stamp_of(message)][:, 0]
        if np.isfinite(position).all() and position.any():
            assert figures["worst_body"] == recording.bodies[int(position.argmax())]
            assert float(figures["position_error_m"]) == pytest.approx(position.max(), rel=1e-8)
            named.add(figures["worst_body"])
    assert named
