# SPDX-License-Identifier: Apache-2.0
"""The recorder under load, in killed processes and on a full disk: data loss and messages."""

import io
import json
import os
import random
import signal
import threading
import time
from pathlib import Path

import pytest
from example_run import SCENE, python
from mcap.reader import make_reader
from waiting import PATIENCE, wait_for

from liegroup_sim_ros.messages.codecs import ClockCodec, PoseStampedCodec
from liegroup_sim_ros.recording import write_mcap
from liegroup_sim_ros.recording.read import RecordingError, read_recording
from liegroup_sim_ros.recording.walk import ChunkMessages, Walk
from liegroup_sim_ros.recording.write import Recorder, RecorderError
from liegroup_sim_ros.recording.write_mcap import CHUNK_SIZE, LARGEST_CHUNK, Chunk


def test_a_killed_process_has_written_what_is_older_than_the_flush_interval(tmp_path):
    """The process writes messages that fill no chunk, then none: only time brings them to the disk."""
    path = tmp_path / "killed.mcap"
    child = python(
        """
        import sys, time
        from example_run import PoseStampedCodec, Recorder, attachments
        recorder = Recorder(sys.argv[1], attachments(), flush_interval=0.2)
        channel = recorder.add_channel("/sim_node/top/pose", PoseStampedCodec.TYPE)
        for stamp in range(100):
            recorder.write(channel, stamp, PoseStampedCodec("world").encode(stamp, (0, 0, 0), (0, 0, 0, 1)))
            time.sleep(5e-3)
        print("written", flush=True)
        sys.stdin.read()
        """,
        path,
    )
    assert child.stdout.readline() == "written\n"
    wait_for(lambda: len(read_recording(path).pose["top"].stamp_ns) == 100, "the flush")
    child.send_signal(signal.SIGKILL)
    child.communicate(timeout=PATIENCE)
    recording = read_recording(path)
    assert not recording.complete and "not finished" in recording.problem
    assert recording.scene_text == SCENE and recording.pacing is None
    assert recording.lost == {} and recording.pose["top"].stamp_ns.tolist() == list(range(100))


class Changing(io.BytesIO):
    """A file that has other bytes after so many reads."""

    def __init__(self, before, after, reads):
        super().__init__(before)
        self._after, self._reads = after, reads

    def read(self, size=-1):
        self._reads -= 1
        if self._reads == -1:
            at = self.tell()
            self.seek(0)
            self.truncate()
            self.write(self._after)
            self.seek(at)
        return super().read(size)


def test_what_was_saved_is_in_the_file_between_any_two_calls_of_the_system(tmp_path, monkeypatch):
    """A copy of the file after each call is what a process leaves that is killed there.

    A reader may have begun before the call: whenever it comes, what the reader has is right.
    """
    path, written, saved, kinds = tmp_path / "run.mcap", [], 0, set()
    draw = random.Random(4)

    def followed(call):
        def copied(*arguments):
            before = path.read_bytes()
            result = call(*arguments)
            after = path.read_bytes()
            begun = [Changing(before, after, draw.randrange(400)) for _ in range(3 if before else 0)]
            for file, size in ((io.BytesIO(after), len(after)), *((each, len(before)) for each in begun)):
                there = list(loose_messages(file, size))
                assert there == written[: len(there)] and (file in begun or len(there) >= saved)
            kinds.add(call.__name__)
            return result

        return copied

    def loose_messages(file, size):
        walk = Walk(file, size)
        for item in walk:
            if isinstance(item, ChunkMessages):
                yield from ((int(item.log_time[k]), item.payload(k)) for k in range(len(item.log_time)))
        assert not walk.problems

    for name in ("pwrite", "ftruncate"):
        monkeypatch.setattr(write_mcap.os, name, followed(getattr(os, name)))
    made = random.Random(3)
    with Recorder(path, {"x": ("y", b"1")}, flush_interval=0.01) as recorder:
        channels = []
        for stamp in range(150):
            if stamp in (0, 40):
                channels.append(recorder.add_channel(f"/{stamp}", PoseStampedCodec.TYPE))
            for channel in channels:
                written.append((stamp, made.randbytes(made.choice((0, 1, 7, 8, 9, 10, 3000)))))
                recorder.write(channel, *written[-1])
            if made.random() < 0.8:
                recorder.save()
                saved = len(written)
            if made.random() < 0.05:
                recorder.add_attachment("z", "y", made.randbytes(made.choice((0, 50000))))
    assert recorder.failure is None and kinds == {"pwrite", "ftruncate"}
    with open(path, "rb") as file:
        assert list(loose_messages(file, path.stat().st_size)) == written
    assert len(chunks_of(path)) > 2


