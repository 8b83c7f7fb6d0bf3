# SPDX-License-Identifier: Apache-2.0
"""The simulation node in its own process, over DDS: topics, services, wrenches and errors."""

import re
import signal
import time
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from node_process import COMPILING, PATIENCE, PUSH, NodeProcess, python, stamp_ns
from rcl_interfaces.msg import Log
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock

from liegroup_core.scene.load import load_scene
from liegroup_sim_ros.node.parameter_texts import preset_text, table_text
from liegroup_sim_ros.node.parameters import RATES, TABLE, check, fitting_steps
from liegroup_sim_ros.node.rates import Output, Rates

STEP_NS = 1_000_000
PERIOD_NS = 10 * STEP_NS
NODE = "/sim_node"
SOURCE = Path(__file__).resolve().parents[2]


class Shared:
    """Running node and all messages received from it."""

    def __init__(self, client):
        self.pose = client.listen(f"{NODE}/puck/pose", PoseStamped)
        self.twist = client.listen(f"{NODE}/puck/twist", TwistStamped)
        self.cube_twist = client.listen(f"{NODE}/cube/twist", TwistStamped)
        self.clock = client.listen("/clock", Clock, QoSProfile(depth=200, reliability=ReliabilityPolicy.BEST_EFFORT))
        self.given = client.given(NODE)
        self.events = client.listen(
            f"{NODE}/events", Log, QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        )
        self.diagnostics = client.listen("/diagnostics", DiagnosticArray)
        self.logged = client.listen("/rosout", Log)
        self.push = client.pusher(NODE)
        client.until(
            lambda: self.pose and self.twist and self.cube_twist and self.clock and self.diagnostics and self.events,
            COMPILING,
            "one message of each",
        )

    def now_ns(self):
        """Stamp up to which all poses and twists have come."""
        return min(stamp_ns(messages[-1].header.stamp) for messages in (self.pose, self.twist, self.cube_twist))

    def pause(self, client):
        """Pause the node; the stamp at which it stands, once all messages up to it have come."""
        assert client.call(f"{NODE}/pause").success
        client.until(lambda: self.events[-1].name == "pause" and self.now_ns() == stamp_ns(self.events[-1].stamp))
        return self.now_ns()

    def figures(self):
        return {pair.key: pair.value for pair in self.diagnostics[-1].status[0].values}


@pytest.fixture(scope="module")
def shared(client, scene):
    with NodeProcess({"scene": scene, "method": "rkmk4", "step": 1e-3}) as process:
        yield Shared(client)
        process.send(signal.SIGINT)
        assert process.wait()[0] == 0


@pytest.fixture
def node(client, shared):
    """The shared node, running, reset to its initial state, without wrenches."""
    assert client.call(f"{NODE}/reset").success
    assert client.call(f"{NODE}/resume").success
    count = len(shared.pose)
    client.until(lambda: len(shared.pose) > count + 5)
    shared.given.clear()
    return shared


def test_poses_twists_and_clock_are_complete(client, node):
    begin = node.now_ns()
    end = begin + 50 * PERIOD_NS
    client.until(lambda: node.now_ns() > end)
    pose, twist, cube = (
        [m for m in messages if begin < stamp_ns(m.header.stamp) <= end]
        for messages in (node.pose, node.twist, node.cube_twist)
    )
    assert {m.header.frame_id for m in pose} == {"world"}
    assert {m.header.frame_id for m in twist} == {"puck"}
    assert {m.header.frame_id for m in cube} == {"cube"}
    expected = list(range(begin + PERIOD_NS, end + 1, PERIOD_NS))
    for messages in (pose, twist, cube):
        assert [stamp_ns(m.header.stamp) for m in messages] == expected
    # The puck is at rest, exactly; the cube keeps its speed, whatever axes it is told in.
    assert pose[-1].pose.position.x == 0.0 and pose[-1].pose.orientation.w == 1.0
    speed = [np.linalg.norm([m.twist.linear.x, m.twist.linear.y, m.twist.linear.z]) for m in cube]
    # RKMK4 at 1 ms: global error of order |omega|^5 h^4 t = 1e-12 within a second.
    assert np.allclose(speed, np.sqrt(0.14), rtol=1e-10)
    clocks = [stamp_ns(m.clock) for m in node.clock]
    assert set(np.diff(clocks[-40:])) == {PERIOD_NS}


