# SPDX-License-Identifier: Apache-2.0
"""Arrays of the relative formulation: counterparts of Model and Work, which are for bodies on SE(3)^n.

A link is a body of the spanning tree with everything that is welded to it. Its frame is the child
frame of the joint to its parent link; that of a floating link is at its centre of mass. The joint
lets the link move relative to its parent link in a subgroup H of SE(3), its motion group:

    C_b = C_a T X ,   V_b = Ad(C_ba) V_a + S qdot ,   X in H, S a basis of the Lie algebra of H

with the constant placement T of the joint in the parent link. S has unit columns (for a screw: one
column with the pitch). A universal joint is two hinges with a massless link between them.

    n bodies of the scene, L links, f degrees of freedom (columns of S of all links), m rows of cut joints

A state has n + L rows. The first n are poses (n, 12) and twists (n, 6) of the bodies, as in Work.
Row n + b has the coordinates of link b: X as (R row by row, r) for the groups SO(3) and SE(3), else
(cos, sin, x, y, z) of a rotation about z and a translation; and qdot.
"""

import numpy as np

from liegroup_core.compiling import Struct, shaped
from liegroup_core.forces.external import COLUMNS as EXTERNAL_COLUMNS

from .bodies import CallTimes, Model, Work

LARGEST_ROWS = 6  # of a joint

# Columns of Work.modes.
SLIP, SIDE, COORDINATE, KNOWN, RESTS, EFFORT = range(6)
SETTLED = 2.0  # KNOWN of modes that are those of the inputs
# Entries of Work.watch: 1 if a step stops at events; start and size of the substep with an event.
WATCHED, BEGIN, SPAN = range(3)
NODES = 6  # largest number of stages of a step whose guards are kept

# How the coordinates of a link are found from poses of bodies.
OWN, CROSS, AFTER_CROSS = 0, 1, 2

LINK = np.dtype(
    [
        ("group", "i8"),  # motion_groups/table.py
        ("parent", "i8"),  # parent: link, or WORLD
        ("freedom", "i8"),
        ("freedoms", "i8"),  # first degree of freedom, and their number
        ("body", "i8"),
        ("coordinates", "i8"),  # body that represents the link; OWN, or CROSS for
        # the massless link of a universal joint
        ("rotation", "f8", (9,)),
        ("point", "f8", (3,)),  # T
        ("body_rotation", "f8", (9,)),
        ("body_point", "f8", (3,)),  # D: pose of `body` in the link
        ("aligned", "i8"),  # 1: T turns about x, and then about z
        ("pitch", "f8"),
        ("rotor", "f8"),  # inertia of the rotor of its joint at the degree of freedom, kg m^2 or kg; 0: none
        ("mass", "f8"),  # m/rad, kg
        ("moment", "f8", (3,)),
        ("inertia", "f8", (6,)),  # m c; xx, xy, xz, yy, yz, zz about the origin
    ],
    align=True,
)

IN_LINK = np.dtype(
    [  # body of the scene in its link
        ("link", "i8"),  # link, or WORLD: welded to the world
        ("rotation", "f8", (9,)),
        ("point", "f8", (3,)),  # its pose in the link
    ],
    align=True,
)

CUT = np.dtype(
    [  # cut element with rows that are solved for
        ("parent", "i8"),
        ("child", "i8"),  # link; the parent may be WORLD, the child not
        ("kind", "i8"),
        ("element", "i8"),  # kind of element, and its index in `elements`
        ("rows", "i8"),
        ("first", "i8"),  # rows, and the first of them in `row_residual`
        ("in_loop", "i8"),  # 0: its rows never depend on those of other joints
        ("own_points", "i8"),  # 1: its force acts on each link at its own point, see rows.py
    ],
    align=True,
)