def test_a_full_disk_ends_the_recording_but_not_the_run(tmp_path):
    """A file size limit simulates it: a write succeeds partly, the remainder is refused."""
    path = tmp_path / "full.mcap"
    child = python(
        """
        import json, os, resource, sys
        from example_run import PoseStampedCodec, Recorder, attachments
        resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))
        recorder = Recorder(sys.argv[1], attachments(), flush_interval=0.05, queue_size=100)
        channel = recorder.add_channel("/sim_node/top/pose", PoseStampedCodec.TYPE)
        codec = PoseStampedCodec("world")
        for i in range(20_000):           # noise, 56 bytes each: 1.1 MB whatever the compression
            noise = [b / 7 + c / 13 for b, c in zip(os.urandom(7), os.urandom(7))]
            recorder.write(channel, i, codec.encode(i, noise[:3], noise[3:]))
        recorder.add_channel("/late", PoseStampedCodec.TYPE)
        recorder.close()
        recorder.close()
        print(json.dumps([recorder.written, recorder.lost, recorder.queued, recorder.failure]))
        """,
        path,
    )
    output, errors = child.communicate(timeout=PATIENCE)
    assert child.returncode == 0, errors
    written, lost, queued, failure = json.loads(output)
    assert errors.splitlines() == [failure]
    assert "File too large" in failure and str(path) in failure and "\n" not in failure
    assert lost > 0 and written + lost == 20_000 and queued == 0
    recording = read_recording(path)  # what counts as written is really there
    assert len(recording.pose["top"].stamp_ns) >= written > 0
    assert not recording.complete and recording.lost == {}


def test_a_disk_that_is_full_on_close_is_detected(tmp_path):
    """The last three bytes do not fit: the system writes a part and reports no error."""
    child = python(
        """
        import json, resource, sys
        from example_run import ClockCodec, Recorder, attachments

        def record(path):
            with Recorder(path, attachments()) as recorder:
                channel = recorder.add_channel("/clock", ClockCodec.TYPE)
                recorder.write(channel, 1, ClockCodec.encode(1))
            return recorder

        size = record(sys.argv[1] + "/1.mcap").bytes
        resource.setrlimit(resource.RLIMIT_FSIZE, (size - 3, size - 3))
        short = record(sys.argv[1] + "/2.mcap")
        print(json.dumps([size, short.bytes, short.failure]))
        """,
        tmp_path,
    )
    size, short, failure = json.loads(child.communicate(timeout=PATIENCE)[0])
    assert short == size - 3 and "File too large" in failure


def renamed(path):
    path.rename(path.with_name("other.mcap"))


def replaced(path):
    path.unlink()
    path.write_bytes(b"other")