def test_a_late_subscriber_receives_the_start_event(node):
    assert node.events[0].name == "start"


def test_a_wrench_from_another_process_gives_its_impulse(client, node):
    push = python(PUSH, "push", "puck", "--force", 3, 0, 0, "--torque", 0, 0, 0.8, "--duration", 0.3)
    client.until(lambda: push.poll() is not None, what="end of the push")
    output, errors = push.communicate()
    assert push.returncode == 0, errors
    assert re.search(r"applied force .* to puck .* 15 messages, .*\napplied from \S+ s to \S+ s", output)
    assert len(node.given) == 16
    assert {(order.name, order.values) for order in node.given[:15]} == {("puck", (0.0, 0.0, 0.8, 3.0, 0.0, 0.0))}
    assert node.given[15].values == (0.0,) * 6
    start, end = node.given[0].start, node.given[15].start
    seconds = (end - start) * 1e-9
    client.until(lambda: node.now_ns() > end)
    twist = node.twist[-1].twist
    # About the principal axis z: omega = torque t / 0.4. The force turns with the body, so the
    # velocity in world axes is (F / m) times the integral of (cos, sin)(omega' t^2 / 2).
    assert twist.angular.z == pytest.approx(0.8 * seconds / 0.4, rel=1e-12)
    assert twist.angular.x == twist.angular.y == 0.0
    t = np.linspace(0.0, seconds, 20001)
    angle = 0.5 * (0.8 / 0.4) * t**2
    impulse = np.trapezoid if hasattr(np, "trapezoid") else np.trapz
    expected = 3.0 / 2.0 * np.hypot(impulse(np.cos(angle), t), impulse(np.sin(angle), t))
    # Trapezoids of 15 us: error of order 1e-10.
    assert np.hypot(twist.linear.x, twist.linear.y) == pytest.approx(expected, rel=1e-8)
    assert twist.linear.z == 0.0


def test_push_refuses_an_unknown_body(node):
    push = python(PUSH, "push", "bal", "--force", 1, 0, 0)
    output, errors = push.communicate(timeout=PATIENCE)
    assert (push.returncode, output) == (2, "")
    assert errors == "liegroup_sim: /sim_node has no body or link 'bal'; its bodies: cube, puck\n"


@pytest.mark.parametrize("hold, steps", [("timeout", 100), ("one_step", 1)])
def test_a_wrench_ends_after_its_hold_time(client, node, hold, steps):
    assert client.set(NODE, wrench_hold=hold).successful
    node.push("puck", force=(0.0, 4.0, 0.0))
    client.until(lambda: node.given)
    ((_, _, wrench, start, end, *_),) = node.given
    assert wrench == (0.0, 0.0, 0.0, 0.0, 4.0, 0.0) and end - start == steps * STEP_NS
    client.until(lambda: node.now_ns() > end)
    assert node.twist[-1].twist.linear.y == pytest.approx(4.0 / 2.0 * steps * 1e-3, rel=1e-12)


def test_a_wrench_lasts_until_it_is_replaced(client, node):
    assert client.set(NODE, wrench_hold="until_replaced").successful
    node.push("puck", force=(1.0, 0.0, 0.0))
    client.until(lambda: node.given)
    start = node.given[0].start
    client.until(lambda: node.now_ns() > start + 300 * STEP_NS)
    assert node.twist[-1].twist.linear.x > 0.149  # F t / m = 0.5 * 0.3
    node.push("puck", force=(-1.0, 0.0, 0.0))
    client.until(lambda: len(node.given) == 2)
    node.push("puck")
    client.until(lambda: len(node.given) == 3)
    assert [(order.values[3], order.end) for order in node.given] == [(1.0, None), (-1.0, None), (0.0, None)]
    assert client.set(NODE, wrench_hold="timeout").successful