COUPLED = np.dtype(
    [  # coupling of the coordinates of links, each a hinge, slide or screw: couplings.py
        ("row", "i8"),
        ("residual", "i8"),  # index of the row, and of its residual
        ("terms", "i8", (2,)),  # range of `coupling_terms`: joint, other, further ones; one of a driven joint
        ("curve", "f8", (4,)),  # ratio, a_2, a_3, a_4 of p(q), see law of couplings.py
        ("curved", "i8"),  # 1: any of a_2, a_3, a_4
        ("offset", "f8"),
        ("turned", "i8"),  # 1: the residual is taken modulo 2 pi
        ("motion", "i8"),  # motion that the first coordinate of a driven joint follows; -1: a coupling
        ("order", "i8"),  # of the derivative that is solved for: 2 accelerations, 1 rates
    ],
    align=True,
)


TERM = np.dtype(
    [  # of a coupling: coordinate of a link
        ("link", "i8"),
        ("factor", "f8"),  # of its rate in the row; for the second joint of a curve at q = 0
        ("angle", "i8"),  # its unwrapped angle, -1: none
        ("sign", "f8"),  # of the link's coordinate when that of its joint increases
    ],
    align=True,
)


SWITCH = np.dtype(
    [  # coordinate with stops or dry friction: of a link of the tree, or of a row; see switches.py
        ("row", "i8"),  # -1: a degree of freedom of the tree
        ("joint", "i8"),  # cut joint whose wrench the row is, else -1
        ("link", "i8"),
        ("freedom", "i8"),  # of the tree; of row r: f + r
        ("component", "i8"),  # of the rates of the link
        ("unit", "f8"),  # 1 rad, or the characteristic length, m: round-off refers to it
        ("turned", "i8"),  # 1: poses determine the coordinate modulo 2 pi
        ("sign", "f8"),  # of this coordinate when that of the joint increases
        ("lower", "f8"),
        ("upper", "f8"),  # stops, rad or m; infinite: none
        ("expected", "f8"),  # coordinate near which that of a new state is unwrapped
        ("restitution", "f8"),
        ("stiffness", "f8"),  # 0: rigid stops
        ("damping", "f8"),
        ("coulomb", "f8"),
        ("static", "f8"),
        ("viscous", "f8"),
        ("sliding_by_load", "f8"),  # friction for each N of load: N m or N
        ("static_by_load", "f8"),
        ("bearing", "i8"),  # cut joint that carries the load; -1: the joint of the link
    ],
    align=True,
)


class RelativeModel(Struct):
    """Constants of a mechanism in relative coordinates; parents precede their children."""

    space: Model  # the same mechanism on SE(3)^n
    gravity: np.ndarray  # (1, 3) m/s^2, world axes
    links: np.ndarray  # (L,) of LINK
    bodies: np.ndarray  # (n,) of IN_LINK
    law_links: np.ndarray  # (s,) links whose rates are the states of laws, see forces/law.py
    elements: np.ndarray  # of ELEMENT: those of the cut joints, between links
    cuts: np.ndarray  # (c,) of CUT
    owners: np.ndarray  # (c,) their elements in `space`
    row_residual: np.ndarray  # (m,) index of the residual of each row
    row_turns: np.ndarray  # (m,) 1: the row forbids a rotation, 0: a translation
    child_jacobian: np.ndarray  # (m, 6) rows of every PAIR for its child link
    paths: np.ndarray  # (c, 2) range of each cut in `path_links`
    path_links: np.ndarray  # links between the cut and the world, children first
    path_freedoms: np.ndarray  # degrees of freedom of these links, in the order of elimination
    path_ends: np.ndarray  # (c + 1,) where those of each cut start in `path_freedoms`
    path_places: np.ndarray  # (c + 1,) where the cut's responses start in Work.response
    shared: np.ndarray  # (k, 3) cuts i, j < i that share degrees of freedom, end in shared_freedoms
    shared_freedoms: np.ndarray  # (l, 3) a degree of freedom, its place in the responses of both cuts
    couplings: np.ndarray  # of COUPLED
    coupling_terms: np.ndarray  # of TERM
    coupling: np.ndarray  # (c,) index of the coupling that a cut joint stands for, or -1
    switches: np.ndarray  # (k,) of SWITCH
    switched: np.ndarray  # (m,) 1: the row is that of a switch
    has_switched_rows: bool  # any of them
    has_loads: bool  # any friction by load
    first_column: np.ndarray  # (m,) first nonzero column of each row of the factor of W
    is_empty_tree: bool  # all bodies float, all joints are cut
    only_free_bodies: bool  # all links float, each with one body; no joints: see free_bodies.py
    refinements: int  # steps of iterative refinement in each solve
    usual_pivot: float  # smallest pivot of W, relative to the mobility, at poses that are not singular
    projects: bool
    baumgarte_rate: float

    def kept_rows(self, element):
        """Indices of the rows of an element of `space` that are solved for in a cut joint."""
        (found,) = (self.owners == element).nonzero()
        if not len(found):
            return []
        cut = self.cuts[found[0]]
        rows = self.row_residual[cut["first"] : cut["first"] + cut["rows"]]
        return (rows - self.elements[cut["element"]]["row_start"]).tolist()


