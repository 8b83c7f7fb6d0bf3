# SPDX-License-Identifier: Apache-2.0
"""Wrong arguments of the command line: one line on stderr, exit code 2, and no file is replaced."""

import pytest

from liegroup_sim_ros.commands.main import main


@pytest.mark.parametrize(
    "line, says",
    [
        ("run heavy_top --duration 1 --accuracy abc", "--accuracy: invalid float value: 'abc'"),
        ("analyze x.mcap --max-error -1", "--max-error: must be a number of 0 or more, got '-1'"),
        ("analyze x.mcap --max-drift x", "--max-drift: must be a number of 0 or more, got 'x'"),
        ("analyze x.mcap --reference-steps 0", "must be a whole number of 1 or more, got '0'"),
        *(
            (f"{line} --workers 0", "--workers: must be a whole number of 1 or more")
            for line in ("trade heavy_top", "sweep heavy_top", "extremes", "compare a.yaml b")
        ),
        ("replay x.mcap --resimulate --bound -1", "--bound: must be a number of 0 or more"),
        ("nonsense", "unknown command nonsense; known are: --help, --version, analyze"),
        ("viw x.yaml", "unknown command viw: did you mean view?"),
        ("run heavy_top --duration 1 --acuracy 1e-3", "unknown option --acuracy: did you mean --accuracy?"),
    ],
)
def test_a_wrong_argument_gives_one_line(line, says, capsys):
    with pytest.raises(SystemExit) as stop:
        main(line.split())
    out, err = capsys.readouterr()
    assert stop.value.code == 2 and out == ""
    assert says in err and err.count("\n") == 1 and err.startswith("liegroup_sim")


@pytest.mark.parametrize("line", ["trade heavy_top --json {}", "analyze a.mcap --html {}"])
@pytest.mark.parametrize("name", ["scene.yaml", "run.mcap", "robot.URDF"])
def test_no_report_replaces_a_scene_or_a_recording(line, name, tmp_path, capsys):
    path = tmp_path / name
    path.write_text("kept")
    assert main(line.format(path).split()) == 2
    assert "choose another name" in capsys.readouterr().err
    assert path.read_text() == "kept"


def test_keys_prints_the_tables_of_a_word_and_refuses_others(capsys):
    assert main(["keys", "servo", "couplings"]) == 0
    printed = capsys.readouterr().out
    assert "effort_limit" in printed and "backlash" in printed and "quadratic" not in printed
    assert main(["keys", "servos"]) == 2
    error = capsys.readouterr().err
    assert "'servos' is unknown" in error and "servo, " in error and error.count("\n") == 1
