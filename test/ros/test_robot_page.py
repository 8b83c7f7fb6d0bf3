# SPDX-License-Identifier: Apache-2.0
"""Files and commands of the page "Bring your robot" run as printed; exit codes of the import."""

import re
import shlex
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from node_process import NodeProcess
from robot_texts import five_bar_urdf
from scene_files import text_of
from sensor_msgs.msg import JointState

from liegroup_core import Simulation, load_scene
from liegroup_sim_ros.analysis import analyse
from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.messages.description import robot_description
from liegroup_sim_ros.playback.resimulate import resimulate
from liegroup_sim_ros.recording import read_recording
from liegroup_sim_ros.report.shapes import MOST_TRIANGLES, decoded, robot_shapes, shapes_from
from liegroup_sim_ros.report.view import make_view

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE = (DOCS / "how-to" / "robot.md").read_text()
[ROBOT] = re.findall(r"```xml\n(.*?)```", PAGE, re.DOTALL)
[CLOSED, SENSED] = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
BLOCKS = re.findall(r"```sh\n(.*?)\n```", PAGE, re.DOTALL)
LINES = [shlex.split(line) for block in BLOCKS for line in block.splitlines()]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "arm.urdf").write_text(ROBOT)
    (tmp_path / "closed.yaml").write_text(CLOSED)
    (tmp_path / "sensed.yaml").write_text(SENSED)
    shutil.copytree(DOCS / "robots", tmp_path / "docs" / "robots")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.turn(3)
def test_all_commands_of_the_page(folder, capsys):
    done = []
    for program, *arguments in LINES:
        if program == "liegroup_sim":
            assert main(arguments) == 0, arguments
            done.append(arguments[0])
    closed, sensed = ["describe", "run"], ["describe", "run", "import"]
    first = ["describe", "run", "analyze", "import", "run", *closed, *sensed]
    assert done == [*first, "run", "run", "run", "import", "run", "analyze", "import"]
    assert {"flange", "shoulder", "elbow"} < set(read_recording("sensed.mcap").reactions)
    (rod,) = load_scene("rod.yaml").bodies
    assert rod.com == (0.0, 0.0, -0.4)
    for name in ("five_bar", "lift", "stewart", "swing"):
        poses = read_recording(f"{name}.mcap").pose
        assert max(np.ptp(each.position, axis=0).max() for each in poses.values()) > 0.01
    printed = " ".join(capsys.readouterr().out.split())
    assert main(["run", "arm.urdf", "--no-stops", "--duration", "0.1", "--out", "free.mcap"]) == 0
    assert "arm: changes the motion: joint limits are not enforced: shoulder" in capsys.readouterr().err
    for note in re.findall(r"^    (\w+ [\w ]*?\w)   +(.*)$", PAGE, re.MULTILINE):
        assert " ".join(note) in printed
    assert "arm: 2 degrees of freedom" in printed and "arm: 1 degree of freedom" in printed


def test_a_recording_is_repeated_without_the_robots_file(folder):
    assert main(["run", "closed.yaml", "--duration", "0.5", "--out", "run.mcap"]) == 0
    for path in ("arm.urdf", "closed.yaml"):
        (folder / path).unlink()
    figures = resimulate(read_recording("run.mcap"))
    assert figures["identical"] == figures["samples"] > 10


@pytest.mark.turn(3)
def test_the_command_beside_robot_state_publisher(folder, client):
    """/tf needs tf2_msgs, which is not on PyPI: without it the node publishes the rest."""
    assert ["sim_node", "--ros-args", "-p", "scene:=arm.urdf"] in LINES
    ((command, publisher),) = re.findall(r"^ +sim_node (.*)\n +ros2 run (.*)$", PAGE, re.MULTILINE)
    parameters = dict(re.findall(r"-p (\w+):=(\S+)", command))
    assert parameters["tf_links"] == "roots" and parameters["scene"] == "arm.urdf"
    with NodeProcess(parameters) as process:
        states = client.listen("/sim_node/joint_states", JointState)
        client.until(lambda: states, "joint states")
        process.end()
    assert states[-1].name == ["shoulder", "elbow"]
    assert publisher.startswith("robot_state_publisher robot_state_publisher arm.urdf ")