PLANE_LINK = np.dtype(
    [  # link of a planar mechanism: fields that sweeps need, close together in memory
        ("group", "i8"),
        ("parent", "i8"),
        ("freedom", "i8"),
        ("freedoms", "i8"),
        ("rotor", "f8"),  # as in LINK
        ("mass", "f8"),  # kg
        ("moment_x", "f8"),
        ("moment_y", "f8"),  # m c, kg m
        ("inertia", "f8"),  # about the origin, kg m^2
        ("cos", "f8"),
        ("sin", "f8"),
        ("x", "f8"),
        ("y", "f8"),  # T
    ],
    align=True,
)


class PlaneModel(RelativeModel):
    """RelativeModel of a planar mechanism; z of all link frames is normal to the plane.

    The coordinates of a link are its pose in its parent, T X, as (cos, sin, x, y). A slide moves
    along the x axis of its frame. Twists are (omega, v_x, v_y).
    """

    axes: np.ndarray  # (1, 9) axes of the plane in world axes, as columns; the last is its normal
    plane_gravity: np.ndarray  # (1, 2) m/s^2
    plane_links: np.ndarray  # (L,) of PLANE_LINK
    link_heights: np.ndarray  # (L,) of the link frames along the normal, m


FURTHER = 4  # blocks of slopes for states inside a substep: three stages and the state itself


