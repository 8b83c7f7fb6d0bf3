# SPDX-License-Identifier: Apache-2.0
"""Data files of tests: example scenes, the scenes and robots of test/scenes/, and the cases of tables.yaml."""

import functools
import re
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
SCENES = sorted((ROOT / "config" / "scenes").glob("*.yaml"))

each_scene = pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)


def text_of(name):
    """Text of a file of test/scenes/."""
    return (ROOT / "test" / "scenes" / name).read_text(encoding="utf-8")


def filled(text, **values):
    """Text with the value of each key in the place of @key@."""
    return re.sub(r"@(\w+)@", lambda found: str(values[found[1]]), text)


@functools.cache
def _tables():
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    return yaml.load((ROOT / "test" / "tables.yaml").read_text(encoding="utf-8"), loader)


def cases(test):
    """Cases of a parametrised test, by its name without test_."""
    return _tables()[test]
