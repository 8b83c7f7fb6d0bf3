# SPDX-License-Identifier: Apache-2.0
"""A running node with a full disk, after a suspension, and under overload."""

import shlex
import signal
import subprocess
import time

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from node_process import NodeProcess, figures_of, on_grid, stamp_of

from liegroup_sim_ros.messages.codecs import LogCodec

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