class RelativeWork(Struct):
    """Scratch memory of one simulation; fields without a comment as in Work.

    Sizes are those of `make_relative_work`. In a plane velocities, moved, force and U have 3 numbers and
    inertia has 6; drift is A, (links, 2); moved is E: see dynamics/plane.py.
    """

    space: Work
    angle: np.ndarray  # the fields from here to `report` are those of `space`
    targets: np.ndarray
    registers: np.ndarray
    motions: np.ndarray
    clock: CallTimes
    start_angle: np.ndarray
    report: np.ndarray
    child_jacobian: np.ndarray  # (m, 6)
    factors: np.ndarray  # of the rate of each of `coupling_terms`, at the stage
    known: np.ndarray = shaped(1)  # 1 if the link rows of pose and twist belong to the present state
    pose: np.ndarray = shaped("state", 12)  # the state
    twist: np.ndarray = shaped("state", 6)
    stage_pose: np.ndarray = shaped("state", 12)
    stage_twist: np.ndarray = shaped("state", 6)
    start_pose: np.ndarray = shaped("state", 12)
    start_twist: np.ndarray = shaped("state", 6)
    middle_pose: np.ndarray = shaped("state", 12)  # the stage at a singular pose, see singular_poses.py
    middle_twist: np.ndarray = shaped("state", 6)
    middle: np.ndarray = shaped("freedoms", 2)  # its regularised accelerations, and those interpolated
    velocity: np.ndarray = shaped("links", 6)  # qdot at the start of the step
    slopes: np.ndarray = shaped("slopes", 2)  # k of stages, end and inside: algebra, then qdot part
    # Of a state that is ahead of the caller's: its angles, coordinates of switches and derivative; of the kept substep
    # the start, derivatives of its stages, angles and coordinates; the inputs. See munthe_kaas/ahead.py.
    lead_angle: np.ndarray
    lead_coordinates: np.ndarray = shaped("switches")
    lead_slopes: np.ndarray = shaped("freedoms", 2)
    kept_pose: np.ndarray = shaped("state", 12)
    kept_twist: np.ndarray = shaped("state", 6)
    kept_slopes: np.ndarray = shaped("slopes", 2)
    kept_angle: np.ndarray
    kept_coordinates: np.ndarray = shaped("switches")
    start_coordinates: np.ndarray = shaped("switches")  # of the caller's state
    lead_external: np.ndarray = shaped("bodies", EXTERNAL_COLUMNS)
    lead_targets: np.ndarray
    lead_motions: np.ndarray
    external: np.ndarray = shaped("bodies", EXTERNAL_COLUMNS)  # see forces/external.py: external wrenches of the call
    pushed: np.ndarray = shaped(1)  # positive if any of them is not zero
    held: np.ndarray = shaped("held")  # 1 if a degree of freedom or a switch row is held: switches.py
    # Of each switch: SLIP, its direction; SIDE of the stop in contact, -1 lower, 1 upper; COORDINATE at the
    # start of the step, unwrapped; KNOWN, not 0 if these are valid; RESTS, 1 if it rests because of others that
    # are held, and its EFFORT then
    modes: np.ndarray = shaped("switches", 6)
    reach: np.ndarray = shaped("switches")  # coordinate of each switch that is a row
    since: np.ndarray = shaped("switches", 2)  # rate and acceleration of each at the start of the step
    now: np.ndarray = shaped("switches", 2)  # and at the stage
    # Force normal to the axis of each, N: the one that its friction uses, and the one at the present
    # accelerations; then both of the previous iteration: see loads.py
    loads: np.ndarray = shaped("switches", 4)
    iteration: np.ndarray = shaped(3)  # 1 if the loads are given; 1 if they did not converge; scratch
    branches: np.ndarray = shaped("branches")  # of the kinks of laws, with error control: forces/formulas.py
    # Of sliding motions, see dynamics/sliding.py: rates of the twists of bodies and of surfaces; rates at shares of
    # zero, and sums of their changes; changes of the rates by shares.
    body_rates: np.ndarray = shaped("sliding", 6)
    surface_rates: np.ndarray = shaped("surfaces")
    shares: np.ndarray = shaped("surfaces", 2)
    share_matrix: np.ndarray = shaped("surfaces", "surfaces")
    share_pivots: np.ndarray
    kept_branches: np.ndarray = shaped("surfaces")  # while those of a state in a substep are computed
    least: np.ndarray = shaped(1)  # a smaller effect of a change, relative to all forces and to states, is no event
    guards: np.ndarray = shaped("guards", 5)  # distance of each switch, then of each branch, to its next events
    course: np.ndarray = shaped(NODES, "guards", 2)  # the last two guards at some stages: see events/crossings.py
    dips: np.ndarray = shaped("guards", 2, 2)  # of the same: first stage, as a fraction of the step, that is below zero
    crossed: np.ndarray = shaped("guards", 5)  # fraction of the step by which each event has occurred, or -1
    watch: np.ndarray = shaped(3)  # WATCHED, BEGIN, SPAN
    pace: np.ndarray = shaped(1)  # s, longest substep: see crossings.is_too_long
    wrench: np.ndarray = shaped("bodies", 6)  # wrenches on the bodies
    relative: np.ndarray = shaped("links", 12)  # pose of each link in its parent link
    world: np.ndarray = shaped("links", 12)  # pose in the world; where it is needed
    placed: np.ndarray = shaped("links", 4)  # pose in the plane: cos, sin, x, y
    velocities: np.ndarray = shaped("links", "twist")  # twists of the links
    drift: np.ndarray = shaped("links", "drift")  # [V, S qdot]
    moved: np.ndarray = shaped("links", "twist")  # Vdot - gravity of the links
    inertia: np.ndarray = shaped("links", "inertia")  # of the articulated body: A (6), B (9), C (6)
    applied: np.ndarray = shaped("links", "twist")  # applied wrenches on the links
    force: np.ndarray = shaped("links", "twist")  # bias force of the articulated body
    freedoms: np.ndarray = shaped("freedoms", 8)  # U, 1 / D, u of each degree of freedom
    acceleration: np.ndarray = shaped("freedoms", 1)  # qddot
    total: np.ndarray = shaped("freedoms", 1)  # qddot, and Vdot - gravity, before a refinement
    total_moved: np.ndarray = shaped("links", "twist")
    parent_jacobian: np.ndarray = shaped("rows", 6)
    slip: np.ndarray = shaped("rows")  # J V
    gap: np.ndarray = shaped("residuals")  # position residuals of all rows of the cut joints
    bias: np.ndarray = shaped("rows")  # J Vdot = bias
    right: np.ndarray = shaped("rows")  # residual, then a change of the multipliers
    multipliers: np.ndarray = shaped("rows")
    carried: np.ndarray = shaped("carried", 6)  # wrenches of the rows of a joint on their way to the world
    response: np.ndarray = shaped("responses")  # y of each row and degree of freedom on its path
    matrix: np.ndarray = shaped("rows", "rows")  # W in the upper, its factor in the lower triangle
    diagonal: np.ndarray = shaped("rows")  # pivots
    difference: np.ndarray = shaped(2, 6)  # error estimate of a link: algebra, qdot
    errors: np.ndarray = shaped("errors", 12)  # error estimates of the links, two rows each: xi, eta, dw, dv


