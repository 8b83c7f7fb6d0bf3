# SPDX-License-Identifier: Apache-2.0
"""Lockstep of a node with controllers in processes of their own: the same bits, whatever the machine does."""

import hashlib
import json
import os
import signal
from fractions import Fraction

import pytest
import rclpy
from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from mcap.reader import make_reader
from node_process import NodeProcess, figures_of, python, refusal, stamp_in, stamp_of
from rosgraph_msgs.msg import Clock
from scene_files import cases, text_of
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from waiting import PATIENCE

from liegroup_core.forces.instants import NS, exact_step
from liegroup_sim_ros.playback.resimulate import resimulate
from liegroup_sim_ros.recording.read import read_recording
from liegroup_sim_ros.serving import lockstep
from liegroup_sim_ros.serving.counted_input import Refusal

# PD on the shoulder by efforts from ~/joint_states, and a wrench on the lower rod from its pose.
CONTROLLER = """
import json, random, signal, sys, time
import rclpy
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.experimental import EventsExecutor
from sensor_msgs.msg import JointState
from liegroup_sim_ros.controller import Controller

topic, rate, delay, count = json.loads(sys.argv[1])
rclpy.init()
node = rclpy.create_node("controller")


def delayed():
    global count
    count -= 1
    if count < 0:
        signal.pause()
    time.sleep(delay * random.random())


def effort(state):
    delayed()
    k = state.name.index("shoulder")
    return JointState(name=["shoulder"], effort=[-3.0 * state.position[k] - 0.2 * state.velocity[k]])


def wrench(pose):
    delayed()
    message = WrenchStamped()
    message.header.frame_id = "lower"
    message.wrench.force.x = -5.0 * pose.pose.position.z
    return message


if topic.startswith("joint"):
    states, kind, compute = [("/sim_node/joint_states", JointState)], JointState, effort
else:
    states, kind, compute = [("/sim_node/lower/pose", PoseStamped)], WrenchStamped, wrench
Controller(node, rate, states, ("/sim_node/" + topic, kind), compute)
executor = EventsExecutor()
executor.add_node(node)
while rclpy.ok():
    executor.spin_once(timeout_sec=1.0)
"""
# Order of ros2_control_node with use_sim_time, and a plugin that blocks in `read`: two nodes, each with its own clock.
PLUGIN = """
import threading
import rclpy
from rclpy.duration import Duration
from rclpy.experimental import EventsExecutor
from rclpy.parameter import Parameter
from rclpy.time import Time
from sensor_msgs.msg import JointState

rclpy.init()
simulated = [Parameter("use_sim_time", value=True)]
manager, arm = (rclpy.create_node(name, parameter_overrides=simulated) for name in ("controller_manager", "arm"))
latest, come, period = [JointState()], threading.Condition(), Duration(nanoseconds=2_000_000)


def take(state):
    with come:
        latest[0] = state
        come.notify_all()


def sleep_until(clock, end):  # that of rclpy waits for ever if this time comes before it begins to wait
    while clock.now() < end:
        come.acquire(), come.wait(0.001), come.release()


def loop():
    clock = manager.get_clock()
    while not clock.now().nanoseconds or not latest[0].name:  # wait_until_started
        come.acquire(), come.wait(0.01), come.release()
    sleep_until(clock, clock.now() + period)
    while rclpy.ok():
        now = clock.now()
        with come:  # read
            come.wait_for(lambda: Time.from_msg(latest[0].header.stamp, clock.clock_type) >= now)
            state = latest[0]
        k = state.name.index("shoulder")  # update
        message = JointState(name=["shoulder"], effort=[-3.0 * state.position[k] - 0.2 * state.velocity[k]])
        message.header.stamp = now.to_msg()
        commands.publish(message)  # write
        sleep_until(clock, now + period)


arm.create_subscription(JointState, "/sim_node/joint_states", take, 10)
commands = arm.create_publisher(JointState, "/sim_node/joint_commands", 1)
executor = EventsExecutor()
executor.add_node(manager)
executor.add_node(arm)
threading.Thread(target=loop, daemon=True).start()
while rclpy.ok():
    executor.spin_once(timeout_sec=1.0)
"""
FAST, SLOW = ("joint_commands", 1000.0), ("wrench/slow", 100.0)
SERVO = text_of("rig_lockstep.yaml")
BOTH = f"{FAST[0]}@1000,{SLOW[0]}@100"
SCENE = {"scene": "double_pendulum", "method": "rkmk4", "step": 1e-3, "real_time_factor": 0.0, "lockstep": BOTH}


