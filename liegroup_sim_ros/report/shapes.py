# SPDX-License-Identifier: Apache-2.0
"""Visuals of a robot's file as triangles for the 3D view, within a bound for the page.

Needs trimesh, and for collada and decimation the other packages of the extra `meshes`. Without them,
and for meshes that this machine does not have, the view draws the boxes of the bodies' inertias.
"""

import base64
import os

import numpy as np

from liegroup_core.robots.resources import find_resource
from liegroup_sim_ros.numbers import counted

MOST_TRIANGLES = 20_000  # of a page
LARGEST_FILE = 64 * 2**20  # bytes of a mesh
ROUND = 24  # sides of a cylinder
HINT = "pip install 'liegroup_sim_ros[meshes]'"


def robot_shapes(robot):
    """({body: shape}, [remark]) of the visuals of a robot: a scene's RobotNames.

    shape : {"points": base64 of (k, 3) float32 in m, in the body frame, "faces": base64 of (m, 3)
            int32, "at", "size": centre and edges of their bounding box in the body frame, m}
    remarks say in one line each what is not drawn.
    """
    try:
        import trimesh
    except ImportError:
        return {}, [f"visuals are drawn as boxes, trimesh is not installed: {HINT}"]
    meshes, missing, failed = {}, [], {}
    for link, (body, place) in robot.frames.items():
        for visual in robot.visuals.get(link, ()) if body != "world" else ():
            try:
                mesh = _mesh(trimesh, visual, robot.file)
            # Whatever a reader of meshes finds wrong, the other bodies are drawn.
            except Exception as error:
                failed[visual.mesh] = " ".join(f"{type(error).__name__}: {error}".split())[:120]
                continue
            if mesh is None:
                missing.append(visual.mesh)
            else:
                mesh.apply_transform(place @ visual.pose)
                meshes.setdefault(body, []).append(mesh)
    remarks = []
    if missing:
        remarks.append(
            f"meshes that are not on this machine: {len(missing)}, the first is {missing[0]}"
        )
    for name, text in list(failed.items())[:1]:
        remarks.append(f"meshes that cannot be read: {len(failed)}, the first is {name}: {text}")
    whole = {body: trimesh.util.concatenate(parts) for body, parts in meshes.items()}
    return {body: _packed(mesh) for body, mesh in _decimated(whole, remarks).items()}, remarks


def _mesh(trimesh, visual, file):
    """Trimesh of a visual in its own frame, or None for a mesh that is not there."""
    if visual.kind == "box":
        return trimesh.creation.box(extents=np.maximum(visual.size, 1e-6))
    if visual.kind == "cylinder":
        radius, length = visual.size
        return trimesh.creation.cylinder(radius=radius, height=length, sections=ROUND)
    if visual.kind == "sphere":
        return trimesh.creation.icosphere(subdivisions=2, radius=visual.size[0])
    path = find_resource(visual.mesh, file)
    if path is None:
        return None
    if os.path.getsize(path) > LARGEST_FILE:
        raise ValueError(f"it is larger than {LARGEST_FILE >> 20} MiB")
    mesh = trimesh.load_mesh(path).copy()
    # Without common points decimation would tear the triangles apart.
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    if not len(mesh.faces) or not np.isfinite(mesh.vertices).all():
        raise ValueError("it has no triangles, or points that are no numbers")
    mesh.apply_scale(visual.size)
    return mesh


def _decimated(meshes, remarks):
    """Meshes with at most MOST_TRIANGLES in all, in proportion to what they have."""
    total = sum(len(mesh.faces) for mesh in meshes.values())
    if total <= MOST_TRIANGLES:
        return meshes
    found, boxes, advice = {}, 0, ""
    for body, mesh in meshes.items():
        most = int(MOST_TRIANGLES * len(mesh.faces) / total)
        try:
            mesh = mesh.simplify_quadric_decimation(face_count=max(most, 4))
        except ImportError:
            mesh, advice = None, f"; {HINT} decimates them"
        if mesh is None or len(mesh.faces) > most:  # what cannot be simplified so far
            boxes += 1
        else:
            found[body] = mesh
    if boxes:
        remarks.append(
            f"drawn as boxes: {counted(boxes, 'body')}; all visuals have {total} triangles, the page "
            f"at most {MOST_TRIANGLES}{advice}"
        )
    return found


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
