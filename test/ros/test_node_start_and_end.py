# SPDX-License-Identifier: Apache-2.0
"""Start and end of the node: refused parameters, signals, repeatable recordings, a full disk, suspension, overload."""

import shlex
import signal
import subprocess
import time

import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from mcap.reader import make_reader
from node_process import NodeProcess, figures_of, on_grid, stamp_of
from rcl_interfaces.msg import Log
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from liegroup_core.compiling import compiled
from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.messages.codecs import LogCodec
from liegroup_sim_ros.playback.resimulate import resimulate
from liegroup_sim_ros.recording.motion import RecordedMotion
from liegroup_sim_ros.recording.read import read_recording


@pytest.mark.turn(3)
def test_a_recording_with_wrenches_and_controls_repeats_bit_for_bit(client, scene, tmp_path):
    """Also: three SIGINTs, of which `ros2 launch` sends two, end the node cleanly with a complete file."""
    path, name = tmp_path / "run.mcap", "/recorded"
    parameters = {"scene": scene, "record": path, "publish_rate": 200.0, "method": "rkmk4"}
    with NodeProcess(parameters, remap=[f"__node:={name[1:]}"]) as process:
        push = client.pusher(name)
        seen = client.listen(f"{name}/cube/pose", PoseStamped)
        client.until(lambda: len(seen) > 20)
        push("cube", torque=(0.3, -0.2, 0.1), force=(1.0, 2.0, -0.7))
        push("nobody", force=(1.0, 0.0, 0.0))
        client.pass_time(seen, 0.25)
        client.command(f"{name}/pause")
        push("puck", force=(0.1, 0.2, 0.3), torque=(0.01, 0.02, -0.03))
        assert client.set(name, step_count=13).successful
        client.command(f"{name}/step")
        client.command(f"{name}/resume")
        push("puck", torque=(0.2, 0.1, 0.0))
        client.pass_time(seen, 0.05)
        client.until_stamp(client.command(f"{name}/reset"), seen)
        push("cube", torque=(0.3, 0.2, 0.1), force=(0.0, 0.0, 1.0))
        client.pass_time(seen, 0.3)
        for _ in range(2):
            process.send(signal.SIGINT)
            time.sleep(0.02)  # the next one comes during the clean-up
        process.end()
    recording = read_recording(path)
    assert recording.complete and recording.lost == {}
    names = [event.name for event in recording.events if event.name != "slow"]  # on a busy machine
    assert names == ["start", "pause", "step", "resume", "reset", "stop"]
    assert recording.settings["topics"]["pose"] == {"puck": f"{name}/puck/pose", "cube": f"{name}/cube/pose"}
    assert len(recording.inputs) >= 3 and recording.pacing["ticks"] > 0
    samples = recording.pose["cube"].stamp_ns
    assert (np.diff(samples) > 0).all()
    figures = resimulate(recording)
    assert figures["identical"] == figures["samples"] > 100 and figures["must_be_equal"]
    # What was heard is what was recorded.
    heard = {stamp_of(m): m.pose.position.x for m in seen}
    kept = dict(zip(samples.tolist(), recording.pose["cube"].position[:, 0]))
    assert len(heard) > 50 and heard.items() <= kept.items()


@pytest.mark.turn(3)
def test_a_signal_ends_the_node_and_completes_its_file(client, scene, tmp_path):
    """SIGTERM, and others in other tests; with quality of service that is set by parameters."""
    path, name = tmp_path / "run.mcap", "/ended"
    qos = {
        f"qos_overrides.{name}/wrench.subscription.reliability": "best_effort",
        f"qos_overrides.{name}/cube/pose.publisher.reliability": "best_effort",
        f"qos_overrides.{name}/puck/pose.publisher.depth": 25,
    }
    parameters = {"scene": scene, "record": path, "real_time_factor": 0.0, **qos}
    with NodeProcess(parameters, remap=[f"__node:={name[1:]}"]) as process:
        seen = client.listen(f"{name}/puck/pose", PoseStamped, 1)
        client.until(lambda: seen)
        (wrench,) = client.until(lambda: client.node.get_subscriptions_info_by_topic(f"{name}/wrench"))
        (cube,) = client.until(lambda: client.node.get_publishers_info_by_topic(f"{name}/cube/pose"))
        for endpoint in (wrench, cube):
            assert endpoint.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
        process.end(signal.SIGTERM)
    recording = read_recording(path)
    assert recording.complete and recording.events[-1].name == "stop"
    with open(path, "rb") as stream:
        offered = {
            channel.topic: yaml.safe_load(channel.metadata["offered_qos_profiles"])[0]
            for channel in make_reader(stream).get_summary().channels.values()
        }
    assert offered[f"{name}/cube/pose"]["reliability"] == "best_effort"
    assert offered[f"{name}/puck/pose"]["depth"] == 25
    assert recording.settings["parameters"]["real_time_factor"] == 0.0 < recording.pacing["real_time_factor"]


