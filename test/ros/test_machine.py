# SPDX-License-Identifier: Apache-2.0
"""A node beside a machine: what it says of one that moves as the scene, is pushed, jams, moves again, and is silent.

The machine is a mass on a spring, by its closed form, with noise, on topics of a node in this process. Its values are
those of its stamps, so that no delay of this process is an error.
"""

import math
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from node_process import NodeProcess, figures_of
from scene_files import text_of
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from liegroup_core.layout import make_layout
from liegroup_core.scene.load import scene_from_text
from liegroup_sim_ros.logs.map import Map
from liegroup_sim_ros.messages.machine import AHEAD, COLUMNS, decode
from liegroup_sim_ros.serving.machine import RealMachine
from liegroup_sim_ros.view.remote import Remote

STIFFNESS, MASS, NOISE, EFFORT, TOLERANCE = 20.0, 2.0, 1e-3, 6.0, 0.05
RATE = math.sqrt(STIFFNESS / MASS)  # 2 s for a period


class Oscillator(threading.Thread):
    """Machine that publishes on /arm/joint_states; `go_on` starts another motion from where it is."""

    def __init__(self, client):
        super().__init__(daemon=True)
        self._publisher = client.node.create_publisher(JointState, "/arm/joint_states", 10)
        self._random, self._lock = np.random.default_rng(0), threading.Lock()
        self._since, self._start, self._equilibrium, self._is_jammed = time.time(), (0.3, 0.0), 0.0, False
        self.others, self.is_stamped, self.is_silent, self.is_over = [], True, False, False

    def at(self, now):
        """(position, velocity)."""
        if self._is_jammed:
            return self._start[0], 0.0
        (x, v), t = self._start, RATE * (now - self._since)
        x -= self._equilibrium
        position = x * math.cos(t) + v / RATE * math.sin(t)
        return position + self._equilibrium, v * math.cos(t) - x * RATE * math.sin(t)

    def go_on(self, equilibrium=0.0, jammed=False):
        with self._lock:
            now = time.time()
            self._start, self._since = self.at(now), now
            self._equilibrium, self._is_jammed = equilibrium, jammed

    def run(self):
        while not self.is_over:
            with self._lock:
                now = time.time()
                message = JointState(name=["rail"])
                values = np.array(self.at(now)) + NOISE * self._random.normal(size=2)
            if self.is_stamped:
                message.header.stamp.sec, message.header.stamp.nanosec = divmod(round(now * 1e9), 10**9)
            message.position, message.velocity = values[:1].tolist(), values[1:].tolist()
            for each in () if self.is_silent else (message, *self.others):
                self._publisher.publish(each)
            self.others = []
            time.sleep(0.01)


@pytest.fixture
def machine(client):
    machine = Oscillator(client)
    yield machine
    machine.is_over = True
    if machine.is_alive():
        machine.join()


