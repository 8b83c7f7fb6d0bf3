# SPDX-License-Identifier: Apache-2.0
"""Recorder compared with a bare mcap.Writer; killed processes, a full disk, truncation; readers.

    python benchmarks/recording.py               all parts, short
    python benchmarks/recording.py --long        the configuration of the published figures
    python benchmarks/recording.py killed disk   some parts

Each part ends the program with one line of text if a check fails.
"""

import argparse
import json
import os
import random
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from liegroup_sim_ros.messages import schemas
from liegroup_sim_ros.messages.codecs import PoseStampedCodec
from liegroup_sim_ros.recording.damaged_recover import write_recovered
from liegroup_sim_ros.recording.damaged_survey import survey
from liegroup_sim_ros.recording.read import RecordingError
from liegroup_sim_ros.recording.write import Recorder

SIDE = Path(__file__).parent / "recording_side"
FLUSH = 0.2  # s, of the processes that are killed
RATE = 10_000  # messages per second


def fail(text):
    raise SystemExit(f"recording.py: {text}")


def check(condition, text):
    if not condition:
        fail(text)


def poses(count):
    """Serialized poses of a moving body."""
    codec, t = PoseStampedCodec("world"), np.arange(count) * 1e-3
    q = np.stack([np.sin(3 * t), np.cos(3 * t), np.sin(t), np.cos(t)], axis=1)
    q /= np.linalg.norm(q, axis=1)[:, None]
    p = np.stack([np.cos(t), np.sin(t), 0.1 * np.sin(7 * t)], axis=1)
    return [codec.encode(k * 10**6, *row) for k, row in enumerate(zip(p.tolist(), q.tolist()))]


def ours(path, messages):
    with Recorder(path) as recorder:
        channel, write = recorder.add_channel("/pose", PoseStampedCodec.TYPE), recorder.write
        for k, data in enumerate(messages):
            write(channel, k * 10**6, data)
    check(recorder.failure is None and recorder.written == len(messages), "messages were lost")


def bare(path, messages):
    with open(path, "wb") as stream:
        writer = Writer(stream, chunk_size=128 * 1024, compression=CompressionType.ZSTD)
        writer.start("ros2")
        schema = writer.register_schema(
            PoseStampedCodec.TYPE, "ros2msg", schemas.definition(PoseStampedCodec.TYPE).encode()
        )
        channel = writer.register_channel("/pose", "cdr", schema)
        for k, data in enumerate(messages):
            writer.add_message(channel, k * 10**6, data, k * 10**6, k + 1)
        writer.finish()


def speed(folder, count):
    """Messages per second of wall time and of CPU time, alternating."""
    messages, found = poses(count), {ours: [], bare: []}
    path = folder / "speed.mcap"
    for _ in range(5):
        for write in found:
            wall, cpu = time.perf_counter(), time.process_time()
            write(path, messages)
            found[write].append((time.perf_counter() - wall, time.process_time() - cpu, path.stat().st_size))
            path.unlink()
    print(f"\nwriting {count} poses            messages/s      of CPU   CPU us each   MB/million")
    best = {}
    for write, name in ((ours, "recorder, its thread"), (bare, "bare mcap.Writer")):
        wall, cpu = (min(row[k] for row in found[write]) for k in (0, 1))
        best[write] = wall, cpu
        print(
            f"{name:<28} {count / wall:12.0f} {count / cpu:11.0f} {1e6 * cpu / count:13.2f} "
            f"{found[write][0][2] / count:12.2f}"
        )
    print(
        f"the recorder is faster by {best[bare][0] / best[ours][0]:.2f} by the clock, "
        f"{best[bare][1] / best[ours][1]:.2f} in CPU time"
    )