def test_a_future_stamp_is_scheduled_and_a_past_stamp_applies_now(client, node):
    future = node.now_ns() + 333 * STEP_NS + 1234  # inside a step
    node.push("puck", force=(1.0, 0.0, 0.0), stamp_ns=future)
    node.push("cube", force=(1.0, 0.0, 0.0), stamp_ns=1)
    client.until(lambda: len(node.given) == 2)
    starts = {order.name: (order.start, order.end) for order in node.given}
    assert starts["puck"] == (future, future + 100 * STEP_NS)
    assert starts["cube"][0] < future - 200 * STEP_NS


@pytest.mark.parametrize(
    "reason, body, force, ahead, message",
    [
        ("not_finite", "puck", (float("nan"), 0.0, 0.0), 0, "for puck: a component is NaN"),
        ("not_finite", "puck", (0.0, float("-inf"), 0.0), 0, None),
        ("unknown_frame", "world", (1.0, 0.0, 0.0), 0, "unknown frame_id 'world'"),
        ("no_frame", "", (1.0, 0.0, 0.0), 0, "frame_id is empty"),
        ("stamp_too_far", "puck", (1.0, 0.0, 0.0), 1_800_000_000 * 10**9, "ahead of the simulated"),
    ],
)
def test_an_invalid_wrench_is_refused_counted_and_logged_once(client, node, reason, body, force, ahead, message):
    client.until(lambda: node.figures()["state"] == "running")
    logged = len(node.logged)
    key = f"wrenches_refused_{reason}"
    before = int(node.figures()[key])
    for _ in range(3):
        node.push(body, force=force, stamp_ns=ahead)
    client.until(lambda: int(node.figures()[key]) == before + 3)
    assert node.given == []
    twist = node.twist[-1].twist
    assert [twist.linear.x, twist.linear.y, twist.angular.z] == [0.0] * 3
    said = [m.msg for m in node.logged[logged:] if m.msg.startswith("wrench refused")]
    if message:
        assert len(said) == 1 and message in said[0]
    else:
        assert said == []  # the reason is known from the case before


def test_a_wrench_publisher_with_incompatible_qos_is_reported(client, node):
    publisher = client.node.create_publisher(
        WrenchStamped, f"{NODE}/wrench", QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    )
    client.until(lambda: any("incompatible QoS" in m.msg and "RELIABILITY" in m.msg for m in node.logged))
    client.node.destroy_publisher(publisher)


def test_step_advances_by_the_exact_number_while_paused(client, node):
    refused = client.call(f"{NODE}/step")
    assert not refused.success and "~/pause first" in refused.message
    still, count = node.pause(client), len(node.pose)
    client.spin(0.3)
    assert len(node.pose) == count
    for steps in (1, 7, 25):
        assert client.set(NODE, step_count=steps).successful
        assert client.call(f"{NODE}/step").success
        still += steps * STEP_NS
        client.until(lambda: node.now_ns() == still)
    client.spin(0.2)
    assert node.now_ns() == still
    # From a step that is on no grid, running goes on on the grid, with no burst.
    start = time.monotonic()
    count = len(node.pose)
    assert client.call(f"{NODE}/resume").success
    client.until(lambda: len(node.pose) > count + 30)
    stamps = [stamp_ns(m.header.stamp) for m in node.pose[count:]]
    assert 0 < stamps[0] - still < PERIOD_NS
    assert set(np.diff(stamps)) == {PERIOD_NS}
    assert time.monotonic() - start > 0.29
    assert client.set(NODE, step_count=1).successful


