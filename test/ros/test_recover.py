# SPDX-License-Identifier: Apache-2.0
"""`recover` and `info` on truncated, damaged and hostile files."""

import json
import random

import pytest
from example_run import ClockCodec, python, record_run
from hostile_recordings import HOSTILE, hostile
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader

from liegroup_sim_ros.commands.info import as_json
from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.recording import write_mcap
from liegroup_sim_ros.recording.damaged_recover import write_recovered
from liegroup_sim_ros.recording.damaged_survey import survey
from liegroup_sim_ros.recording.read import RecordingError
from liegroup_sim_ros.recording.write import Recorder

COUNT = 60  # messages of the small file


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """(path, [(log time, bytes)]) of a recording with several small chunks."""
    path = tmp_path_factory.mktemp("small") / "run.mcap"
    written = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(write_mcap, "CHUNK_SIZE", 600)
        settings = json.dumps({"format": 1}).encode()
        with Recorder(path, {"settings.json": ("application/json", settings)}) as log:
            channel = log.add_channel("/clock", ClockCodec.TYPE)
            for i in range(COUNT):
                stamp = 10**9 + i * 10**6
                written.append((stamp, ClockCodec.encode(stamp)))
                log.write(channel, *written[-1])
            log.add_attachment("pacing.json", "application/json", b"{}")
    return path, written


def messages_of(path):
    """[(log time, bytes)] by the mcap reader with CRC checks, sequentially and by index."""
    with open(path, "rb") as stream:
        for _ in StreamReader(stream, validate_crcs=True).records:
            pass
        stream.seek(0)
        reader = make_reader(stream)
        rows = [(message.log_time, message.data) for _, _, message in reader.iter_messages()]
        assert reader.get_summary().statistics.message_count == len(rows)
    return rows


def one_line(error, path):
    assert str(error).startswith(f"{path}: ") and "\n" not in str(error)


@pytest.mark.turn(3)
def test_a_file_truncated_at_any_byte_gives_exactly_its_beginning(small, tmp_path):
    path, written = small
    whole, cut, out = path.read_bytes(), tmp_path / "cut.mcap", tmp_path / "out.mcap"
    counts = []
    for size in range(len(whole)):
        cut.write_bytes(whole[:size])
        try:
            found = survey(cut)
        except RecordingError as error:
            one_line(error, cut)
            assert not counts  # only before there was anything in it
            continue
        assert not found.complete and found.lost == {}
        assert found.stamps == ((written[0][0], written[found.count - 1][0]) if found.count else (0, 0))
        assert as_json(found)["messages"] == found.count
        if not counts or found.count != counts[-1] or size % 50 == 0:
            assert write_recovered(found, out) == found.count
            assert messages_of(out) == written[: found.count]
            out.unlink()
        counts.append(found.count)
    assert counts == sorted(counts)  # more bytes, no fewer messages
    with open(path, "rb") as stream:
        chunks = make_reader(stream).get_summary().statistics.chunk_count
    assert len(set(counts)) == chunks + 1 > 4 and counts[-1] == COUNT


def test_a_truncated_large_chunk_gives_its_beginning(small, tmp_path):
    """As other software writes them: chunks of several zstd blocks of 128 KiB."""
    path, cut, out = tmp_path / "large.mcap", tmp_path / "cut.mcap", tmp_path / "out.mcap"
    noise = random.Random(2)
    for compression in (CompressionType.ZSTD, CompressionType.NONE):
        rows = []
        with open(path, "wb") as stream:
            writer = Writer(stream, chunk_size=2**20, compression=compression)
            writer.start()
            schema = writer.register_schema("x", "ros2msg", b"")
            channel = writer.register_channel("/x", "cdr", schema)
            for i in range(10_000):
                rows.append((i, noise.randbytes(90)))
                writer.add_message(channel, i, rows[-1][1], i + 7, i + 1)
            writer.finish()
        with open(path, "rb") as stream:
            first = make_reader(stream).get_summary().chunk_indexes[0]
        held = first.uncompressed_size / 121  # messages in it
        for part in (0.3, 0.5, 0.9):
            cut.write_bytes(path.read_bytes()[: int(first.chunk_start_offset + part * first.chunk_length)])
            found = survey(cut)
            assert found.unfinished == found.count > part * held - 2**17 / 121 > 1000
            assert write_recovered(found, out) == found.count
            assert messages_of(out) == rows[: found.count]
            with open(out, "rb") as stream:
                _, _, message = next(make_reader(stream).iter_messages())
            assert (message.sequence, message.publish_time) == (1, 7)
            out.unlink()


@pytest.mark.turn(3)
def test_every_flipped_bit_is_detected_and_no_message_changed(small, tmp_path):
    path, written = small
    whole, damaged, out = path.read_bytes(), tmp_path / "flipped.mcap", tmp_path / "out.mcap"
    stamps = {stamp: data for stamp, data in written}
    random.seed(1)
    best = 0
    for _ in range(400):
        data = bytearray(whole)
        data[random.randrange(len(data))] ^= 1 << random.randrange(8)
        damaged.write_bytes(data)
        try:
            found = survey(damaged)
            write_recovered(found, out)
        except RecordingError as error:
            one_line(error, damaged)
            assert "not an MCAP file" in str(error)  # the very first bytes
            continue
        assert not found.complete
        rows = messages_of(out)
        assert all(stamps[stamp] == data for stamp, data in rows)
        assert len(rows) + sum(found.lost.values()) <= COUNT
        best += len(rows) == COUNT
        assert len(rows) >= COUNT / 2  # one chunk of many, at most, is lost
        out.unlink()
    assert best > 50  # where the index or the end was hit, nothing is