@pytest.mark.parametrize("at_the_end", [False, True])
@pytest.mark.parametrize(
    "harm, said",
    [
        (Path.unlink, "the file was removed or renamed"),
        (renamed, "the file was removed or renamed"),
        (replaced, "the file was replaced by another one"),
        (lambda path: os.truncate(path, 50), "the file was truncated to "),
    ],
)
def test_a_file_that_is_lost_while_it_is_written_is_reported(tmp_path, caplog, harm, said, at_the_end):
    """At the next flush, or at the end. A part that is finished may go where it likes."""
    with Recorder(tmp_path / "run.mcap", flush_interval=60.0 if at_the_end else 0.02) as recorder:
        channel = recorder.add_channel("/clock", ClockCodec.TYPE)
        recorder.write(channel, 1, ClockCodec.encode(1))
        recorder.divide(1, {})
        recorder.write(channel, 2, ClockCodec.encode(2))
        wait_for(lambda: recorder.path.name.endswith("_part2.mcap"), "the second part")
        (tmp_path / "run.mcap").unlink()
        harm(recorder.path)
        wait_for(lambda: at_the_end or recorder.failure, "the failure")
        recorder.write(channel, 3, ClockCodec.encode(3))
    assert said in recorder.failure and recorder.is_lost and recorder.failure in caplog.text
    assert (recorder.written, recorder.lost, recorder.queued) == (1, 2, 0)
    assert not list(tmp_path.glob("*.yaml"))


def test_a_fast_producer_blocks_and_no_message_is_lost(tmp_path):
    path = tmp_path / "fast.mcap"
    codec = PoseStampedCodec("world")
    payload = codec.encode(0, (1, 2, 3), (0, 0, 0, 1))
    longest = 0
    with Recorder(path, queue_size=1000) as recorder:
        channel = recorder.add_channel("/pose", codec.TYPE)
        for i in range(50_000):
            recorder.write(channel, i, payload)
            longest = max(longest, recorder.queued)
    assert recorder.written == 50_000 and recorder.lost == 0
    assert 900 < longest <= 1000  # the queue did fill, and its bound held
    with open(path, "rb") as stream:
        sequences = [message.sequence for _, _, message in make_reader(stream).iter_messages(log_time_order=False)]
    assert sequences == list(range(1, 50_001))


def test_many_threads_share_one_recorder(tmp_path):
    path = tmp_path / "threads.mcap"
    started = time.monotonic()
    with Recorder(path, queue_size=100, flush_interval=2.0 * PATIENCE) as recorder:
        shared = recorder.add_channel("/clock", ClockCodec.TYPE)

        def produce():
            for i in range(2000):
                recorder.write(shared, i, ClockCodec.encode(i))

        threads = [threading.Thread(target=produce) for _ in range(4)]
        for thread in threads:
            thread.start()
        late = recorder.add_channel("/late/clock", ClockCodec.TYPE)
        recorder.write(late, 7, ClockCodec.encode(7))
        for thread in threads:
            thread.join()
    assert time.monotonic() - started < PATIENCE  # no thread waits for the flush
    with open(path, "rb") as stream:
        messages = [
            (channel.topic, message.sequence)
            for _, channel, message in make_reader(stream).iter_messages(log_time_order=False)
        ]
    assert sorted(messages) == ([("/clock", i) for i in range(1, 8001)] + [("/late/clock", 1)])


def test_concurrent_close_and_write_after_close(tmp_path):
    recorder = Recorder(tmp_path / "run.mcap")
    channel = recorder.add_channel("/clock", ClockCodec.TYPE)
    recorder.write(channel, 0, ClockCodec.encode(0))
    other = threading.Thread(target=recorder.close)
    other.start()
    recorder.close()
    other.join()
    recorder.write(channel, 1, ClockCodec.encode(1))
    recorder.close()
    assert (recorder.written, recorder.lost, recorder.queued) == (1, 1, 0)
    assert recorder.failure is None
    with open(recorder.path, "rb") as stream:
        assert make_reader(stream).get_summary().statistics.message_count == 1


def test_an_exception_in_the_run_completes_the_file(tmp_path):
    child = python(
        """
        import sys
        from example_run import ClockCodec, Recorder
        recorder = Recorder(sys.argv[1])
        recorder.write(recorder.add_channel("/clock", ClockCodec.TYPE), 3, ClockCodec.encode(3))
        raise SystemExit(5)
        """,
        tmp_path / "run.mcap",
    )
    assert child.communicate(timeout=PATIENCE) == ("", "") and child.returncode == 5
    with open(tmp_path / "run.mcap", "rb") as stream:
        assert make_reader(stream).get_summary().statistics.message_count == 1


