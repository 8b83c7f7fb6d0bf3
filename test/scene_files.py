# SPDX-License-Identifier: Apache-2.0
"""The scene files that come along, for tests."""
from pathlib import Path
from typing import get_args

import pytest
import yaml

from liegroup_core.scene.description import FORCES, JOINTS

ROOT = Path(__file__).resolve().parents[1]
SCENES = sorted((ROOT / "config" / "scenes").glob("*.yaml"))


def unknown_kinds(path):
    """Types of joints and forces of a scene file that this version does not have."""
    values = yaml.safe_load(path.read_text(encoding="utf-8"))
    known = {name for kind in (*JOINTS, *FORCES)
             for name in get_args(kind.model_fields["type"].annotation)}
    links = [*(values.get("joints") or ()), *(values.get("forces") or ())]
    return {link["type"] for link in links} - known


def with_known_kinds(*names):
    """pytest parameters: these scenes, or all; skipped if it needs kinds there are not yet."""
    paths = [path for path in SCENES if not names or path.stem in names]
    return [pytest.param(path, id=path.stem, marks=pytest.mark.skipif(
        bool(unknown_kinds(path)), reason=f"needs {', '.join(sorted(unknown_kinds(path)))}"))
        for path in paths]