def test_reset_restores_the_state_and_time_continues(client, node):
    node.push("puck", force=(5.0, 0.0, 0.0), torque=(0.0, 1.0, 0.0))
    client.until(lambda: node.twist[-1].twist.linear.x != 0.0)
    before, count = node.pause(client), len(node.pose)
    assert client.call(f"{NODE}/reset").success
    client.until(lambda: node.now_ns() > before)
    assert node.now_ns() == before + STEP_NS and len(node.pose) == count + 1
    pose, twist = node.pose[-1].pose, node.twist[-1].twist
    assert (pose.position.x, pose.orientation.y, pose.orientation.w) == (0.0, 0.0, 1.0)
    assert (twist.linear.x, twist.angular.y) == (0.0, 0.0)
    # The push is over, too, and that was said with the reset.
    client.until(lambda: node.given.present == [])
    assert client.call(f"{NODE}/resume").success
    client.until(lambda: len(node.pose) > count + 30)
    stamps = np.array([stamp_ns(m.header.stamp) for m in node.pose])
    assert (np.diff(stamps) > 0).all()
    assert node.twist[-1].twist.linear.x == 0.0
    assert [m.name for m in node.events[-3:]] == ["pause", "reset", "resume"]


def test_the_real_time_factor_is_held_and_can_be_changed(client, node):
    for wanted in (0.5, 2):  # a whole number is a number, too
        assert client.set(NODE, real_time_factor=wanted).successful
        client.spin(0.1)
        begin, start = node.now_ns(), time.monotonic()
        client.spin(1.0)
        achieved = (node.now_ns() - begin) * 1e-9 / (time.monotonic() - start)
        # Two readings, each up to a period and some transport off, on a shared machine.
        assert achieved == pytest.approx(wanted, rel=0.2)
    assert client.set(NODE, real_time_factor=0.0).successful
    begin, start = node.now_ns(), time.monotonic()
    client.until(lambda: node.now_ns() - begin > 5e9, what="as fast as it goes")
    assert time.monotonic() - start < 2.5
    for value in (-1.0, float("nan"), "fast"):
        assert not client.set(NODE, real_time_factor=value).successful
    assert not client.set(NODE, step=0.5).successful
    assert not client.set(NODE, wrench_hold="forever").successful
    assert client.set(NODE, real_time_factor=1.0).successful
    # Events and answers come by different ways.
    client.until(
        lambda: (
            [m.msg for m in node.events if m.name == "speed"][-4:]
            == [f"real-time factor {factor}" for factor in ("0.5", "2", "0", "1")]
        ),
        what="all events",
    )


def test_divergence_stops_the_simulation_but_not_the_node(client, node):
    node.push("cube", torque=(1e99, 1e99, 0.0))
    client.until(lambda: node.events[-1].name == "fault", what="a fault")
    client.until(lambda: node.diagnostics[-1].status[0].level == DiagnosticStatus.ERROR)
    assert node.figures()["state"] == "faulted"
    last = node.cube_twist[-1].twist.angular
    assert np.isfinite([last.x, last.y, last.z]).all()
    refused = client.call(f"{NODE}/resume")
    assert not refused.success and "~/reset first" in refused.message
    count = len(node.pose)
    assert client.call(f"{NODE}/reset").success
    client.until(lambda: len(node.pose) > count + 10)  # running again, as before
    client.until(lambda: node.figures()["state"] == "running")
    speed = node.cube_twist[-1].twist.linear
    assert np.linalg.norm([speed.x, speed.y, speed.z]) == pytest.approx(np.sqrt(0.14), rel=1e-10)


def test_diagnostics_contain_the_documented_values(client, node):
    client.until(lambda: node.figures()["state"] == "running")
    figures = node.figures()
    documented = (SOURCE / "docs" / "reference" / "node.md").read_text()
    for key in figures:
        assert f"`{re.sub('_refused_.*', '_refused_REASON', key)}`" in documented, key
    assert float(figures["constraint_residual"]) == 0.0
    assert figures["recorder_lost"] == "0"
    # Energy of the tumbling cube: nothing acts, the drift is the integrator's, far below 1e-9 J.
    assert abs(float(figures["energy_drift_J"])) < 1e-9
    assert node.diagnostics[-1].status[0].name == "/sim_node: simulation"


