# SPDX-License-Identifier: Apache-2.0
"""Robots of public packages: which ones load, and their accelerations compared with Pinocchio and MuJoCo.

    python benchmarks/robots.py [--states 100] [--motion] [--json FILE] [--page FILE] [WORD ...]

Loads every URDF and SDF of example-robot-data and every MJCF of mujoco and dm_control, or those whose
path contains one of the words. Prints a row for each: bodies, degrees of freedom, joints that close
loops, merged links, kinds of omitted elements, time to load, and the largest relative difference of the
accelerations of all bodies at random states. Trees from URDF and loops from SDF are compared with
Pinocchio, MJCF with MuJoCo (with armature of joints with one coordinate; without contact, limits and friction).
Couplings are added to their accelerations as exact rows. If two codes differ by more than
DOUBTFUL, the accelerations are computed with 50 digits.
"""

import argparse
import json
import sys
import time
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

from robots_side.page import MUJOCO, TREES, by_format, page_of, summary_of

from liegroup_core import SceneError, SimulationError
from liegroup_core.describe import describe
from liegroup_core.layout import make_layout
from liegroup_core.robots.options import Options
from liegroup_core.scene.load import scene_from_robot

# Files of the packages that are not robots: parts for inclusion in others, schemas.
PARTS = ("/schema.xml", "attribute_test_schema", "/common/", "/testdata/msh.xml")
DOUBTFUL = 1e-11  # difference of accelerations
LOOPS = "Pinocchio with loops as exact rows"


def files(words):
    """Paths of all robots of the installed packages."""
    found = []
    spec = find_spec("cmeel")
    if spec is not None:
        prefix = Path(spec.origin).parents[1] / "cmeel.prefix" / "share" / "example-robot-data"
        found += sorted([*prefix.rglob("*.urdf"), *prefix.rglob("*.sdf")])
    for package in ("mujoco", "dm_control"):
        spec = find_spec(package)
        if spec is not None:
            found += sorted(Path(spec.origin).parent.rglob("*.xml"))
    kept = [path for path in found if not any(part in str(path) for part in PARTS)]
    return [path for path in kept if not words or any(word in str(path) for word in words)]


def row_of(path, states, motion=False):
    """Figures of one file as a dict."""
    row = {"robot": "/".join(path.parts[-3:]), "format": path.suffix[1:]}
    start = time.perf_counter()
    try:
        # Stops and friction act by jumps of the acceleration, which the peers do not have.
        scene = scene_from_robot(path, Options(stops=[], friction=[]))
        row["load_s"] = round(time.perf_counter() - start, 3)
        layout = make_layout(scene)
    except SceneError as error:
        text = str(error).replace(str(path), path.name).replace(f"{path.parent}/", "")
        return row | {"refused": text}
    held = set(scene.robot.links.values())  # links that are the frame of a body
    row |= {
        "bodies": len(scene.bodies),
        "freedoms": describe(layout)["degrees_of_freedom"],
        "couplings": len(scene.couplings),
        "loops": len(scene.joints) - sum(_held(scene, body) for body in scene.bodies),
        "merged": sum(link not in held for link in scene.robot.frames),
        "left_out": _left_out(scene),
    }
    peer = {".urdf": TREES, ".sdf": LOOPS, ".xml": MUJOCO}.get(path.suffix)
    # Fixed joints of a tree are kept for force sensors; MuJoCo's equality/weld is soft.
    welded = peer == MUJOCO and any(
        joint.type == "fixed" and not joint.name.endswith("_weld") for joint in scene.joints
    )
    if states and (peer == LOOPS or not (row["loops"] or welded)):
        try:
            row |= {"peer": peer} | _compared(path, scene, states, peer, motion)
        except ImportError as error:
            row["difference"] = str(error)
    return row


def _compared(path, scene, states, peer, motion):
    """Differences of accelerations and motion, as parts of a row."""
    if peer != MUJOCO:  # Pinocchio does not know Gazebo's links without gravity
        robot, others = scene.robot, [force for force in scene.forces if force.type != "applied_wrench"]
        scene = scene.model_copy(update={"forces": others})
        scene._robot = robot
    if peer == LOOPS:
        from robots_side.with_pinocchio_loops import against_pinocchio_loops

        return _doubted(*against_pinocchio_loops(scene, states))
    if peer == TREES:
        from robots_side.with_pinocchio import against_pinocchio, motion_against_pinocchio

        found, state = against_pinocchio(path, scene, states)
        row = _doubted(found, (scene, *state))
        return row | (_moved(motion_against_pinocchio, path, scene) if motion else {})
    from robots_side.with_mujoco import against_mujoco, motion_against_mujoco

    row = {"difference": float(against_mujoco(path, scene, states))}
    return row | (_moved(motion_against_mujoco, path, scene) if motion and not scene.couplings else {})


def _moved(compare, path, scene):
    """Difference of the motion, as parts of a row, or the reason why it was not compared."""
    try:
        return compare(path, scene)
    except SimulationError as error:
        return {"motion_m": str(error)}


def _doubted(found, state):
    """Difference, and the errors of both codes if it is large; state: scene and its state."""
    row = {"difference": float(found)}
    if found > DOUBTFUL:
        from robots_side.digits import NearlySingular, against_digits

        with suppress(NearlySingular):
            row["errors"] = against_digits(*state)
    return row


def _left_out(scene):
    """[(element, number, changes the motion)] of the elements of a file that its scene lacks."""
    found = []
    for note in scene.notes:
        text = note.removeprefix("changes the motion: ")
        changes = text != note
        what, separator, names = text.partition(", left out: ")
        if separator:
            found.append((what, _number_of(names), True))
        elif text.startswith("left out: "):
            count, _, what = text.removeprefix("left out: ").partition(" ")
            found.append((what.partition(" (")[0], int(count), False))
        elif changes and text.startswith("no contact, "):
            found.append(("collision shapes", int(text.split()[2]), True))
        elif changes and ": " in text:
            what, _, names = text.rpartition(": ")
            what = what.removesuffix(" are not enforced").removesuffix(" is not simulated")
            found.append((what.partition(" (")[0], _number_of(names), True))
    return found


def _number_of(names):
    """Number of names of a note."""
    return names.count(", ") + 1


def _held(scene, body):
    """True if a joint has this body as its child."""
    return any(joint.child == body.name for joint in scene.joints)


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("words", nargs="*")
    parser.add_argument("--states", type=int, default=100)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--page", type=Path, help="write one line for each robot as a page")
    parser.add_argument("--motion", action="store_true", help="also compare 1 s of motion")
    args = parser.parse_args()
    rows = []
    found = files(args.words)
    row_of(found[0], 0)  # imports and compiles
    for path in found:
        rows.append(row_of(path, args.states, args.motion))
        print(rows[-1], flush=True)
    print(*summary_of(rows), by_format(rows), sep="\n")
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1) + "\n")
    if args.page:
        args.page.write_text(page_of(rows, args.states), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