def test_import_writes_what_load_scene_takes(folder, capsys):
    robot = folder / "five_bar.urdf"
    robot.write_text(five_bar_urdf())
    close = ["--close", "left_end", "right_end", "revolute"]
    assert main(["import", str(robot), "--start", "left_crank=0.05", *close, "--out", "a.yaml"]) == 0
    errors = capsys.readouterr().err
    assert "a.yaml: 4 bodies, 5 joints" in errors and "merged into left_bar: left_end" in errors
    scene = load_scene("a.yaml")
    tips = [
        Simulation(scene, "rkmk4", 1e-3).sample().poses[f"{side}_bar"] @ (1.2, 0, 0, 1) for side in ("left", "right")
    ]
    assert tips[0] == pytest.approx(tips[1], abs=1e-12)
    assert main(["import", "closed.yaml", "--out", "all.yaml"]) == 0
    assert (
        Path("all.yaml")
        .read_text()
        .startswith("# 4 links of the file -> 2 bodies, 2 joint coordinates -> 2\nname: arm\n")
    )
    assert load_scene("all.yaml").model_dump() == load_scene("closed.yaml").model_dump()
    assert main(["import", "closed.yaml", "--start", "elbow=1"]) == 2
    assert "closed.yaml: is a scene file" in capsys.readouterr().err
    assert main(["import", str(robot), "--lock", "left_crank=0", "right_crank=0"]) == 0
    assert "name: left_bar" in capsys.readouterr().out


def test_options_of_robots_work_with_run_and_describe(folder, capsys):
    start = ["--start", "shoulder=0.3", "elbow=0.5"]
    assert main(["run", "arm.urdf", "--duration", "0.1", "--out", "a.npz", *start]) == 0
    assert main(["import", "arm.urdf", *start, "--out", "arm.yaml"]) == 0
    assert main(["run", "arm.yaml", "--duration", "0.1", "--out", "b.npz"]) == 0
    runs = [np.load(name) for name in ("a.npz", "b.npz")]
    assert all(np.array_equal(runs[0][key], runs[1][key]) for key in ("poses", "twists"))
    elbow = (0.5 * np.cos(0.3), 0, -0.5 * np.sin(0.3))
    assert runs[0]["poses"][0, 1, :3, 3] == pytest.approx(elbow, abs=1e-14)
    capsys.readouterr()
    assert main(["describe", "arm.urdf", "--lock", "elbow=0.5"]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "arm: 1 degree of freedom" in printed and "locked joint elbow at 0.5" in printed
    for command in (["describe"], ["run", "--duration", "1", "--out", "c.npz"]):
        for arguments, expected in (
            (["arm.urdf", "--start", "elbov=1"], 'did you mean "elbow"'),
            (["arm.urdf", "--close", "tool", "base", "glue"], "type 'glue'"),
            (["heavy_top", "--lock", "elbow=1"], "heavy_top.yaml: is a scene file"),
        ):
            assert main([command[0], *arguments, *command[1:]]) == 2
            errors = capsys.readouterr().err
            assert errors.count("\n") == 1 and expected in errors, errors
    assert not Path("c.npz").exists()


@pytest.mark.turn(3)
def test_what_cannot_move_is_refused_by_import_as_by_describe(folder, capsys):
    Path("stretched.yaml").write_text(
        "robot: arm.urdf\njoints:\n  - {name: rod, type: revolute, parent: world, child: tool, "
        "parent_frame: {position: [0.9, 0, 0], axis: [0, 1, 0]}, child_frame: {axis: [0, 1, 0]}}\n"
    )
    said = []
    for arguments in (["describe"], ["import", "--out", "all.yaml"]):
        assert main([arguments[0], "stretched.yaml", *arguments[1:]]) == 2
        said.append(capsys.readouterr().err)
    assert said[0] == said[1] and "its loop is fully stretched" in said[0]
    assert said[0].count("\n") == 1 and not Path("all.yaml").exists()


BALL_URDF = text_of("ball.urdf")


@pytest.mark.turn(3)
def test_the_page_draws_meshes_within_its_bound(tmp_path, capsys, monkeypatch):
    """A sphere of 81 920 triangles, scaled to an ellipsoid, is decimated; its shape stays."""
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("fast_simplification")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "meshes").mkdir()
    trimesh.creation.icosphere(subdivisions=6).export("meshes/ball.stl")
    Path("ball.urdf").write_text(BALL_URDF)
    shapes, remarks = robot_shapes(load_scene("ball.urdf").robot)
    assert remarks == ["missing mesh files: 1, the first is package://nowhere/rod.stl"]
    [ball] = shapes["ball"]
    points, faces = decoded(ball)
    assert 15_000 < len(faces) <= MOST_TRIANGLES and faces.max() < len(points)
    # Half axes 0.1, 0.2 and 0.1 m, as x of the mesh is y of the link. An edge of 20 000 triangles is
    # 0.03 of the radius long: its middle is 1e-4 of it inside, and decimation moves points as far.
    inside = np.linalg.norm((points - (0.5, 0.1, 0.0)) / (0.1, 0.2, 0.1), axis=1)
    assert np.abs(inside - 1.0).max() < 2e-3
    assert ball["at"] == pytest.approx((0.5, 0.1, 0.0), abs=1e-4)
    assert main(["run", "ball.urdf", "--duration", "0.5", "--out", "run.mcap"]) == 0
    report = ["analyze", "run.mcap", "--no-reference", "--html", "run.html", "--robot"]
    assert main([*report, "ball.urdf"]) == 0
    assert ball["points"] in Path("run.html").read_text()
    assert "missing mesh files: 1" in capsys.readouterr().err
    Path("arm.urdf").write_text(ROBOT)
    assert main([*report, "arm.urdf"]) == 2
    assert "its bodies differ from those of the recording" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "trimesh", None)
    assert main([*report, "ball.urdf"]) == 0
    assert "drawn as boxes, because trimesh is not installed" in capsys.readouterr().err
    assert ball["points"] not in Path("run.html").read_text()


