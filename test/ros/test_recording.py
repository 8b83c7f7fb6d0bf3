# SPDX-License-Identifier: Apache-2.0
"""Recordings read back by this package and independent readers, and damaged recordings."""

import importlib
import importlib.util
import json
from types import SimpleNamespace

import numpy as np
import pytest
import small_mcap
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from example_run import (
    BODIES,
    END_NS,
    INITIAL,
    PACING,
    PUSH,
    SCENE,
    SETTINGS,
    START_NS,
    TOPICS,
    attachments,
    record_run,
)
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from node_process import NodeProcess
from pybag.mcap_reader import McapFileReader
from rclpy.serialization import deserialize_message
from rosbags.highlevel import AnyReader

from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.messages import samples
from liegroup_sim_ros.messages.codecs import PoseStampedCodec, TwistStampedCodec
from liegroup_sim_ros.recording.read import RecordingError, read_recording
from liegroup_sim_ros.recording.write import Recorder


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    path = tmp_path_factory.mktemp("logs") / "new" / "folder" / "run.mcap"
    return path, record_run(path)


def test_reading_returns_what_was_written(run):
    path, written = run
    recording = read_recording(path)
    assert (recording.scene_text, recording.settings, recording.initial_state, recording.pacing) == (
        SCENE,
        SETTINGS,
        INITIAL,
        PACING,
    )
    assert recording.complete and recording.problem is None and recording.lost == {}
    assert recording.topics == {topic: len(rows) for topic, rows in written.items()}
    assert recording.bodies == BODIES
    for body in BODIES:
        for track, topics in ((recording.pose, TOPICS["pose"]), (recording.twist, TOPICS["twist"])):
            stamps = [stamp for stamp, _ in written[topics[body]]]
            assert track[body].stamp_ns.tolist() == stamps
            assert np.array_equal(track[body].time, np.array(stamps) * 1e-9)
        poses = [PoseStampedCodec.decode_one(data)[2] for _, data in written[TOPICS["pose"][body]]]
        assert np.array_equal(np.hstack(recording.pose[body][1:]), poses)
        twists = [TwistStampedCodec.decode_one(data)[2] for _, data in written[TOPICS["twist"][body]]]
        assert np.array_equal(recording.twist[body].twist, twists)
    (given,) = recording.inputs
    times = {"start_ns": START_NS + PUSH.start_ns, "end_ns": START_NS + PUSH.end_ns}
    assert given == PUSH._replace(**times) and recording.inputs.stamp_ns.tolist() == [END_NS]
    assert recording.events == [(START_NS, "start", "spinning top"), (END_NS, "stop", "done")]
    assert recording.diagnostics == [(END_NS, {"energy": "1.5", "lost": "0"})]


