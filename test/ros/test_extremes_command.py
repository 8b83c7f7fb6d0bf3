# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim extremes`: table, plot, JSON, and one line for wrong input."""

import json
import signal

import pytest

from liegroup_core.study.extremes import extremes
from liegroup_core.study.trade import cache as store
from liegroup_sim_ros.commands.main import main


def test_table_picture_and_json(tmp_path, capsys):
    picture, cells = tmp_path / "map.png", tmp_path / "map.json"
    command = f"extremes --axes step_free --methods rkmk4 rkmk8 --quick --workers 1 --png {picture} --json {cells}"
    assert main(command.split()) == 0
    shown = capsys.readouterr().out
    assert "step, free body over 16 s, s" in shown and "silent 0" in shown
    found = json.loads(cells.read_text())
    assert found["counts"] == {"accurate": 4, "flagged": 0, "refused": 2, "stopped": 0, "unjudged": 0, "silent": 0}
    assert [cell["value"] for cell in found["cells"]] == [8.0, 8.0, 1.0, 1.0, 0.25, 0.25]
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.turn(3)
def test_an_interrupted_map_keeps_its_cells(tmp_path, capsys, monkeypatch):
    """The next call shows the cells of the first one and runs only the remaining ones."""
    monkeypatch.setattr(store, "cache_root", lambda: tmp_path)
    call = ["extremes", "--axes", "turn", "--methods", "rkmk4", "rkmk8", "--workers", "1"]
    made, presses = [], iter([3])

    def column(item):
        if len(made) == 3 and next(presses, None):
            signal.raise_signal(signal.SIGINT)
        made.append(item[1])
        return extremes_column(item)

    extremes_column = extremes.column
    monkeypatch.setattr(extremes, "column", column)
    assert main(call) == 130
    assert capsys.readouterr().err.splitlines()[-1] == (
        "liegroup_sim: interrupted; finished cells are saved, the same command continues"
    )
    assert len(made) == 3
    assert main(call) == 0
    assert sorted(made) == sorted(next(a for a in extremes.AXES if a.name == "turn").values)
    assert len(made) == len(set(made)) and "silent 0" in capsys.readouterr().out


def test_a_user_scene_is_mapped(capsys):
    assert main("extremes free_body --horizon 0.5 --axes step --methods rkmk4 --workers 1".split()) == 0
    assert "accurate 9" in capsys.readouterr().out


def test_a_scene_at_rest_has_no_speeds_and_quick_is_quick(capsys):
    assert main("extremes double_pendulum --horizon 0.5 --quick --methods rkmk8 rattle --workers 1".split()) == 0
    shown, said = capsys.readouterr()
    # Every third of nine steps, for the one method that is for it.
    heads, row = (line.split() for line in shown.splitlines()[1:3])
    assert heads == ["0.5", "0.05", "0.005"] and row == ["rkmk8", ".", ".", "."]
    assert "initial velocities at" not in shown and "initially at rest" in said


@pytest.mark.turn(3)
def test_close_values_are_distinguishable_and_not_truncated(tmp_path, capsys):
    """1.000001 differs from 1 on the terminal and in the report; column heads are complete."""
    page, wanted = tmp_path / "map.md", next(a for a in extremes.AXES if a.name == "sleeping")
    assert (
        main(["extremes", "--axes", "sleeping", "--methods", "rkmk8", "--workers", "1", "--markdown", str(page)]) == 0
    )
    heads = capsys.readouterr().out.splitlines()[1].split()
    assert tuple(map(float, heads)) == wanted.values
    row = next(line for line in page.read_text().splitlines() if line.startswith("| | 0.5"))
    assert [float(x) for x in row.strip("| ").split("|")] == list(wanted.values)
    # The page may be anywhere, so a path of the documentation would lead nowhere.
    assert "](" not in page.read_text()