class Controllers:
    """Processes of controllers, killed by `with`; they answer for some seconds of simulated time."""

    def __init__(self, *tasks, delay=0.0, seconds=1e6):
        self.processes = [
            python(CONTROLLER, json.dumps([topic, rate, delay, round(rate * seconds)])) for topic, rate in tasks
        ]

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for process in self.processes:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
            process.communicate()


def states_hash(path):
    """SHA-256 of all recorded messages but those with figures of the wall clock."""
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
            if channel.topic not in ("/diagnostics", "/sim_node/state", "/sim_node/events"):
                digest.update(channel.topic.encode() + message.log_time.to_bytes(8, "little") + message.data)
    return digest.hexdigest()


def answer(stamp, effort=1.0, joint="shoulder"):
    message = JointState(name=[joint], effort=[effort])
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, NS)
    return message


def test_the_same_bits_whatever_the_controllers_delay(tmp_path, client):
    found = []
    for k, delay in enumerate((0.0, 4e-3)):
        path = tmp_path / f"{k}.mcap"
        events = client.events("/sim_node")
        with NodeProcess(SCENE | {"record": path}) as node:
            with Controllers(FAST, SLOW, delay=delay, seconds=0.15):
                client.until(lambda heard=events: any("at 0.150000000 s" in e.msg for e in heard), "the last state")
                node.end()
        recording = read_recording(path)
        assert recording.complete and not recording.lost
        figures = resimulate(recording)
        assert figures["identical"] == figures["samples"] == 151 and figures["must_be_equal"]
        found.append(states_hash(path))
        for source, period in ((FAST[0], 10**6), (f"{SLOW[0]}/lower/", 10**7)):
            held = [(c.start_ns, c.end_ns) for c in recording.inputs if c.source == source]
            assert held == [(start, start + period) for start in range(0, 150 * 10**6, period)]
    assert found[0] == found[1]


def test_a_dead_controller_is_reported_and_replaced(tmp_path, client):
    events = client.events("/sim_node")
    path = tmp_path / "run.mcap"
    # 3 s: a loaded machine stops a controller that lives for longer than 0.5 s.
    with NodeProcess(SCENE | {"lockstep_timeout": 3.0, "record": path}) as node:
        clock = client.listen("/clock", Clock)
        with Controllers(SLOW):
            for number in (signal.SIGKILL, signal.SIGSTOP):
                with Controllers(FAST) as fast:
                    count = len(clock)
                    client.until(lambda n=count: len(clock) > n + 100, "steps")
                    events.clear()
                    os.killpg(fast.processes[0].pid, number)
                    client.until(lambda: any("paused" in e.msg for e in events), "event of the missing answer")
                    (text,) = (e.msg for e in events if "paused" in e.msg)
                    assert text.startswith(f"no answer on ~/{FAST[0]} to the state at ")
                    assert client.call("/sim_node/pause").message == "already paused"
                    stamp = client.command("/sim_node/resume")
                    if number == signal.SIGSTOP:
                        os.killpg(fast.processes[0].pid, signal.SIGCONT)
                        client.until(lambda n=stamp: stamp_of(clock[-1]) > n + 10**8, "steps after the freeze")
        log = node.end()
    assert "no answer on ~/joint_commands" in log
    recording = read_recording(path)
    assert recording.complete and not recording.lost
    figures = resimulate(recording)
    assert figures["identical"] == figures["samples"] and figures["must_be_equal"]


def test_states_that_are_set_are_answered_at_multiples_of_both_periods(tmp_path, client):
    path = tmp_path / "run.mcap"
    with NodeProcess(SCENE | {"record": path}) as node, Controllers(FAST, SLOW):
        clock = client.listen("/clock", Clock)
        client.until_stamp(10**8, clock)
        client.command("/sim_node/pause")
        assert client.call("/sim_node/save_snapshot").success
        client.command("/sim_node/resume")
        for name in ("restore_snapshot", "reset", "reload"):
            response = client.call(f"/sim_node/{name}")
            assert response.success
            client.until_stamp(stamp_in(response.message) + 10**8, clock)
        node.end()
    for part in (path, tmp_path / "run_part2.mcap"):
        recording = read_recording(part)
        assert recording.complete and not recording.lost
        figures = resimulate(recording)
        assert figures["identical"] == figures["samples"] and figures["must_be_equal"]
        for source, period in ((FAST[0], 10**6), (f"{SLOW[0]}/lower/", 10**7)):
            starts = [c.start_ns for c in recording.inputs if c.source == source]
            assert len(starts) >= 10**8 // period and not any(start % period for start in starts)
            assert len(set(starts)) == len(starts)


