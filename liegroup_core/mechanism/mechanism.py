# SPDX-License-Identifier: Apache-2.0
"""RelativeModel of a scene: links, degrees of freedom, and the independent rows of the cut joints."""

import numpy as np

from liegroup_core.joints.elements import WORLD
from liegroup_core.motion_groups.table import FLOATING, FREE
from liegroup_core.scene.consistency import resolve_elements, resolve_frames
from liegroup_core.threads import one_blas_thread

from .arrays import IN_LINK, PLANE_LINK, PlaneModel, RelativeModel
from .body_model import LARGE_RATIO, are_unlike, levers
from .cuts import coupled_links, cut_elements, cut_rows, loop_arrays
from .freedoms_without_inertia import check_inertia
from .links import find_links, link_poses, link_records
from .planar import find_plane, plane_axes
from .redundancy import loop_joints
from .size import mechanism_size
from .spanning_tree import WORLD_NAME, spanning_tree
from .switch_records import stop_rows, switch_arrays


@one_blas_thread()
def relative_model(scene, model, in_space=False, group=None):
    """RelativeModel of a mechanism; a PlaneModel if it is planar.

    scene    : Scene with body frames at the centres of mass
    model    : its Model
    in_space : True: never a PlaneModel
    group    : key of FLOATING for an empty tree: all bodies float on this group, all joints are cut
    """
    frames, parts = resolve_frames(scene), resolve_elements(scene)
    plane = None if in_space else find_plane(scene, frames, parts)
    normal, allowed = (None, None) if plane is None else plane
    if group is not None:
        allowed = ()
    tree = spanning_tree(scene, allowed)
    floating = FLOATING.get(group, FREE)
    links, places = find_links(scene, frames, tree, normal, floating)
    index = {body.name: i for i, body in enumerate(scene.bodies)}
    records = link_records(scene, links, index)
    coupled = coupled_links(scene, links)
    stops = stop_rows(scene, links)
    cut, rows = cut_rows(scene, frames, parts, tree, links, places, stops, coupled)
    elements = cut_elements(scene, frames, cut, places, coupled)
    springs = sum(force.type == "torsional_spring_damper" for force in scene.forces)
    loops = None
    if group is not None:
        loops = loop_joints([(joint.parent, joint.child) for joint in scene.joints])
    arrays = loop_arrays(links, records, cut, rows, elements, coupled, springs, loops)
    body_records = np.array(
        [
            (places[body.name][0], places[body.name][1][:3, :3].ravel(), places[body.name][1][:3, 3])
            for body in scene.bodies
        ],
        dtype=IN_LINK,
    )
    common = dict(
        space=model,
        gravity=model.gravity,
        links=records,
        bodies=body_records,
        law_links=np.array([b for b, link in enumerate(links) if link.state], dtype=np.int64),
        elements=elements,
        **switch_arrays(scene, links, records, arrays, elements, places, mechanism_size(model, scene.joints)),
        refinements=_refinements(scene, model, len(arrays["cuts"]) > 0, normal),
        is_empty_tree=group is not None,
        only_free_bodies=not scene.joints and all(link.group == FREE for link in links),
        usual_pivot=1.0,
        projects=bool(model.projects and len(arrays["cuts"])),
        baumgarte_rate=model.baumgarte_rate,
        **arrays,
    )
    if normal is None:
        return RelativeModel(**common)
    return PlaneModel(**common, **_plane_arrays(model, links, records, normal))


def tree_of(scene):
    """SpanningTree that a RelativeModel of a scene is built on."""
    plane = find_plane(scene, resolve_frames(scene), resolve_elements(scene))
    return spanning_tree(scene, None if plane is None else plane[1])


def _plane_arrays(model, links, records, normal):
    """Fields of a PlaneModel that a RelativeModel does not have."""
    axes = plane_axes(normal)
    plane_links, heights = [], []
    for link, record in zip(links, records):
        T = link.placement
        if link.parent == WORLD:
            turned = np.eye(4)
            turned[:3, :3] = axes
            T = turned.T @ T
        turn = T[:2, 0] / np.linalg.norm(T[:2, 0])
        heights.append(T[2, 3] + (0.0 if link.parent == WORLD else heights[link.parent]))
        plane_links.append(
            (
                link.group,
                link.parent,
                record["freedom"],
                record["freedoms"],
                record["rotor"],
                record["mass"],
                *record["moment"][:2],
                record["inertia"][5],
                *turn,
                *T[:2, 3],
            )
        )
    return {
        "axes": axes.reshape(1, 9),
        "plane_gravity": model.gravity @ axes[:, :2],
        "plane_links": np.array(plane_links, dtype=PLANE_LINK),
        "link_heights": np.array(heights),
    }


def _refinements(scene, model, has_cuts, normal):
    """Number of refinements in each solve that recover all its digits.

    One if neighbours differ so much that articulated inertias lose digits; slender bodies and long levers
    cost none. W of cut joints loses twice as many digits. It also loses some with long levers and, in space,
    with slender bodies; in a plane a body has only one moment of inertia
    (test/verification/test_relative_accelerations.py).
    """
    bodies, elements = model.bodies, model.elements
    ends = list(zip(elements["parent"].tolist(), elements["child"].tolist()))
    inertia = bodies["inertia"].reshape(-1, 3, 3)
    traces = _without_zeros(np.trace(inertia, axis1=1, axis2=2))
    unlike = int(are_unlike(bodies["mass"], traces, ends, []))
    if not has_cuts:
        return unlike
    if normal is None:
        return max(2 * unlike, model.refinements)
    # About the normal only.
    axes = np.array([body.rotation.T @ normal for body in scene.bodies])
    moments = _without_zeros(np.einsum("bi,bij,bj->b", axes, inertia, axes))
    inverse = axes[:, :, None] * axes[:, None, :] / moments[:, None, None]
    longest = max(levers(bodies["mass"], inverse, elements), default=0.0)
    return max(2 * unlike, int(longest > LARGE_RATIO))


def _without_zeros(moments):
    """Moments of inertia (n,); zeros, those of point masses, are replaced by the largest one."""
    return np.where(moments > 0.0, moments, moments.max() or 1.0)


def refuse_freedoms_without_inertia(scene):
    """Raise SceneError if a degree of freedom of the spanning tree has no inertia.

    scene : Scene with body frames at the centres of mass
    """
    links, places = find_links(scene, resolve_frames(scene), spanning_tree(scene), None)
    links = [link for link in links if not link.state]  # the last ones, which have no body
    poses = {body.name: body.pose for body in scene.bodies} | {WORLD_NAME: np.eye(4)}
    check_inertia(scene, links, places, link_poses(links, range(len(links)), poses))


def refuse_cut_couplings(scene):
    """Raise SceneError if a coupled joint is not in the spanning tree.

    scene : Scene with body frames at the centres of mass
    """
    frames = resolve_frames(scene)
    links, _ = find_links(scene, frames, tree_of(scene), None)
    coupled_links(scene, links)