@pytest.mark.parametrize("told", [True, False])
def test_visuals_of_a_robot_that_floats(tmp_path, monkeypatch, told):
    """The recording says how the file was mapped; of an imported scene, it is found whether the root link floats."""
    monkeypatch.chdir(tmp_path)
    Path("arm.urdf").write_text(ROBOT)
    options = ["--base", "floating", *(["--lock", "elbow=0.5"] if told else [])]
    assert main(["import", "arm.urdf", *options, "--out", "arm.yaml"]) == 0
    run = ["arm.urdf", *options] if told else ["arm.yaml"]
    assert main(["run", *run, "--duration", "0.1", "--out", "run.mcap"]) == 0
    shapes, _ = shapes_from("arm.urdf", load_scene("arm.yaml"), read_recording("run.mcap").settings.get("robot"))
    if told:  # a box along x up to 0.5 m, and beyond the locked elbow a cylinder across its end: one mesh
        c, s = np.cos(0.5), np.sin(0.5)
        expected = 0.5 * (0.5 + 0.2 * c + 0.2 * s + 0.03 * c), 0.0, -0.2 * s
        assert shapes["upper"][0]["at"] == pytest.approx(expected, abs=1e-4)  # it has some 30 facets
    else:
        assert shapes["upper"][0]["at"] == pytest.approx((0.25, 0, 0))
        assert shapes["lower"][0]["at"] == pytest.approx((0.2, 0, 0))
    report = ["analyze", "run.mcap", "--no-reference", "--html", "run.html", "--robot", "arm.urdf"]
    assert main(report) == 0


def test_the_page_lists_what_does_not_act(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("ball.urdf").write_text(BALL_URDF.replace("</joint>", '<dynamic damping="4"/></joint>'))
    assert main(["run", "ball.urdf", "--duration", "0.1", "--out", "run.mcap"]) == 0
    assert main(["analyze", "run.mcap", "--no-reference", "--html", "run.html"]) == 0
    page = Path("run.html").read_text()
    assert "change the motion:</p><ul" in page and "no numerical problem found, 1 note on the model" in page
    assert "<li>unknown parts of the URDF file, left out: &lt;dynamic&gt; in &lt;joint&gt; of line" in page


@pytest.mark.turn(3)
def test_a_damaged_mesh_leaves_a_box(tmp_path):
    pytest.importorskip("trimesh")
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "ball.stl").write_bytes(b"solid \xff\x00" * 9)
    (tmp_path / "ball.urdf").write_text(BALL_URDF)
    shapes, remarks = robot_shapes(load_scene(tmp_path / "ball.urdf").robot)
    assert not shapes and any("unreadable mesh files: 1, the first is meshes/ball" in r for r in remarks)


DRAWN = text_of("drawn.xml")


