# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim replay` in a separate process, received over DDS."""

import signal
import time

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from made_run import PAIR, record
from node_process import PATIENCE, PUSH, python, stamp_of
from rosgraph_msgs.msg import Clock

from liegroup_core.scene.load import scene_from_text
from liegroup_sim_ros.recording.read import read_recording

STEPS = 2000  # 4 s of simulated time, 201 samples


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return record(
        tmp_path_factory.mktemp("log") / "run.mcap",
        scene_from_text(PAIR),
        STEPS,
        pushes=[(20, ("left", (0, 0, 1.0, 0, 0, 0))), (30, ("left", (0,) * 6))],
    )


class Replay:
    """`liegroup_sim replay` process and the messages received from it."""

    def __init__(self, client, log, *options):
        self.client = client
        self.poses = client.listen("/sim_node/left/pose", PoseStamped)
        self.clock = client.listen("/clock", Clock)
        self.events = client.events("/sim_node")
        # SIGINT ignored, as a shell starts a process in the background.
        under = ("sh", "-c", "trap '' INT; exec \"$@\"", "sh")
        self.process = python(PUSH, "replay", log, "--start-paused", *options, under=under)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.process.poll() is None:
            self.process.kill()
        self.process.communicate()

    def call(self, name):
        return self.client.call(f"/replay/{name}").message

    def stamps(self):
        return [stamp_of(message) for message in self.poses]

    def heard(self):
        """Both ends know of each other."""
        # It knows the client of the service, so also the subscriptions made before.
        self.client.call("/replay/pause", again=3.0)
        self.client.until(lambda: self.client.node.count_publishers("/sim_node/left/pose"), what="discovery")


@pytest.mark.turn(3)
def test_every_message_is_published_with_its_stamp_and_clock(client, log):
    """At four times the speed; afterwards the process exits by itself."""
    recording = read_recording(log)
    with Replay(client, log, "--rate", "4") as replay:
        replay.heard()
        assert replay.stamps() == []
        assert replay.call("resume").startswith("playing at 0 s")
        client.until(lambda: replay.process.poll() is not None, "the end of the replay")
        out, err = replay.process.communicate()
        assert (replay.process.returncode, err) == (0, "")
        total = sum(recording.topics.values())
        assert f"{total} messages of 7 topics published" in out
        pose = recording.pose["left"]
        client.until_stamp(pose.stamp_ns[-1], replay.poses, replay.clock)
        # A busy machine may lose some on their way.
        rows = np.searchsorted(pose.stamp_ns, replay.stamps())
        assert replay.stamps() == pose.stamp_ns[rows].tolist() and len(rows) > 50 and (np.diff(rows) > 0).all()
        numbers = [[m.pose.position.x, m.pose.orientation.w] for m in replay.poses]
        assert np.array_equal(numbers, np.stack([pose.position[rows, 0], pose.quaternion[rows, 3]], 1))
        assert [event.name for event in replay.events] == ["start", "stop"]
        # The recording has no clock: one of 100 Hz is made, up to the last message.
        ticks = [stamp_of(message) for message in replay.clock]
        assert ticks == sorted(ticks) and ticks[-1] == pose.stamp_ns[-1]
        assert len(ticks) >= 100


@pytest.mark.turn(3)
def test_seek_step_rate_and_the_end(client, log):
    with Replay(client, log) as replay:
        replay.heard()
        assert client.set("/replay", position=2.0).successful
        replay.call("play_next")
        client.until(replay.stamps, "one sample")
        assert min(replay.stamps()) >= 2 * 10**9
        for wrong in ({"position": 100.0}, {"position": -1.0}, {"rate": float("nan")}):
            assert "must be a number from 0 to" in client.set("/replay", **wrong).reason
        assert client.set("/replay", rate=0.5).successful
        first, start = replay.stamps()[-1], time.monotonic()
        assert replay.call("toggle_paused").endswith("rate 0.5")
        client.until_stamp(first + 4 * 10**8, replay.poses)
        assert time.monotonic() - start > 0.4 / 0.5 - 0.1  # never faster
        replay.call("pause")  # or a busy machine would let it come to its end
        assert client.set("/replay", position=0.0).successful
        replay.call("play_next")
        client.until(lambda: replay.stamps()[-1] < 10**9, "samples of the beginning")
        replay.process.send_signal(signal.SIGINT)
        out, err = replay.process.communicate(timeout=PATIENCE)
        assert replay.process.returncode == 130 and "Traceback" not in err


@pytest.mark.turn(3)
def test_replay_in_a_loop(client, log):
    with Replay(client, log, "--rate", "0", "--loop", "--start", "3.5") as replay:
        replay.heard()
        replay.call("resume")
        client.until(lambda: replay.stamps().count(0) > 1, what="two beginnings")
        replay.process.send_signal(signal.SIGTERM)
        _, err = replay.process.communicate(timeout=PATIENCE)
        assert replay.process.returncode == 130 and "Traceback" not in err