def test_a_trajectory_starts_at_the_time_of_its_state(tmp_path, client):
    (tmp_path / "rig.yaml").write_text(SERVO)
    parameters = {"scene": tmp_path / "rig.yaml", "method": "rkmk4", "lockstep": "joint_trajectory@100"}
    with NodeProcess(parameters | {"start_paused": "true", "step_count": 10}) as node:
        clock, targets = client.listen("/clock", Clock), client.listen("/sim_node/servo_targets", JointState)
        publish = client.publisher("/sim_node/joint_trajectory", JointTrajectory)
        client.until(lambda: clock, "a connection")
        for k in range(3):
            message = JointTrajectory()
            message.header.stamp.nanosec = k * 10**7
            if k == 1:
                message.joint_names = ["hinge"]
                message.points = [JointTrajectoryPoint(positions=[0.5], time_from_start=Duration(nanosec=4 * 10**6))]
            publish(message)
            assert client.call("/sim_node/step").success
        client.until(lambda: targets and targets[-1].position[0] == 0.5, "the last target")
        node.end()
    assert [stamp_of(target) for target in targets][-3:] == [10**7, 12 * 10**6, 14 * 10**6]


def test_the_step_follows_the_lockstep(client):
    with NodeProcess(SCENE | {"lockstep": "wrench@300", "step": 0.0}) as node:
        events = client.events("/sim_node")
        client.until(lambda: any("waiting" in e.msg for e in events), "the wait")
        assert "step 0.000833333 s" in node.end()


def test_wrong_stamps_are_refused_and_a_step_ends_at_the_time_limit(client, tmp_path):
    parameters = SCENE | {"lockstep": "joint_commands@1000", "lockstep_timeout": 0.3, "start_paused": "true"}
    clock = client.listen("/clock", Clock)
    with NodeProcess(parameters | {"record": tmp_path / "run.mcap"}) as node:
        publish = client.publisher("/sim_node/joint_commands", JointState)
        diagnostics = client.listen("/diagnostics", DiagnosticArray)
        client.until(lambda: clock, "a connection")
        publish(answer(10**6))  # early
        publish(answer(0))
        publish(answer(0))  # the same again is no news
        publish(answer(0, effort=2.0))  # repeated
        assert client.call("/sim_node/step").message == "1 step, at 0.001 s"
        publish(answer(1))  # late
        refused = client.call("/sim_node/step")
        assert not refused.success
        assert refused.message.startswith(
            "no answer on ~/joint_commands to the state at 0.001000000 s within 0.3 s: paused"
        )
        publish(answer(10**6, joint="nobody"))  # refused as usual, so it is no answer
        publish(answer(10**6))
        assert client.call("/sim_node/step").success
        assert client.call("/sim_node/reset").message == "initial state at 0.003 s, paused"
        client.until(lambda: diagnostics and figures_of(diagnostics[-1])["answers_accepted"] == "2", "diagnostics")
        figures = figures_of(diagnostics[-1])
        assert figures["answers_missing"] == "joint_commands"
        for reason in ("early", "late", "repeated"):
            assert figures[f"answers_refused_{reason}"] == "1", reason
        log = node.end()
    for text in ("0.001000000 s is after 0.000000000 s", "0.000000001 s is before 0.001000000 s", "the first one acts"):
        assert text in log, log
    recording = read_recording(tmp_path / "run.mcap")
    assert [(c.start_ns, c.end_ns, c.values) for c in recording.inputs] == [
        (0, 10**6, (1.0,)),
        (10**6, 2 * 10**6, (1.0,)),
    ]


def test_a_step_that_waits_is_answered_when_the_node_ends(client):
    """The line is the answer; `end` checks that nothing else is logged."""
    events = client.events("/sim_node")
    with NodeProcess(SCENE | {"start_paused": "true", "step_count": 10}) as node:
        service = client.node.create_client(Trigger, "/sim_node/step")
        client.until(service.service_is_ready)
        future = service.call_async(Trigger.Request())
        client.until(lambda: any("waiting" in event.msg for event in events))
        node.end()
        rclpy.spin_until_future_complete(client.node, future, client._executor, PATIENCE)
        assert (future.result().success, future.result().message) == (False, "the node is shutting down")


