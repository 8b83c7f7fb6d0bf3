# SPDX-License-Identifier: Apache-2.0
"""Recordings of the node with all topics, decoded by independent readers."""

import importlib
import importlib.util
from types import SimpleNamespace

import pytest
import small_mcap
from diagnostic_msgs.msg import DiagnosticArray
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from node_process import NodeProcess
from pybag.mcap_reader import McapFileReader
from rclpy.serialization import deserialize_message
from rosbags.highlevel import AnyReader

from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.messages import samples
from liegroup_sim_ros.recording.write import Recorder

# tf2_msgs is not on PyPI: /tf is recorded where it is installed.
OPTIONAL = ["odometry", "pose_with_covariance", "velocity"]  # of two bodies
OPTIONAL += ["joint_state", "marker", "state"]
OPTIONAL += ["tf"] if importlib.util.find_spec("tf2_msgs") else []


@pytest.fixture(scope="module")
def log(client, tmp_path_factory):
    """Recording of a node with all topics, applied wrenches, a pause and frequent flushes."""
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    parameters = {f"{name}_rate": 50.0 for name in OPTIONAL}
    parameters |= {"scene": "four_bar", "record": path, "record_flush_interval": 0.2}
    parameters |= {"estimate": True, "body_topics": "crank,coupler"}
    sizes = set()

    def flushed():
        """Whether the file has grown several times."""
        sizes.add(path.stat().st_size)
        return len(sizes) > 8

    with NodeProcess(parameters, remap=["__node:=all_topics"]) as node:
        events = client.events("/all_topics")
        diagnostics = client.listen("/diagnostics", DiagnosticArray)
        client.until(lambda: events)
        push = client.pusher("/all_topics")
        push("coupler", force=(1.0, 0.0, 0.0))
        client.until(flushed)
        assert client.call("/all_topics/pause").success
        count = len(diagnostics)
        client.until(lambda: len(diagnostics) > count)
        node.end()
    return path


@pytest.fixture(scope="module")
def written(log):
    """{topic: [(stamp, message)]} as rclpy deserializes them."""
    found = {}
    with open(log, "rb") as stream:
        for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            package, _, name = schema.name.split("/")
            kind = getattr(importlib.import_module(f"{package}.msg"), name)
            found.setdefault(channel.topic, []).append((message.log_time, deserialize_message(message.data, kind)))
    return found


def by_mcap_ros2(path):
    with open(path, "rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            yield channel.topic, message.log_time, decoded


def by_rosbags(path):
    with AnyReader([path]) as reader:
        for connection, stamp, data in reader.messages():
            yield connection.topic, stamp, reader.deserialize(data, connection.msgtype)


def by_pybag(path):
    with McapFileReader.from_file(path, enable_crc_check=True) as reader:
        for message in reader.messages(reader.get_topics()):
            yield message.topic, message.log_time, message.data


def by_small_mcap(path):
    """It has no CDR decoder and returns memory views; the mcap_ros2 decoder needs bytes."""

    class Factory:
        def decoder_for(self, encoding, schema):
            decode = DecoderFactory().decoder_for(encoding, schema)
            return lambda data: decode(bytes(data))

    with open(path, "rb") as stream:
        for found in small_mcap.read_message_decoded(stream, decoder_factories=[Factory()], validate_crc=True):
            yield found.channel.topic, found.message.log_time, found.decoded_message


READERS = [by_mcap_ros2, by_rosbags, by_pybag, by_small_mcap]


def same(one, other):
    """Whether an rclpy message and that of another reader have equal fields."""
    if hasattr(one, "get_fields_and_field_types"):
        return all(same(getattr(one, name), getattr(other, name)) for name in one.get_fields_and_field_types())
    if isinstance(one, bytes):  # a byte; some readers make a number of it
        return one in (other, bytes([other]) if isinstance(other, int) else None)
    if hasattr(one, "__len__") and not isinstance(one, str):
        return len(one) == len(other) and all(map(same, one, other))
    return one == other or one != one and other != other  # NaN


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.turn(3)
def test_every_message_of_every_topic_is_decoded(reader, log, written):
    assert len(written) == 5 + 2 + 2 * 2 + 3 * 2 + 3 + ("tf" in OPTIONAL)
    found = {}
    for topic, stamp, message in reader(log):
        found.setdefault(topic, []).append((stamp, message))
    assert {topic: len(rows) for topic, rows in found.items()} == {topic: len(rows) for topic, rows in written.items()}
    for topic, rows in written.items():
        for (stamp, message), (their_stamp, theirs) in zip(rows, found[topic]):
            assert stamp == their_stamp and same(message, theirs), topic


@pytest.mark.parametrize("reader", READERS)
def test_joint_states_of_one_joint_and_two_are_decoded(reader, tmp_path):
    path = tmp_path / "run.mcap"
    with Recorder(path) as recorder:
        for count in (1, 2):
            names = [f"joint_{k}" for k in range(count)]
            layout = SimpleNamespace(coordinates=SimpleNamespace(names=names), scene=SimpleNamespace(robot=None))
            ((_, kind, encode),) = samples.joint_states(layout, "world")
            state = SimpleNamespace(joint_coordinates={name: (1.0, 2.0) for name in names}, all_efforts={})
            channel = recorder.add_channel(f"/joints_{count}", kind)
            recorder.write(channel, count, encode(count, state))
    for count, (_, _, message) in enumerate(reader(path), 1):
        assert list(message.name) == [f"joint_{k}" for k in range(count)]
        assert list(message.position) == [1.0] * count
        assert list(message.velocity) == [2.0] * count
        assert len(message.effort) == count
    assert count == 2


def overlaps(path):
    """Time in ns from the end of each chunk to the start of the next one."""
    with open(path, "rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    chunks.sort(key=lambda chunk: chunk.chunk_start_offset)
    return [after.message_start_time - before.message_end_time for before, after in zip(chunks, chunks[1:])]


def test_chunks_of_the_node_do_not_overlap_in_time(log):
    """They may share one stamp: while paused, all events have the same stamp."""
    gaps = overlaps(log)
    assert len(gaps) >= 4 and min(gaps) >= 0
    assert sum(gap > 0 for gap in gaps) >= 4


def test_chunks_of_run_do_not_overlap_in_time(tmp_path, capfd):
    path = tmp_path / "run.mcap"
    assert main(["run", "four_bar", "--step", "1e-3", "--duration", "2", "--out", str(path)]) == 0
    *gaps, last = overlaps(path)
    assert len(gaps) > 7 and min(gaps) > 0
    assert last >= 0  # a checkpoint at the last sample ends its chunk before the event `stop`