@pytest.mark.parametrize(
    "name, said",
    [
        ("there.mcap", "already exists; remove it or choose another name"),
        ("there.mcap/run.mcap", "exists|Not a directory"),
        ("run.bag", "must end in .mcap or be an existing folder"),
        ("x" * 300 + ".mcap", "File name too long"),
        ("/proc/run.mcap", "cannot record to /proc/run.mcap: "),
    ],
)
def test_an_unwritable_path_is_refused_in_one_line(tmp_path, name, said):
    (tmp_path / "there.mcap").write_text("precious")
    with pytest.raises(RecorderError, match=said) as caught:
        Recorder(tmp_path / name)
    assert "\n" not in str(caught.value)
    assert (tmp_path / "there.mcap").read_text() == "precious"


def test_recording_to_a_folder_chooses_a_file_name(tmp_path):
    with Recorder(str(tmp_path)) as recorder:
        pass
    assert list(tmp_path.iterdir()) == [recorder.path] and recorder.path.suffix == ".mcap"
    with pytest.raises(RecordingError, match='no attachment "settings.json"'):
        read_recording(recorder.path)


def test_an_unknown_message_type_is_refused_in_one_line(tmp_path):
    with Recorder(tmp_path / "run.mcap") as recorder:
        with pytest.raises(RecorderError, match="cannot record /x: no_such_msgs/msg/Thing"):
            recorder.add_channel("/x", "no_such_msgs/msg/Thing")


def test_reading_and_recording_import_no_ros():
    child = python("""
        import sys
        import liegroup_sim_ros.messages.codecs, liegroup_sim_ros.recording.write
        import liegroup_sim_ros.recording.read
        print([name for name in sys.modules if name.split(".")[0] in
               ("rclpy", "geometry_msgs", "std_msgs", "rosidl_parser", "ament_index_python")])
        """)
    assert child.communicate(timeout=PATIENCE) == ("[]\n", "")


def chunks_of(path):
    """[(start, end, uncompressed bytes)] of all chunks, in file order."""
    with open(path, "rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    return [
        (chunk.message_start_time, chunk.message_end_time, chunk.uncompressed_size)
        for chunk in sorted(chunks, key=lambda chunk: chunk.chunk_start_offset)
    ]


def test_chunks_end_between_two_time_stamps(tmp_path):
    """Also if the queue is full."""
    path = tmp_path / "run.mcap"
    payload = PoseStampedCodec("world").encode(0, (1, 2, 3), (0, 0, 0, 1))
    with Recorder(path, queue_size=2000, flush_interval=PATIENCE) as recorder:
        channels = [recorder.add_channel(f"/{k}", PoseStampedCodec.TYPE) for k in range(7)]
        for stamp in range(6000):
            for channel in channels:
                recorder.write(channel, stamp, payload)
    chunks = chunks_of(path)
    assert len(chunks) >= 6000 * 7 * len(payload) / CHUNK_SIZE
    gaps = [start - end for (_, end, _), (start, _, _) in zip(chunks, chunks[1:])]
    assert min(gaps) > 0
    assert max(size for _, _, size in chunks) < CHUNK_SIZE + 7 * (len(payload) + 31) + 5000


def test_a_chunk_knows_its_last_stamp_after_every_message():
    """Also if it was asked before: a queue that is full for a moment would divide the next instant."""
    chunk = Chunk()
    for stamp in (1, 2):
        assert chunk.may_end_before(stamp)
        chunk.add(0, stamp, b"", 0)
        assert not chunk.may_end_before(stamp)


def test_messages_of_one_stamp_beyond_the_chunk_size_are_split(tmp_path):
    path = tmp_path / "run.mcap"
    with Recorder(path) as recorder:
        channel = recorder.add_channel("/clock", ClockCodec.TYPE)
        for _ in range(4 * LARGEST_CHUNK // 1000):
            recorder.write(channel, 5, bytes(1000))
    chunks = chunks_of(path)
    assert 3 <= len(chunks) <= 5 and {chunk[:2] for chunk in chunks} == {(5, 5)}
    assert max(size for _, _, size in chunks) < LARGEST_CHUNK + 5000