def test_the_preset_lists_the_defaults_of_all_parameters():
    preset = yaml.safe_load((SOURCE / "config" / "default.yaml").read_text())
    given = preset["/**"]["ros__parameters"]
    fixed = [entry for entry in TABLE if entry.name != "tf_rate"]  # its default depends on the machine
    assert given == {entry.name: entry.default for entry in fixed} | {"scene": "heavy_top"}
    assert [type(given[entry.name]) for entry in fixed] == [type(e.default) for e in fixed]
    assert (SOURCE / "config" / "default.yaml").read_text() == preset_text()


@pytest.mark.parametrize("path", sorted((SOURCE / "config").glob("*.yaml")), ids=lambda p: p.stem)
def test_every_preset_has_valid_parameters(path):
    given = yaml.safe_load(path.read_text())["/**"]["ros__parameters"]
    for name, value in given.items():
        assert check(name, value) == value
    assert 1e-3 <= fitting_steps(values_of(given), load_scene("gripper"))[0] <= 1e-2


@pytest.mark.parametrize(
    "rates, longest",
    [
        ({}, 0.01),
        ({"publish_rate": 1000.0}, 0.001),
        ({"clock_rate": 30.0}, 0.01),
        ({"publish_rate": 333.0}, 0.002),
        ({"accuracy_horizon": 0.05}, 0.001),
        ({"publish_rate": 1e5}, 1e-5),
        ({"publish_rate": 1.0, "clock_rate": 0.0, "state_rate": 0.0}, 0.01),
    ],
)
def test_steps_with_stops_are_not_longer_than_the_shortest_period(rates, longest):
    values = values_of(rates)
    steps = fitting_steps(values, load_scene("gripper"))
    assert steps[0] == longest and steps[-1] < 1e-6
    assert fitting_steps(values, load_scene("heavy_top"))[0] == min(0.01, 0.02 * values.accuracy_horizon)
    assert all(after < before for before, after in zip(steps, steps[1:]))


def values_of(given):
    values = SimpleNamespace(**{entry.name: entry.default for entry in TABLE} | given)
    values.rates = {name: getattr(values, name) for name in RATES}
    return values


@pytest.mark.parametrize("rate", [1e5, 1e4, 1000.0, 333.0, 30.0, 333.3, 1.0 / 3.0, 1e-3])
def test_outputs_are_due_at_exact_multiples_of_their_periods(rate):
    """Multiples of the exact period, rounded to ns, from any time on: against fractions, after hours, too."""
    rates = Rates([Output(rate, print), Output(100.0, print)])
    period = 1 / Fraction(rate)
    for start in (0, 10**9 - 1, 86_400 * 10**9 + 1):
        now, rates_of = start, []
        for _ in range(50):
            before, now = now, rates.after(now)
            rates_of += [output.rate for output in rates.due(now, now)]
            assert now > before
        expected = {}
        for each in (period, Fraction(1, 100)):
            number = int(start * Fraction(1, 10**9) / each)
            times = (int(n * each * 10**9 + Fraction(1, 2)) for n in range(number, number + 60))
            for at in times:
                expected.setdefault(at, []).append(1 / each)
        due = sorted(at for at in expected if start < at <= now)
        assert len(due) == 50 and due[-1] == now
        assert rates_of == [float(each) for at in due for each in expected[at]]


def test_an_output_is_sent_once_with_a_stamp():
    rates = Rates([Output(100.0, print)])
    assert rates.due(0, 0, everything=True) and not rates.due(0, 0, everything=True)
    assert rates.after(0) == 10**7 and rates.due(10**7, 10**7) and not rates.due(10**7, 10**7, everything=True)
    rates.restart()
    assert rates.after(0) == 10**7


def test_the_table_of_parameters_for_the_documentation_has_all_of_them():
    rows = [line.strip("| ").split(" | ") for line in table_text().splitlines()[2:]]
    assert [row[0] for row in rows] == [f"`{entry.name}`" for entry in TABLE]
    assert {len(row) for row in rows} == {5}
