# SPDX-License-Identifier: Apache-2.0
"""3D view of the HTML report: shapes of the bodies, joints, and poses over time."""

import base64
import math

import numpy as np
import scipy

from liegroup_core.scene.names import WORLD
from liegroup_sim_ros.analysis.acting import sample_of
from liegroup_sim_ros.messages.markers import THINNEST, edges, links, solid
from liegroup_sim_ros.messages.touching import arrows, measure, patches, radius

from .plots import BASE, MANY_COLOURS, label
from .shapes import box_of, with_contacts

# Limits on the number of poses of all bodies and of frames. More would make the page large, fewer the motion jerky.
MOST_PLACES, MOST_FRAMES, LEAST_FRAMES = 15_000, 3000, 200
MOST_PUSHES = 1000
COLOURFUL = 0.2  # least distance of the largest and the smallest of red, green and blue in a colour that is not grey


def make_view(analysis, shapes=None):
    """Data of the 3D view of an Analysis for page.js, JSON types; m, s, world axes.

    shapes        : {body or world: [triangles]}, see shapes.robot_shapes; other bodies are drawn by the shapes of their
                    contacts, or as solids with their inertia
    times, places : base64 of (k,) float64, and of (k, n, 7) float32: position and x y z w of the
                    body frames
    planes        : corners of the `patches` that contacts touch
    forces        : base64 of float32 (k, c, 6): start and tip of the force of each contact, NaN where it is 0
    touching      : base64 of float32 (t, 4), points that press: x y z, 1 where one slips, and `ends`, base64 of int32
                    (k,) of how many there are up to each time; `point`: radius in m of one that is drawn
    breaks        : last frames before a reset
    """
    scene, stretches = analysis.scene, analysis.motion.stretches
    shapes = with_contacts(shapes or {}, scene)
    layout = analysis.layout
    index = {body.name: i for i, body in enumerate(scene.bodies)}
    solids = [solid(body, scene) for body in scene.bodies]
    thinnest = THINNEST * max(max(edges(each)) for each in solids)
    bodies = [
        {
            "name": label(body.name),
            "solid": each.kind,
            "size": [max(float(length), thinnest) for length in edges(each)],
            "at": each.pose[:3, 3].tolist(),
            "turn": each.pose[:3, :3].ravel().tolist(),
            "com": [float(x) for x in body.com],
            "colour": MANY_COLOURS[i % len(MANY_COLOURS)],
        }
        for i, (body, each) in enumerate(zip(scene.bodies, solids))
    ]
    given = [shapes.get(body.name) for body in scene.bodies]
    given = [found and max(found, key=lambda shape: np.prod(shape["size"]))["color"] for found in given]
    for scene_body, body, own in zip(scene.bodies, bodies, given):
        # Paths of equal colours, or of grey ones, could not be told apart.
        if own and given.count(own) == 1 and np.ptp(own[:3]) > COLOURFUL:
            body["colour"] = _rgb(own)
        if found := shapes.get(scene_body.name):
            at, size = box_of(found)
            body |= {
                "shapes": list(_coloured(found)),
                "at": at.tolist(),
                "size": size.tolist(),
                "turn": np.eye(3).ravel().tolist(),
            }
        elif scene_body.name in shapes:
            body |= {"solid": "sphere", "at": body["com"], "size": [thinnest] * 3}
    joints = [
        {
            "name": label(joint.name),
            "parent": index.get(joint.parent, -1),
            "child": index[joint.child],
            "at": (frame[:3, 3] + scene.bodies[index[joint.child]].com).tolist(),
        }
        for joint, (_, frame) in zip(scene.joints, layout.joint_frames)
    ]
    count = sum(len(stretch.steps) for stretch in stretches)
    most = min(MOST_FRAMES, max(LEAST_FRAMES, MOST_PLACES // len(bodies)))
    pick = np.unique(np.linspace(0, count - 1, min(count, most)).astype(int))
    since = np.cumsum([0] + [len(stretch.steps) for stretch in stretches])
    owner = np.searchsorted(since, pick, "right") - 1
    times = np.concatenate([stretch.log_times for stretch in stretches])[pick]
    position = np.concatenate([stretch.position for stretch in stretches])[pick]
    turn = np.concatenate([stretch.rotation for stretch in stretches])[pick]
    quaternion = scipy.spatial.transform.Rotation.from_matrix(turn.reshape(-1, 3, 3)).as_quat()
    places = np.concatenate([position, quaternion.reshape(*position.shape[:2], 4)], axis=2)
    pushes = [
        [
            index[body],
            stretch.base_ns * 1e-9 + first * stretch.step,
            stretch.base_ns * 1e-9 + end * stretch.step if math.isfinite(end) else None,
        ]
        for stretch in stretches
        for first, end, body in sorted((*pair, name) for name in index for pair in stretch.pushes_on(name).tolist())
    ]
    scale = measure(scene, [max(body["size"]) for body in bodies])
    forces, touching = _contacts(layout, stretches, pick - since[owner], owner, scale)
    low, high = _bounds(bodies, position, turn.reshape(*position.shape[:2], 3, 3))
    seconds = float(times[-1] - times[0])
    return {
        "bodies": bodies,
        "fixed": [{"shapes": list(_coloured(found))} for found in [shapes.get(WORLD)] if found],
        "joints": joints,
        "links": [[[i, point.tolist()] for i, point in ends] for ends in links(scene)],
        "times": _packed(times, "<f8"),
        "places": _packed(places, "<f4"),
        "planes": [each.tolist() for each in patches(scene, low, high)],
        "forces": _packed(forces, "<f4"),
        "touching": _packed(np.concatenate([*touching, np.empty((0, 4))]), "<f4"),
        "ends": _packed(np.cumsum([len(each) for each in touching]), "<i4"),
        "point": radius(scene, scale[0], float(np.linalg.norm(high - low))),
        "breaks": np.flatnonzero(np.diff(owner)).tolist(),
        "pushes": pushes[:MOST_PUSHES],
        "frames": len(pick),
        "seconds": seconds,
        "digits": max(0, min(6, 3 - math.floor(math.log10(seconds)))) if seconds > 0 else 3,
        "layout": {"margin": {"l": 0, "r": 0, "t": 32, "b": 0}, **BASE},
    }


def _contacts(layout, stretches, rows, owner, scale):
    """(k, c, 2, 3) `arrows` of the samples `rows` (k,) of the stretches `owner` (k,), and [(p, 4)] points."""
    found, points = np.full((len(rows), len(layout.touching.names), 2, 3), np.nan), []
    for k, (row, stretch) in enumerate(zip(rows, owner) if found.size else ()):
        sample = sample_of(layout, stretches[stretch], row)
        found[k] = arrows(sample, *scale)
        points.append(sample.pressing[sample.pressing[:, 0] > 0.0, 1:])
    return found, points or [np.empty((0, 4))] * len(rows)


def _bounds(bodies, position, turn):
    """Least and largest coordinates (3,), (3,) m of the boxes about bodies, in frames (k, n, 3), (k, n, 3, 3)."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for i, body in enumerate(bodies):
        axes = turn[:, i] @ np.reshape(body["turn"], (3, 3))
        at = position[:, i] + turn[:, i] @ body["at"]
        reach = np.abs(axes) @ (0.5 * np.array(body["size"]))
        low, high = np.minimum(low, (at - reach).min(axis=0)), np.maximum(high, (at + reach).max(axis=0))
    return low, high


def _coloured(shapes):
    """Shapes with their color as that of a style sheet, and an opacity."""
    for shape in shapes:
        color = shape["color"]
        yield shape | ({"colour": _rgb(color), "opacity": color[3]} if color else {})


def _rgb(color):
    return "rgb({},{},{})".format(*(round(255.0 * part) for part in color[:3]))


def speeds(seconds):
    """([playback speeds], initial speed); they play a run in 2 s to several minutes."""
    seconds = seconds or 1.0
    steps = [m * 10.0**e for e in range(-6, 7) for m in (1, 2, 5)]
    usual = [s for s in steps if seconds / 200.0 <= s <= seconds / 1.5] or [1.0]
    first = 1.0 if 3.0 <= seconds <= 60.0 else min(usual, key=lambda s: abs(math.log(seconds / s / 15.0)))
    return sorted({*usual, first}), first


def _packed(values, kind):
    return base64.b64encode(np.ascontiguousarray(values, dtype=kind).tobytes()).decode()
