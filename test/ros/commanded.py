# SPDX-License-Identifier: Apache-2.0
"""Client of a node that takes commands for joints, for the tests."""

import json

from diagnostic_msgs.msg import DiagnosticArray
from node_process import figures_of, stamp_of
from sensor_msgs.msg import JointState

from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.playback.resimulate import resimulate
from liegroup_sim_ros.recording.read import read_recording

STEP = 1e-3  # s, of the node


class Commanded:
    """Paused node with a publisher of commands; joint states and given commands as they come."""

    def __init__(self, client, node):
        self.client, self.node = client, node
        self.states = client.listen(f"{node}/joint_states", JointState)
        self.given = client.given(node)
        self.figures = client.listen(f"{node}/state", DiagnosticArray)
        self._publish = client.publisher(f"{node}/joint_commands", JointState)

    def command(self, stamp=0, **fields):
        """Command joints; the node has it before anything that it is asked for later."""
        message = JointState(**fields)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
        self._publish(message)

    def figure(self, name):
        return int(figures_of(self.figures[-1])[name])

    def now(self):
        return stamp_of(self.states[-1])

    def restart(self):
        """Reset the node, and clear the commands up to then."""
        self.given.present = None
        self._arrive(self.client.command(f"{self.node}/reset"))
        self.client.until(lambda: self.given.present is not None, "the commands that act")
        self.given.clear()

    def steps(self, count):
        """Take steps; the joint state after them."""
        assert self.client.set(self.node, step_count=count).successful
        self._arrive(self.client.command(f"{self.node}/step"))
        return self.states[-1]

    def _arrive(self, stamp):
        topics = self.states, self.figures
        self.client.until(lambda: all(m and stamp_of(m[-1]) == stamp for m in topics), f"states at {stamp}")

    def check_refusals(self, cases, topic="joint_commands", command=None):
        """Each of the cases (reason, fields of a command) is counted as refused for its reason, none as accepted."""
        before = figures_of(self.figures[-1])
        for _, fields in cases:
            (command or self.command)(**fields)
        self.steps(1)
        reasons = [reason for reason, _ in cases]
        for name, count in {"accepted": 0, "refused": len(cases)}.items():
            assert self.figure(f"{topic}_{name}") == int(before[f"{topic}_{name}"]) + count, name
        for reason in reasons:
            count = f"{topic}_refused_{reason}"
            assert self.figure(count) == int(before.get(count, 0)) + reasons.count(reason), reason


def finished_parts(process):
    """Recordings of the parts of a run that is ended here; each is repeated, the last four are analysed.

    process : with the NodeProcess `process` and the `folder` of its recording
    """
    lines = [line.partition("refused: ")[2] for line in process.process.end().splitlines() if " refused: " in line]
    assert len(lines) == len(set(lines)), lines  # each refusal once in the log, in one line
    paths = sorted(process.folder.glob("*.mcap"))
    assert len(paths) > 4
    recordings = [read_recording(path) for path in paths]
    for path, recording in zip(paths, recordings):
        figures = resimulate(recording)
        assert figures["identical"] == figures["samples"] > 0 and figures["must_be_equal"], path
    out = process.folder / "out.json"
    assert main(["analyze", *map(str, paths[-4:]), "--json", str(out)]) == 0
    for log in json.loads(out.read_text())["logs"]:
        assert log["reference"]["angle"]["max"] < 1e-9, log["log"]
        assert log["reference"]["position"]["max"] < 1e-9, log["log"]
    return recordings
