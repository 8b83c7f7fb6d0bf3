# SPDX-License-Identifier: Apache-2.0
"""Wrong robot files: one line with file and line, whatever is wrong, in bounded time."""

import itertools
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from robot_damage import mutated
from robot_texts import (
    ARM_MJCF,
    ARM_SDF,
    ARM_URDF,
    FIVE_BAR_TIP,
    MJCF_WITH_ALL_JOINTS,
    five_bar_urdf,
    mimic_urdf,
    written,
)
from scene_files import cases, filled, text_of
from volume import VERIFY, some

from liegroup_core import SceneError, Simulation, load_scene
from liegroup_core.layout import make_layout
from liegroup_core.robots import apart
from liegroup_core.robots.access import served_from
from liegroup_core.robots.options import Options
from liegroup_core.scene.load import scene_from_robot, scene_from_text

SECONDS = 20.0  # far above the time of a correct file, also on a loaded machine


def refusal(path):
    """Text of the one line that a file is refused with."""
    with pytest.raises(SceneError) as caught:
        make_layout(load_scene(path))
    text = str(caught.value)
    assert "\n" not in text and text.startswith(str(path)) and len(text) < 1000, text
    return text


def table(name):
    """[(file, row)] of a table of changes of robot files."""
    rows = yaml.safe_load(Path(__file__).with_name(name).read_text(encoding="utf-8"))
    return [(file, row) for file, cases in rows.items() for row in cases]


def files(folder):
    """Write the robot files that the tables change; {name: text}."""
    found = {
        "arm.urdf": ARM_URDF,
        "arm.sdf": ARM_SDF,
        "arm.xml": filled(ARM_MJCF, upper="0.02 0.03 0.025 0.001 -0.002 0.0015"),
        "all.xml": MJCF_WITH_ALL_JOINTS,
        "five_bar.urdf": five_bar_urdf(),
        "hand.urdf": mimic_urdf(folder).read_text(),
        "open.srdf": '<robot name="hand"><group_state name="open" group="g"><joint name="drive" value="1"/>'
        "</group_state></robot>",
        **{name: text_of(name) for name in ("mimic.urdf", "elbow.urdf", "beside.yaml")},
    }
    for name, text in found.items():
        (folder / name).write_text(text)
    return found


def changed(folder, file, row):
    """Path of a file with the change of a row; a file of another name has its second text only."""
    text, (old, new) = files(folder).get(file, ""), row["change"]
    assert old in text
    return written(folder / file, text.replace(old, new, 1))


