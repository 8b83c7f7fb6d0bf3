# SPDX-License-Identifier: Apache-2.0
"""Triangles of the shapes that a viewer draws, and hulls of collision meshes, by trimesh.

It runs in a separate process, see apart.py.
"""

import base64

import numpy as np
import trimesh

ROUND = 32  # facets of a cylinder's surface
BOX = 12  # triangles of a box
DIRECTIONS = 4096  # 3 degrees apart, in which hulls are compared
AT_ONCE = 10**7  # products of points and directions, 80 MB


def triangles_of(order):
    """Dict of JSON types: shapes {body: [shape]}, failed {mesh: why}, triangles (all), boxes (bodies).

    order : dict with shapes [(body, kind, size, pose in the body's frame, path of the mesh, color, asset)], kinds,
            sizes, colors and assets as in robots.description.Visual; of an asset, the path is that of the MJCF file;
            and most, the maximum number of triangles of the result
    shape : points, base64 of (k, 3) float32 in m, in the body's frame; faces, base64 of (m, 3) int32; at,
            size: centre and edges of their bounding box in the body's frame, m; color, None for that of the body
    A body whose triangles cannot be simplified far enough has its convex hull, or its bounding box. lacks: name of the
    package for simplification if it is not installed, else "".
    """
    parts, failed = {}, {}
    for body, kind, size, pose, path, color, asset in order["shapes"]:
        try:
            found = _meshes(kind, size, path, asset)
        # Mesh readers raise errors of any type. The other bodies are still drawn.
        except Exception as error:
            failed[path] = " ".join(f"{type(error).__name__}: {error}".split())[:120]
            continue
        for mesh, own in found:
            mesh.apply_transform(np.array(pose))
            parts.setdefault((body, *(color or own or ())), []).append(mesh)
    whole = {key: trimesh.util.concatenate(some) for key, some in parts.items()}
    total, lacks, boxes = sum(len(mesh.faces) for mesh in whole.values()), "", 0
    if total > order["most"]:
        whole, boxes, lacks = _decimated(whole, order["most"] / total)
    shapes = {}
    for (body, *color), mesh in whole.items():
        shapes.setdefault(body, []).append(_packed(mesh) | {"color": color or None})
    return {"shapes": shapes, "failed": failed, "triangles": total, "boxes": boxes, "lacks": lacks}


def hulls_of(order):
    """Dict of JSON types: hulls [{points, loss, failed}] of meshes, each with `hull_of`, or with why it failed.

    order : dict with hulls [(scale, path, asset)] as in the shapes of `triangles_of`, and most and within of `hull_of`
    """
    found = []
    for scale, path, asset in order["hulls"]:
        try:
            points = np.concatenate([mesh.vertices for mesh, _ in _meshes("mesh", scale, path, asset)])
            chosen, loss = hull_of(points, order["most"], order["within"])
            found.append({"points": chosen.tolist(), "loss": loss, "failed": ""})
        # As above: the contacts of the other shapes still act.
        except Exception as error:
            why = " ".join(f"{type(error).__name__}: {error}".split())[:120]
            found.append({"points": None, "loss": 0.0, "failed": why})
    return {"hulls": found}


def hull_of(points, most, within):
    """(points (k, 3) of a hull, loss in m): some of the points, at most `most`, and how far their hull lacks behind.

    The loss is the largest difference of the support functions among DIRECTIONS directions of a Fibonacci sphere and
    those of the axes. A point is added where it is largest, until it is at most `within`.
    """
    k = np.arange(DIRECTIONS) + 0.5
    z, turn = 1.0 - 2.0 * k / DIRECTIONS, np.pi * (1.0 + np.sqrt(5.0)) * k
    ball = np.column_stack([np.sqrt(1.0 - z**2) * np.cos(turn), np.sqrt(1.0 - z**2) * np.sin(turn), z])
    directions = np.concatenate([np.eye(3), -np.eye(3), ball])
    parts = np.array_split(directions, 1 + len(points) * len(directions) // AT_ONCE)
    farthest = np.unique(np.concatenate([np.argmax(points @ part.T, axis=0) for part in parts]))
    reach = points[farthest] @ directions.T
    whole, own, chosen = reach.max(axis=0), np.full(len(directions), -np.inf), []
    while True:
        at = np.argmax(whole - own)
        loss = whole[at] - own[at]
        if loss <= within or len(chosen) == most:
            return points[farthest[chosen]], float(loss)
        chosen.append(np.argmax(reach[:, at]))
        own = np.maximum(own, reach[chosen[-1]])


def _meshes(kind, size, path, asset):
    """[(Trimesh in the frame of the shape, its own color or None)] of a shape."""
    if kind == "box":
        return [(trimesh.creation.box(extents=np.maximum(size, 1e-6)), None)]
    if kind == "cylinder":
        return [(trimesh.creation.cylinder(radius=size[0], height=size[1], sections=ROUND), None)]
    if kind == "capsule":
        mesh = trimesh.creation.capsule(radius=size[0], height=size[1], count=(ROUND, ROUND))
        mesh.apply_translation(-mesh.bounds.mean(axis=0))
        return [(mesh, None)]
    if kind in ("sphere", "ellipsoid"):
        ball = trimesh.creation.icosphere(subdivisions=3)
        ball.apply_scale(np.maximum(size, 1e-9))
        return [(ball, None)]
    if asset >= 0:
        from .mjcf_model import triangles_of_mesh

        return [(_checked(trimesh.Trimesh(*triangles_of_mesh(path, asset), process=False)), None)]
    scene, found = trimesh.load_scene(path), []
    unit = trimesh.units.unit_conversion(scene.units, "meters") if path.lower().endswith(".dae") else 1.0
    for mesh in scene.dump():
        color = np.divide(mesh.visual.main_color, 255.0).tolist() if mesh.visual.defined else None
        # Decimation keeps triangles connected only if they share vertices.
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        mesh.visual = None
        mesh.apply_scale(unit * np.array(size))
        found.append((_checked(mesh), color))
    return found or _checked(trimesh.Trimesh())


def _checked(mesh):
    if not len(mesh.faces) or not np.isfinite(mesh.vertices).all():
        raise ValueError("it has no triangles, or points that are not finite")
    return mesh


def _decimated(meshes, part):
    """({key: mesh} with about this fraction of the triangles, number of hulls and boxes, missing package)."""
    found, coarse, lacks = {}, 0, ""
    for key, mesh in meshes.items():
        most = max(int(part * len(mesh.faces)), BOX)
        try:
            small = mesh.simplify_quadric_decimation(face_count=most)
            if len(small.faces) > most:
                coarse += 1
                small = mesh.convex_hull.simplify_quadric_decimation(face_count=most)
        except (ImportError, ValueError, RuntimeError) as error:  # a flat mesh has no hull
            if isinstance(error, ImportError):
                lacks, coarse = error.name or "fast_simplification", coarse + 1
            small = mesh
        found[key] = small if len(small.faces) <= most else trimesh.creation.box(bounds=mesh.bounds)
    return found, coarse, lacks


def _packed(mesh):
    low, high = np.asarray(mesh.bounds)
    return {
        "points": _base64(mesh.vertices, "<f4"),
        "faces": _base64(mesh.faces, "<i4"),
        "at": ((low + high) / 2).tolist(),
        "size": (high - low).tolist(),
    }


def _base64(values, kind):
    return base64.b64encode(np.ascontiguousarray(values, dtype=kind).tobytes()).decode()
