# SPDX-License-Identifier: Apache-2.0
"""A recording split into parts: each complete in itself, together one rosbag2 bag."""

import json

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from node_process import NodeProcess
from rosbags.highlevel import AnyReader
from scene_files import text_of

from liegroup_core import Simulation
from liegroup_core.scene.load import scene_from_text
from liegroup_sim_ros.messages import inputs
from liegroup_sim_ros.messages.codecs import ClockCodec, PoseStampedCodec, TwistStampedCodec
from liegroup_sim_ros.messages.schemas import qos_profile
from liegroup_sim_ros.recording import attachments, bag_metadata
from liegroup_sim_ros.recording.damaged_survey import survey
from liegroup_sim_ros.recording.write import Recorder, RecorderError

# Turns are counted, a motor depends on time, and a method keeps the size of its substep.
SCENE = text_of("wound_parts.yaml")


def content(path):
    """({attachment: JSON or text}, {topic: [(sequence, stamp, bytes)]}) of a recording."""
    with open(path, "rb") as stream:
        reader = make_reader(stream)
        files = {a.name: a.data for a in reader.iter_attachments()}
        rows = {}
        for _, channel, message in reader.iter_messages(log_time_order=False):
            rows.setdefault(channel.topic, []).append((message.sequence, message.log_time, message.data))
    return ({name: json.loads(data) if name.endswith(".json") else data.decode() for name, data in files.items()}, rows)


def same_bits(path):
    """Number of samples of a part, after checking that the part alone reproduces them bitwise."""
    files, rows = content(path)
    settings, state = files["settings.json"], files["initial_state.json"]
    simulation = Simulation(
        scene_from_text(files["scene.yaml"]),
        settings["method"],
        settings["step"],
        settings["group"],
        settings["stabilisation"],
        settings["baumgarte_time"],
        **settings["options"],
    )
    assert attachments.restore(simulation, state)
    topics, base = settings["topics"], state["base_ns"]
    given = [(stamp, *inputs.decode(data)) for _, stamp, data in rows.get(topics["inputs"], [])]
    bodies = state["bodies"]
    poses = {b: rows[topics["pose"][b]] for b in bodies}
    twists = {b: rows[topics["twist"][b]] for b in bodies}
    assert poses[bodies[0]][0][1] == state["stamp_ns"]  # the first sample is the state
    resets = [stamp for _, stamp, data in rows.get(topics["events"], []) if b"\0reset\0" in data]
    for k, (_, stamp, _) in enumerate(poses[bodies[0]]):
        while resets and resets[0] <= stamp:
            base = resets.pop(0)
            simulation.reset()
        while given and given[0][0] < stamp:
            at, base_ns, commands = given.pop(0)
            if at < base:
                continue  # what ended by the reset
            assert base_ns == base
            for command in commands:
                command.repeat(simulation)
        simulation.advance(round((stamp - base) * 1e-9 / settings["step"]) - simulation.steps)
        sample = simulation.sample()
        for b in bodies:
            assert poses[b][k][1:] == (
                stamp,
                PoseStampedCodec(settings["world_frame"]).encode(
                    stamp, sample.positions[b].tolist(), sample.quaternions[b].tolist()
                ),
            ), (path, k)
            assert twists[b][k][1:] == (stamp, TwistStampedCodec(b).encode(stamp, sample.twists[b].tolist())), (path, k)
    return len(poses[bodies[0]])