def killed(folder, count):
    """Processes that record 10 000 messages/s, killed at random instants; their files recovered."""
    lags, salvaged, sizes, done = [], 0, [], 0
    path, out = folder / "killed.mcap", folder / "out.mcap"
    random.seed(5)
    while done < count:
        child = subprocess.Popen(
            [sys.executable, SIDE / "writes.py", path, str(FLUSH), str(RATE)], stdout=subprocess.PIPE, text=True
        )
        check(child.stdout.readline() == "running\n", "a process did not start")
        started = time.monotonic_ns()
        time.sleep(random.uniform(0.1, 1.5))
        at = time.monotonic_ns()
        child.send_signal(signal.SIGKILL)
        child.communicate()
        done += 1
        try:
            found = survey(path)
        except RecordingError as error:
            check(at - started < FLUSH * 1e9, f"nothing can be read: {error}")
            path.unlink()
            continue
        check(not found.complete and not found.lost, "a killed recording looks complete, or has gaps")
        write_recovered(found, out)
        with open(out, "rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            rows = [message.log_time for _, _, message in reader.iter_messages()]
        check(
            len(rows) == found.count == reader.get_summary().statistics.message_count and rows == sorted(rows),
            "the recovered file differs from the survey",
        )
        lags.append((at - rows[-1]) * 1e-9 if rows else (at - started) * 1e-9)
        salvaged += found.unfinished
        sizes.append(len(rows))
        path.unlink()
        out.unlink()
    print(
        f"\n{done} processes killed at random instants, {RATE} messages/s, flushed every "
        f"{FLUSH} s:\nnot on the disk at most {max(lags):.3f} s, median "
        f"{statistics.median(lags):.3f} s; {sum(sizes)} messages recovered, no gap, {salvaged} "
        "of them out of unfinished chunks; every file opens"
    )
    # The recorder's thread checks every 5 ms; other processes delay it.
    check(max(lags) < FLUSH + 0.25, "a message older than the flush interval is lost")


def cut(folder, _):
    """A small recording truncated at every byte: surveyed, recovered and read."""
    path, part, out = folder / "small.mcap", folder / "part.mcap", folder / "out.mcap"
    messages = poses(60)
    with Recorder(path, {"settings.json": ("application/json", b'{"format": 1}')}) as recorder:
        channel = recorder.add_channel("/pose", PoseStampedCodec.TYPE)
        for k, data in enumerate(messages):
            recorder.write(channel, k, data)
            if k % 15 == 14:  # ends the chunk
                recorder.add_attachment(f"mark{k}", "text/plain", b"x")
    whole, refused, counts = path.read_bytes(), 0, set()
    for size in range(len(whole)):
        part.write_bytes(whole[:size])
        try:
            found = survey(part)
            write_recovered(found, out)
        except RecordingError as error:
            check("\n" not in str(error), "more than a line")
            refused += 1
            continue
        with open(out, "rb") as stream:
            rows = [(m.log_time, m.data) for _, _, m in make_reader(stream, validate_crcs=True).iter_messages()]
        check(rows == list(enumerate(messages[: len(rows)])), f"cut at {size}: wrong messages")
        check(found.count == len(rows) and not found.lost and not found.complete, f"cut at {size}: wrong figures")
        counts.add(len(rows))
        out.unlink()
    print(
        f"\na recording of {len(whole)} bytes cut at every byte: {len(whole) - refused} gave a "
        f"file with exactly its beginning ({len(counts)} lengths), {refused} one line, as "
        "nothing was in them yet"
    )


def disk(folder, _):
    """The simulation node records to a disk of 1 MB."""
    place = folder / "small_disk"
    place.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "none", place], capture_output=True).returncode:
        print("\ndisk full: omitted, a disk of 1 MB cannot be mounted here")
        return
    try:
        answer = subprocess.run([sys.executable, SIDE / "full.py", place / "run.mcap"], capture_output=True, text=True)
        check(answer.returncode == 0, answer.stderr[-2000:])
        steps_at_failure, steps, written, lost, failure, logged = json.loads(answer.stdout)
        found = survey(place / "run.mcap")
        write_recovered(found, folder / "out.mcap")
        with open(folder / "out.mcap", "rb") as stream:
            rows = sum(1 for _ in make_reader(stream, validate_crcs=True).iter_messages())
        check(rows >= written and not found.lost, "messages counted as written are missing")
        print(
            f"\ndisk of 1 MB: failed at step {steps_at_failure}, the simulation went on to step "
            f"{steps};\n{written} written, {lost} lost and counted, {rows} recovered, no gap\n"
            f"said: {failure}\nlogged as an error: {logged}"
        )
    finally:
        subprocess.run(["umount", place], check=True)


def readers(folder, _):
    """Every message of a recording with all topics, decoded by independent readers."""
    path = folder / "all_topics.mcap"
    subprocess.run([sys.executable, SIDE / "all_topics.py", path], check=True)
    found = survey(path)
    check(found.complete and not found.lost, "the log of the node is not complete")
    counts = {each.topic: each.count for each in found.figures.values()}
    check(all(counts.values()), "a topic has no message")
    print(f"\na log of the node with all its {len(counts)} topics, {found.count} messages")
    for name in ("mcap_ros2", "rosbags", "pybag", "small_mcap"):
        answer = json.loads(
            subprocess.run(
                [sys.executable, SIDE / "decode.py", name, path], check=True, capture_output=True, text=True
            ).stdout
        )
        check(answer == counts, f"{name} found {answer}")
        print(f"{name:<12} decoded every message")
    if not shutil.which("npm"):
        print("@mcap/core   omitted, npm is not installed")
        return
    place = folder / "npm"
    place.mkdir()
    for name in ("package.json", "decode.mjs"):
        shutil.copy(SIDE / name, place)
    made = subprocess.run(
        ["npm", "install", "--no-audit", "--no-fund", "--loglevel=error"], cwd=place, capture_output=True, text=True
    )
    if made.returncode:
        print(f"@mcap/core   omitted, npm cannot install it here: {made.stderr[:200].strip()}")
        return
    done = subprocess.run(["node", "decode.mjs", path], cwd=place, capture_output=True, text=True)
    check(done.returncode == 0, f"@mcap/core: {done.stderr[-1000:]}")
    check(json.loads(done.stdout) == counts, f"@mcap/core found {done.stdout}")
    versions = subprocess.run(["npm", "ls", "--depth=0"], cwd=place, capture_output=True, text=True).stdout.split("\n")[
        1:
    ]
    print("@mcap/core   decoded every message:", ", ".join(line.split()[-1] for line in versions if line.strip()))


def main():
    """Run all parts, or the named ones."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("parts", nargs="*", metavar="PART", help="speed, killed, cut, disk or readers (default: all)")
    parser.add_argument("--long", action="store_true", help="a million messages, 200 kills")
    args = parser.parse_args()
    sizes = {speed: (1_000_000, 100_000), killed: (200, 10), cut: (0, 0), disk: (0, 0), readers: (0, 0)}
    parts = {part.__name__: part for part in sizes}
    if unknown := set(args.parts) - set(parts):
        parser.error(f"unknown part {min(unknown)}; there are {', '.join(parts)}")
    print(f"load of the machine at the start: {os.getloadavg()[0]:.2f} on {os.cpu_count()} cores")
    for name in args.parts or parts:
        with tempfile.TemporaryDirectory() as folder:
            long, short = sizes[parts[name]]
            parts[name](Path(folder), long if args.long else short)


if __name__ == "__main__":
    main()
