# SPDX-License-Identifier: Apache-2.0
"""A running node with a full disk, after a suspension, and under overload."""

import shlex
import signal
import subprocess
import time

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from node_process import COMPILING, NodeProcess, stamp_ns
from rcl_interfaces.msg import Log
from rclpy.qos import DurabilityPolicy, QoSProfile

from liegroup_sim_ros.messages.codecs import LogCodec

PERIOD_NS = 10_000_000
UNRECORDED = 1  # exit code
# A disk of 300 kB in a mount namespace of its own; then the node, with the arguments behind.
SMALL_DISK = 'mount -t tmpfs -o size=300k tmpfs {0} && exec "$@"'


def has_namespaces():
    return subprocess.run(["unshare", "-rm", "true"], capture_output=True).returncode == 0


def figures(messages):
    return {pair.key: pair.value for pair in messages[-1].status[0].values}


def ended_well(process, expected=0):
    process.send(signal.SIGTERM)
    code, errors = process.wait()
    assert code == expected and "Traceback" not in errors, errors
    return errors


@pytest.mark.skipif(not has_namespaces(), reason="no mount namespaces for users here")
def test_a_full_disk_ends_the_recording_with_an_error_but_not_the_simulation(client, scene, tmp_path):
    script = SMALL_DISK.format(shlex.quote(str(tmp_path)))
    diagnostics = client.listen("/diagnostics", DiagnosticArray)
    poses = client.listen("/filling/puck/pose", PoseStamped)
    with NodeProcess(
        {"scene": scene, "record": tmp_path / "run.mcap", "publish_rate": 1000.0},
        remap=["__node:=filling"],
        under=("unshare", "-rm", "sh", "-c", script, "sh"),
    ) as process:
        client.until(lambda: diagnostics and figures(diagnostics).get("recorder_failure"), COMPILING, "a full disk")
        status = diagnostics[-1].status[0]
        assert status.level == DiagnosticStatus.ERROR and "No space left" in status.message
        count, lost = len(poses), int(figures(diagnostics)["recorder_lost"])
        assert figures(diagnostics)["state"] == "running" and lost > 0
        client.until(lambda: len(poses) > count + 500)
        client.until(lambda: int(figures(diagnostics)["recorder_lost"]) > lost)
        errors = ended_well(process, UNRECORDED)
        said = [line for line in errors.splitlines() if "No space left" in line]
        assert len(said) == 1 and said[0].startswith("[ERROR]")


def test_a_removed_recording_is_an_error_an_event_and_an_exit_code(client, scene, tmp_path):
    events = client.listen("/emptied/events", Log, QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    log = tmp_path / "run.mcap"
    with NodeProcess(
        {"scene": scene, "record": log, "record_flush_interval": 0.2}, remap=["__node:=emptied"]
    ) as process:
        client.until(lambda: events, COMPILING)
        log.unlink()
        client.until(lambda: [m for m in events if m.name == "unrecorded"])
        (event,) = (m for m in events if m.name == "unrecorded")
        assert "the file was removed" in event.msg and event.level == LogCodec.ERROR
        errors = ended_well(process, UNRECORDED)
        said = [line for line in errors.splitlines() if "the file was removed" in line]
        assert len(said) == 1 and said[0].startswith("[ERROR]") and not log.exists()


def test_a_suspended_node_continues_without_a_burst(client, scene):
    poses = client.listen("/held/puck/pose", PoseStamped)
    diagnostics = client.listen("/diagnostics", DiagnosticArray)
    with NodeProcess({"scene": scene}, remap=["__node:=held"]) as process:
        client.until(lambda: len(poses) > 20, COMPILING)
        process.send(signal.SIGSTOP)
        client.spin(1.0)
        before = stamp_ns(poses[-1].header.stamp)
        start = time.monotonic()
        process.send(signal.SIGCONT)
        client.spin(0.5)
        simulated = (stamp_ns(poses[-1].header.stamp) - before) * 1e-9
        elapsed = time.monotonic() - start
        # At most 0.1 s is caught up with; a period under way and one for the transport.
        assert simulated < elapsed + 0.1 + 2e-9 * PERIOD_NS
        client.until(lambda: int(figures(diagnostics)["reanchored"]) >= 1)
        stamps = [stamp_ns(m.header.stamp) for m in poses]
        assert {b - a for a, b in zip(stamps, stamps[1:])} == {PERIOD_NS}  # nothing is left out
        ended_well(process)


def test_an_overloaded_node_reports_it(client, scene):
    diagnostics = client.listen("/diagnostics", DiagnosticArray)
    with NodeProcess({"scene": scene, "real_time_factor": 1e6}, remap=["__node:=hurried"]) as process:
        client.until(lambda: diagnostics and int(figures(diagnostics)["reanchored"]) > 1, COMPILING, "diagnostics")
        client.until(lambda: diagnostics[-1].status[0].level == DiagnosticStatus.WARN)
        assert "too slow: real-time factor" in diagnostics[-1].status[0].message
        assert int(figures(diagnostics)["overruns"]) > 1
        assert client.set("/hurried", real_time_factor=1.0).successful
        client.until(lambda: diagnostics[-1].status[0].level == DiagnosticStatus.OK)
        ended_well(process)