@pytest.mark.turn(3)
def test_every_part_alone_repeats_bit_for_bit(client, tmp_path):
    """With a world-axes wrench that spans parts, a pause, single steps and a reset."""
    scene = tmp_path / "wound.yaml"
    scene.write_text(SCENE)
    bag = tmp_path / "bag"
    with NodeProcess(
        {
            "scene": scene,
            "method": "rkmk54",
            "record": bag / "run.mcap",
            "publish_rate": 200.0,
            "record_split_duration": 0.25,
            "record_metadata": True,
            "wrench_hold": "until_replaced",
            "step_count": 7,
            "record_flush_interval": 0.2,
        },
        remap=["__node:=parted"],
    ) as node:
        events = client.events("/parted")
        client.until(lambda: events)
        push = client.pusher("/parted", "free/wrench")
        push("world", torque=(0.0, 0.3, 0.0), force=(0.5, 0.0, 1.0))
        client.until(lambda: (bag / "run_part3.mcap").exists())
        slower = client.command("/parted/pause") + 7_000_000  # stamp after the single steps
        assert client.call("/parted/step").success
        assert client.set("/parted", real_time_factor=0.5).successful
        assert client.call("/parted/resume").success
        there = len(list(bag.glob("*.mcap")))
        client.until(lambda: (bag / f"run_part{there + 2}.mcap").exists())
        assert client.call("/parted/reset").success
        push("free", force=(0.0, 0.0, 2.0))
        client.until(lambda: (bag / f"run_part{there + 4}.mcap").exists())
        node.end()
    parts = sorted(bag.glob("*.mcap"), key=lambda path: (len(path.name), path.name))
    assert len(parts) >= there + 4 >= 7
    samples = [same_bits(path) for path in parts]
    # 50 samples of 5 ms each, then the next begins; single steps put out a sample more.
    assert all(50 <= count <= 53 for count in samples[:-1])

    numbers, before = {}, None
    for k, path in enumerate(parts, 1):
        found = survey(path)
        assert found.complete and found.lost == {}
        files, rows = content(path)
        settings, state = files["settings.json"], files["initial_state.json"]
        assert (settings["part"], settings.get("previous")) == (k, before)
        assert settings["parameters"]["record_split_duration"] == 0.25
        assert settings["parameters"]["real_time_factor"] == (1.0 if state["stamp_ns"] <= slower else 0.5)
        assert files["pacing.json"]["ticks"] > 0
        assert settings.get("sequences", {}).items() >= numbers.items()
        for topic, messages in rows.items():
            first = numbers.get(topic, 0) + 1
            assert [m[0] for m in messages] == list(range(first, first + len(messages)))
            numbers[topic] = messages[-1][0]
        before = path.name
        assert state["steps"] == round((state["stamp_ns"] - state["base_ns"]) / 1e6)
    assert state["steps"] > 0 and state["base_ns"] > 0  # after the reset
    # The spring is wound further than a pose can tell.
    angles = [content(path)[0]["initial_state.json"]["angles"][0] for path in parts[:3]]
    assert abs(angles[2]) > 2 * np.pi

    told = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert told["relative_file_paths"] == [path.name for path in parts]
    assert told["message_count"] == sum(survey(path).count for path in parts)
    with AnyReader([bag]) as reader:
        counts, last = {}, 0
        for connection, stamp, data in reader.messages():
            reader.deserialize(data, connection.msgtype)
            counts[connection.topic] = counts.get(connection.topic, 0) + 1
            assert stamp >= last
            last = stamp
        assert reader.message_count == sum(counts.values()) == told["message_count"]
    assert counts == {topic: number for topic, number in numbers.items()}


def test_parts_are_split_by_size_with_continuous_sequence_numbers(tmp_path):
    with Recorder(tmp_path / "run.mcap", {"x": ("y", b"1")}, queue_size=500, max_size=100_000, bag=True) as log:
        channel = log.add_channel("/pose", PoseStampedCodec.TYPE)
        codec, random = PoseStampedCodec("world"), np.random.default_rng(1)
        for i in range(10_000):
            if log.is_part_due(i):
                log.divide(i, {"x": ("y", b"%d" % (log.part + 1))})
                late = log.add_channel(f"/late{log.part}", ClockCodec.TYPE)
                log.write(late, i, ClockCodec.encode(i))
            log.write(channel, i, codec.encode(i, random.normal(size=3), random.normal(size=4)))
    parts = [log.part_path(k) for k in range(1, log.part + 1)]
    assert sorted(tmp_path.iterdir()) == sorted([*parts, tmp_path / "metadata.yaml"])
    assert log.path == parts[-1] and len(parts) > 5 and log.failure is None
    sequences = []
    for k, path in enumerate(parts, 1):
        files, rows = content(path)
        assert files["x"] == str(k)
        sequences += [sequence for sequence, _, _ in rows["/pose"]]
        # Queued messages still go to the part that is full.
        assert path.stat().st_size < 100_000 + 500 * 135 + 20_000
    assert sequences == list(range(1, 10_001))
    with AnyReader([tmp_path]) as reader:
        assert reader.message_count == 10_000 + len(parts) - 1