def test_recovered_files_are_readable_and_losses_reported(tmp_path, capsys):
    path = tmp_path / "run.mcap"
    written = record_run(path)
    with open(path, "rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    data = bytearray(path.read_bytes())
    data[chunks[1].chunk_start_offset + 100] ^= 1  # one chunk is damaged
    last = chunks[-1]
    path.write_bytes(data[: last.chunk_start_offset + last.chunk_length * 3 // 4])  # the end cut
    before = path.read_bytes()
    assert main(["recover", str(path)]) == 0
    said = capsys.readouterr().out
    out = tmp_path / "run_recovered.mcap"
    assert "a damaged chunk" in said and "the end of the run is missing" in said
    assert "its end is missing" in said
    assert path.read_bytes() == before
    found = survey(out)
    assert found.complete and found.lost.keys() == survey(path).lost.keys()
    with open(out, "rb") as stream:
        reader = make_reader(stream)
        rows = {}
        for _, channel, message in reader.iter_messages(log_time_order=False):
            rows.setdefault(channel.topic, []).append((message.sequence, message.log_time, message.data))
    with AnyReader([out]) as reader:
        counts = {}
        for connection, _, payload in reader.messages():
            reader.deserialize(payload, connection.msgtype)
            counts[connection.topic] = counts.get(connection.topic, 0) + 1
    assert counts == {topic: len(each) for topic, each in rows.items()}
    for topic, each in rows.items():
        assert all(written[topic][sequence - 1] == (stamp, data) for sequence, stamp, data in each)
        assert found.lost.get(topic, 0) == each[-1][0] - len(each)
    assert found.lost["/clock"] > 50
    assert main(["recover", str(path)]) == 2
    assert "already exists; choose another name" in capsys.readouterr().err
    assert main(["recover", str(out)]) == 0
    assert "there is nothing to recover" in capsys.readouterr().out
    assert main(["recover", str(path), "-o", str(path)]) == 2 and path.read_bytes() == before
    assert main(["info", "--json", str(path), str(out)]) == 0
    first, second = json.loads(capsys.readouterr().out)
    assert not first["complete"] and second["complete"]
    assert second["recovered_from"] == "run.mcap" and first["lost"] == second["lost"] > 0


def test_a_closed_stdout_ends_the_command_cleanly(small):
    """As behind `| head -1`: no traceback, and the exit code of a broken pipe."""
    for many in (1, 300):  # less, and more, than Python keeps before it writes
        child = python(
            """
            import sys
            from liegroup_sim_ros.commands.main import main
            sys.stdin.read()
            sys.exit(main(["info", "--json", *sys.argv[1:]]))
            """,
            *[small[0]] * many,
        )
        child.stdout.close()
        child.stdin.close()
        assert (child.wait(60), child.stderr.read()) == (141, "")


@pytest.mark.turn(3)
def test_hostile_files_use_bounded_memory_and_time_and_give_one_line(tmp_path):
    """Each in a process limited to 1.5 GB of address space, libraries included."""
    for name in HOSTILE:
        (tmp_path / f"{name}.mcap").write_bytes(hostile(name))
    child = python(
        """
        import contextlib, io, json, re, resource, sys, time
        from pathlib import Path
        from liegroup_sim_ros.commands.main import main

        def peak():         # MB; not ru_maxrss, which counts what there was before exec()
            status = Path("/proc/self/status").read_text()
            return int(re.search(r"VmHWM:\\s+(\\d+) kB", status)[1]) / 1e3

        resource.setrlimit(resource.RLIMIT_AS, (1_500_000_000, 1_500_000_000))
        results = {}
        for path in sorted(Path(sys.argv[1]).glob("*.mcap")):
            for command in (["info", "--json"], ["info"], ["recover"]):
                out, err = io.StringIO(), io.StringIO()
                start = time.process_time()
                with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                    code = main([*command, str(path)])
                results[f"{path.stem}: {' '.join(command)}"] = [
                    code, out.getvalue(), err.getvalue(), time.process_time() - start,
                    peak()]
        print(json.dumps(results))
        """,
        tmp_path,
    )
    output, errors = child.communicate(timeout=300)
    assert child.returncode == 0, errors[-2000:]
    results = json.loads(output)
    assert "more than 100 times its size" in results["many chunks that grow: recover"][1]
    assert "claims to contain" in results["bomb that claims 2^60: info"][2]
    assert json.loads(results["short message: info --json"][1])[0]["messages"] == 2
    assert "beyond the end of its record" in results["length beyond its record: info"][2]
    for name, (code, out, err, seconds, megabytes) in results.items():
        assert code in (0, 2), name
        if code == 2:
            assert len(err.splitlines()) == 1 and "Traceback" not in err, (name, err)
        assert "\x1b" not in out + err, name
        # A second of pure Python for each 10 MB that the largest bombs may claim; and the
        # interpreter with its libraries, twice the largest record and its output.
        assert seconds < 30.0 and megabytes < 600.0, (name, seconds, megabytes)
