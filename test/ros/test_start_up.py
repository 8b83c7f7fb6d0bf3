# SPDX-License-Identifier: Apache-2.0
"""Imports at start-up: heavy modules cost seconds, so unneeded ones must not be imported."""

import argparse
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from liegroup_sim_ros.commands.main import COMMANDS, make_parser

REFERENCE = Path(__file__).parents[2] / "docs" / "reference"
HEAVY = ("numba", "numpy", "scipy", "pydantic", "rich", "rclpy", "plotly", "pandas", "dask")


def imported(code):
    """Heavy packages that a process has imported after running `code`."""
    printed = subprocess.run(
        [sys.executable, "-P", "-c", f"{code}\nimport sys\nprint('\\n', *sys.modules)"],
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    ).stdout
    return set(printed.splitlines()[-1].split()).intersection(HEAVY)


def test_help_and_the_bare_core_import_nothing_heavy():
    assert not imported("import liegroup_core")
    assert not imported(
        "from contextlib import suppress\n"
        "from liegroup_sim_ros.commands.main import main\n"
        "with suppress(SystemExit): main(['--help'])"
    )


def test_a_simulation_imports_only_its_solver():
    found = imported("from liegroup_core import Simulation, load_scene")
    assert "numpy" in found
    assert found.isdisjoint({"numba", "rich", "rclpy", "plotly", "pandas", "dask"})


def test_scipy_integrate_is_imported_only_for_references():
    code = "import sys\nfrom liegroup_core import Simulation\nassert 'scipy.integrate' not in sys.modules"
    assert imported(code)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help(name, capsys):
    with pytest.raises(SystemExit) as ended:
        make_parser(name).parse_args([name, "--help"])
    assert ended.value.code == 0 and f"liegroup_sim {name}" in capsys.readouterr().out
    parser = argparse.ArgumentParser()
    import_module(f"liegroup_sim_ros.commands.{name}").add_arguments(parser)
    assert parser.description.endswith(".")
    assert f"`{name}`" in (REFERENCE / "commands.md").read_text(encoding="utf-8")


def test_all_public_names_of_the_core_exist():
    import liegroup_core

    for name in liegroup_core.__all__:
        assert getattr(liegroup_core, name).__name__ == name
    with pytest.raises(AttributeError, match="no attribute 'Simulator'"):
        liegroup_core.Simulator  # noqa: B018
