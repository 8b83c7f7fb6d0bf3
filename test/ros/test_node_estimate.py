# SPDX-License-Identifier: Apache-2.0
"""A node that carries an estimate of its error: diagnostics, covariances, and the event."""

import signal

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from node_process import COMPILING, NodeProcess
from rcl_interfaces.msg import Log
from rclpy.qos import DurabilityPolicy, QoSProfile

from liegroup_sim_ros.playback.resimulate import resimulate
from liegroup_sim_ros.recording.read import read_recording


def test_estimates_are_served_recorded_and_end_with_an_event(client, tmp_path):
    """A double pendulum at 8 ms leaves its motion within seconds."""
    path = tmp_path / "run.mcap"
    states = client.listen("/doubtful/state", DiagnosticArray)
    events = client.listen(
        "/doubtful/events", Log, QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    )
    parameters = {
        "scene": "double_pendulum",
        "step": 8e-3,
        "publish_rate": 125.0,
        "odometry_rate": 125.0,
        "clock_rate": 125.0,
        "state_rate": 12.5,
        "estimate": True,
        "record": path,
        "real_time_factor": 4.0,
    }
    with NodeProcess(parameters, remap=["__node:=doubtful"]) as node:
        client.until(lambda: events, COMPILING, "the start")
        body = "upper"
        client.until(lambda: states, what="states")
        figures = {pair.key: pair.value for pair in states[-1].status[0].values}
        assert {"position_error_m", "attitude_error_rad", "predictable_until_s"} <= set(figures)
        odometry = client.listen(f"/doubtful/{body}/odometry", Odometry)
        # In the first three steps the error is not known.
        client.until(
            lambda: odometry and np.isfinite(odometry[-1].pose.covariance).all(), what="covariances"
        )
        covariance = np.reshape(odometry[-1].pose.covariance, (6, 6))
        assert (np.diag(covariance) > 0.0).all() and np.count_nonzero(covariance) == 6
        client.until(lambda: any(e.name == "unpredictable" for e in events), what="the event")
        node.send(signal.SIGINT)
        code, errors = node.wait()
        assert code == 0, errors
    recording = read_recording(path)
    (event,) = [event for event in recording.events if event.name == "unpredictable"]
    assert "too large for the motion to be known" in event.text
    figures = resimulate(recording)
    assert figures["identical"] == figures["samples"] > 100
