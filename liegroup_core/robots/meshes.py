# SPDX-License-Identifier: Apache-2.0
"""Triangles of the shapes that a viewer draws, by trimesh. It runs in a separate process, see apart.py."""

import base64

import numpy as np
import trimesh

ROUND = 24  # facets of a cylinder's surface
BOX = 12  # triangles of a box


def triangles_of(order):
    """Dict of JSON types: shapes {body: shape}, failed {mesh: why}, triangles (all), boxes (bodies).

    order : dict with shapes [(body, kind, size, pose in the body's frame, path of the mesh)], kinds and sizes
            as in robots.description.Visual; and most, the maximum number of triangles of the result
    shape : points, base64 of (k, 3) float32 in m, in the body's frame; faces, base64 of (m, 3) int32; at,
            size: centre and edges of their bounding box in the body's frame, m
    A body whose triangles cannot be simplified far enough has its convex hull, or its bounding box. lacks: name of the
    package for simplification if it is not installed, else "".
    """
    meshes, failed = {}, {}
    for body, kind, size, pose, path in order["shapes"]:
        try:
            mesh = _mesh(kind, size, path)
        # Mesh readers raise errors of any type. The other bodies are still drawn.
        except Exception as error:
            failed[path] = " ".join(f"{type(error).__name__}: {error}".split())[:120]
            continue
        mesh.apply_transform(np.array(pose))
        meshes.setdefault(body, []).append(mesh)
    whole = {body: trimesh.util.concatenate(parts) for body, parts in meshes.items()}
    total, lacks, boxes = sum(len(mesh.faces) for mesh in whole.values()), "", 0
    if total > order["most"]:
        whole, boxes, lacks = _decimated(whole, order["most"] / total)
    return {
        "shapes": {body: _packed(mesh) for body, mesh in whole.items()},
        "failed": failed,
        "triangles": total,
        "boxes": boxes,
        "lacks": lacks,
    }


def _mesh(kind, size, path):
    """Trimesh of a shape in its own frame."""
    if kind == "box":
        return trimesh.creation.box(extents=np.maximum(size, 1e-6))
    if kind == "cylinder":
        return trimesh.creation.cylinder(radius=size[0], height=size[1], sections=ROUND)
    if kind == "sphere":
        return trimesh.creation.icosphere(subdivisions=2, radius=size[0])
    mesh = trimesh.load_mesh(path).copy()
    # Decimation keeps triangles connected only if they share vertices.
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    if not len(mesh.faces) or not np.isfinite(mesh.vertices).all():
        raise ValueError("it has no triangles, or points that are not finite")
    mesh.apply_scale(size)
    return mesh


def _decimated(meshes, part):
    """({body: mesh} with about this fraction of the triangles, number of hulls and boxes, missing package)."""
    found, coarse, lacks = {}, 0, ""
    for body, mesh in meshes.items():
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
        found[body] = small if len(small.faces) <= most else trimesh.creation.box(bounds=mesh.bounds)
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
