# SPDX-License-Identifier: Apache-2.0
"""Robots' files cannot run code, reach other files or take more than their share of memory."""

import json
import math
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hostile import expression, xacro_text
from robot_texts import written
from scene_files import cases

from liegroup_core import SceneError, load_scene
from liegroup_core.robots import access, apart
from liegroup_core.robots.expressions import RefusedExpression, evaluate
from liegroup_core.robots.resources import readable_resource
from liegroup_core.scene.load import scene_from_text

ARM = xacro_text("x")


class Space(dict):
    """Mapping whose entries are attributes, as namespaces of xacro."""


def symbols():
    space = Space(list=list, map=map, load_yaml=print, parent=1)
    return {"python": space, "xacro": space, "str": str, "len": len, "max": max, "dict": dict}


def test_hostile_expressions_are_refused():
    rng = np.random.default_rng(5)
    for _ in range(500):
        text = expression(rng)
        with pytest.raises((RefusedExpression, NameError)):
            evaluate(text, symbols(), (Space,))


@pytest.mark.parametrize(
    "text, expected",
    [
        ("2 * 3 + 1", 7),
        ("'a' + 'b' if 1 > 0 else 'c'", "ab"),
        ("'{}_{x}'.format(1, x=2)", "1_2"),
        ("'a b'.split()[1].upper()", "B"),
        ("dict(a=1).get('b', [3, 4][-1])", 4),
        ("python.list(python.map(str, (1, 2)))", ["1", "2"]),
        ("xacro.parent", 1),
        ("max(*[1, 5]) % 3", 2),
        ("{'k': {1, 2}}['k']", {1, 2}),
        ("not (1 in [1, 2])", False),
    ],
)
def test_what_robots_write_in_expressions_has_its_value(text, expected):
    assert evaluate(text, symbols(), (Space,)) == expected


# Prints which of these a confined process can do.
RIGHTS = """
import fcntl, os, signal, socket, subprocess, sys, threading
from liegroup_core.robots.confined import confine
inside, outside = sys.argv[1:]
here = os.open(inside, os.O_RDONLY)
confine([inside, *sys.path, sys.prefix, sys.base_prefix, "/usr/lib", "/lib"])
tried = {
    "read inside": lambda: open(inside + "/file").read(),
    "thread": lambda: threading.Thread(target=int).start(),
    "read outside": lambda: open(outside + "/file").read(),
    "list outside": lambda: os.listdir(outside),
    "write": lambda: open(inside + "/file", "r+"),
    "append": lambda: open(inside + "/file", "a"),
    "make": lambda: os.open(inside + "/new", os.O_CREAT),
    "empty": lambda: os.open(inside + "/file", os.O_TRUNC),
    "truncate": lambda: os.truncate(inside + "/file", 0),
    "hidden file": lambda: os.open(inside, os.O_TMPFILE | os.O_RDWR),
    "remove": lambda: os.remove(inside + "/file"),
    "rename": lambda: os.rename(inside + "/file", inside + "/other"),
    "link": lambda: os.link(inside + "/file", inside + "/other"),
    "folder": lambda: os.mkdir(inside + "/folder"),
    "mode": lambda: os.chmod(inside + "/file", 0o777),
    "times": lambda: os.utime(inside + "/file"),
    "fork": os.fork,
    "program": lambda: subprocess.run(["/bin/true"], check=True),
    "replace": lambda: os.execv("/bin/true", ["true"]),
    "socket": socket.socket,
    "unix socket": lambda: socket.socket(socket.AF_UNIX),
    "signal": lambda: os.kill(os.getppid(), 0),
    "signal of a file": lambda: fcntl.fcntl(here, fcntl.F_SETOWN, os.getppid()),
    "notice of a folder": lambda: fcntl.fcntl(here, fcntl.F_NOTIFY, fcntl.DN_ACCESS),
    "lease": lambda: fcntl.fcntl(here, fcntl.F_SETLEASE, fcntl.F_RDLCK),
    "memory of another": lambda: open(f"/proc/{os.getppid()}/mem", "rb"),
    "namespace": lambda: os.unshare(0) if hasattr(os, "unshare") else os.setsid(),
}
for name, do in tried.items():
    try:
        do()
        print(name)
    except OSError:
        pass
"""