@pytest.mark.parametrize("file, row", table("wrong_robots.yaml"), ids=str)
def test_a_wrong_robot_has_one_line(file, row, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = changed(tmp_path, file, row)
    with pytest.raises(SceneError) as caught:
        make_layout(scene_from_robot(path, Options(**row["options"])) if "options" in row else load_scene(path))
    text = str(caught.value)
    assert "\n" not in text and len(text) < 1000 and "root:" not in text, text
    assert all(part in text for part in row["says"]), text


@pytest.mark.parametrize("file, row", table("robot_notes.yaml"), ids=str)
def test_what_looks_wrong_is_noted(file, row, tmp_path):
    scene = load_scene(changed(tmp_path, file, row))
    found = [note for note in scene.notes if row["note"] in note]
    assert [note in scene.differences for note in found] == ([] if row["motion"] is None else [row["motion"]])


@pytest.mark.parametrize(
    "text",
    ["<robot>" + "<link>" * 5000 + "</link>" * 5000 + "</robot>", f"<robot name='x'><a b='{'x' * 10**6}'/></robot>"],
)
def test_long_files_are_refused_soon(text, tmp_path):
    start = time.perf_counter()
    refusal(written(tmp_path / "robot.xml", text))
    assert time.perf_counter() - start < SECONDS


MESHES = text_of("meshes.xml")
OWN = '<inertial pos="0 0 0.5" mass="2" diaginertia="1 1 1"/>'


@pytest.mark.parametrize(
    "inertial, mass, rule, expected",
    [
        (OWN, "", "", 2.0),
        ("", 'density="0"', "", 48.0),
        ("", 'group="4"', 'inertiagrouprange="0 2"', 48.0),
        ("", "", "", None),
        ("", 'mass="1"', "", None),
        (OWN, "", 'inertiafromgeom="true"', None),
    ],
)
@pytest.mark.turn(3)
def test_a_mesh_of_mjcf_may_be_missing_unless_a_mass_follows_from_it(inertial, mass, rule, expected, tmp_path):
    path = written(tmp_path / "mesh.xml", filled(MESHES, inertial=inertial, mass=mass, rule=rule))
    if expected is None:
        text = refusal(path)
        assert text.startswith(f"{path}:2: mjcf: mesh file 'meshes/nope.stl' does not exist"), text
        assert 'the mass of body "arm" follows' in text
        return
    scene = load_scene(path)
    assert scene.bodies[0].mass == pytest.approx(expected, rel=1e-12)
    assert "through each other: without effect 3 collision shapes of arm" in " ".join(scene.notes)
    assert [note for note in scene.notes if "mesh files" in note] == [
        "left out: missing mesh files (meshes/nope.stl of arm)"
    ]
    assert [visual.kind for visual in scene.robot.visuals["arm"]] == ["box"]


XACRO = text_of("two.xacro")


@pytest.mark.turn(3)
def test_xacro_files(tmp_path):
    path = written(tmp_path / "two.urdf.xacro", XACRO)
    scene = load_scene(path)
    assert scene.bodies[0].com == (0.25, 0.0, 0.0) and "two.urdf.xacro" in scene.description
    path.write_text(XACRO.replace("length / 2", "lenght / 2"))
    # The call of the macro is what xacro handles: an element that a macro makes is in no file.
    assert "two.urdf.xacro:6: xacro: name 'lenght' is not defined" in refusal(path)
    (tmp_path / "part.xacro").write_text('<robot>\n\n<link name="${x}"/></robot>')
    line = '<xacro:include filename="part.xacro"/>'
    path.write_text(XACRO.replace("<link name", f"{line}<link name", 1))
    with pytest.raises(SceneError, match=r"part\.xacro:3: xacro: name 'x' is not defined"):
        load_scene(path)
    path.write_text(XACRO.replace("xacro:rod name", "xacro:rot name"))
    assert "two.urdf.xacro:6: xacro: unknown macro name: xacro:rot" in refusal(path)
    # A macro that calls itself for ever.
    path.write_text(XACRO.replace('<link name="${name}">', '<xacro:rod name="b"/><link name="x">'))
    start = time.perf_counter()
    assert "xacro" in refusal(path) and time.perf_counter() - start < SECONDS


XACRO_WITH_ARGUMENTS = (
    XACRO.replace('<xacro:property name="length" value="0.5"/>', '<xacro:arg name="m" default="1"/>'
        '<xacro:arg name="length" default="0.5"/><xacro:property name="length" value="$(arg length)"/>')
    .replace('<mass value="1"/>', '<mass value="$(arg m)"/>')
)  # fmt: skip


@pytest.mark.turn(3)
def test_xacro_finds_the_packages_around_a_file(tmp_path, monkeypatch):
    """The folder of the package by its name or its package.xml, packages beside it, AMENT_PREFIX_PATH first."""
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    part = '<robot xmlns:xacro="http://ros.org"><xacro:property name="length" value="{}"/></robot>'
    files = {"arm_src": 0.5, "other_src": 0.8, "installed/share/other": 1.0}
    for folder, length in files.items():
        (tmp_path / folder / "urdf").mkdir(parents=True)
        (tmp_path / folder / "urdf" / "part.xacro").write_text(part.format(length))
    for folder, name in (("arm_src", "arm"), ("other_src", "other")):
        (tmp_path / folder / "package.xml").write_text(f"<package><name>{name}</name></package>")
    path = tmp_path / "arm_src" / "urdf" / "two.urdf.xacro"

    def length(package):
        line = f'<xacro:include filename="$(find {package})/urdf/part.xacro"/>'
        path.write_text(XACRO.replace('<xacro:property name="length" value="0.5"/>', line))
        return 2 * load_scene(path).bodies[0].com[0]

    assert [length(name) for name in ("arm", "arm_src", "other", "other_src")] == [0.5, 0.5, 0.8, 0.8]
    with pytest.raises(SceneError, match=r"xacro:2: xacro: the package 'none' is not found: source its workspace"):
        length("none")
    with served_from([tmp_path / "arm_src"]):
        assert length("arm") == 0.5
        with pytest.raises(SceneError, match="xacro: .*part.xacro is not read|package 'other' is not found"):
            length("other")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "installed"))
    assert length("other") == 1.0
    (tmp_path / "arm_src" / "package.xml").unlink()
    assert length("arm_src") == 0.5