def test_shapes_of_mjcf_are_those_of_the_compiled_model(tmp_path, monkeypatch):
    """Bounds of meshes are those of MuJoCo's points; volumes of others those of its masses at density 1."""
    trimesh, mujoco = pytest.importorskip("trimesh"), pytest.importorskip("mujoco")
    wedge = trimesh.convex.convex_hull([[100, 50, 10], [160, 50, 10], [100, 80, 10], [100, 50, 30]])
    wedge.export(tmp_path / "m.stl")
    (tmp_path / "drawn.xml").write_text(DRAWN)
    scene = load_scene(tmp_path / "drawn.xml")
    shapes, remarks = robot_shapes(scene.robot)
    assert not remarks and " (plane of world)" in " ".join(scene.notes)
    assert "left out: shapes of geom groups above 2, which MuJoCo hides (sphere of d)" in scene.notes
    assert "<mesh" not in robot_description(scene)  # they have no file in the frame of their geom: boxes
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "drawn.xml"))
    found = {body: trimesh.Trimesh(*decoded(shape)) for body, [shape] in shapes.items()}
    for geom in (i for i in range(model.ngeom) if model.geom_type[i] == mujoco.mjtGeom.mjGEOM_MESH):
        mesh, turn = model.geom_dataid[geom], np.zeros(9)
        mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
        points = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
        points = points @ turn.reshape(3, 3).T + model.geom_pos[geom]
        shape = found[model.body(model.geom_bodyid[geom]).name]
        # Numbers of 32 bits, up to 2 m.
        assert shape.bounds == pytest.approx(np.array([points.min(axis=0), points.max(axis=0)]), abs=4e-7)
        assert shape.volume == pytest.approx(trimesh.convex.convex_hull(points).volume, rel=1e-4)
    for body in "ef":  # 32 facets around have 0.64 % less area than the circle, a ball of 1280 has 0.9 % less volume
        assert found[body].volume == pytest.approx(model.body(body).mass[0], rel=0.01)
    assert found["f"].bounds == pytest.approx(np.array([[-0.1, 0, -0.1], [0.1, 0.2, 0.5]]), abs=1e-6)
    assert found["world"].volume == pytest.approx(0.016)
    expected = {"a": (0.9, 0.1, 0.1, 0.5), "b": None, "c": (1, 127 / 255, 0.5 * 63 / 255, 1), "d": (0.1, 0.2, 0.3, 1)}
    for body, color in expected.items():
        assert shapes[body][0]["color"] == (color if color is None else pytest.approx(color, abs=1e-6))
    monkeypatch.chdir(tmp_path)
    assert main(["run", "drawn.xml", "--duration", "0.02", "--out", "run.mcap"]) == 0
    view = make_view(analyse(read_recording("run.mcap"), reference=False), shapes)
    drawn = {body["name"]: body["colour"] for body in view["bodies"]}  # of its path and in the legend
    assert (drawn["a"], drawn["b"], drawn["c"]) == ("rgb(229,26,26)", "--orange", "rgb(255,127,32)")


COLLADA = text_of("textured.dae")
COLOURED = text_of("coloured.urdf")
COLOURED_SDF = """<sdf version="1.9"><model name="m"><link name="l"><visual name="v">
<transparency>0.5</transparency><geometry><ellipsoid><radii>0.1 0.2 0.3</radii></ellipsoid></geometry>
<material><ambient>1 1 1</ambient><diffuse>0 0.5 1 1</diffuse></material></visual></link></model></sdf>"""


def test_units_of_collada_and_colours_of_urdf_and_sdf(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("collada")
    for name, text in (("m.dae", COLLADA), ("r.urdf", COLOURED), ("r.sdf", COLOURED_SDF)):
        (tmp_path / name).write_text(text)
    mesh, capsule = robot_shapes(load_scene(tmp_path / "r.urdf").robot)[0]["l"]
    shape = trimesh.Trimesh(*decoded(mesh))
    assert shape.bounds == pytest.approx(0.0254 * np.array([[10, -16, 1], [16, -10, 3]]), abs=1e-7)
    assert shape.volume == pytest.approx(2 * 6.0 * 0.0254**3, rel=1e-5)  # a sixth of the edges, mirrored and stretched
    assert (mesh["color"], capsule["color"]) == ([0, 0, 1, 1], [1, 0, 0, 0.5])
    assert capsule["size"] == pytest.approx([0.2, 0.2, 0.6], abs=1e-6)
    [ellipsoid] = robot_shapes(load_scene(tmp_path / "r.sdf").robot)[0]["l"]
    assert ellipsoid["color"] == [0, 0.5, 1, 0.5] and ellipsoid["size"] == pytest.approx([0.2, 0.4, 0.6], abs=1e-6)
