# SPDX-License-Identifier: Apache-2.0
"""The installed package meets the expectations of pip, the ament index and `ros2 run`."""

import argparse
import ast
import importlib.metadata
import json
import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from importlib import import_module
from pathlib import Path

import pytest
import yaml
from ament_index_python.packages import get_package_prefix, get_package_share_directory

import liegroup_core
import liegroup_sim_ros
from liegroup_core import Simulation, load_scene
from liegroup_sim_ros.commands.main import COMMANDS, make_parser
from liegroup_sim_ros.messages.samples import OPTIONAL
from liegroup_sim_ros.node.parameters import TABLE

NAME = "liegroup_sim_ros"
SOURCE = Path(__file__).resolve().parents[2]

# Imports every module of the packages named, then prints which modules that brought.
IMPORT_ALL = """
import importlib, pkgutil, sys
for name in sys.argv[1:]:
    module = importlib.import_module(name)
    for found in pkgutil.walk_packages(getattr(module, "__path__", []), name + "."):
        importlib.import_module(found.name)
print(*sys.modules)
"""


@pytest.fixture(autouse=True)
def ament_path(monkeypatch):
    """Set the ament path, as setup.bash does in a workspace; pip does not."""
    sourced = os.environ.get("AMENT_PREFIX_PATH")
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join(filter(None, [sourced, sys.prefix])))


def imported_by(*names):
    printed = subprocess.run(
        [sys.executable, "-P", "-c", IMPORT_ALL, *names], check=True, stdout=subprocess.PIPE, text=True
    ).stdout
    return set(printed.split())


def test_tests_run_against_the_installed_package():
    site_packages = Path(importlib.metadata.distribution(NAME).locate_file("")).resolve()
    for package in (liegroup_core, liegroup_sim_ros):
        assert Path(package.__file__).resolve().is_relative_to(site_packages)


def test_version_is_the_same_everywhere():
    package_xml = ElementTree.parse(SOURCE / "package.xml")
    assert package_xml.findtext("name") == NAME
    assert package_xml.findtext("version") == importlib.metadata.version(NAME)
    assert liegroup_sim_ros.__version__ == importlib.metadata.version(NAME)


def test_share_files_are_installed():
    share = Path(get_package_share_directory(NAME))
    files = [
        path.relative_to(SOURCE)
        for pattern in (
            "package.xml",
            "config/*.yaml",
            "config/*.rviz",
            "config/*.json",
            "config/scenes/*.yaml",
            "launch/*.launch.*",
        )
        for path in SOURCE.glob(pattern)
    ]
    assert Path("config/scenes/heavy_top.yaml") in files
    for file in files:
        assert (share / file).read_bytes() == (SOURCE / file).read_bytes()


def rviz_displays(displays):
    """All displays of an RViz configuration, those in groups too."""
    for display in displays:
        yield display
        yield from rviz_displays(display.get("Displays", ()))


def test_the_displays_of_rviz_show_topics_of_the_preset():
    """With their types; poses with estimated errors of every body of its scene."""
    preset = yaml.safe_load((SOURCE / "config" / "show.yaml").read_text())
    values = preset["/**"]["ros__parameters"]
    layout = Simulation(load_scene(values["scene"])).layout
    published = {"~/markers": "visualization_msgs/msg/MarkerArray"} | {
        topic: message_type
        for name, (make, _) in OPTIONAL.items()
        if values.get(name)
        for topic, message_type, _ in make(layout, "world")
    }
    rviz = yaml.safe_load((SOURCE / "config" / "scene.rviz").read_text())
    shown = {
        display["Topic"]["Value"].replace("/sim_node", "~"): display
        for display in rviz_displays(rviz["Visualization Manager"]["Displays"])
        if "Topic" in display
    }
    types = {
        "rviz_default_plugins/MarkerArray": "visualization_msgs/msg/MarkerArray",
        "rviz_default_plugins/PoseWithCovariance": "geometry_msgs/msg/PoseWithCovarianceStamped",
    }
    assert values["marker_rate"] > 0.0
    for topic, display in shown.items():
        assert published[topic] == types[display["Class"]] and display["Enabled"] is True, topic
    assert shown.keys() == {"~/markers"} | {f"~/{body}/pose_with_covariance" for body in layout.body_names}
    # A namespace moves them all.
    launch = (SOURCE / "launch" / "sim.launch.py").read_text()
    moved = ast.literal_eval(re.search(r"SHOWN = (\(.*?\))\n", launch, re.DOTALL)[1])
    assert {f"~/{topic}" for topic in moved} == shown.keys()