@pytest.mark.skipif(not compiled(), reason="nothing is compiled")
@pytest.mark.turn(3)
def test_a_signal_during_compilation_ends_the_node(scene, tmp_path):
    path = tmp_path / "run.mcap"
    with NodeProcess({"scene": scene, "record": path}, env={"LIEGROUP_CACHE_DIR": str(tmp_path)}) as process:
        for line in process.process.stderr:
            if "compiling" in line:
                break
        process.end(signal.SIGTERM)
    assert not path.exists()


@pytest.mark.turn(3)
def test_two_nodes_in_two_namespaces(client, scene):
    both = [
        NodeProcess({"scene": scene, "clock_rate": 0.0, "world_frame": f"map_{ns}"}, remap=[f"__ns:=/{ns}"])
        for ns in ("a", "b")
    ]
    with both[0], both[1]:
        heard = {ns: client.listen(f"/{ns}/sim_node/puck/pose", PoseStamped) for ns in "ab"}
        client.until(lambda: heard["a"] and heard["b"])
        for ns in "ab":
            assert {m.header.frame_id for m in heard[ns]} == {f"map_{ns}"}
        assert client.call("/a/sim_node/pause").success
        client.pass_time(heard["b"], 0.3)
        count = len(heard["a"])
        client.pass_time(heard["b"], 0.3)
        assert len(heard["a"]) == count
        for process in both:
            process.send(signal.SIGINT)
        assert [process.wait()[0] for process in both] == [0, 0]


@pytest.mark.turn(3)
def test_rates_and_accuracy_change_while_the_node_runs_and_its_recording_repeats(client, tmp_path):
    path = tmp_path / "run.mcap"
    other = "another node has it as std_msgs/msg/String, this one as geometry_msgs/msg/WrenchStamped"
    with NodeProcess({"scene": "double_pendulum", "joint_state_rate": 0.0, "record": path}) as process:
        markers = client.listen("/sim_node/markers", MarkerArray, QoSProfile(depth=10))
        joints = client.listen("/sim_node/joint_states", JointState)
        clock = client.listen("/clock", Clock)
        poses = client.listen("/sim_node/upper/pose", PoseStamped)
        logged = client.listen("/rosout", Log)
        client.node.create_publisher(String, "/sim_node/wrench", 1)
        client.until(lambda: len(clock) > 20 and len(markers) > 4)
        assert on_grid([stamp_of(message) for message in markers], 50_000_000) and not joints  # 20 Hz by default
        assert client.set("/sim_node", joint_state_rate=30.0, marker_rate=50.0).successful
        client.until(lambda: len(joints) > 5 and stamp_of(markers[-1]) - stamp_of(markers[-2]) == 20_000_000)
        assert client.set("/sim_node", clock_rate=0.0, marker_rate=0.0, joint_state_rate=0.0).successful
        client.pass_time(poses, 0.3)
        seen = len(markers), len(joints), len(clock)
        client.pass_time(poses, 0.3)
        assert (len(markers), len(joints), len(clock)) == seen
        assert client.set("/sim_node", accuracy=1.25e-7).successful
        refused = client.set("/sim_node", publish_rate=50.0).reason
        assert refused == "parameter publish_rate: cannot change while the node records: start with it"
        client.until(lambda: any(other in message.msg for message in logged), "the warning of the other type")
        errors = process.end()
    assert errors.count(other) == 1
    recording = read_recording(path)
    assert [accuracy for _, accuracy in RecordedMotion(recording).all[0].accuracies] == [1.25e-7]
    assert main(["replay", str(path), "--resimulate"]) == 0


