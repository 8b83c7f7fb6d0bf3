# SPDX-License-Identifier: Apache-2.0
"""The algebra of the sweeps, selected by the type of the model: se(3), or se(2) in a plane.

Each sweep is written once. It calls these functions, those of links.py, and those of a link's motion group.
Twists and wrenches are pairs of an angular and a linear part in space, and (omega, v_x, v_y) in a plane.
"""

from liegroup_core.compiling import Choice, kernel
from liegroup_core.lie.se2 import se2_Ad_inverse, se2_compose, se2_wrench
from liegroup_core.lie.se3 import se3_Ad_inverse, se3_compose, se3_wrench
from liegroup_core.lie.vec3 import ZERO3, add3, add_to3, axpy3, dot3, load3, load9, store3, sub3
from liegroup_core.mechanism.arrays import PlaneModel, RelativeModel
from liegroup_core.motion_groups.elimination import made
from liegroup_core.motion_groups.in_plane import place
from liegroup_core.motion_groups.table import by_model, in_world_axes, relative_pose, slides


@kernel
def tree_size(model):
    """Number of links without those of the states of laws, which come last: slides without mass or children."""
    return len(model.links) - len(model.law_links)


@kernel
def first_state(model, work):
    """Degree of freedom of the first state of laws; they are the last ones, in order."""
    return len(work.freedoms) - len(model.law_links)


def choice(name, space, plane):
    """Choice between two functions: for models in space, and in a plane."""
    return Choice(name, {RelativeModel: space, PlaneModel: plane})


def by_space(name, space, plane):
    """Choice between the functions of this name in two modules."""
    return choice(name, getattr(space, name), getattr(plane, name))


def of_group(name):
    """Choice of a function of the motion group of a link: (model, link, arguments of the table)."""
    return choice(name, *by_model(name))


def _of(name, arguments, *texts):
    """Choice of two expressions: in space, and in a plane."""
    called = {each.__name__: each for each in _CALLED} | {"ZERO3": ZERO3}
    head = f"def {name}({', '.join(['model', *arguments.split()])}):\n    "
    return choice(name, *(made(name, f"{head}{text}\n", called) for text in texts))


_CALLED = (add3, add_to3, axpy3, dot3, load3, load9, store3, sub3)
_CALLED += (in_world_axes, relative_pose, se2_compose, se3_compose)
_CALLED += (se2_Ad_inverse, se2_wrench, se3_Ad_inverse, se3_wrench, place, slides)

# Number of components of a twist, and their first column in a row (6) of a Jacobian.
size, offset = _of("size", "", "return 6", "return 3"), _of("offset", "", "return 0", "return 2")
# Record of link b.
link_of = _of("link_of", "b", "return model.links[b]", "return model.plane_links[b]")
# Whether velocities on the motion group are in world axes.
is_direct = _of("is_direct", "link", "return in_world_axes(link)", "return False")
zero = _of("zero", "", "return ZERO3, ZERO3", "return ZERO3")
load = _of("load", "array row", "return load3(array, row, 0), load3(array, row, 3)", "return load3(array, row, 0)")
store = _of("store", "V out row", "store3(V[0], out, row, 0); store3(V[1], out, row, 3)", "store3(V, out, row, 0)")
add_to = _of("add_to", "F out row", "add_to3(F[0], out, row, 0); add_to3(F[1], out, row, 3)", "add_to3(F, out, row, 0)")
add = _of("add", "V W", "return add3(V[0], W[0]), add3(V[1], W[1])", "return add3(V, W)")
sub = _of("sub", "V W", "return sub3(V[0], W[0]), sub3(V[1], W[1])", "return sub3(V, W)")
# value + J V for row r of J, and e + slip times the linear part of the row.
product = _of(
    "product",
    "value rows r V",
    "return value + dot3(load3(rows, r, 0), V[0]) + dot3(load3(rows, r, 3), V[1])",
    "return value + dot3(load3(rows, r, 2), V)",
)
add_row = _of(
    "add_row",
    "e slip rows r",
    "return e[0], axpy3(slip, load3(rows, r, 3), e[1])",
    "return axpy3(slip, (0.0, rows[r, 3], rows[r, 4]), e)",
)
# Index of the wrench component along the degree of freedom of a hinge, screw, slide or cylinder (component 1:
# displacement of a cylinder, else 0), and the wrench with this component alone.
column = _of(
    "column", "link component", "return 5 if component == 1 or slides(link) else 2", "return 1 if slides(link) else 0"
)
unit = _of(
    "unit",
    "column value",
    "return (ZERO3, (0.0, 0.0, value)) if column == 5 else ((0.0, 0.0, value), ZERO3)",
    "return (0.0, value, 0.0) if column == 1 else (value, 0.0, 0.0)",
)
# The pose X of link b in its parent; with it, a twist of the parent in the frame of b, and a wrench on b in the frame
# of the parent.
relative = _of(
    "relative",
    "work b",
    "return load9(work.relative, b, 0), load3(work.relative, b, 9)",
    "return place(work.stage_pose, len(model.bodies) + b)",
)
Ad_inverse = _of("Ad_inverse", "X V", "return se3_Ad_inverse(X[0], X[1], V[0], V[1])", "return se2_Ad_inverse(X, V)")
wrench_at = _of("wrench_at", "X F", "return se3_wrench(X[0], X[1], F[0], F[1])", "return se2_wrench(X, F)")
# Vdot of link b minus gravity; and of the world.
freed = _of(
    "freed",
    "work b",
    "return load3(work.moved, b, 0), load3(work.moved, b, 3)",
    "return work.moved[b, 0], work.moved[b, 1] + work.drift[b, 0], work.moved[b, 2] + work.drift[b, 1]",
)
resting = _of(
    "resting",
    "",
    "return ZERO3, axpy3(-1.0, load3(model.gravity, 0, 0), ZERO3)",
    "return 0.0, -model.plane_gravity[0, 0], -model.plane_gravity[0, 1]",
)
# Poses of links in the world, or in the plane, at the stage.
compose = _of("compose", "X Y", "return se3_compose(X[0], X[1], Y[0], Y[1])", "return se2_compose(X, Y)")
placed = _of(
    "placed", "work b", "return load9(work.world, b, 0), load3(work.world, b, 9)", "return place(work.placed, b)"
)
# Pose in the parent from coordinates; pose and twist lifted to space, z normal to the plane; twist in the plane.
in_parent = _of(
    "in_parent",
    "link coordinates row",
    "return relative_pose(link, coordinates, row)",
    "return place(coordinates, row)",
)
lifted = _of("lifted", "X", "return X", "return (X[0], -X[1], 0.0, X[1], X[0], 0.0, 0.0, 0.0, 1.0), (X[2], X[3], 0.0)")
spatial = _of("spatial", "V", "return V", "return (0.0, 0.0, V[0]), (V[1], V[2], 0.0)")
planar = _of("planar", "V", "return V", "return V[0][2], V[1][0], V[1][1]")
# That of the state of a law, which is a slide.
state_column = _of("state_column", "", "return 5", "return 1")
coordinate, rate_twist, project_pose = map(of_group, ("coordinate", "rate_twist", "project_pose"))
rates_of, own_forces, column_twist = map(of_group, ("rates_of", "own_forces", "column_twist"))