def test_a_confined_process_reads_and_computes_and_no_more(tmp_path):
    folders = [tmp_path / "in", tmp_path / "out"]
    for folder in folders:
        folder.mkdir()
        (folder / "file").write_text("text")
    done = subprocess.run(
        [sys.executable, "-c", RIGHTS, *map(str, folders)], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines() == ["read inside", "thread"], done.stderr
    assert (tmp_path / "in" / "file").read_text() == "text"


# The tool of apart.py, with expressions that Python evaluates unchecked.
UNCHECKED = """
import sys
from liegroup_core.robots import apart
import builtins
apart.evaluate = lambda text, symbols, spaces: eval(text, dict(vars(builtins)), symbols)
sys.exit(apart.main(*sys.argv[1:]))
"""


@pytest.mark.parametrize(
    "code, value",
    [
        ("open('CANARY', 'w')", None),
        ("__import__('os').system('touch CANARY')", 127 << 8),  # the shell did not start
        ("__import__('subprocess').run(['touch', 'CANARY'], check=True)", None),
        ("__import__('socket').create_server(('127.0.0.1', 0))", None),
        ("open('/etc/passwd').read()", None),
        ("__import__('ctypes').CDLL(None).fork()", -1),
    ],
)
@pytest.mark.turn(3)
def test_unchecked_code_in_a_xacro_file_can_do_no_harm(code, value, tmp_path):
    """The second wall holds without the first. value : that code returns; None: it raises an error."""
    canary, path = tmp_path / "canary", tmp_path / "arm.xacro"
    path.write_text(xacro_text("${%s}" % code.replace("CANARY", str(canary))))
    done = subprocess.run(
        [sys.executable, "-c", UNCHECKED, str(tmp_path), "xacro", str(path)], capture_output=True, text=True
    )
    assert not canary.exists()
    if value is None:
        assert done.returncode in (1, apart.FORBIDDEN), done.stdout
    else:
        assert f'"l{value}"' in done.stdout, done.stdout + done.stderr


@pytest.mark.parametrize(
    "text, value",
    [
        *(
            (text, None)
            for text in ("9**9**9**9", "(-10)**10**9", "1 << 10**10", "10**200 * 10**200", "factorial(10**7)")
        ),
        *(
            (text, None)
            for text in ("'a' * 10**9", "10**9 * [0]", "'x'.ljust(10**9)", "'%999999999d' % 1", "'%*d' % (9, 1)")
        ),
        *((text, None) for text in ("'{:>99999}'.format(1)", "'x' * 10**6 + 'y'", "'abc'.replace('', 'x' * 10**6)")),
        *((text, None) for text in ("('x' * 1000).join(['y'] * 10000)", "range(10**9)", "10**10**9 if 1 else 0")),
        *(("2**10 - 3.5**2", 1011.75), ("'-' * 3 + 'a'", "---a"), ("[1] * 2 + [3]", [1, 1, 3]), ("2.0**0.5", 2.0**0.5)),
        *(("'%.3f' % 0.5", "0.500"), ("'{:06.2f}'.format(1)", "001.00"), ("factorial(5) % 7", 1), ("-2**-1", -0.5)),
        ("'a_b'.replace('_', '-')", "a-b"),
    ],
)
def test_results_of_expressions_have_a_bounded_size(text, value):
    """Before they are computed. value : of Python; None: refused."""
    names = {"factorial": math.factorial, "range": range}
    if value is None:
        with pytest.raises(RefusedExpression, match="longer than 1000000, or a whole number of more than 300 digits"):
            evaluate(text, names, ())
    else:
        assert evaluate(text, names, ()) == value


def test_macros_that_call_each_other_twice_are_refused(tmp_path):
    """30 of them would be a billion elements."""
    one = '<xacro:macro name="m{0}" params=""><xacro:m{1}/><xacro:m{1}/></xacro:macro>'
    macros = "".join(one.format(k, k + 1) for k in range(30)) + '<xacro:macro name="m30" params=""><a/></xacro:macro>'
    head = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    path = written(tmp_path / "r.xacro", f'{head}{macros}<xacro:m0/><link name="a"/></robot>')
    with pytest.raises(SceneError, match="macros are called more than 20000 times"):
        load_scene(path)


def test_a_model_includes_nothing_outside_of_its_tree(tmp_path):
    """MuJoCo calls a file that it may not read empty."""
    written(tmp_path / "outside.xml", "<mujoco/>")
    (tmp_path / "ws" / "model").mkdir(parents=True)
    inner = written(tmp_path / "ws" / "part.xml", '<mujoco><include file="../../outside.xml"/></mujoco>')
    path = tmp_path / "ws" / "model" / "m.xml"
    for file, line in (("../../outside.xml", f"{path}:1"), ("../part.xml", f"{inner}:1")):
        body = '<worldbody><body><joint/><geom size=".1"/></body></worldbody>'
        path.write_text(f'<mujoco><include file="{file}"/>{body}</mujoco>')
        with pytest.raises(SceneError, match="is not read: it is outside of") as caught:
            load_scene(path)
        assert str(caught.value).startswith(line)


@pytest.mark.parametrize("value, expected", cases("a_hostile_xacro_file_is_refused_in_one_line"))
@pytest.mark.turn(3)
def test_a_hostile_xacro_file_is_refused_in_one_line(value, expected, tmp_path, monkeypatch):
    outside = written(tmp_path / "outside.yaml", "secret")
    path = tmp_path / "ws" / "package" / "arm.xacro"
    path.parent.mkdir(parents=True)
    path.write_text(xacro_text(value.replace("OUTSIDE", str(outside))))
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    text = str(caught.value)
    assert expected.replace("OUTSIDE", str(outside)) in text and text.startswith(str(path)), text
    assert "secret" not in text


@pytest.mark.turn(3)
def test_files_outside_of_the_tree_are_read_on_request_only(tmp_path):
    (tmp_path / "part.xacro").write_text(ARM)
    path = tmp_path / "ws" / "robots" / "arm.xacro"
    path.parent.mkdir(parents=True)
    include = f'<xacro:include filename="{tmp_path}/part.xacro"/>'
    path.write_text(f'<robot name="r" xmlns:xacro="http://ros.org/wiki/xacro">{include}</robot>')
    with pytest.raises(SceneError, match="part.xacro is not read.*give --allow-files"):
        load_scene(path)
    assert load_scene(path, allow_files=True).bodies[0].name == "lx"
    # A package is one tree, however deep its files lie.
    (tmp_path / "package.xml").write_text("<package/>")
    assert load_scene(path).bodies[0].name == "lx"
    with access.served_from([tmp_path / "ws"]), pytest.raises(SceneError, match="world_folders"):
        load_scene(path)
    with access.served_from([tmp_path]):
        assert load_scene(path).bodies[0].name == "lx"
    with access.served_from([tmp_path / "none"]), pytest.raises(SceneError, match="world_folders"):
        load_scene(path)


MESHED = """<mujoco><asset><mesh name="m" file="{mesh}"/></asset><worldbody><body name="arm"><joint/>{own}
<geom type="mesh" mesh="m"/></body></worldbody></mujoco>"""
MESHED_URDF = """<robot name="r"><link name="base"/><link name="arm"><inertial><mass value="1"/><inertia ixx="1" iyy="1"
izz="1"/></inertial><visual><geometry><mesh filename="{mesh}"/></geometry></visual></link><joint name="j"
type="continuous"><parent link="base"/><child link="arm"/></joint></robot>"""


@pytest.mark.parametrize("text", [MESHED, MESHED_URDF])
def test_a_mesh_outside_of_the_tree_is_noted(text, tmp_path):
    """A mass that follows from it is refused, also for OBJ; a mesh in the tree that is empty is said to be empty."""
    path = tmp_path / "ws" / "robots" / "arm.xml"
    path.parent.mkdir(parents=True)
    mesh = written(tmp_path / "m.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n")
    own = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
    path.write_text(text.format(mesh=mesh, own=own))
    what = "left out: mesh files outside of the robot file's tree, which only --allow-files reads"
    assert f"{what} ({mesh} of arm)" in load_scene(path).notes
    assert not any("mesh files" in note for note in load_scene(path, allow_files=True).notes)
    if text is MESHED:
        path.write_text(text.format(mesh=mesh, own=""))
        with pytest.raises(SceneError, match="m.obj is not read: it is outside of"):
            load_scene(path)
        written(path.parent / "empty.stl", "")
        path.write_text(text.format(mesh="empty.stl", own=own))
        with pytest.raises(SceneError, match="arm.xml:1: mjcf: .*empty.stl' is empty"):
            load_scene(path)


def test_the_tree_of_a_file_is_never_a_home_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / ".git").mkdir()
    assert access.tree_of(tmp_path / "a" / "b" / "x.xml") == tmp_path / "a"
    assert access.tree_of(tmp_path / "a" / "x.xml") == tmp_path / "a"
    assert access.tree_of(tmp_path / "x.xml") == tmp_path / "x.xml"
    link = tmp_path / "a" / "link"
    link.parent.mkdir()
    link.symlink_to("/etc/passwd")
    with pytest.raises(SceneError, match="is not read"):
        access.permit(link, tmp_path / "a" / "x.xml")


