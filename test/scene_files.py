# SPDX-License-Identifier: Apache-2.0
"""Example scenes, and the scenes and robots of test/scenes/, for tests."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SCENES = sorted((ROOT / "config" / "scenes").glob("*.yaml"))

each_scene = pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)


def text_of(name):
    """Text of a file of test/scenes/."""
    return (ROOT / "test" / "scenes" / name).read_text(encoding="utf-8")


def filled(text, **values):
    """Text with the value of each key in the place of @key@."""
    return re.sub(r"@(\w+)@", lambda found: str(values[found[1]]), text)
