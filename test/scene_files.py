# SPDX-License-Identifier: Apache-2.0
"""Example scenes, for tests."""

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SCENES = sorted((ROOT / "config" / "scenes").glob("*.yaml"))

each_scene = pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
