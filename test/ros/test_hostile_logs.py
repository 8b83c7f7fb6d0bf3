# SPDX-License-Identifier: Apache-2.0
"""Damaged and hostile recordings: one line, bounded memory and time, never a wrong number."""

import dataclasses
import math
import random
import sys
import time
import tracemalloc

import numpy as np
import pytest
from hostile_recordings import HOSTILE, hostile
from made_run import PAIR, record
from scene_files import cases

from liegroup_core import SceneError
from liegroup_core.scene.load import scene_from_text
from liegroup_sim_ros.analysis import local_error
from liegroup_sim_ros.analysis.analyse import analyse
from liegroup_sim_ros.analysis.bounds import find_exceeded
from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.messages import topics
from liegroup_sim_ros.playback.rerun import ReplayError
from liegroup_sim_ros.playback.resimulate import resimulate
from liegroup_sim_ros.recording.read import RecordingError, read_recording

MAGIC = b"\x89MCAP0\r\n"


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """Small recording with poses, twists, wrenches, a reset, diagnostics and all attachments."""
    path = tmp_path_factory.mktemp("log") / "small.mcap"
    return record(
        path,
        scene_from_text(PAIR),
        60,
        resets=(40,),
        pushes=[(20, ("left", (0, 0, 1.0, 0, 0, 0))), (30, ("left", (0,) * 6))],
    )


def motion(recording):
    """{(kind, body, stamp): numbers} of a recording."""
    return {
        (kind, body, stamp): tuple(row)
        for kind in ("pose", "twist")
        for body, track in getattr(recording, kind).items()
        for stamp, row in zip(track.stamp_ns.tolist(), np.hstack(track[1:]).tolist())
    }


@pytest.mark.parametrize("harm", ["cut", "flip", "garble", "repeat", "random", "flip in arrays"])
@pytest.mark.turn(3)
def test_damage_never_gives_wrong_numbers(small, tmp_path, monkeypatch, harm):
    """Every value read was written, and missing data are reported; otherwise one error line.

    Places and bits by chance, the same ones every time. Every one of the 25 798 cuts and as many
    flips of this file were tried once like this.
    """
    if harm == "flip in arrays":
        monkeypatch.setattr(topics, "MOST_OWN", 1)
        small = tmp_path / "arrays.mcap"
        assert main(["run", "double_pendulum", "--duration", "0.3", "--out", str(small)]) == 0
    data, good = small.read_bytes(), read_recording(small)
    everything = motion(good)
    chance, file = random.Random(7), tmp_path / "harmed.mcap"
    refused = read = 0
    for _ in range(300):
        k = chance.randrange(len(data))
        if harm == "cut":
            harmed = data[:k]
        elif harm.startswith("flip"):
            harmed = data[:k] + bytes([data[k] ^ 1 << chance.randrange(8)]) + data[k + 1 :]
        elif harm == "garble":
            size = chance.choice((2, 8, 100, 3000))
            harmed = data[:k] + chance.randbytes(size) + data[k + size :]
        elif harm == "repeat":
            harmed = data[:k] + data[chance.randrange(k + 1) :]
        else:
            harmed = MAGIC + chance.randbytes(chance.randrange(4000))
        file.write_bytes(harmed)
        try:
            recording = read_recording(file)
            found = motion(recording)
        except RecordingError as error:
            assert str(error).startswith(f"{file}: ") and "\n" not in str(error)
            refused += 1
            continue
        read += 1
        assert found.items() <= everything.items()
        for name in ("settings", "initial_state", "scene_text"):
            assert getattr(recording, name) == getattr(good, name)
        for name in ("inputs", "events"):
            assert set(getattr(recording, name)) <= set(getattr(good, name))
        if (recording.topics, recording.pacing) != (good.topics, good.pacing):
            assert not recording.complete and str(file) in recording.problem
    assert (refused, read) == (300, 0) if harm == "random" else read and (refused or harm == "repeat")


# Others take seconds in pure Python.
BOMBS = [name for name in HOSTILE if not name.startswith(("many", "cut"))]


@pytest.mark.parametrize("name", BOMBS)
@pytest.mark.volume(6)
def test_bombs_and_huge_lengths_are_refused_quickly(tmp_path, capsys, name):
    """Within about 1 s and the memory of one chunk (64 MiB) and its arrays."""
    file = tmp_path / "hostile.mcap"
    file.write_bytes(hostile(name))
    tracemalloc.start()
    start = time.process_time()
    assert main(["analyze", str(file)]) == 2
    used, peak = time.process_time() - start, tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and str(file) in err
    # 64 MiB packed into 31 bytes a message: 5 numbers of 8 bytes each and 24 for other records.
    assert used < 10.0 and peak < 64 * 2**20 * (3 + (5 + 3) * 8 / 9)
    assert main(["replay", str(file)]) == main(["replay", str(file), "--resimulate"]) == 2