def test_lockstep_begins_and_ends_while_the_node_runs(client):
    clock, events = client.listen("/clock", Clock), client.events("/sim_node")
    with NodeProcess(SCENE | {"lockstep": "''", "real_time_factor": 1.0}):
        client.until(lambda: len(clock) > 3)
        assert not client.set("/sim_node", lockstep="commands@100").successful
        assert "multiple of the step" in client.set("/sim_node", lockstep="wrench@1500").reason
        assert client.set("/sim_node", lockstep="wrench/mine@100").successful
        publish = client.publisher("/sim_node/wrench/mine", WrenchStamped)
        client.until(lambda: any("no answer on ~/wrench/mine" in e.msg for e in events), "the wait")
        stamp = stamp_of(clock[-1])
        assert stamp % 10**7 == 0
        message = WrenchStamped()
        message.header.frame_id = "lower"
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, NS)
        publish(message)
        client.until(lambda: stamp_of(clock[-1]) == stamp + 10**7, "the next state")
        assert client.set("/sim_node", lockstep="").successful
        client.until(lambda: stamp_of(clock[-1]) > stamp + 10**9, "a free run")


def test_a_plugin_of_ros2_control_that_blocks_is_exact(client, tmp_path):
    found = []
    rates = dict.fromkeys(("joint_state_rate", "clock_rate", "publish_rate"), 500.0)
    for k in range(2):
        path = tmp_path / f"{k}.mcap"
        given = SCENE | rates | {"lockstep": "''", "real_time_factor": 1.0, "lockstep_timeout": 60.0, "record": path}
        with NodeProcess(given) as node:
            clock = client.listen("/clock", Clock)
            process = python(PLUGIN)
            try:
                commands = client.listen("/sim_node/joint_commands", JointState)
                client.until(lambda heard=(clock, commands): all(len(each) > 10 for each in heard), "commands")
                assert client.set("/sim_node", lockstep="joint_commands@500").successful
                stamp = stamp_in(client.call("/sim_node/reset", again=PATIENCE).message)
                client.until_stamp(stamp + 4 * 10**8, clock)
                node.end()
            finally:
                os.killpg(process.pid, signal.SIGKILL)
                process.communicate()
        recording = read_recording(path)
        (base,) = (event.stamp_ns for event in recording.events if event.name == "reset")
        given = [(c.start_ns - base, c.end_ns - base, c.values) for c in recording.inputs if c.start_ns >= base][:200]
        assert [(start, end) for start, end, _ in given] == [(n, n + 2 * 10**6) for n in range(0, 4 * 10**8, 2 * 10**6)]
        found.append(given)
    assert found[0] == found[1]


@pytest.mark.parametrize(("given", "text"), cases("wrong_parameters"))
def test_wrong_parameters(capfd, given, text):
    assert text in refusal(capfd, SCENE | given)


def test_a_damaged_answer_is_none():
    waiting = lockstep.Lockstep(rates={"wrench": 100.0})
    waiting.ask("wrench", 0, 0)
    with pytest.raises(Refusal, match="no time stamp"):
        waiting.receive("wrench", b"\0\1\0\0", None)
    assert waiting.missing == ["wrench"] and waiting.figures()["answers_refused_damaged"] == 1
    waiting.receive("wrench", b"\0\1" + bytes(10), lambda payload, asked: asked)
    assert waiting.missing == [] and waiting.take() == [(0, 0.01)] and waiting.take() == []


@pytest.mark.parametrize("rates", [[1000.0, 100.0], [300.0], [300.0, 1000.0], [1024.0, 7.0], [333.3]])
def test_steps_and_time_stamps_fit_the_periods(rates):
    step = lockstep.fitting_step(rates, 2e-3)
    assert step <= 2e-3 and lockstep.unfitting(dict.fromkeys(rates, rates[0]), step) is None
    size = Fraction(*exact_step(step))
    assert all((NS / lockstep.exact_rate(rate) / size).denominator == 1 for rate in rates)
    stamp = lockstep.aligned(rates, 1_234_567_891, 7)
    assert all((Fraction(stamp - 7) * lockstep.exact_rate(rate) / NS).denominator == 1 for rate in rates)
    assert lockstep.aligned(rates, stamp, 7) == stamp >= 1_234_567_891
