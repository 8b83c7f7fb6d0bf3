# SPDX-License-Identifier: Apache-2.0
"""Damaged files of each format: exit code 2 and one line, in bounded time and memory."""

import subprocess
import sys
from pathlib import Path

import pytest
from robot_texts import ARM_MJCF, ARM_SDF, ARM_URDF
from scene_files import filled
from volume import VERIFY

COUNT = 200 if VERIFY else 40
SECONDS = 20.0  # of CPU time for a file; far above that of a correct one
# MiB above what the program has after a correct file, and those of a compiler of its own process.
MEMORY, COMPILER = 50.0, 400.0
TEXTS = {"urdf": ARM_URDF, "sdf": ARM_SDF, "xml": filled(ARM_MJCF, upper="0.02 0.03 0.025 0.001 -0.002 0.0015")}
# Prints: refused files, seconds of the slowest, MiB of this process before and after, MiB of a child.
CODE = """
import contextlib, io, re, resource, sys, time
from pathlib import Path
import numpy as np
sys.path.append(sys.argv[3])
from robot_damage import mutated
from liegroup_sim_ros.commands.main import main

def peak():
    return int(re.search(r"VmHWM:\\s+(\\d+) kB", Path("/proc/self/status").read_text())[1]) / 1024

path, count = Path(sys.argv[1]), int(sys.argv[2])
text, rng = path.read_text(), np.random.default_rng(17)

def run():
    said = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
        return main(["import", str(path)]), said.getvalue()

assert run()[0] == 0
before, slowest, refused = peak(), 0.0, 0
for k in range(count):
    path.write_text(mutated(text, rng))
    start = time.process_time()
    code, said = run()
    slowest = max(slowest, time.process_time() - start)
    if code:
        refused += 1
        assert code == 2, (code, said)
        assert said.startswith(f"liegroup_sim: {path}") and said.count("\\n") == 1, said
        assert "Traceback" not in said and len(said) < 2000, said
child = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
print(refused, slowest, before, peak(), child)
"""


@pytest.mark.parametrize("kind", ["urdf", "sdf", pytest.param("xml", marks=pytest.mark.slow)])
@pytest.mark.volume(1)
def test_damaged_files_end_import_with_2_and_one_line(kind, tmp_path):
    path = tmp_path / f"arm.{kind}"
    path.write_text(TEXTS[kind])
    folder = str(Path(__file__).resolve().parents[1])
    done = subprocess.run(
        [sys.executable, "-P", "-c", CODE, str(path), str(COUNT), folder], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-2000:]
    refused, slowest, before, after, child = map(float, done.stdout.split())
    assert COUNT // 2 < refused < COUNT
    assert slowest < SECONDS and after - before < MEMORY and child < COMPILER
