# SPDX-License-Identifier: Apache-2.0
"""Client of a node that takes commands for joints, for the tests."""

import json
import signal

from diagnostic_msgs.msg import DiagnosticArray
from node_process import COMPILING, stamp_ns
from sensor_msgs.msg import JointState

from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.playback.resimulate import resimulate
from liegroup_sim_ros.recording.read import read_recording

STEP = 1e-3  # s, of the node


class Commanded:
    """Running node with a publisher of commands; joint states and given commands as they come."""

    def __init__(self, client, node):
        self.client, self.node = client, node
        self.states = client.listen(f"{node}/joint_states", JointState)
        self.given = client.given(node)
        self.figures = client.listen(f"{node}/state", DiagnosticArray)
        self.publisher = client.node.create_publisher(JointState, f"{node}/joint_commands", 100)
        client.until(self.publisher.get_subscription_count, COMPILING, "the subscription")

    def command(self, stamp=0, **fields):
        message = JointState(**fields)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
        self.publisher.publish(message)

    def figure(self, name):
        return int({v.key: v.value for v in self.figures[-1].status[0].values}[name])

    def now(self):
        return stamp_ns(self.states[-1].header.stamp)

    def steps(self, count):
        """Take steps while paused; the joint state after them."""
        assert self.client.set(self.node, step_count=count).successful
        self.client.spin(0.1)  # commands have arrived before it is asked for steps
        before = self.now()
        assert self.client.call(f"{self.node}/step").success
        end = before + round(count * STEP * 1e9)
        return self.client.until(
            lambda: next((s for s in reversed(self.states) if stamp_ns(s.header.stamp) == end), None)
        )


def coordinates(state):
    return list(zip(state.position, state.velocity))


def finished_parts(process):
    """Recordings of the parts of a run that is ended here; each is repeated and analysed.

    process : with the NodeProcess `process` and the `folder` of its recording
    """
    process.process.send(signal.SIGINT)
    code, log = process.process.wait()
    assert code == 0, log
    paths = sorted(process.folder.glob("*.mcap"))
    assert len(paths) > 4
    recordings = [read_recording(path) for path in paths]
    for path, recording in zip(paths, recordings):
        figures = resimulate(recording)
        assert figures["identical"] == figures["samples"] > 0 and figures["must_be_equal"], path
    out = process.folder / "out.json"
    assert main(["analyze", *map(str, paths), "--json", str(out)]) == 0
    for log in json.loads(out.read_text())["logs"]:
        assert log["reference"]["angle"]["max"] < 1e-9, log["log"]
        assert log["reference"]["position"]["max"] < 1e-9, log["log"]
    return recordings