@pytest.mark.turn(3)
def test_arguments_of_xacro(tmp_path):
    path, beside = tmp_path / "two.urdf.xacro", tmp_path / "two.yaml"
    path.write_text(XACRO_WITH_ARGUMENTS)
    assert load_scene(path).bodies[0].mass == 1.0
    (body,) = scene_from_robot(path, Options(xacro={"m": "3", "length": "0.8"})).bodies
    assert (body.mass, body.com) == (3.0, (0.4, 0.0, 0.0))
    beside.write_text("robot: two.urdf.xacro\nxacro: {m: 2.5, length: 1}\n")
    (body,) = load_scene(beside).bodies
    assert (body.mass, body.com) == (2.5, (0.5, 0.0, 0.0))
    with pytest.raises(SceneError, match="'lenght' is not used by the file; did you mean \"length\"?"):
        scene_from_robot(path, Options(xacro={"lenght": "3"}))
    beside.write_text("robot: two.urdf.xacro\nxacro: {m: [1]}\n")
    assert refusal(beside).startswith(f"{beside}:2: xacro must have one text, number")
    plain = written(tmp_path / "arm.urdf", ARM_URDF)
    with pytest.raises(SceneError, match="is not a xacro file and takes no arguments: omit m"):
        scene_from_robot(plain, Options(xacro={"m": "1"}))


@pytest.mark.turn(3)
def test_a_model_that_needs_too_much_memory_is_refused(tmp_path):
    text = '<body><freejoint/><geom size="0.1"/></body>'
    for _ in range(3):
        text = f'<replicate count="200" offset="1 0 0">{text}</replicate>'
    path = written(tmp_path / "many.xml", f"<mujoco><worldbody>{text}</worldbody></mujoco>")
    assert "mjcf needs more than 1 GiB of memory" in refusal(path)


# Texts, and how many damaged ones there are and are tried on a day.
TEXTS = {
    "urdf": (ARM_URDF, 300, 30),
    "sdf": (ARM_SDF, 300, 30),
    "xml": (filled(ARM_MJCF, upper="0.02 0.03 0.025 0.001 -0.002 0.0015"), 200, 8),
}


