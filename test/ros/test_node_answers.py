# SPDX-License-Identifier: Apache-2.0
"""A running node answers a command by its next state at once, at most one period early; its recording repeats.

The period is so long that no other state comes while a test waits.
"""

import pytest
from commanded import Commanded
from diagnostic_msgs.msg import DiagnosticArray
from node_process import NodeProcess, on_grid, stamp_of
from scene_files import text_of

from liegroup_sim_ros.playback.resimulate import resimulate
from liegroup_sim_ros.recording.read import read_recording

NODE = "/answering"
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

    with NodeProcess(parameters, remap=[f"__node:={NODE[1:]}"]) as process:
        diagnostics = client.listen("/diagnostics", DiagnosticArray)
        node = Commanded(client, NODE)
        client.call(f"{NODE}/reset")  # a late subscriber has missed the start
        client.until(lambda: node.states)
        begin = node.now()
        # A command that waits for its stamp in the second period brings no state forward.
        node.command(begin + period + period // 2, name=["hinge"], effort=[7e-6])
        assert stands_at(begin)
        node.command(name=["hinge"], effort=[1e-6])
        client.until(lambda: node.now() == begin + period, "the answer")
        assert list(node.states[-1].effort) == [1e-6]
        # The next one would be two periods early.
        node.command(name=["hinge"], effort=[2e-6])
        assert stands_at(begin + period)
        assert client.set(NODE, real_time_factor=0.0).successful
        client.until(lambda: node.now() > begin + 5 * period)
        process.end()
    assert on_grid([stamp_of(state) for state in node.states if stamp_of(state) >= begin], period)
    figures = resimulate(read_recording(tmp_path / "run.mcap"))
    assert figures["identical"] == figures["samples"] > 5 and figures["must_be_equal"]
