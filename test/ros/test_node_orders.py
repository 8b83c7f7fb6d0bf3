# SPDX-License-Identifier: Apache-2.0
"""Concurrent commands in random order: each is answered, and every recording repeats."""

import random

import numpy as np
import pytest
from commanded import Commanded
from diagnostic_msgs.msg import DiagnosticArray
from node_process import NodeProcess, on_grid, stamp_ns, stamp_of
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from scene_files import text_of
from std_srvs.srv import Trigger

from liegroup_sim_ros.playback.resimulate import resimulate
from liegroup_sim_ros.recording.read import read_recording

NODE = "/ordered"
COMMANDS = ["pause", "resume", "step", "reset", "reload"]
REFUSALS = (
    "the simulation is running: call ~/pause first",
    "call ~/reset first",
    "the previous scene continues: no_such_scene",
    "stopped after",
    "another scene is being loaded",
)
# Of each, some are taken and some are not: those of REFUSED.
VALUES = {
    "real_time_factor": [0.0, 0.5, 3.0, -1.0],
    "step_count": [1, 7, 300, 0],
    "wrench_hold": ["one_step", "timeout", "until_replaced", "for_ever"],
    "scene": ["heavy_top", "double_pendulum", "no_such_scene"],
    "method": ["rkmk2"],
}
REFUSED = {("real_time_factor", -1.0), ("step_count", 0), ("wrench_hold", "for_ever"), ("method", "rkmk2")}


@pytest.mark.turn(3)
def test_random_commands_are_answered_and_all_recording_parts_repeat(client, tmp_path):
    rng = random.Random(5)
    clock = client.listen("/clock", Clock)
    with NodeProcess({"scene": "heavy_top", "record": tmp_path / "run.mcap"}, remap=[f"__node:={NODE[1:]}"]) as process:
        push = client.pusher(NODE, "wrench/persistent")
        services = {name: client.node.create_client(Trigger, f"{NODE}/{name}") for name in COMMANDS}
        parameters = client.node.create_client(SetParameters, f"{NODE}/set_parameters")
        client.until(lambda: all(each.service_is_ready() for each in (parameters, *services.values())))
        for _ in range(60):
            asked = []
            for _ in range(3):
                if rng.random() < 0.3:
                    name = rng.choice(list(VALUES))
                    value = rng.choice(VALUES[name])
                    request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
                    asked.append(((name, value), parameters.call_async(request)))
                else:
                    asked.append((None, services[rng.choice(COMMANDS)].call_async(Trigger.Request())))
            # The last one is finite, but no motion under it is: a fault.
            push(
                rng.choice(["top", "upper", "lower"]),
                force=(rng.choice([1.0, 50.0, 0.0]), 0.0, 0.0),
                torque=(0.0, rng.choice([0.0, 0.0, 0.0, 1e306]), 0.0),
            )
            # A reload may have to compile.
            client.until(lambda: all(future.done() for _, future in asked), "all answers")
            for given, future in asked:
                if given is None:
                    answer = future.result()
                    assert answer.success or any(text in answer.message for text in REFUSALS)
                else:
                    (result,) = future.result().results
                    assert result.successful == (given not in REFUSED), (given, result)
        process.end()
    assert (np.diff([stamp_ns(message.clock) for message in clock]) >= 0).all()
    parts = sorted(tmp_path.glob("*.mcap"), key=lambda path: (len(path.stem), path.stem))
    assert len(parts) > 10
    names, last = set(), -1
    for part in parts:
        recording = read_recording(part)
        assert recording.complete and recording.lost == {}
        names |= {event.name for event in recording.events}
        stamps = recording.pose[recording.bodies[0]].stamp_ns
        assert last < stamps[0] and (np.diff(stamps) > 0).all()
        last = stamps[-1]
        same = resimulate(recording)
        assert same["identical"] == same["samples"] >= 1, part
    # How far the motion gets in real time, and so what is said of its accuracy, depends on the machine.
    assert names - {"fault", "inaccurate", "unpredictable", "slow"} == {
        "start",
        "pause",
        "resume",
        "step",
        "reset",
        "speed",
        "stop",
    }


# A running node answers a command by its next state at once, at most one period early; its recording repeats.
#
# The period is so long that no other state comes while a test waits.


NODE_ANSWERS_NODE = "/answering"
PERIOD = 1000.0  # s, of the states
SCENE = text_of("bench_node_answers.yaml")


@pytest.mark.turn(3)
def test_a_command_is_answered_at_once_and_states_stay_on_their_grid(client, tmp_path):
    (tmp_path / "bench.yaml").write_text(SCENE)
    rate, period = 1.0 / PERIOD, round(PERIOD * 1e9)
    parameters = {
        "scene": tmp_path / "bench.yaml",
        "method": "rkmk4",
        "step": 1.0,
        "publish_rate": rate,
        "joint_state_rate": rate,
        "state_rate": rate,
        "clock_rate": 0.0,
        "marker_rate": 0.0,
        "record": tmp_path / "run.mcap",
    }

    def stands_at(stamp):
        """Whether no state has been brought forward; a diagnostic comes after what was commanded before."""
        count = len(diagnostics)
        client.until(lambda: len(diagnostics) > count + 1)
        return stamp_of(diagnostics[-1]) == stamp == node.now()

    with NodeProcess(parameters, remap=[f"__node:={NODE_ANSWERS_NODE[1:]}"]) as process:
        diagnostics = client.listen("/diagnostics", DiagnosticArray)
        node = Commanded(client, NODE_ANSWERS_NODE)
        begin = client.command(f"{NODE_ANSWERS_NODE}/reset")  # a late subscriber may have missed the start
        client.until(lambda: node.states and node.now() == begin, "the state of the reset")
        # A command that waits for its stamp in the second period brings no state forward.
        node.command(begin + period + period // 2, name=["hinge"], effort=[7e-6])
        assert stands_at(begin)
        node.command(name=["hinge"], effort=[1e-6])
        client.until(lambda: node.now() == begin + period, "the answer")
        assert list(node.states[-1].effort) == [1e-6]
        # The next one would be two periods early.
        node.command(name=["hinge"], effort=[2e-6])
        assert stands_at(begin + period)
        assert client.set(NODE_ANSWERS_NODE, real_time_factor=0.0).successful
        client.until(lambda: node.now() > begin + 5 * period)
        process.end()
    assert on_grid([stamp_of(state) for state in node.states if stamp_of(state) >= begin], period)
    figures = resimulate(read_recording(tmp_path / "run.mcap"))
    assert figures["identical"] == figures["samples"] > 5 and figures["must_be_equal"]
