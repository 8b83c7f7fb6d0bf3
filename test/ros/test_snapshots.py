# SPDX-License-Identifier: Apache-2.0
"""~/save_snapshot and ~/restore_snapshot of a running node, over DDS, and in its recording."""

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TwistStamped
from node_process import NodeProcess, stamp_in, stamp_of

from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.recording.read import read_recording

NODE = "/kept"
STEP_NS = 10_000_000


def numbers(message):
    """All numbers of a pose or a twist."""
    parts = (
        (message.pose.position, message.pose.orientation)
        if hasattr(message, "pose")
        else (message.twist.linear, message.twist.angular)
    )
    return [getattr(part, name) for part in parts for name in "xyzw" if hasattr(part, name)]


@pytest.mark.turn(3)
def test_a_restored_snapshot_continues_bit_for_bit_and_is_recorded(client, scene, tmp_path, capsys):
    name = NODE
    poses = client.listen(f"{name}/cube/pose", PoseStamped)
    twists = client.listen(f"{name}/puck/twist", TwistStamped)
    given = client.given(name)
    events = client.events(name)
    figures = client.listen("/diagnostics", DiagnosticArray)
    parameters = {"scene": scene, "start_paused": True, "record": tmp_path / "run.mcap", "accuracy": 1e-6}
    with NodeProcess(parameters, [f"__node:={name[1:]}"]) as process:

        def call(service):
            response = client.call(f"{name}/{service}")
            assert response.success, response.message
            return response.message

        def step(count):
            assert client.set(name, step_count=count).successful
            call("step")

        def branch(start):
            """[{ns after the start: numbers}] of the poses and twists that steps publish."""
            step(40)
            end = start + 40 * STEP_NS
            client.until_stamp(end, poses, twists)
            found = [
                {stamp_of(m) - start: numbers(m) for m in kept if start < stamp_of(m) <= end}
                for kept in (poses, twists)
            ]
            assert min(map(len, found)) > 20  # a burst of messages may have gaps
            return found

        def same(one, other):
            """Whether two branches agree at all stamps that both have, of which the last is one."""
            return all(a[k] == b[k] for a, b in zip(one, other) for k in a.keys() & b.keys())

        def held():
            """Wrenches that act or wait."""
            shown = {p.key: p.value for m in figures[-1:] for p in m.status[0].values}
            return int(shown.get("wrenches_held", 0))

        client.call(f"{name}/step")  # waits for the node
        client.until(lambda: client.call(f"{name}/step").success and poses and twists)
        push = client.pusher(name, "wrench/persistent")
        timed = client.pusher(name)
        assert client.set(name, wrench_timeout=0.33).successful
        push("puck", force=(0.3, 0.0, 0.0))
        timed("cube", torque=(0.0, 0.2, 0.0), stamp_ns=123_456_789)
        client.until(lambda: int(client.call(f"{name}/step").success) and len(given) > 1)
        step(17)
        refused = client.call(f"{name}/restore_snapshot")
        assert not refused.success
        assert "unknown snapshot 'snapshot'; saved are: none" in refused.message
        assert client.set(name, snapshot="first").successful
        answer = call("save_snapshot")
        assert answer.startswith("saved 'first' at ")
        start = stamp_in(answer)
        expected = branch(start)
        for force in (7.0, None):
            last = stamp_of(poses[-1])
            given.present = None
            answer = call("restore_snapshot")
            assert answer.startswith("snapshot 'first' at ")
            start = stamp_in(answer)
            assert start == last + STEP_NS
            # What acts is published again.
            client.until(lambda: given.present is not None and len(given.present) > 1)
            assert ("puck", (0.0, 0.0, 0.0, 0.3, 0.0, 0.0)) in [order[1:3] for order in given.present]
            assert same(branch(start), expected)
            if force:  # another branch in between
                other = client.pusher(name, "puck/wrench")
                start = stamp_in(call("restore_snapshot"))
                other("puck", force=(force, 0.0, 0.0))
                client.until(lambda: held() > 2)
                assert not same(branch(start), expected)
        assert client.set(name, snapshot="other").successful
        refused = client.call(f"{name}/restore_snapshot")
        assert not refused.success and "saved are: first" in refused.message
        # While running, too.
        call("resume")
        call("save_snapshot")
        call("restore_snapshot")
        client.until(lambda: events[-1].name == "state")
        assert events[-1].msg.startswith("snapshot other, step ")
        process.end()
    recording = read_recording(tmp_path / "run.mcap")
    assert sum(event.name == "state" for event in recording.events) == 4
    assert main(["replay", str(tmp_path / "run.mcap"), "--resimulate"]) == 0
    assert ": bit-identical in" in capsys.readouterr().out
