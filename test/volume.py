# SPDX-License-Identifier: Apache-2.0
"""How much of tests that gain by volume, or take long, is run: all by `make verify`, a part by `make test`.

The part follows from the commit, so a commit always runs the same tests. Every case passes `make verify`.
"""

import functools
import os
import random
import subprocess
import zlib
from pathlib import Path

VERIFY = os.environ.get("VERIFY") == "1"
TESTS = Path(__file__).resolve().parent


@functools.cache
def revision():
    """Hash of the commit; without git, a checksum of the tests."""
    try:
        git = subprocess.run(["git", "-C", TESTS, "rev-parse", "HEAD"], capture_output=True, text=True)
    except FileNotFoundError:
        git = None
    if git and git.returncode == 0:
        return git.stdout.strip()
    return str(zlib.crc32(b"".join(path.read_bytes() for path in sorted(TESTS.rglob("*.py")))))


def some(cases, count):
    """All cases with VERIFY=1, else so many of them: others for every commit."""
    cases = list(cases)
    if VERIFY or len(cases) <= count:
        return cases
    return [cases[k] for k in sorted(random.Random(revision()).sample(range(len(cases)), count))]


def has_turn(name, commits):
    """Whether a test that runs for one commit in so many runs for this one; always with VERIFY=1."""
    return VERIFY or zlib.crc32(f"{name} {revision()}".encode()) % commits == 0