STRANGE = (None, True, -1, 0, 1e-300, 1e300, math.nan, math.inf, 2**70, "x", "", [], [1], {}, {"a": [{}]}, "\n", 1.5)


@pytest.mark.parametrize("key", cases("invalid_settings_in_a_recording"))
@pytest.mark.turn(3)
def test_invalid_settings_in_a_recording(small, key):
    """One error line, or the same numbers if the setting does not affect them."""
    good = read_recording(small)
    for value in STRANGE:
        recording = dataclasses.replace(good, settings=good.settings | {key: value})
        for judge in (lambda: analyse(recording, reference=False).figures["repeat"], lambda: resimulate(recording)):
            try:
                figures = judge()
            except (RecordingError, SceneError, ReplayError) as error:
                assert "\n" not in str(error)
                continue
            assert (
                "failed" in figures
                or figures["identical"] == figures["samples"]
                or (key in ("steps_per_sample", "world_frame"))
            )


@pytest.mark.parametrize("key", ["pose", "twist", "steps", "stamp_ns", "angles"])
def test_invalid_initial_states_in_a_recording(small, key):
    good = read_recording(small)
    for value in STRANGE:
        recording = dataclasses.replace(good, initial_state=good.initial_state | {key: value})
        try:
            figures = resimulate(recording)
        except (RecordingError, ReplayError) as error:
            assert "\n" not in str(error)
            continue
        # Another time of the start: then nothing lies where it would be simulated. A shift of 1 ns
        # is within the rounding of stamps; it shifts the wrenches as well.
        shifted = key == "stamp_ns" and value in (-1, True)
        assert figures["identical"] in (0, figures["samples"]) or shifted


@pytest.fixture(scope="module")
def fast(tmp_path_factory):
    """Recording of a method with error control, 0.1 s of a spinning top."""
    path = tmp_path_factory.mktemp("log") / "fast.mcap"
    run = ["run", "heavy_top", "--method", "rkmk54", "--duration", "0.1", "--out", str(path)]
    assert main(run) == 0
    return read_recording(path)


def spun(recording, speed):
    """The recording with another initial twist."""
    state = {name: entry for name, entry in recording.initial_state.items() if name != "state"}
    return dataclasses.replace(recording, initial_state=state | {"twist": [[speed] * 6]})


@pytest.mark.parametrize("speed", [1e10, 1e30, 1e100])
@pytest.mark.volume(1)
def test_an_analysis_ends_where_no_motion_has_such_numbers(fast, speed):
    """The reference integration, which would take its 50 000 steps for nothing, says so at once."""
    figures = analyse(spun(fast, speed)).figures
    assert "reference integration" in figures["reference"]["failed"]
    assert figures["repeat"]["identical"] == 0
    assert "its error is unknown" in find_exceeded([figures], max_error=1.0)[0]


def test_work_that_numbers_ask_for_is_limited(fast, monkeypatch):
    """Steps that the stamps claim, and substeps that a speed needs: the figure says why it ends."""
    monkeypatch.setattr(sys.modules["liegroup_sim_ros.analysis.analyse"], "REPEAT_STEPS", 10_000)
    claiming = dataclasses.replace(fast, settings=fast.settings | {"step": 1e-9})
    repeat = analyse(claiming, reference=False).figures["repeat"]
    assert "needs more than 111000 steps" in repeat["stopped"] and repeat["identical"] == 1
    assert analyse(fast, reference=False).figures["repeat"]["stopped"] is None
    limits = {"REPEAT_STEPS": 1000, "REPEAT_STEPS_PER_SAMPLE": 0}
    for name, value in limits.items():
        monkeypatch.setattr(sys.modules["liegroup_sim_ros.analysis.analyse"], name, value)
    monkeypatch.setattr(local_error, "MOST_STEPS", 20)
    assert analyse(fast, reference=False).figures["repeat"]["stopped"] is None
    figures = analyse(spun(fast, 1e4), reference=False).figures
    assert "needs more than 1000 steps" in figures["repeat"]["stopped"]
    assert figures["repeat"]["identical"] == 0 and 0 < figures["local"]["windows"] < 8


@pytest.mark.parametrize("command", [["analyze"], ["replay", "--resimulate"]])
def test_a_recording_names_no_files_of_this_machine(command, tmp_path, capsys):
    scene, path = scene_from_text(PAIR), tmp_path / "run.mcap"
    (tmp_path / "arm.xacro").write_text("<robot/>")
    scene._text = f"robot: {tmp_path}/arm.xacro\n"
    record(path, scene, 20)
    assert main([command[0], str(path), *command[1:]]) == 2
    said = capsys.readouterr().err
    assert "scene.yaml:1: a scene given as text cannot refer to a robot file" in said and said.count("\n") == 1, said
