# SPDX-License-Identifier: Apache-2.0
"""Imports only point to lower layers, those of docs/architecture.md; a class name means one thing.

The block `floors` of that page lists every room, the top floor first. A room is a module or a
folder; `folder` holds for all modules below it that no longer entry names. A module may import
from its own room and from the rooms of lower floors, never from a higher one or from another room
of its own floor.
"""

import ast
import functools
import re
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[2]
PAGE = SOURCE / "docs" / "architecture.md"
PACKAGES = ("liegroup_core", "liegroup_sim_ros")
IMPORTING = ("import_module", "__import__", "resolve_name", "run_module")  # calls with the name of a module
PROCESSES = (("liegroup_sim_ros.node.node", "liegroup_sim_ros.commands.main"),)  # started, not imported
# Rooms that import ROS, and its packages.
WITH_ROS = tuple(
    f"liegroup_sim_ros.{name}" for name in ("commands", "controller", "node", "playback.player", "view.remote")
)
ROS = re.compile(r"rclpy|ros2\w+|\w+_(msgs|srvs|interfaces)")


def floors_of(text):
    """{package: layer}, counted from the bottom, from the block `floors` of a page."""
    (block,) = re.findall(r"^```floors\n(.*?)^```", text, re.M | re.S)
    lines = [line.split("#")[0].split() for line in block.splitlines() if line.strip()]
    return {room: number for number, rooms in enumerate(reversed(lines)) for room in rooms}


def modules():
    """{module: path} of both packages; an `__init__` has the name of its package."""
    found = {}
    for package in PACKAGES:
        for path in sorted((SOURCE / package).rglob("*.py")):
            name = ".".join(path.relative_to(SOURCE).with_suffix("").parts)
            found[name.removesuffix(".__init__")] = path
    return found


tree_of = functools.cache(ast.parse)


def named_by(text, name, package, known):
    """Modules of `known` that a text may name, as it is or in a call such as import_module."""
    own = {"__name__": name, "__package__": package}
    parts = text.values if isinstance(text, ast.JoinedStr) else [text]
    parts = [part.value if isinstance(part, ast.FormattedValue) else part for part in parts]
    parts = [part.value if isinstance(part, ast.Constant) else own.get(ast.unparse(part)) for part in parts]
    pattern = "".join(".*" if part is None else re.escape(str(part).split(":")[0]) for part in parts)
    return filter(re.compile(re.sub(r"^(\\\.)+", r".*\\.", pattern)).fullmatch, known)


def imports_of(name, path, known):
    """Modules of `known` that a module imports, at module level, inside functions or by their names."""
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    nodes = list(ast.walk(tree_of(path.read_text())))
    froms = [each for node in nodes if isinstance(node, ast.ImportFrom) for each in node.names]
    calls = (*IMPORTING, *(each.asname for each in froms if each.asname and each.name in IMPORTING))
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (each.name for each in node.names if each.name in known)
        elif isinstance(node, ast.Call) and getattr(node.func, "attr", getattr(node.func, "id", None)) in calls:
            for text in (*node.args[:1], *(each.value for each in node.keywords if each.arg == "name")):
                yield from named_by(text, name, package, known)
        elif isinstance(node, ast.Constant) and "." in str(node.value) and (name, node.value) not in PROCESSES:
            yield from {str(node.value).split(":")[0]}.intersection(known)
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(package.split(".")[: package.count(".") + 2 - node.level])
            full = node.module if not node.level else ".".join(filter(None, (base, node.module)))
            for each in node.names:
                target = f"{full}.{each.name}"
                yield target if target in known else full


def room_of(name, floors):
    """Longest entry that is a prefix of the module's name, or None."""
    parts = name.split(".")
    entries = (".".join(parts[:n]) for n in range(len(parts), 0, -1))
    return next((entry for entry in entries if entry in floors), None)


def violations(floors, imports):
    """Imports that do not point to a lower layer: [(module, imported module)]."""
    wrong = []
    for name, targets in imports.items():
        room = room_of(name, floors)
        for target in targets:
            other = room_of(target, floors)
            if other != room and floors[other] >= floors[room]:
                wrong.append((name, target))
    return wrong


def circles(imports):
    """Modules that import each other, directly or indirectly."""
    left = {name: set(targets) - {name} for name, targets in imports.items()}
    while True:
        # Whatever imports nothing that is left is in no circle.
        done = {name for name, targets in left.items() if not targets & left.keys()}
        if not done:
            return sorted(left)
        left = {name: targets for name, targets in left.items() if name not in done}


