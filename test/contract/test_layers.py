# SPDX-License-Identifier: Apache-2.0
"""Imports only point to lower layers; the layers are those of docs/architecture.md.

The block `floors` of that page lists every room, the top floor first. A room is a module or a
folder; `folder` holds for all modules below it that no longer entry names. A module may import
from its own room and from the rooms of lower floors, never from a higher one or from another room
of its own floor.
"""

import ast
import re
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[2]
PAGE = SOURCE / "docs" / "architecture.md"
PACKAGES = ("liegroup_core", "liegroup_sim_ros")


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


def imports_of(name, path, known):
    """Modules of `known` that a module imports, at module level or inside functions."""
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (each.name for each in node.names if each.name in known)
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


def test_an_upward_import_and_a_cycle_are_detected():
    floors = floors_of("```floors\ntop\nmiddle.a middle.b\nlow  # comment\n```\n")
    assert floors == {"top": 2, "middle.a": 1, "middle.b": 1, "low": 0}
    good = {"top.x": {"middle.a", "low"}, "middle.a": {"low"}, "middle.b": set(), "low": set()}
    assert not violations(floors, good) and not circles(good)
    assert violations(floors, {"low": {"top"}}) == [("low", "top")]
    assert violations(floors, {"middle.a": {"middle.b.z"}}) == [("middle.a", "middle.b.z")]
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == ["a", "b", "c", "d"]