def test_a_text_names_no_files(tmp_path):
    (tmp_path / "arm.xacro").write_text(ARM)
    text = f"robot: {tmp_path}/arm.xacro\n"
    with pytest.raises(SceneError, match="^scene:1: a scene given as text cannot refer to a robot file"):
        scene_from_text(text)
    (tmp_path / "scene.yaml").write_text(text)
    assert load_scene(tmp_path / "scene.yaml").bodies[0].name == "lx"


def test_an_included_model_outside_of_the_tree_is_refused(tmp_path):
    (tmp_path / "other.sdf").write_text('<sdf version="1.9"><model name="m"/></sdf>')
    path = tmp_path / "a" / "b" / "robot.sdf"
    path.parent.mkdir(parents=True)
    path.write_text('<sdf version="1.9"><model name="r">\n<include><uri>../../other.sdf</uri></include></model></sdf>')
    with pytest.raises(SceneError, match="robot.sdf:2: .*other.sdf: is not read"):
        load_scene(path)


def test_a_request_includes_no_model_outside_of_what_is_served(tmp_path):
    """One beside the tree, which a file that a user names may include."""
    other, path = tmp_path / "m" / "model.sdf", tmp_path / "served" / "robot.sdf"
    for each in (other, path):
        each.parent.mkdir()
    inertial = "<link name='l'><inertial><mass>1</mass></inertial></link>"
    other.write_text(f"<sdf version='1.9'><model name='m'>{inertial}</model></sdf>")
    (other.parent / "model.config").write_text("<model><sdf version='1.9'>model.sdf</sdf></model>")
    include = "<include><uri>model://m</uri></include>"
    path.write_text(f"<sdf version='1.9'><model name='r'>{include}</model></sdf>")
    assert len(load_scene(path).bodies) == 1
    with access.served_from([path.parent]), pytest.raises(SceneError, match="model.sdf: is not read"):
        load_scene(path)