@pytest.mark.parametrize("kind", ["urdf", "sdf", pytest.param("xml", marks=pytest.mark.slow)])
def test_damaged_files_load_or_have_one_line(kind, tmp_path):
    text, count, each_commit = TEXTS[kind]
    refused, seeds = 0, some(range(count), each_commit)
    path = tmp_path / f"arm.{kind}"
    for seed in seeds:
        path.write_text(mutated(text, np.random.default_rng([5, seed])))
        start = time.perf_counter()
        try:
            make_layout(load_scene(path))
        except SceneError as error:
            refused += 1
            line = str(error)
            assert "\n" not in line and line.startswith(str(path)) and len(line) < 2000, line
        assert time.perf_counter() - start < SECONDS
    assert refused > (count // 2 if VERIFY else 0)


# Peak memory above what the program has before it reads the file, MiB. A file of the largest size has
# 64 MiB, and its tree takes up to 55 MiB. A parsed file never has both: the limit of elements comes first.
MEMORY = 150
MEASURE = """
import re, sys
from pathlib import Path
from liegroup_core import SceneError, Simulation, load_scene
# Not ru_maxrss: it begins with that of the process that started this one.
peak = lambda: int(re.search(r"VmHWM:\\s+(\\d+) kB", Path("/proc/self/status").read_text())[1]) / 1024
before = peak()
try:
    load_scene(sys.argv[1])
    text = "loaded"
except SceneError as error:
    text = str(error)
print(peak() - before)
print(text)
"""
OPENINGS = {
    "urdf": '<robot name="r"><link name="base"/>{}</robot>',
    "sdf": '<sdf version="1.9"><model name="m"><link name="base"/>{}</model></sdf>',
    "xml": "<mujoco>{}</mujoco>",
}
BOMB = "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 10 if k else "lol" * 10}">' for k in range(12))
# {what: (text before the root element, its content, what the refusal says, "" if it may load)}
LARGE = {
    "entity bomb": (f"<!DOCTYPE r [{BOMB}]>", "<link name='&e11;'/>&e11;", "ntity"),
    "deep": ("", "<a>" * 10**5 + "</a>" * 10**5, "is not XML"),
    "long attribute": ("", f'<a b="{"x" * (9 * 10**6)}"/>', ""),
    "attribute above 10 MB": ("", f'<a b="{"x" * (11 * 10**6)}"/>', "is not XML"),
    "long name": ("", f'<link name="{"x" * (9 * 10**6)}"/>', ""),
    "many elements": ("", "<a/>" * 400_000, ""),
    "too many elements": ("", "<a/>" * (16 * 10**6), "has more than 500000 elements"),
    "too many attributes": ("", "<a " + " ".join(f"a{k}=''" for k in range(600_000)) + "/>", "more"),
    "too large": ("", f"<a>{'x' * (65 * 2**20)}</a>", "is larger than 64 MiB"),
}


# The formats share the reader of XML: one format for each file.
@pytest.mark.parametrize("what, kind", list(zip(LARGE, itertools.cycle(OPENINGS))))
@pytest.mark.volume(3)
def test_a_large_file_takes_bounded_memory(kind, what, tmp_path):
    head, content, said = LARGE[what]
    path = written(tmp_path / f"robot.{kind}", head + OPENINGS[kind].format(content))
    done = subprocess.run([sys.executable, "-P", "-c", MEASURE, str(path)], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr[-500:]
    memory, text = done.stdout.split("\n", 1)
    text = text.strip()
    assert float(memory) < MEMORY and said in text
    assert text == "loaded" or text.startswith(str(path)) and "\n" not in text and len(text) < 2000


def test_a_tool_that_prints_too_much_is_refused(tmp_path, monkeypatch):
    """The limit holds in the process of the tool: it cannot fill this one's memory."""
    monkeypatch.setattr(apart, "LARGEST_OUTPUT", 1000)
    path = written(tmp_path / "arm.xml", filled(ARM_MJCF, upper="0.02 0.03 0.025 0.001 -0.002 0.0015"))
    with pytest.raises(SceneError, match="mjcf wrote more than"):
        load_scene(path)


@pytest.mark.parametrize("name", ["all.xml", "arm.xml"])
def test_mjcf_compiles_to_the_same_in_a_process_of_its_own(name, tmp_path, request):
    """Other tests compile it in theirs, see mjcf_here of conftest.py."""
    files(tmp_path)
    apart_from_here = load_scene(tmp_path / name)
    request.getfixturevalue("mjcf_here")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(apart, "SECONDS", 0.0)  # no other process ends in time
        assert repr(load_scene(tmp_path / name).model_dump()) == repr(apart_from_here.model_dump())


def test_a_package_that_is_not_there():
    with pytest.raises(SceneError, match="the package 'nowhere' is not found"):
        load_scene("package://nowhere/a.urdf")


def test_locks_that_fit_their_coupling(tmp_path):
    path = mimic_urdf(tmp_path)
    assert not scene_from_robot(path, Options(lock={"near": 0.07, "drive": 0.1}, base="floating")).joints


def test_group_states_have_joints_of_the_robot(tmp_path):
    path, srdf = mimic_urdf(tmp_path), tmp_path / "hand.srdf"
    srdf.write_text(
        '<robot name="hand"><group_state name="open" group="g"><joint name="drve" value="1"/></group_state></robot>'
    )
    with pytest.raises(SceneError, match='group state "open": the robot has no joint drve'):
        scene_from_robot(path, Options(srdf=srdf))


BESIDE = text_of("beside.yaml")
VALUES = ["", "true", "x", "-1", "1e300", ".nan", "-.inf", "[]", "{}", "[1, 2]", "[a, b, c]"]
VALUES += ["[1e99, 1e99, 1e99]", "{a: 1}", "left_crank", "left", "ground", "world", "[[1, 2, 3]]"]


def test_any_value_beside_a_robot_loads_or_has_one_line(tmp_path):
    (tmp_path / "five_bar.urdf").write_text(five_bar_urdf())
    path = tmp_path / "beside.yaml"
    # Values of keys: lists of numbers, mappings without further ones, words.
    places = [found.span(1) for found in re.finditer(r": (\[[^\]]*\]|\{[^{}]*\}|[^\s,{}]+)", BESIDE)]
    refused = 0
    for start, end in some(places, 8):
        for value in VALUES:
            path.write_text(f"{BESIDE[:start]}{value}{BESIDE[end:]}")
            try:
                load_scene(path)
            except SceneError as error:
                refused += 1
                assert re.match(r"\S+: ", str(error)) and "\n" not in str(error), error
    assert refused > (len(places) * len(VALUES) // 2 if VERIFY else 0)


def test_a_spring_between_a_link_and_one_that_stays(tmp_path):
    """The link that does not move may be parent or child."""
    (tmp_path / "five_bar.urdf").write_text(five_bar_urdf())
    path, found = tmp_path / "beside.yaml", []
    for ends in (
        "parent: ground, parent_point: [1, 2, 3], child: left, child_point: [4, 5, 6]",
        "child: ground, child_point: [1, 2, 3], parent: left, parent_point: [4, 5, 6]",
    ):
        path.write_text(f"robot: five_bar.urdf\nforces: [{{name: s, type: spring_damper, stiffness: 2, {ends}}}]\n")
        found.append(load_scene(path).forces[-1])
    assert found[0] == found[1] and found[0].parent == "world"


BARE = text_of("bare.urdf")


def test_links_without_inertia_are_fixed_to_the_world_or_merged(tmp_path):
    """Of the base nothing counts; the load is a point mass, which the parallel axis theorem adds."""
    path = written(tmp_path / "bare.urdf", BARE.format("fixed"))
    scene = load_scene(path)
    (body,) = scene.bodies
    com = 0.2 * np.array([0.2, 0.3, 0.1])
    d = np.array([0.2, 0.3, 0.1])  # reduced mass 2 * 0.5 / 2.5 at the distance of both centres
    inertia = np.diag([0.1, 0.2, 0.25]) + 0.4 * (d @ d * np.eye(3) - np.outer(d, d))
    assert body.mass == 2.5 and body.com == pytest.approx(com, abs=1e-15)
    assert body.inertia == pytest.approx(inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]], abs=1e-15)
    assert "without <inertia>, merged as a point mass: load" in scene.notes
    path.write_text(BARE.format("continuous"))
    text = f'{path}:4: <inertial> of link "load" has no <inertia>, and the link moves: give one, or fix it to the world'
    assert refusal(path) == text
    path.write_text(BARE.format("fixed").replace('<mass value="0.5"/>', '<inertia ixx="1" iyy="1" izz="1"/>'))
    assert refusal(path) == text.replace("<inertia>", "<mass>")


@pytest.mark.parametrize(
    "kind, limit, notes",
    [
        ("prismatic", 3.0, []),  # 30 rad of j, but 3 m in the file
        ("revolute", 180.0, ["lower limit of joint k: -180 rad", "upper limit of joint k: 180 rad"]),
    ],
)
def test_a_limit_that_looks_like_degrees_is_one_of_the_file(kind, limit, notes, tmp_path):
    inertial = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>'
    text = f"""<robot name="r"><link name="base"/><link name="a">{inertial}</link><link name="b">{inertial}</link>
<joint name="j" type="continuous"><parent link="base"/><child link="a"/><axis xyz="0 1 0"/></joint>
<joint name="k" type="{kind}"><parent link="a"/><child link="b"/><limit lower="-{limit}" upper="{limit}" effort="1"/>
<mimic joint="j" multiplier="0.1"/></joint></robot>"""
    scene = load_scene(written(tmp_path / "led.urdf", text))
    assert scene.joints[0].limits.upper == pytest.approx(10.0 * limit)
    found = [note for note in scene.notes if "turns" in note]
    assert len(found) == len(notes) and all(map(str.startswith, found, notes))


@pytest.mark.parametrize("geometry, color, notes", cases("visuals_that_look_wrong_are_noted"))
def test_visuals_that_look_wrong_are_noted(geometry, color, notes, tmp_path):
    inertial = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>'
    visual = f'<visual><geometry>{geometry}</geometry><material name="m"><color rgba="{color}"/></material></visual>'
    text = f"""<robot name="r"><link name="base"/><link name="a">{inertial}{visual}</link>
<joint name="j" type="continuous"><parent link="base"/><child link="a"/></joint></robot>"""
    scene = load_scene(written(tmp_path / "r.urdf", text))
    assert [note for note in scene.notes if note.startswith(("visuals", "colours"))] == notes
    ((_, _, drawn),) = scene.robot.drawn()
    assert drawn.color == tuple(np.clip([float(part) for part in color.split()], 0.0, 1.0))


def test_a_start_outside_the_limits_is_refused_or_noted(tmp_path):
    """A value that is given, such as one in degrees, is refused unless the stops are left out, as is none of a file."""
    path = written(tmp_path / "arm.urdf", ARM_URDF)
    for shoulder, extend, expected in ((2, -1, None), (90, 0, "90 degrees are 1.5708 rad"), (1, 1.5, "from -1 to 1")):
        given = {"shoulder": shoulder, "extend": extend}
        if expected is None:
            assert all(joint.limits for joint in scene_from_robot(path, Options(start=given)).joints)
            continue
        with pytest.raises(SceneError, match=f"is outside of its limits.*{expected}|{expected}.* is outside of its"):
            scene_from_robot(path, Options(start=given))
        assert scene_from_robot(path, Options(start=given, stops=[])).joints


def test_damping_of_a_light_link_is_noted_with_its_time(tmp_path):
    """A rod on a hinge: its velocity decays with the moment of inertia over the damping."""
    path = tmp_path / "robot.urdf"
    for damping, expected in ((1.0, []), (300.0, ["turn"])):
        path.write_text(
            '<robot name="rod"><link name="base"/><link name="rod"><inertial><origin xyz="0 0.1 0"/>'
            '<mass value="0.5"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-3" ixy="0" ixz="0" iyz="0"/>'
            '</inertial></link><joint name="turn" type="continuous"><parent link="base"/>'
            f'<child link="rod"/><axis xyz="0 0 1"/><dynamics damping="{damping}"/></joint></robot>'
        )
        notes = [note for note in load_scene(path).notes if note.startswith("stiff")]
        assert notes == [
            f"stiff: damping stops joint {name} within 2e-05 s; give no method, or radau5 or "
            "generalized_alpha, so that steps need not be that short"
            for name in expected
        ]
        simulation = Simulation(
            scene_from_robot(path, Options(start_velocity={"turn": 1.0}, gravity=(0.0, 0.0, -1e-9))), "rkmk8", 1e-6
        )
        simulation.advance(20)
        decayed = simulation.sample().twists["rod"][2]
        assert decayed == pytest.approx(np.exp(-20e-6 * damping / (1e-3 + 0.5 * 0.1**2)), rel=1e-9)


def test_a_point_mass_on_axes_that_meet_is_noted(tmp_path):
    """Rotations about the first and the last axis move the mass in the same direction."""
    path = tmp_path / "neck.urdf"
    links = "".join(
        f'<link name="{name}"><inertial><origin xyz="{x} 0 0"/><mass value="1"/><inertia ixx="0" '
        'iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        for name, x in (("yaw", 0.0), ("pitch", 0.0), ("roll", 0.2))
    )
    joints = "".join(
        f'<joint name="{child}" type="continuous"><parent link="{parent}"/><child link="{child}"/>'
        f'<axis xyz="{axis}"/><dynamics damping="1"/></joint>'
        for parent, child, axis in (("base", "yaw", "0 0 1"), ("yaw", "pitch", "0 1 0"), ("pitch", "roll", "1e-3 0 1"))
    )
    path.write_text(f'<robot name="neck"><link name="base"/>{links}{joints}</robot>')
    noted = []
    for lock in ({}, {"yaw": 0.0}):
        notes = scene_from_robot(path, Options(lock=lock)).notes
        noted.append([note for note in notes if note.startswith("stiff")])
    assert len(noted[0]) == 1 and noted[1] == []
    assert re.search(r"joint (yaw|roll) within \S+ s; the bodies that it moves have almost no", noted[0][0])


def test_collision_shapes_of_links_that_are_cut_are_not_counted(tmp_path):
    shape = '<collision><geometry><sphere radius="1"/></geometry></collision></link>'
    path = written(tmp_path / "robot.urdf", ARM_URDF.replace("</link>", shape))
    contact = [
        [note for note in scene_from_robot(path, options).notes if "no contact" in note]
        for options in (Options(), Options(only=["upper"]))
    ]
    assert all(len(notes) == 1 for notes in contact)
    assert "slide" in contact[0][0] and "slide" not in contact[1][0]


@pytest.mark.parametrize("address", ["http://a.org/arm.urdf", "https://a.org/b", "ftp://a/b"])
def test_nothing_is_fetched_from_a_network(address):
    with pytest.raises(SceneError, match="nothing is fetched from a network: download the file"):
        load_scene(address)


def test_an_srdf_file_needs_a_pose(tmp_path):
    path, srdf = mimic_urdf(tmp_path), tmp_path / "hand.srdf"
    state = '<robot name="hand"><group_state name="open" group="g"><joint name="drive" {}/>'
    srdf.write_text(state.format("") + "</group_state></robot>")
    with pytest.raises(SceneError, match=r'hand.srdf:1: joint "drive" has no value'):
        scene_from_robot(path, Options(srdf=srdf, pose="open"))


def test_names_that_yaml_takes_for_values(tmp_path):
    text = ARM_URDF.replace('<robot name="arm"', '<robot name="true"')
    assert load_scene(written(tmp_path / "arm.urdf", text)).name == "true"


LOOP = text_of("five_bar_robot.yaml")


@pytest.mark.parametrize("start", [{"left_crank": 0.2}, {"left_crank": -0.1, "right_elbow": 0.05}])
def test_a_loop_keeps_the_start_values_that_are_given(start, tmp_path):
    """The five-bar has two freedoms: up to two coordinates can be chosen."""
    (tmp_path / "five_bar.urdf").write_text(five_bar_urdf())
    path = written(tmp_path / "loop.yaml", LOOP.format(str(start).replace("'", "")))
    found = Simulation(load_scene(path), "rkmk4", 1e-3).sample()
    for name, value in start.items():
        assert found.joint_coordinates[name][0] == pytest.approx(value, abs=1e-13)
    tips = [found.poses[f"{side}_bar"] @ (1.2, 0, 0, 1) for side in ("left", "right")]
    assert np.allclose(*tips, atol=1e-12)


def test_start_values_that_a_loop_cannot_keep_are_refused_with_the_nearest(tmp_path):
    (tmp_path / "five_bar.urdf").write_text(five_bar_urdf())
    path = tmp_path / "loop.yaml"
    names = ("left_crank", "left_elbow", "right_crank")
    start = dict.fromkeys(names, 0.1)
    path.write_text(LOOP.format(str(start).replace("'", "")))
    text = refusal(path)
    assert text.startswith(f"{path}:3: start[") and "give fewer coordinates, or the nearest" in text
    # The values of the line are kept.
    nearest = dict(re.findall(r"(\w+) (-?[\d.]+)[,)]?", text.rpartition("nearest ones: ")[2]))
    assert set(nearest) == set(names)
    path.write_text(LOOP.format(str({name: float(nearest[name]) for name in names}).replace("'", "")))
    load_scene(path)
    with pytest.raises(SceneError, match=r"five_bar.urdf: --start \"left_"):
        scene_from_robot(tmp_path / "five_bar.urdf", Options(start=start, joints=[FIVE_BAR_TIP]))


@pytest.mark.parametrize("digits, moved", [(15, False), (4, True), (1, None)])
def test_rounded_start_values_of_a_loop_are_moved(digits, moved, tmp_path):
    """All five angles of a closed five-bar, which has two freedoms, with few digits."""
    (tmp_path / "five_bar.urdf").write_text(five_bar_urdf())
    path = written(tmp_path / "loop.yaml", LOOP.format("{left_crank: 0.2, right_crank: -0.1}"))
    exact = Simulation(load_scene(path), "rkmk4", 1e-3).sample().joint_coordinates
    names = ("left_crank", "left_elbow", "right_crank", "right_elbow")
    start = {name: round(float(exact[name][0]), digits) for name in names}
    path.write_text(LOOP.format(str(start).replace("'", "")))
    if moved is None:
        assert "no pose near the start satisfies all joints" in refusal(path)
        return
    scene = load_scene(path)
    notes = [note for note in scene.differences if "start values" in note]
    assert bool(notes) is moved
    if moved:
        changes = re.findall(r"(\w+) by (-?[\d.e-]+) rad to (-?[\d.]+)", notes[0])
        found = Simulation(scene, "rkmk4", 1e-3).sample().joint_coordinates
        assert {name for name, _, _ in changes} == set(names)
        for name, change, value in changes:
            assert abs(float(change)) < 1e-4 and float(value) == pytest.approx(found[name][0])
            assert float(value) - start[name] == pytest.approx(float(change), abs=1e-6)


def test_errors_have_the_names_of_the_robots_file(tmp_path):
    (tmp_path / "five_bar.urdf").write_text(five_bar_urdf().replace("left_crank", "left-crank"))
    path = written(tmp_path / "loop.yaml", LOOP.format("{left-crank: 0.1, left_elbow: 0.1, right_crank: 0.1}"))
    assert re.search(r"nearest ones: left-crank -?[\d.]+, ", refusal(path))


def test_a_loop_that_cannot_close_names_the_closing_joint(tmp_path):
    path = written(tmp_path / "five_bar.urdf", five_bar_urdf())
    (tmp_path / "loop.yaml").write_text(
        LOOP.format("").replace("child_frame: {}", "child_frame: {position: [9, 0, 0]}")
    )
    text = refusal(tmp_path / "loop.yaml")
    assert f'{tmp_path / "loop.yaml"}:5: joints[0] "tip": cannot be assembled' in text
    far = FIVE_BAR_TIP.remade(name="close_left_end_ground", child="ground", child_frame={"position": (9, 0, 0)})
    with pytest.raises(SceneError, match='--close "close_left_end_ground": cannot be assembled'):
        scene_from_robot(path, Options(joints=[far]))


def test_a_coordinate_is_of_joints_that_have_one(tmp_path):
    with pytest.raises(SceneError, match=r'joints\[0\] "j": coordinate cannot be given for a spher'):
        scene_from_text(
            "name: s\ngravity: [0, 0, 0]\nassemble: true\n"
            "bodies: [{name: a, mass: 1, inertia: [1, 1, 1]}]\n"
            "joints: [{name: j, type: spherical, parent: world, child: a, child_frame: {},"
            " coordinate: 1}]\n"
        )