def roots_of(tree):
    """Packages that a module imports, at module level or inside functions."""
    nodes = list(ast.walk(tree))
    names = {each.name for node in nodes if isinstance(node, ast.Import) for each in node.names}
    names |= {node.module for node in nodes if isinstance(node, ast.ImportFrom) and not node.level}
    return {name.split(".")[0] for name in names}


def names_of_several(sources):
    """Public names of classes that several of the sources {module: text} define: {name: modules}."""
    found = {}
    for module, text in sources.items():
        for node in ast.walk(tree_of(text)):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                found.setdefault(node.name, []).append(module)
    return {name: where for name, where in found.items() if len(where) > 1}


@pytest.fixture(scope="module")
def imports():
    known = modules()
    return {
        name: {target for target in imports_of(name, path, known) if target in known} for name, path in known.items()
    }


def test_every_module_belongs_to_a_layer(imports):
    floors = floors_of(PAGE.read_text())
    assert not [name for name in imports if room_of(name, floors) is None]
    unused = floors.keys() - {room_of(name, floors) for name in imports}
    assert not unused, "rooms of the page that do not exist"


def test_imports_point_to_lower_layers(imports):
    assert not violations(floors_of(PAGE.read_text()), imports)


def test_there_are_no_import_cycles(imports):
    assert not circles({name: targets - {name} for name, targets in imports.items()})


def test_the_core_does_not_import_the_ros_package(imports):
    assert not [
        (name, target)
        for name, targets in imports.items()
        for target in targets
        if name.startswith("liegroup_core") and not target.startswith("liegroup_core")
    ]


def test_a_public_class_has_a_name_of_its_own():
    assert not names_of_several({name: path.read_text() for name, path in modules().items()})
    twins = {"a": "class A: pass\ndef f():\n    class B: pass", "b": "class B: pass\nclass _A: pass", "c": "A = 1"}
    assert names_of_several(twins) == {"B": ["a", "b"]}


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("def f():\n    from ..top import x", {"p.top"}),
        ("def f():\n    import p.top", {"p.top"}),
        ("importlib.import_module('p.top')", {"p.top"}),
        ("import_module(f'p.{name}')", {"p.top", "p.low.y"}),
        ("__import__(f'{__package__}.{name}')", {"p.low.y"}),
        ("import_module(f'{__name__}.z')", set()),
        ("import_module(name)", {"p", "p.top", "p.low.y"}),
        ("import_module(f'{package}.msg')", set()),
        ("import_module('p.' + name)", {"p", "p.top", "p.low.y"}),
        ("import_module('.top', 'p')", {"p.top"}),
        ("from importlib import import_module as load\nload(name='p.top')", {"p.top"}),
        ("pkgutil.resolve_name('p.top:x')", {"p.top"}),
        ("sys.modules['p.top'].x()", {"p.top"}),
    ],
)
def test_an_import_inside_a_function_or_by_a_call_is_found(tmp_path, text, found):
    path = tmp_path / "y.py"
    path.write_text(text)
    known = {"p", "p.top", "p.low.y"}
    assert {target for target in imports_of("p.low.y", path, known) if target in known} == found


def test_only_some_rooms_import_ros():
    found = {name for name, path in modules().items() if any(map(ROS.fullmatch, roots_of(tree_of(path.read_text()))))}
    assert found and not [name for name in found if not name.startswith(WITH_ROS)]
    text = "import os, rclpy.node\ndef f():\n    from std_msgs.msg import String\n    from . import std_srvs"
    assert roots_of(ast.parse(text)) == {"os", "rclpy", "std_msgs"}


def test_an_upward_import_and_a_cycle_are_detected():
    floors = floors_of("```floors\ntop\nmiddle.a middle.b\nlow  # comment\n```\n")
    assert floors == {"top": 2, "middle.a": 1, "middle.b": 1, "low": 0}
    good = {"top.x": {"middle.a", "low"}, "middle.a": {"low"}, "middle.b": set(), "low": set()}
    assert not violations(floors, good) and not circles(good)
    assert violations(floors, {"low": {"top"}}) == [("low", "top")]
    assert violations(floors, {"middle.a": {"middle.b.z"}}) == [("middle.a", "middle.b.z")]
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == ["a", "b", "c", "d"]
