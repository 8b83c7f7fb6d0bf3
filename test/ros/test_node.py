# SPDX-License-Identifier: Apache-2.0
"""The simulation node in its own process, over DDS: topics, services, wrenches and errors."""

import math
import re
import time
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from node_process import NodeProcess, figures_of, on_grid, push_command, stamp_of
from rcl_interfaces.msg import Log
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from scene_files import cases
from scene_runs import node_values

from liegroup_sim_ros.node.parameter_texts import preset_text, table_text
from liegroup_sim_ros.node.parameters import TABLE, check, fitting_step
from liegroup_sim_ros.serving.outputs import NodeParameterError
from liegroup_sim_ros.serving.rates import Output, Rates

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
        best_effort = QoSProfile(depth=10_000, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.clock = client.listen("/clock", Clock, best_effort)
        self.given = client.given(NODE)
        self.events = client.events(NODE)
        self.diagnostics = client.listen("/diagnostics", DiagnosticArray)
        self.logged = client.listen("/rosout", Log)
        self.push = client.pusher(NODE)
        all_of_them = (self.pose, self.twist, self.cube_twist, self.clock, self.diagnostics, self.events)
        client.until(lambda: all(all_of_them), "one message of each")

    def now_ns(self):
        """Stamp up to which all poses and twists have come."""
        return min(stamp_of(messages[-1]) for messages in (self.pose, self.twist, self.cube_twist))

    def reach(self, client, command):
        """Give a command; its stamp, once all messages up to it have come."""
        stamp = client.command(f"{NODE}/{command}")
        client.until(lambda: self.now_ns() == stamp, f"the stamp of {command}")
        return stamp

    def figures(self):
        return figures_of(self.diagnostics[-1])


@pytest.fixture(scope="module")
def shared(client, scene):
    with NodeProcess({"scene": scene, "method": "rkmk4", "step": 1e-3}) as process:
        yield Shared(client)
        process.end()


@pytest.fixture
def node(client, shared):
    """The shared node, running, reset to its initial state, without wrenches."""
    shared.given.present = None
    client.until_stamp(client.command(f"{NODE}/reset"), shared.pose, shared.twist, shared.cube_twist)
    client.until(lambda: shared.given.present == [])
    assert client.call(f"{NODE}/resume").success
    shared.given.clear()
    return shared


def test_poses_twists_and_clock_have_their_grid(client, node):
    """The recordings of other tests show that none is missing."""
    begin = node.now_ns()
    end = begin + 100 * PERIOD_NS
    client.until(lambda: node.now_ns() > end)
    pose, twist, cube = (
        [m for m in messages if begin < stamp_of(m) <= end] for messages in (node.pose, node.twist, node.cube_twist)
    )
    for messages, frame in ((pose, "world"), (twist, "puck"), (cube, "cube")):
        assert {m.header.frame_id for m in messages} == {frame}
        stamps = [stamp_of(m) for m in messages]
        assert on_grid(stamps, PERIOD_NS) and not stamps[0] % PERIOD_NS - begin % PERIOD_NS
    # The puck is at rest, exactly; the cube keeps its speed, whatever axes it is told in.
    assert pose[-1].pose.position.x == 0.0 and pose[-1].pose.orientation.w == 1.0
    speed = [np.linalg.norm([m.twist.linear.x, m.twist.linear.y, m.twist.linear.z]) for m in cube]
    # RKMK4 at 1 ms: global error of order |omega|^5 h^4 t = 1e-12 within a second.
    assert np.allclose(speed, np.sqrt(0.14), rtol=1e-10)
    assert on_grid([stamp_of(m) for m in node.clock][-90:], PERIOD_NS)


def test_a_late_subscriber_receives_the_start_event(node):
    assert node.events[0].name == "start"


def test_the_command_push_gives_its_impulse(client, node, capsys):
    """The node keeps each wrench until the next one, for a machine that delays the command."""
    assert client.set(NODE, wrench_hold="until_replaced").successful
    assert push_command("puck", "--force", 3, 0, 0, "--torque", 0, 0, 0.8, "--duration", 0.3) == 0
    output = capsys.readouterr().out
    assert re.search(r"applied force .* to puck .* 15 messages, .*\napplied from \S+ s to \S+ s", output)
    client.until(lambda: node.given and node.given[-1].values == (0.0,) * 6, "the end of the push")
    assert {(o.name, o.values) for o in node.given[:-1]} == {("puck", (0.0, 0.0, 0.8, 3.0, 0.0, 0.0))}
    assert len(node.given) <= 16
    start, end = node.given[0].start, node.given[-1].start
    seconds = (end - start) * 1e-9
    client.until(lambda: node.now_ns() > end)
    assert client.set(NODE, wrench_hold="timeout").successful
    twist = node.twist[-1].twist
    # About the principal axis z: omega = torque t / 0.4. The force turns with the body, so the
    # velocity in world axes is (F / m) times the integral of (cos, sin)(omega' t^2 / 2).
    assert twist.angular.z == pytest.approx(0.8 * seconds / 0.4, rel=1e-12)
    assert twist.angular.x == twist.angular.y == 0.0
    t = np.linspace(0.0, seconds, 20001)
    angle = 0.5 * (0.8 / 0.4) * t**2
    impulse = np.trapezoid if hasattr(np, "trapezoid") else np.trapz
    expected = 3.0 / 2.0 * np.hypot(impulse(np.cos(angle), t), impulse(np.sin(angle), t))
    # Trapezoids of seconds / 20000, 15 us for 0.3 s: error of order 1e-10.
    assert np.hypot(twist.linear.x, twist.linear.y) == pytest.approx(expected, rel=1e-8)
    assert twist.linear.z == 0.0


def test_push_refuses_an_unknown_body(node, capsys):
    assert push_command("bal", "--force", 1, 0, 0) == 2
    output, errors = capsys.readouterr()
    assert output == "" and errors == "liegroup_sim: /sim_node has no body or link 'bal'; its bodies: cube, puck\n"


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
    now = node.reach(client, "pause")
    future = now + 333 * STEP_NS + 1234  # inside a step
    node.push("puck", force=(1.0, 0.0, 0.0), stamp_ns=future)
    node.push("cube", force=(1.0, 0.0, 0.0), stamp_ns=1)
    assert client.call(f"{NODE}/step").success
    client.until(lambda: len(node.given) == 2)
    starts = {order.name: (order.start, order.end) for order in node.given}
    assert starts["puck"] == (future, future + 100 * STEP_NS)
    assert starts["cube"][0] == now


# (reason, frame_id, force, stamp in ns, text in the log or None if the reason is known from the case before)
WRONG_WRENCHES = [
    ("not_finite", "puck", (float("nan"), 0.0, 0.0), 0, "for puck: a component is NaN"),
    ("not_finite", "puck", (0.0, float("-inf"), 0.0), 0, None),
    ("unknown_frame", "world", (1.0, 0.0, 0.0), 0, "unknown frame_id 'world'"),
    ("no_frame", "", (1.0, 0.0, 0.0), 0, "frame_id is empty"),
    ("stamp_too_far", "puck", (1.0, 0.0, 0.0), 1_800_000_000 * 10**9, "ahead of the simulated"),
]


def test_invalid_wrenches_are_refused_counted_and_logged_once(client, node):
    node.reach(client, "pause")
    # The last figures may be older than what was refused before; the first of two new ones may be under way.
    count = len(node.diagnostics)
    client.until(lambda: len(node.diagnostics) > count + 1, "figures")
    logged, expected = len(node.logged), {}
    for reason, frame, force, stamp, _ in WRONG_WRENCHES:
        key = f"wrenches_refused_{reason}"
        expected[key] = expected.get(key, int(node.figures()[key])) + 3
        for _ in range(3):
            node.push(frame, force=force, stamp_ns=stamp)
    client.until(lambda: all(int(node.figures()[key]) == count for key, count in expected.items()), "all counts")
    assert client.call(f"{NODE}/step").success and node.given == []
    twist = node.twist[-1].twist
    assert [twist.linear.x, twist.linear.y, twist.angular.z] == [0.0] * 3

    def said():
        return [message.msg for message in node.logged[logged:] if message.msg.startswith("wrench refused")]

    texts = [text for *_, text in WRONG_WRENCHES if text]
    client.until(lambda: len(said()) >= len(texts), "the log")
    assert len(said()) == len(texts) and all(text in line for text, line in zip(texts, said()))


def test_a_wrench_publisher_with_incompatible_qos_is_reported(client, node):
    publisher = client.node.create_publisher(
        WrenchStamped, f"{NODE}/wrench", QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    )
    client.until(lambda: any("incompatible QoS" in m.msg and "RELIABILITY" in m.msg for m in node.logged))
    client.node.destroy_publisher(publisher)


def test_step_advances_by_the_exact_number_while_paused(client, node):
    refused = client.call(f"{NODE}/step")
    assert not refused.success and "~/pause first" in refused.message
    still = node.reach(client, "pause")
    for steps in (1, 7, 25):
        assert client.set(NODE, step_count=steps).successful
        still += steps * STEP_NS
        assert node.reach(client, "step") == still
    # From a step that is on no grid, running goes on on the grid.
    count = len(node.pose)
    assert client.call(f"{NODE}/resume").success
    client.until(lambda: len(node.pose) > count + 30)
    stamps = [stamp_of(m) for m in node.pose[count:]]
    assert 0 < stamps[0] - still and on_grid(stamps, PERIOD_NS)
    assert client.set(NODE, step_count=1).successful


def test_reset_restores_the_state_and_time_continues(client, node):
    node.push("puck", force=(5.0, 0.0, 0.0), torque=(0.0, 1.0, 0.0))
    client.until(lambda: node.twist[-1].twist.linear.x != 0.0)
    before, count = node.reach(client, "pause"), len(node.pose)
    assert node.reach(client, "reset") == before + STEP_NS and len(node.pose) == count + 1
    pose, twist = node.pose[-1].pose, node.twist[-1].twist
    assert (pose.position.x, pose.orientation.y, pose.orientation.w) == (0.0, 0.0, 1.0)
    assert (twist.linear.x, twist.angular.y) == (0.0, 0.0)
    # The push is over, too, and that was said with the reset.
    client.until(lambda: node.given.present == [])
    assert client.call(f"{NODE}/resume").success
    client.until(lambda: len(node.pose) > count + 30)
    assert (np.diff([stamp_of(m) for m in node.pose]) > 0).all()
    assert node.twist[-1].twist.linear.x == 0.0
    client.until(lambda: [m.name for m in node.events if m.name != "slow"][-3:] == ["pause", "reset", "resume"])


def test_the_real_time_factor_is_held_and_can_be_changed(client, node):
    """Simulated time is never ahead of it, and reaches it in some second in which the machine lets it."""
    for wanted in (0.5, 2):  # a whole number is a number, too
        start = time.monotonic()
        assert client.set(NODE, real_time_factor=wanted).successful
        text = f"real-time factor {wanted:g}"
        begin = client.until(lambda: next((stamp_of(m) for m in node.events if m.msg == text), None))
        client.until_stamp(begin + round(0.5e9 * wanted), node.pose)
        assert time.monotonic() - start > 0.5 - 0.01 / wanted  # the first tick is at most a period early
        client.until(lambda: float(node.figures()["real_time_factor"]) > 0.8 * wanted)
    assert client.set(NODE, real_time_factor=0.0).successful
    client.until(lambda: float(node.figures()["real_time_factor"]) > 3.0, "as fast as possible")
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
    assert 1e-3 <= fitting_step(node_values(**given)) <= 1e-2


@pytest.mark.parametrize("entry", [entry for entry in TABLE if isinstance(entry.default, float)], ids=lambda e: e.name)
def test_numbers_that_divide_have_a_smallest_value(entry):
    """Periods and durations below the resolution of stamps, 1 ns, and rates whose periods overflow, are refused."""
    for value in (5e-324, 1e-12) if entry.name != "accuracy" else (5e-324,):
        with pytest.raises(NodeParameterError, match=f"parameter {entry.name}: must be .*number from"):
            check(entry.name, value)
    assert math.isfinite(1.0 / check(entry.name, max(entry.low, 1e-9)))


@pytest.mark.parametrize("rates, longest", cases("steps_are_not_longer_than_the_shortest_period"))
def test_steps_are_not_longer_than_the_shortest_period(rates, longest):
    assert fitting_step(node_values(**rates)) == longest


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
