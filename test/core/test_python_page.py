# SPDX-License-Identifier: Apache-2.0
"""The code blocks of docs/reference/python.md run in sequence and print what the page shows."""

import re
from pathlib import Path

import numpy as np

from liegroup_core import load_scene

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "python.md"


def test_all_code_blocks_of_the_python_page_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    pieces = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), re.DOTALL | re.MULTILINE)
    assert len(pieces) == 11
    names = {}
    for piece in pieces:
        exec(compile(piece, str(PAGE), "exec"), names)
    said = capsys.readouterr().out
    assert "no_such_scene" in said and "smaller step" in said
    # The same second of the same pendulum: rkmk4 at 1 ms is off by 1e-9 or so.
    runs = [names[name].sample().positions["arm"] for name in ("exact", "adaptive", "product")]
    assert np.ptp(runs, axis=0).max() < 1e-7
    assert load_scene("rod.yaml").bodies == names["pendulum"].bodies
    assert names["facts"]["degrees_of_freedom"] == 3