def test_mcap_sees_the_same_bytes_stamps_and_sequences(run):
    path, written = run
    read = {}
    with open(path, "rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        for _, channel, message in reader.iter_messages(log_time_order=False):
            rows = read.setdefault(channel.topic, [])
            rows.append((message.log_time, message.data))
            assert message.publish_time == message.log_time
            assert message.sequence == len(rows)
        assert read == written
        assert {a.name: a.data for a in reader.iter_attachments()} == {
            **{name: data for name, (_, data) in attachments().items()},
            "pacing.json": json.dumps(PACING).encode(),
        }
        assert reader.get_header().profile == "ros2"
        assert {m.name: m.metadata for m in reader.iter_metadata()}["run"] == {"operator": "test"}


def test_three_readers_decode_every_message_to_the_same_values(run):
    path, written = run

    def numbers(message):
        """Stamp, frame and all numbers of a decoded message, in the message's own order."""
        if hasattr(message, "clock"):
            return (message.clock.sec, message.clock.nanosec)
        if hasattr(message, "msg"):
            return (message.stamp.sec, message.stamp.nanosec, message.name, message.msg)
        if hasattr(message, "data"):
            return json.loads(message.data)
        header = (message.header.stamp.sec, message.header.stamp.nanosec, message.header.frame_id)
        if hasattr(message, "status"):
            return header + tuple((pair.key, pair.value) for status in message.status for pair in status.values)
        if hasattr(message, "pose"):
            parts = (message.pose.position, "xyz"), (message.pose.orientation, "xyzw")
        elif hasattr(message, "twist"):
            parts = (message.twist.linear, "xyz"), (message.twist.angular, "xyz")
        else:
            raise AssertionError(message)
        return header + tuple(getattr(part, name) for part, names in parts for name in names)

    by_mcap, by_rosbags = {}, {}
    with open(path, "rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            by_mcap.setdefault(channel.topic, []).append((message.log_time, numbers(decoded)))
    with AnyReader([path]) as reader:
        for connection, stamp_ns, data in reader.messages():
            decoded = numbers(reader.deserialize(data, connection.msgtype))
            by_rosbags.setdefault(connection.topic, []).append((stamp_ns, decoded))
    assert by_mcap == by_rosbags
    assert by_mcap.keys() == written.keys()

    # And ours: the numbers of the fast codecs, put back into the order of the messages.
    recording = read_recording(path)
    for body in BODIES:
        pose, twist = recording.pose[body], recording.twist[body]
        theirs = [row[3:] for _, row in by_mcap[TOPICS["pose"][body]]]
        assert np.array_equal(np.hstack([pose.position, pose.quaternion]), theirs)
        theirs = [row[3:] for _, row in by_mcap[TOPICS["twist"][body]]]
        assert np.array_equal(np.hstack([twist.twist[:, 3:], twist.twist[:, :3]]), theirs)
    ((stamp, given),) = by_mcap[TOPICS["inputs"]]
    assert stamp == END_NS and given == {
        "base_ns": START_NS,
        "all": False,
        "commands": [json.loads(json.dumps(PUSH.as_json()))],
    }


def test_rosbag2_finds_its_metadata_and_indexes(run):
    path, written = run
    with open(path, "rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        bag = yaml.safe_load({m.name: m.metadata for m in reader.iter_metadata()}["rosbag2"]["serialized_metadata"])
    counts = {topic: len(rows) for topic, rows in written.items()}
    statistics = summary.statistics
    assert statistics.message_count == bag["message_count"] == sum(counts.values())
    assert all(chunk.message_index_length > 0 for chunk in summary.chunk_indexes)
    assert (bag["version"], bag["storage_identifier"]) == (9, "mcap")
    assert bag["starting_time"]["nanoseconds_since_epoch"] == statistics.message_start_time == START_NS
    assert bag["duration"]["nanoseconds"] == END_NS - START_NS
    assert statistics.message_end_time == END_NS
    topics = {entry["topic_metadata"]["name"]: entry for entry in bag["topics_with_message_count"]}
    assert {name: entry["message_count"] for name, entry in topics.items()} == counts
    for channel in summary.channels.values():
        said = topics[channel.topic]["topic_metadata"]
        assert channel.message_encoding == said["serialization_format"] == "cdr"
        assert summary.schemas[channel.schema_id].encoding == "ros2msg"
        assert summary.schemas[channel.schema_id].name == said["type"]
        assert channel.metadata["topic_type_hash"] == said["type_description_hash"]
        assert yaml.safe_load(channel.metadata["offered_qos_profiles"]) == said["offered_qos_profiles"]
    with AnyReader([path]) as reader:
        qos = {c.topic: c.ext.offered_qos_profiles[0] for c in reader.connections}
    assert qos["/clock"].reliability.name == "BEST_EFFORT"
    assert qos[TOPICS["events"]].durability.name == "TRANSIENT_LOCAL"
    assert qos[TOPICS["pose"]["top"]].reliability.name == "RELIABLE"
    assert qos[TOPICS["pose"]["top"]].history.name == "KEEP_LAST"


def test_a_truncated_file_gives_its_beginning_or_one_error_line(run, tmp_path):
    path, written = run
    whole, cut = path.read_bytes(), tmp_path / "cut.mcap"
    everything = np.array([PoseStampedCodec.decode_one(data)[2][:3] for _, data in written[TOPICS["pose"]["top"]]])
    read = 0
    for size in [*range(0, 60, 7), *np.linspace(60, len(whole) - 1, 120).astype(int).tolist()]:
        cut.write_bytes(whole[:size])
        try:
            recording = read_recording(cut)
        except RecordingError as error:
            assert "\n" not in str(error) and str(error).startswith(f"{cut}: ")
            continue
        position = recording.pose["top"].position
        assert not recording.complete and str(cut) in recording.problem
        assert np.array_equal(position, everything[: len(position)])
        read += len(position) > 0
    assert read > 10  # the file has several chunks


@pytest.mark.parametrize("number", [0, 1])
def test_a_damaged_chunk_is_skipped_counted_and_reported(run, tmp_path, number):
    """The first chunk has the definitions, which are in the summary, too."""
    path, written = run
    with open(path, "rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    assert len(chunks) > 2
    data = bytearray(path.read_bytes())
    at = chunks[number].chunk_start_offset + chunks[number].chunk_length // 2
    data[at : at + 40] = bytes(b ^ 0x55 for b in data[at : at + 40])
    (tmp_path / "damaged.mcap").write_bytes(data)
    recording = read_recording(tmp_path / "damaged.mcap")
    assert not recording.complete and "1 damaged part(s) skipped" in recording.problem
    assert recording.lost.keys() >= set(TOPICS["pose"].values())
    assert {len(track.time) for track in recording.pose.values()} == {recording.topics[TOPICS["pose"]["top"]]}
    for topic, lost in recording.lost.items():
        assert recording.topics[topic] + lost == len(written[topic])


@pytest.mark.parametrize(
    "content, said", [(None, "No such file"), (b"", "not an MCAP file"), (b"#!/bin/sh\nexit 0\n", "not an MCAP file")]
)
def test_a_file_that_is_no_recording_is_refused_in_one_line(tmp_path, content, said):
    if content is not None:
        (tmp_path / "x.mcap").write_bytes(content)
    with pytest.raises(RecordingError, match=said):
        read_recording(tmp_path / "x.mcap")
    with pytest.raises(RecordingError, match="directory"):
        read_recording(tmp_path)
    (tmp_path / "x.npz").write_bytes(b"PK")
    with pytest.raises(RecordingError, match="run --out FILE.mcap"):
        read_recording(tmp_path / "x.npz")


@pytest.mark.parametrize(
    "name, data, said",
    [
        ("settings.json", b"{}", "it has format None, this version reads format 1"),
        ("settings.json", b"{", 'its attachment "settings.json" is damaged'),
        ("settings.json", b'{"format": 1}', "lack an entry: KeyError"),
        ("initial_state.json", b"[]", "is damaged: it is not a JSON object"),
        ("scene.yaml", None, 'no attachment "scene.yaml"'),
    ],
)
def test_invalid_attachments_are_refused_in_one_line(tmp_path, name, data, said):
    files = attachments()
    files[name] = ("application/json", data)
    if data is None:
        del files[name]
    Recorder(tmp_path / "run.mcap", files).close()
    with pytest.raises(RecordingError, match=said) as caught:
        read_recording(tmp_path / "run.mcap")
    assert "\n" not in str(caught.value)


# Recordings of the node with all topics, decoded by independent readers.


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