def test_a_machine_beside_a_node(client, machine, tmp_path):
    (tmp_path / "scene.yaml").write_text(text_of("oscillator_machine.yaml"))
    parameters = {"scene": tmp_path / "scene.yaml", "machine": "/arm/joint_states", "clock_rate": 0.0}
    parameters |= {"machine_tolerance": TOLERANCE, "record": tmp_path / "run.mcap"}
    diagnostics = client.listen("/diagnostics", DiagnosticArray)
    rows, events = client.listen("/twin/machine", Float64MultiArray), client.events("/twin")
    with NodeProcess(parameters, remap=["__node:=twin"]) as process:
        command = client.publisher("/twin/joint_commands", JointState)

        def figures():
            return {k: v for k, v in figures_of(diagnostics[-1]).items() if k.startswith("machine")}

        def told(word, since):
            return any(each.name == "machine" and word in each.msg for each in events[since:])

        def predicts():
            known = figures() if diagnostics else {}
            return float(known.get("machine_horizon_s", 0.0)) == AHEAD[-1] and not known["machine_departs"]

        client.until(lambda: diagnostics and figures()["machine_note"] == "no message yet", "a note without a machine")
        machine.start()
        # Right: for as long as runs are, and with no event. Noise is estimated from some hundred values; the error of
        # the first interval is the rms of about thirty.
        client.until(predicts, "a prediction")
        assert not told("departs", 0)
        labels = [each.label.split(" ") for each in rows[-1].layout.dim]
        assert labels == [["rail.position", "rail.velocity"], list(COLUMNS)]
        last = np.reshape(rows[-1].data, (2, len(COLUMNS)))
        assert last[0, 0] == pytest.approx(NOISE, rel=0.4) and 0.2 * NOISE < last[0, 1] < 3.0 * NOISE
        assert last[0, 5] == pytest.approx(last[0, 1] / TOLERANCE, rel=1e-9) and np.isnan(last[1, 5:9]).all()
        # A commanded effort acts on the runs. Without it they would swing about another equilibrium, 0.3 m away.
        command(JointState(name=["rail"], effort=[EFFORT]))
        machine.go_on(EFFORT / STIFFNESS)
        before = len(rows)
        client.until(lambda: len(rows) > before + 3, "further comparisons")
        client.until(predicts, "a prediction of what an effort does")
        assert float(figures()["machine_error"]) < TOLERANCE
        # A joint jams: an event, a warning; the page shows both.
        remote, since = Remote("twin"), len(events)
        try:
            machine.go_on(jammed=True)
            client.until(lambda: told("departs", since), "an event")
            client.until(lambda: figures().get("machine_departs"), "a figure")
            warned = lambda each: each.level == b"\1" and each.message.startswith("machine: ")  # noqa: E731
            client.until(lambda: warned(diagnostics[-1].status[0]), "a warning")
            assert figures()["machine_output"] == "rail.position"
            client.until(lambda: float(figures()["machine_horizon_s"]) < 1.0, "a short horizon")
            assert float(figures()["machine_ratio"]) > 1.0
            client.until(lambda: remote.frame() and max(remote.frame().ratios, default=0.0) > 1.0, "curves")
            client.until(lambda: "machine: " in remote.status().text, "a line")
            assert remote.compares and "predicted within 0.05 rad or m" in remote.how
        finally:
            remote.close()
        # Bad messages, between good ones: the joint moves again, and is predicted again.
        wrong = [math.nan, math.inf, -1e300], [], [0.0]
        machine.others = [
            JointState(name=names, position=values) for names in (["rail"], [], ["other"]) for values in wrong
        ]
        machine.go_on(EFFORT / STIFFNESS)
        client.until(lambda: told("is again", since), "an end of the event")
        client.until(predicts, "a prediction again")
        machine.is_stamped, before = False, len(rows)
        client.until(lambda: len(rows) > before + 3, "comparisons without stamps")
        machine.is_silent = True
        client.until(lambda: figures()["machine_note"].startswith("no message for"), "a note on silence")
        text = process.end()
    assert "departs from the scene" in text and "without a stamp" in text


@pytest.mark.parametrize("force", [0.0, 8.0])
def test_poses_and_inputs_of_a_map(force):
    """A body that flies, by its closed form, with a force of which the map tells or the machine alone knows."""
    text = "name: fly\ngravity: [0, 0, -9.81]\nbodies: [{name: ball, mass: 2.0, inertia: [0.1, 0.1, 0.1]}]\n"
    scene, values = scene_from_text(text), SimpleNamespace(machine_tolerance=0.05, machine_ahead=1.0)
    for is_told in (True, False):
        given = {"measurements": ({"output": "ball.pose", "topic": "/mocap", "field": "pose", "noise": 1e-4},)}
        if is_told:
            given["inputs"] = ({"input": "ball.force_x", "topic": "/thrust", "field": "data"},)
        machine = RealMachine(scene, make_layout(scene), Map(**given), values, lambda kind, message: message)
        now = time.time_ns()
        for k in range(400):
            at = now + (k - 400) * 10_000_000
            t = 0.01 * k
            place = {"x": 0.25 * force * t**2, "y": 0.0, "z": 5.0 * t - 0.5 * 9.81 * t**2}
            header = {"stamp": dict(zip(("sec", "nanosec"), divmod(at, 10**9)))}
            turn = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
            pose = {"header": header, "pose": {"position": place, "orientation": turn}}
            machine._bag.take("/thrust", "float", at, {"header": header, "data": force})
            machine._bag.take("/mocap", "pose", at, pose)
        assert machine._compare() == ""
        ((message, event),) = machine.news()
        # Without the force, a start is a line through 0.3 s of a parabola: 2 (0.15 + t)^2 - 0.015 m off, t s later.
        departs = force > 0.0 and not is_told
        assert bool(event) == departs and machine.figures["machine_horizon_s"] == (AHEAD[-1] if not departs else 0.0)
        if departs:  # of times from 0.7 s to 1 s
            assert machine.figures["machine_output"] == "ball.x" and machine.figures["machine_error_ahead_s"] == 1.0
            assert 2.0 * 0.85**2 - 0.015 < machine.figures["machine_error"] < 2.0 * 1.15**2 - 0.015
        assert decode(message)["ball.z"]["error_1s"] < 1e-3