def test_the_cost_of_a_part_does_not_grow_with_their_number(tmp_path, monkeypatch):
    """Entries that are written anew with each file, and files that a killed process leaves out."""
    monkeypatch.setattr(bag_metadata, "AT_ONCE", 10)
    bag, topics, entries = bag_metadata.BagMetadata(), [], 0
    for k, qos in enumerate(("reliable", "transient_local")):
        info = bag_metadata.topic_info(f"/é: {k}", ClockCodec.TYPE, [qos_profile(qos, 5)], "hash")
        topics.append((info, 2 * k))
    names = [f"a b: {k}" + " long" * 40 + ".mcap" for k in range(300)]
    for k, name in enumerate(names, 1):
        empty = k % 7 == 0  # such a file has no stamps
        bag.add_file(name, (0, 0) if empty else (5 * k, 5 * k + 3), [] if empty else topics)
        if bag.is_due():
            bag.write(tmp_path)
            entries += k
        listed = (tmp_path / "metadata.yaml").read_text(encoding="utf-8").count("- path:")
        assert 0 <= k - listed <= k / 10 and entries <= 2 * 10 * k
    bag.write(tmp_path)
    assert [each.name for each in tmp_path.iterdir()] == ["metadata.yaml"]
    told = yaml.safe_load((tmp_path / "metadata.yaml").read_text(encoding="utf-8"))
    told = told["rosbag2_bagfile_information"]
    assert told["relative_file_paths"] == [each["path"] for each in told["files"]] == names
    assert told["message_count"] == sum(each["message_count"] for each in told["files"]) == 2 * 258
    assert told["starting_time"] == {"nanoseconds_since_epoch": 5}
    assert told["duration"] == {"nanoseconds": 5 * 300 + 3 - 5}
    assert [each["topic_metadata"] for each in told["topics_with_message_count"]] == [info for info, _ in topics]
    record = bag_metadata.record_of_file(names[0], (5, 8), topics)["serialized_metadata"]
    assert yaml.safe_load(record)["files"] == told["files"][:1]


def test_existing_files_of_parts_or_bag_are_refused_at_the_start(tmp_path):
    (tmp_path / "run_part2.mcap").touch()
    with pytest.raises(RecorderError, match="run_part2.mcap already exists and could be a part of"):
        Recorder(tmp_path / "run.mcap", max_size=1000)
    Recorder(tmp_path / "run.mcap").close()  # not in the way of a single file
    (tmp_path / "metadata.yaml").touch()
    with pytest.raises(RecorderError, match="already contains a rosbag2 bag"):
        Recorder(tmp_path / "other.mcap", bag=True)
    assert not (tmp_path / "other.mcap").exists()


def test_a_part_that_cannot_be_opened_ends_the_recording_but_not_the_run(tmp_path, caplog):
    with Recorder(tmp_path / "run.mcap") as log:
        channel = log.add_channel("/clock", ClockCodec.TYPE)
        log.write(channel, 1, ClockCodec.encode(1))
        (tmp_path / "run_part2.mcap").mkdir()
        log.divide(1, {})
        log.write(channel, 2, ClockCodec.encode(2))
    assert (log.written, log.lost) == (1, 1)
    assert log.failure in caplog.text and "run_part2.mcap" in log.failure
    assert survey(tmp_path / "run.mcap").complete
