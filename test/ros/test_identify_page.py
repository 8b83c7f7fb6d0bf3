# SPDX-License-Identifier: Apache-2.0
"""docs/how-to/identify.md: its commands make a bag, name what the model lacks and find the number."""

import json
import re
import shlex
from pathlib import Path

import pytest

from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.report.terminal import working

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "how-to" / "identify.md").read_text()
FILES = re.findall(r"^`(\w+\.yaml)`[^`\n]*:\n\n```yaml\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
COMMANDS = re.findall(r"^    (sed .*|liegroup_sim .*)$", PAGE, re.MULTILINE)


def test_progress_is_for_terminals_only(monkeypatch, capsys):
    for is_terminal in ("0", "1"):
        monkeypatch.setenv("TTY_COMPATIBLE", is_terminal)
        with working("identifying") as tell:
            tell("iteration 7")
        out, err = capsys.readouterr()
        assert not out and ("identifying: iteration 7" in err) == (is_terminal == "1")


@pytest.mark.turn(2)
def test_the_page_names_the_friction_and_finds_it(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name, text in FILES:
        Path(name).write_text(text)
    change, *commands = map(shlex.split, COMMANDS)
    _, old, new, _ = change[1].split("/")
    assert change[2:] == ["model.yaml", ">", "machine.yaml"]
    Path("machine.yaml").write_text(Path("model.yaml").read_text().replace(old, new))
    assert [command[1] for command in commands] == ["run", "compare", "identify"]
    for command in commands:
        more = {"run": [], "compare": [], "identify": ["--html", "identify.html"]}[command[1]]
        assert main([*command[1:], *more, *(["--json", f"{command[1]}.json"] if command[1] != "run" else [])]) == 0
    text = " ".join(capsys.readouterr().out.split())
    compared, identified = (json.loads(Path(f"{name}.json").read_text()) for name in ("compare", "identify"))
    assert not compared["agrees"] and compared["effects"][0]["text"] == "viscous friction of hinge"
    assert "Viscous friction of hinge" in Path("compare.html").read_text()
    # What rounding leaves is not white.
    assert identified["in_reach"] and "no run near" not in text
    assert identified["robust"] and all("intervals are robust" in t for t in (text, Path("identify.html").read_text()))
    (number,) = identified["numbers"]
    value, half = map(float, re.search(r"finds ([\d.]+) ± ([\d.]+\d)", PAGE).groups())
    low, high = number["interval"]
    assert abs(number["value"] - value) < 2.0 * half and 0.3 * half < high - low < 3.0 * half
    assert identified["effects"][0]["text"].startswith("offset of hinge.position")
    assert identified["effects"][0]["value"] == pytest.approx(-0.0005, abs=5e-5)
    assert f"# joints.hinge.friction.viscous: {number['value']:.9g} ± " in Path("found.yaml").read_text()
    # On the moon no friction makes the model fit, not even a second of the machine.
    Path("model.yaml").write_text(Path("model.yaml").read_text().replace("-9.81", "-1.62"))
    assert main(["run", "machine.yaml", *"--duration 1 --rate 100 --out short.mcap".split()]) == 0
    bag = [*commands[2][1:3], "short.mcap", *commands[2][4:8], "--html", "far.html", "--json", "far.json"]
    assert main(bag) == 0 and not json.loads(Path("far.json").read_text())["in_reach"]
    text = " ".join(capsys.readouterr().out.split())
    assert all("no run near to the noise was found" in each for each in (text, Path("far.html").read_text()))