@pytest.mark.parametrize(
    "address",
    [
        "package://robot/SECRET",
        "package:///robot/SECRET",
        "package://robot/../../../secret/s.stl",
        "package://secret/s.stl",
    ]
    + ["SECRET", "../../../secret/s.stl", "file://SECRET", "model://../secret/s.stl"],
)
def test_an_address_does_not_lead_out_of_its_package(address, tmp_path):
    secret = tmp_path / "secret" / "s.stl"
    robot = tmp_path / "ws" / "src" / "robot" / "urdf" / "a.urdf"
    for path in (secret, robot):
        path.parent.mkdir(parents=True)
        path.write_text("x")
    (robot.parent.parent / "package.xml").write_text("<package/>")
    try:
        found = readable_resource(address.replace("SECRET", str(secret)), robot)
    except SceneError as error:
        assert "is not read" in str(error)
    else:
        assert found is None
    (robot.parent / "own.stl").write_text("x")
    assert readable_resource("package://robot/urdf/own.stl", robot) == robot.parent / "own.stl"


@pytest.mark.turn(3)
def test_a_mesh_is_read_in_bounded_memory(tmp_path):
    """0.5 MB of a .3mf file that unfolds to 0.5 GB of text, which takes several times as much as numbers."""
    pytest.importorskip("trimesh")
    mesh, order = tmp_path / "bomb.3mf", tmp_path / "order.json"
    model = (
        '<?xml version="1.0"?><model unit="millimeter" xmlns="http://schemas.microsoft.com/3dmanufacturing/'
        'core/2015/02"><resources><object id="1" type="model"><mesh><vertices>'
    )
    with zipfile.ZipFile(mesh, "w", zipfile.ZIP_DEFLATED) as archive:
        with archive.open("3D/3dmodel.model", "w") as part:
            part.write(model.encode())
            for _ in range(500):
                part.write(b'<vertex x="1" y="2" z="3"/>' * 40_000)
    assert mesh.stat().st_size < 4e6
    shapes = [("b", "mesh", [1.0] * 3, np.eye(4).tolist(), str(mesh), None, -1)]
    order.write_text(json.dumps({"shapes": shapes, "most": 100}))
    with pytest.raises(SceneError, match="needs more than 1 GiB"):
        apart.run_apart("meshes", order, folders=[tmp_path])
    assert not list(Path(tmp_path).glob("*.log"))