PERIOD_NS = 10_000_000
UNRECORDED = 1  # exit code
# A disk of 300 kB in a mount namespace of its own; then the node, with the arguments behind.
SMALL_DISK = 'mount -t tmpfs -o size=300k tmpfs {0} && exec "$@"'


def has_namespaces():
    return subprocess.run(["unshare", "-rm", "true"], capture_output=True).returncode == 0


def figures(messages):
    return figures_of(messages[-1])


@pytest.mark.skipif(not has_namespaces(), reason="no mount namespaces for users here")
@pytest.mark.turn(3)
def test_a_full_disk_ends_the_recording_with_an_error_but_not_the_simulation(client, scene, tmp_path):
    script = SMALL_DISK.format(shlex.quote(str(tmp_path)))
    diagnostics = client.listen("/diagnostics", DiagnosticArray)
    poses = client.listen("/filling/puck/pose", PoseStamped)
    with NodeProcess(
        {"scene": scene, "record": tmp_path / "run.mcap", "publish_rate": 1000.0},
        remap=["__node:=filling"],
        under=("unshare", "-rm", "sh", "-c", script, "sh"),
    ) as process:
        client.until(lambda: diagnostics and figures(diagnostics).get("recorder_failure"), "a full disk")
        status = diagnostics[-1].status[0]
        assert status.level == DiagnosticStatus.ERROR and "No space left" in status.message
        count, lost = len(poses), int(figures(diagnostics)["recorder_lost"])
        assert figures(diagnostics)["state"] == "running" and lost > 0
        client.until(lambda: len(poses) > count + 500)
        client.until(lambda: int(figures(diagnostics)["recorder_lost"]) > lost)
        errors = process.end(signal.SIGTERM, UNRECORDED)
        said = [line for line in errors.splitlines() if "No space left" in line]
        assert len(said) == 1 and said[0].startswith("[ERROR]")


@pytest.mark.turn(3)
def test_a_removed_recording_is_an_error_an_event_and_an_exit_code(client, scene, tmp_path):
    events = client.events("/emptied")
    log = tmp_path / "run.mcap"
    with NodeProcess(
        {"scene": scene, "record": log, "record_flush_interval": 0.2}, remap=["__node:=emptied"]
    ) as process:
        client.until(lambda: events)
        log.unlink()
        client.until(lambda: [m for m in events if m.name == "unrecorded"])
        (event,) = (m for m in events if m.name == "unrecorded")
        assert "the file was removed" in event.msg and event.level == LogCodec.ERROR
        errors = process.end(signal.SIGTERM, UNRECORDED)
        said = [line for line in errors.splitlines() if "the file was removed" in line]
        assert len(said) == 1 and said[0].startswith("[ERROR]") and not log.exists()


@pytest.mark.turn(3)
def test_a_suspended_node_continues_without_a_burst_and_an_overloaded_one_reports_it(client, scene):
    poses = client.listen("/held/puck/pose", PoseStamped)
    diagnostics = client.listen("/diagnostics", DiagnosticArray)
    with NodeProcess({"scene": scene}, remap=["__node:=held"]) as process:
        client.until(lambda: len(poses) > 20)
        process.send(signal.SIGSTOP)
        time.sleep(1.0)  # or longer: at most 0.1 s is caught up with
        for _ in range(20):
            client.turn()  # what is under way comes
        before, start = stamp_of(poses[-1]), time.monotonic()
        process.send(signal.SIGCONT)
        client.until(lambda: diagnostics and int(figures(diagnostics)["reanchored"]) >= 1)
        simulated, elapsed = (stamp_of(poses[-1]) - before) * 1e-9, time.monotonic() - start
        assert simulated < elapsed + 0.5
        assert on_grid([stamp_of(m) for m in poses], PERIOD_NS)
        assert client.set("/held", real_time_factor=1e6).successful
        client.until(lambda: all(int(figures(diagnostics)[name]) > 1 for name in ("overruns", "reanchored")))
        client.until(lambda: diagnostics[-1].status[0].level == DiagnosticStatus.WARN)
        assert "too slow: real-time factor" in diagnostics[-1].status[0].message
        assert client.set("/held", real_time_factor=1.0).successful
        client.until(lambda: diagnostics[-1].status[0].level == DiagnosticStatus.OK)
        process.end(signal.SIGTERM)