def test_layouts_show_only_topics_of_the_node():
    documented = (SOURCE / "docs" / "reference" / "node.md").read_text()
    foxglove = json.loads((SOURCE / "config" / "foxglove.json").read_text())["configById"]
    shown = {
        *foxglove["3D!scene"]["topics"],
        *(path["value"].partition(".")[0] for path in foxglove["Plot!joints"]["paths"]),
        foxglove["DiagnosticStatusPanel!figures"]["topicToRender"],
    }
    assert len(shown) == 3
    preset = yaml.safe_load((SOURCE / "config" / "show.yaml").read_text())["/**"]["ros__parameters"]
    joints = Simulation(load_scene(preset["scene"])).layout.coordinates.names
    curves = [f"{value}[{k}]" for value in ("position", "velocity") for k in range(len(joints))]
    paths = [path["value"] for path in foxglove["Plot!joints"]["paths"]]
    assert paths == [f"/sim_node/joint_states.{curve}" for curve in curves]
    for topic in shown:
        assert f"`{topic.replace('/sim_node', '~')}`" in documented, topic


def test_the_launch_file_compiles_and_its_preset_exists():
    """`launch` has no wheel, so starting the node by it is tested only with a ROS installation."""
    text = (SOURCE / "launch" / "sim.launch.py").read_text()
    tree = ast.parse(text)
    (table,) = (node.value for node in tree.body if isinstance(node, ast.Assign) and node.targets[0].id == "ARGUMENTS")
    arguments = {key.value: ast.literal_eval(value) for key, value in zip(table.keys, table.values) if key}
    assert (SOURCE / "config" / f"{arguments['preset'][0]}.yaml").exists()
    used = set(re.findall(r'LaunchConfiguration\("(\w+)"\)', text)) - {"params_file"}
    assert used == set(arguments) and not used & {entry.name for entry in TABLE}
    assert {type(entry.default) for entry in TABLE} <= {str, float, int, bool}
    (node,) = re.findall(r'package=PACKAGE,\s+executable="(\w+)",\s+name="(\w+)"', text)
    assert node == ("sim_node", "sim_node") and (SOURCE / "liegroup_sim_ros/node/entry.py").exists()
    remapped = re.findall(r'\("/(\w+)", LaunchConfiguration', text)
    assert remapped == ["clock", "tf"]


@pytest.mark.parametrize("start", ["ros2 run", "python -m"])
@pytest.mark.turn(3)
def test_node_is_found_and_answers(start):
    command = (
        [Path(get_package_prefix(NAME), "lib", NAME, "sim_node")]
        if start == "ros2 run"
        else [sys.executable, "-P", "-m", f"{NAME}.node.entry"]
    )
    ended = subprocess.run(
        [*command, "--ros-args", "-p", "scene:=no_such_scene"],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=60,
    )
    assert ended.returncode == 2
    assert "no_such_scene" in ended.stdout
    assert "Traceback" not in ended.stdout


@pytest.mark.turn(3)
def test_core_imports_no_ros():
    modules = imported_by("liegroup_core")
    assert "liegroup_core.simulation" in modules
    roots = {name.partition(".")[0] for name in modules}
    assert not {root for root in roots if root.endswith(("_msgs", "_srvs", "_interfaces"))}
    assert not roots & {"rclpy", "rosidl_runtime_py", "rosidl_parser", NAME}


@pytest.mark.turn(3)
def test_analysis_does_not_import_rclpy():
    assert "rclpy" not in imported_by(
        *(f"{NAME}.{part}" for part in ("messages", "recording", "analysis", "report")),
        f"{NAME}.commands.analyze",
        f"{NAME}.playback.resimulate",
        f"{NAME}.playback.player_file",
    )


# Imports at start-up: heavy modules cost seconds, so unneeded ones must not be imported.


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