def make_relative_work(model, work, stages, kinks=0):
    """Allocate the scratch memory of a RelativeModel; work: Work of the same mechanism.

    kinks : number of those of laws whose branches hold within a substep
    """
    surfaces = len(model.space.forces.laws.surfaces) if kinks else 0
    n, links, rows = len(model.bodies), len(model.links), len(model.row_residual)
    freedoms = int(model.links["freedoms"].sum())
    blocks = stages + 1 + FURTHER
    in_plane = isinstance(model, PlaneModel)
    sizes = dict(
        bodies=n,
        state=n + links,
        links=links,
        freedoms=freedoms,
        rows=rows,
        held=freedoms + rows,
        switches=len(model.switches),
        branches=kinks,
        surfaces=surfaces,
        sliding=n if surfaces else 0,
        guards=len(model.switches) + kinks,
        slopes=blocks * freedoms,
        errors=2 * links,
        residuals=int(model.elements["rows"].sum()),
        responses=int(model.path_places[-1]),
        carried=LARGEST_ROWS * links,
        twist=3 if in_plane else 6,
        drift=2 if in_plane else 6,
        inertia=6 if in_plane else 21,
    )
    shared = ("angle", "targets", "registers", "motions", "clock", "start_angle", "report")
    given = {name: getattr(work, name) for name in shared}
    rows = {"child_jacobian": model.child_jacobian.copy(), "factors": model.coupling_terms["factor"].copy()}
    rows |= {name: np.zeros_like(work.angle) for name in ("lead_angle", "kept_angle")}
    rows["share_pivots"] = np.zeros(surfaces, dtype=np.int64)
    rows |= {f"lead_{name}": np.zeros_like(getattr(work, name)) for name in ("targets", "motions")}
    return RelativeWork.zeros(sizes, space=work, **rows, **given)


def links_of(work):
    """Arrays of a RelativeWork that hold the state: whether it is known, coordinates, rates."""
    n = len(work.pose) - len(work.relative)
    return work.known, work.pose[n:], work.twist[n:]
