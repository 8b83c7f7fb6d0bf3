# SPDX-License-Identifier: Apache-2.0
"""A running node answers a command by its next state at once; rate, stamps and repetition stay."""

import signal
import statistics
import time

import pytest
from commanded import Commanded
from node_process import NodeProcess, stamp_ns

from liegroup_sim_ros.playback.resimulate import resimulate
from liegroup_sim_ros.recording.read import read_recording

NODE = "/answering"
PERIOD = 0.2  # s, of the states
SCENE = """
name: bench
gravity: [0, 0, 0]
bodies:
  - {name: wheel, mass: 1.0, inertia: [0.3, 0.4, 0.5]}
joints:
  - {name: hinge, type: revolute, parent: world, child: wheel, child_frame: {}}
"""


@pytest.fixture(scope="module")
def process(client, tmp_path_factory):
    folder = tmp_path_factory.mktemp("answering")
    (folder / "bench.yaml").write_text(SCENE)
    parameters = {
        "scene": folder / "bench.yaml",
        "method": "rkmk4",
        "step": 1e-3,
        "publish_rate": 1.0 / PERIOD,
        "joint_state_rate": 1.0 / PERIOD,
        "clock_rate": 50.0,  # ticks between two states
        "record": folder / "run.mcap",
    }
    with NodeProcess(parameters, remap=[f"__node:={NODE[1:]}"]) as process:
        yield process, Commanded(client, NODE), folder / "run.mcap"


def next_state(client, node):
    """The next joint state, and the wall time at which it came."""
    before = len(node.states)
    client.until(lambda: len(node.states) > before, 10.0)
    return node.states[-1], time.monotonic()


def test_a_command_is_answered_at_once_and_the_rate_stays(client, process):
    """The answer comes long before its tick, the ticks after it when they are due."""
    node, waits = process[1], []
    first, began = next_state(client, node)
    for k in range(10):
        _, came = next_state(client, node)
        client.spin(0.02)
        sent = time.monotonic()
        node.command(name=["hinge"], effort=[float(k + 1)])
        state, answered = next_state(client, node)
        assert list(state.effort) == [k + 1.0]
        waits.append(answered - sent)
        early = came + PERIOD - answered
    # Without it they would wait PERIOD - 0.02 s.
    assert statistics.median(waits) < 0.25 * PERIOD, waits
    assert early > 0.0
    last, ended = next_state(client, node)
    last, ended = next_state(client, node)  # at its own tick
    stamps = [stamp_ns(s.header.stamp) for s in node.states]
    simulated = 1e-9 * (stamps[-1] - stamp_ns(first.header.stamp))
    assert {b - a for a, b in zip(stamps, stamps[1:])} == {round(PERIOD * 1e9)}
    assert ended - began == pytest.approx(simulated, abs=0.5 * PERIOD)


def test_a_stream_of_commands_lets_no_state_be_more_than_one_period_early(client, process):
    """500 Hz for two seconds: as many states as without them, one more at most."""
    node = process[1]
    next_state(client, node)
    count, end = len(node.states), time.monotonic() + 10.0 * PERIOD
    while time.monotonic() < end:
        node.command(name=["hinge"], effort=[0.1])
        client.spin(0.002)
    assert 9 <= len(node.states) - count <= 12
    assert node.figure("overruns") >= 0


def test_a_command_that_waits_for_its_stamp_brings_no_state_forward(client, process):
    node = process[1]
    state, came = next_state(client, node)
    state, came = next_state(client, node)
    node.command(stamp_ns(state.header.stamp) + 10**9, name=["hinge"], effort=[7.0])
    state, after = next_state(client, node)
    assert after - came > 0.7 * PERIOD and list(state.effort) != [7.0]


def test_the_recording_is_repeated_bit_by_bit(process):
    server, _, path = process
    server.send(signal.SIGINT)
    code, log = server.wait()
    assert code == 0, log
    recording = read_recording(path)
    figures = resimulate(recording)
    assert figures["identical"] == figures["samples"] > 20 and figures["must_be_equal"]
