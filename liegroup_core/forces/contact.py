# SPDX-License-Identifier: Apache-2.0
"""Contacts of a body with a plane of the world or with another body: forces that only push, with friction.

Each point of contact has a depth d, with the normal force of Hunt and Crossley

    N = k d (1 + c d') ,   0 where it is not positive

and friction by a bristle z, which the slip speed v of the point bends (Dupont and others, Single State Elastoplastic
Friction Models, IEEE TAC 47, 2002, in two dimensions, here with a stiffness that does not depend on N):

    F = -mu N w / max(n, |w|) ,   w = z + tau v / s ,   s z' = v - z h ,   n = N / load
    h = 2 max(z . v, 0) max(|z|^2 - n^2, 0) / (|z|^4 + n^4)

F stays in the cone. Within it the bristle is a spring of the stiffness mu load / s, whatever N does: were it as N, a
body that moves along and presses in turn would gain energy, and one that stands would begin to vibrate. It yields by s
under the load; nothing creeps at rest. It slips beyond, where |z|^2 goes to (1 + sqrt(2)) n^2: round-off does not take
it back to the cone. Fixed steps need not resolve it while it slips: |z'| is bounded, and w has the direction of v if
steps are below tau. By default this damping is critical for the body alone on four such springs: tau = sqrt(m / k).
Two bodies have their reduced mass. With the mass of a whole robot, explicit steps for a light foot would be shorter by
the square root of the ratio of both masses.
It is written as formulas of a law (law.py), so touching, leaving, slip and stick are events of the methods with error
control, and derivatives, snapshots, estimates and the reference integration are those of laws. A bristle keeps its
place while nothing touches; that is at most 1.6 n times the length s, 1.6 s under the load.

From a restitution e at the speed v of an impact follows c: with a = c v, a - ln(1 + a) = -e a - ln(1 - e a), which a
free mass leaves with the speed e v whatever k and the mass are (Hunt and Crossley, J. Appl. Mech. 42, 1975).
"""

import math
from functools import cached_property
from itertools import product
from typing import Annotated, Any, Literal

import numpy as np
import scipy
from pydantic import BeforeValidator, Field, PrivateAttr, model_validator

from liegroup_core.errors import SceneError
from liegroup_core.fields.frames import Placed, rotation_z_to
from liegroup_core.fields.values import (
    MOST_FRICTION,
    Described,
    Direction,
    NotNegative,
    Number,
    Positive,
    Quaternion,
    RotationVector,
    Sizes,
    Text,
    Vector3,
    listed,
    one_of,
)

from .described import Force
from .law import Law, LawInput, LawOutput, LawState

MOST_POINTS = 64  # of a hull
DEEP = 3.0  # of the depth under the load: from there on a point at the start leaps by 4.5 times that, if undamped
STANDING = 1e-9  # a cylinder that leans less stands: its four points of a rim do not turn to the lowest one
LIGHT = 0.03  # of the load: n below. A point that slides and hardly presses yields by 3 % of s, not by nothing
ROUND = ("sphere", "capsule")
PULLS = -1.0, 0.5, 2.0  # fractions of an axis, see `_touch_each_other`
LEAST_PART = 1e-9  # of an axis: two points that are one have shares all the same
SHORT = 1e-3  # of a radius; at least the depth under the weight, see `_touch_each_other`
# Of the thickness of two bodies, or of the distance of a point from the origin of its body: how far they move in a step
# while they are near. Bodies pass in a distance p along sqrt(p^2 + x^2), and points turn along r cos(x / r), whose
# polynomials of degree five between -p/8 and p/8 have errors of about 1e-8 p.
LOOK = 0.25
# Least depth at rest by the coordinates: with round-off of 2.2e-16 of these the force is right to a thousandth.
RESOLVED = 1e3 * np.finfo(float).eps
TIMES = 1e-9, 1e5  # s, sqrt(mass / stiffness): clocks have whole ns; and a contact that acts within a day
MOST_DAMPING = 1e6  # s/m: a point enters with 1 um/s at most, where the force k d (1 + c d') doubles
# Of sqrt(mass / stiffness of the friction): what sticks vibrates 300 times; and beyond, friction is that of a fluid.
LEAST_SETTLES, MOST_SETTLES = 1e-3, 1e3
WORK = "work"  # state of the law of a contact: what it did on the bodies, J. Its scale is that of `load` along 1 m
UNITS = {"normal_force": "N", "depth": "m", WORK: "J"}  # of what its law shows


def _points(value):
    value = listed(value)
    if not 1 <= len(value) <= MOST_POINTS:
        raise ValueError(f"must be 1 to {MOST_POINTS} points [x, y, z]")
    return value


class _Shape(Placed):
    """Shape of a body for its contacts."""

    position: Vector3 = Field((0.0, 0.0, 0.0), description="its centre in m, in the body frame")
    quaternion: Quaternion | None = Field(None, description="rotation from its axes to body axes; default: none")
    rotation_vector: RotationVector | None = Field(None, description="the same as rotation vector in rad")
    axis: Direction | None = Field(None, description="direction of its z axis in body axes; replaces quaternion")


class ContactSphere(_Shape):
    """Sphere."""

    type: Literal["sphere"] = Field("sphere", description="sphere")
    radius: Positive = Field(description="radius in m")


class ContactCapsule(_Shape):
    """Cylinder along z with half a sphere at both ends."""

    type: Literal["capsule"] = Field("capsule", description="capsule along its z axis")
    radius: Positive = Field(description="radius in m")
    length: Positive = Field(description="length in m, without the half spheres")


class ContactCylinder(_Shape):
    """Cylinder along z."""

    type: Literal["cylinder"] = Field("cylinder", description="cylinder along its z axis")
    radius: Positive = Field(description="radius in m")
    length: Positive = Field(description="length in m")


class ContactBox(_Shape):
    """Box."""

    type: Literal["box"] = Field("box", description="box")
    size: Sizes = Field(description="lengths of the edges in m, in its axes")


class ContactHull(_Shape):
    """Convex hull of points."""

    type: Literal["hull"] = Field("hull", description="convex hull of points")
    points: Annotated[tuple[Vector3, ...], BeforeValidator(_points)] = Field(
        description=f"at most {MOST_POINTS} points in m, in its axes"
    )


class Plane(Described):
    """Plane of the world."""

    point: Vector3 = Field((0.0, 0.0, 0.0), description="a point of it in m, world axes")
    normal: Direction = Field((0.0, 0.0, 1.0), description="direction in which it pushes, world axes")

    @property
    def unit(self):
        """(3,) unit normal."""
        return np.array(self.normal) / math.hypot(*self.normal)

    @property
    def height(self):
        """Distance of the origin of the world along minus the normal, m."""
        return float(self.unit @ np.array(self.point))


CONTACT_SHAPES = (ContactSphere, ContactCapsule, ContactCylinder, ContactBox, ContactHull)
AnyShape = one_of(CONTACT_SHAPES)


class Contact(Force):
    """Contact of a body with a plane of the world, or with another body."""

    type: Literal["contact"] = Field("contact", description="contact")
    body: Text = Field(description="name of a body")
    shape: AnyShape | None = Field(None, description="its shape for this contact; default: the shape of the body")
    plane: Plane = Field(Plane(), description="what it touches: a plane of the world; default: z = 0")
    other: Text | None = Field(None, description="name of another body that it touches, in place of plane")
    other_shape: AnyShape | None = Field(None, description="the shape of that body; default: its own")
    stiffness: Positive | None = Field(None, description="k in N/m of a point on a plane, or of two bodies")
    damping: NotNegative | None = Field(None, description="c, s/m: the force is k d (1 + c d') at the depth d")
    sinks: Positive | None = Field(None, description="in place of stiffness: depth in m of a point under `load`")
    load: Positive | None = Field(None, description="N; default: the weight of all bodies of the scene")
    restitution: Number | None = Field(None, description="in place of damping: 0.01 to 1, at an impact with `speed`")
    speed: Positive = Field(1.0, description="m/s")
    friction: NotNegative = Field(0.0, description="coefficient of friction")
    slip: Positive | None = Field(
        None,
        description="m: length by which friction yields under `load` until it slides; default: friction times `sinks`",
    )
    settles: NotNegative | None = Field(
        None, description="s, damping of this: default: critical for the body on four points"
    )

    _given: Any = PrivateAttr(None)  # (shapes, load in N, reduced mass in kg) of the scene
    _weight: float = PrivateAttr(0.0)  # N, that of the reduced mass, at most the load

    @model_validator(mode="after")
    def _check(self):
        for one, other in (("stiffness", "sinks"), ("damping", "restitution")):
            given = [key for key in (one, other) if getattr(self, key) is not None]
            if len(given) != 1:
                text = f"{one} is missing: give {one} or {other}" if not given else f"{one} and {other}: keep one"
                raise SceneError(text, place=(given or [one])[:1])
        if self.restitution is not None and not 0.01 <= self.restitution <= 1.0:
            raise SceneError(f"restitution must be from 0.01 to 1, got {self.restitution:g}", place=("restitution",))
        if self.other is not None and "plane" in self.model_fields_set:
            raise SceneError("plane and other: keep one", place=("plane",))
        if self.other == self.body:
            raise SceneError("other must be another body", place=("other",))
        if self.other is None and self.other_shape is not None:
            raise SceneError("other is missing: name the body that has other_shape", place=("other_shape",))
        for key, needs in (("slip", "friction"), ("settles", "friction"), ("speed", "restitution")):
            if key in self.model_fields_set and needs not in self.model_fields_set:
                raise SceneError(f"{key} has no effect without {needs}: give {needs} or remove {key}", place=(key,))
        if "load" in self.model_fields_set and not self._load_acts:
            raise SceneError("load has no effect without sinks or friction: give one of them or remove it", ("load",))
        if self.friction and self.slip is None and self.sinks is None:
            raise SceneError("slip is missing: friction yields by this length in m until it slides", place=("slip",))
        return self

    @property
    def _load_acts(self):
        """Whether the force depends on the load."""
        return self.sinks is not None or "friction" in self.model_fields_set

    def complete(self, bodies, gravity):
        """Take shapes of bodies {name: Body} that are not given, and the load from their weight. Raises SceneError."""
        for key, name in (("body", self.body), ("other", self.other)):
            if name is not None and name not in bodies:
                raise SceneError(f"{key} {name!r:.40} is not a body", place=(key,))
        shapes = [self._shape(bodies, "shape", self.body)]
        if self.other is not None:
            shapes.append(self._shape(bodies, "other_shape", self.other))
            for key, shape, other in zip(("shape", "other_shape"), shapes, shapes[::-1]):
                if shape.type not in ROUND and (shape.type != "box" or other.type not in ROUND):
                    raise SceneError(
                        f"{key}: a {shape.type} can touch a plane{' or a round body' if shape.type == 'box' else ''}; "
                        "two bodies touch as spheres or capsules, or one of these and a box",
                        place=(key,),
                    )
        gravity = math.hypot(*gravity)
        load = self.load or sum(body.mass for body in bodies.values()) * gravity
        if load == 0.0 and self.sinks is not None:
            raise SceneError("load is missing: without gravity give it, or stiffness", place=("load",))
        if load == 0.0 and self.friction:
            load = self.stiffness * self.slip / self.friction  # as stiff along the surface as across it
        mass = 1.0 / sum(1.0 / bodies[name].mass for name in self.on_bodies({}))
        self._given, self._weight = (shapes, load, mass), min(load, mass * gravity or load)
        self._check_range(bodies, gravity)

    def _check_range(self, bodies, gravity):
        """Raise SceneError where numbers are beyond what double precision resolves, or what a contact can mean."""
        shapes, load, mass = self._given
        own = [bodies[name] for name in self.on_bodies({})]
        key, numbers = "stiffness" if self.sinks is None else "sinks", self.numbers
        stiffness = numbers["stiffness"]
        sizes = [math.hypot(*shape.position) + _around(shape)[1] for shape in shapes]
        near = abs(self.plane.height) if self.other is None else max(math.hypot(*body.position) for body in own)
        far = near + max(sizes)
        least, weight = RESOLVED * far, gravity * sum(body.mass for body in bodies.values()) or load

        def check(is_right, key, text):
            if not is_right:
                raise SceneError(text, place=(key,))

        if all(shape.type in ROUND for shape in shapes) and len(shapes) == 2:
            apart = _apart(*(_axis_of(shape, body) for shape, body in zip(shapes, self._in_order(bodies))))
            check(
                apart >= least,
                "other",
                f"{self.body} and {self.other} start with their centres or axes in one point, {apart:.2g} m apart: "
                "nothing says in which direction they push each other; move one of them",
            )
        time, number = math.sqrt(mass / stiffness), f"{key} {getattr(self, key):.3g}"
        if "load" in self.model_fields_set and self.sinks is not None:
            number += f" under the load {load:.3g} N"
        check(
            not weight or weight / stiffness >= least,
            key,
            f"{number} gives a depth of {weight / stiffness:.2g} m at rest; double precision resolves {least:.2g} m at "
            f"coordinates of {far:.2g} m: give {'a larger sinks' if self.sinks is not None else 'a smaller stiffness'}",
        )
        check(
            TIMES[0] <= time <= TIMES[1],
            key,
            f"{number} lets a contact of {mass:.3g} kg take {time:.2g} s, sqrt(mass / stiffness); this must be from "
            f"{TIMES[0]:g} to {TIMES[1]:g} s: change {key}{' or load' if self.sinks is not None else ''}",
        )
        depth, most = mass * gravity / stiffness, 2.0 * min(sizes)
        check(
            self.sinks is None or not most or depth <= most,
            key,
            f"{number} lets the body sink {depth:.2g} m by its own weight, more than the size of the shape, "
            f"{most:.2g} m: give a smaller depth, in m",
        )
        check(
            numbers["damping"] <= MOST_DAMPING,
            "damping" if self.restitution is None else "speed",
            f"damping must be at most {MOST_DAMPING:g} s/m, got {numbers['damping']:.3g}"
            + ("" if self.restitution is None else f" of restitution at a speed of {self.speed:.3g} m/s"),
        )
        if not self.friction:
            return
        check(
            self.friction <= MOST_FRICTION,
            "friction",
            f"friction must be at most {MOST_FRICTION:g}, a slope of 89.4 degrees, got {self.friction:.3g}",
        )
        slip = numbers["slip"]
        yields = slip if not weight else min(slip, weight * slip / (self.friction * load))
        check(
            least <= yields,
            "friction" if self.slip is None else "slip",
            f"friction yields by a slip of {slip:.2g} m{'' if self.slip else ' (friction times sinks)'}; double "
            f"precision resolves {least:.2g} m: give a larger slip",
        )
        time = math.sqrt(mass * slip / (self.friction * load))
        for is_right, most, factor in (
            (self.settles is None or self.settles <= MOST_SETTLES * time, "most", MOST_SETTLES),
            (self.settles is None or self.settles >= LEAST_SETTLES * time, "least", LEAST_SETTLES),
        ):
            check(
                is_right,
                "settles",
                f"settles must be at {most} {factor * time:.2g} s, {factor:g} times sqrt(mass / stiffness of the "
                f"friction), got {self.settles}" + (": what sticks vibrates too long" if most == "least" else ""),
            )

    def _in_order(self, bodies):
        return [bodies[name] for name in (self.body, self.other)]

    def _shape(self, bodies, key, name):
        shape = getattr(self, key) or bodies[name].shape
        if shape is None:
            raise SceneError(f"{key} is missing: the body {name} has none", place=(key,))
        return shape

    @property
    def numbers(self):
        """{name: number} of its law."""
        _, load, mass = self._given
        found = {"stiffness": self.stiffness if self.sinks is None else load / self.sinks}
        found["damping"] = self.damping if self.restitution is None else damping_of(self.restitution, self.speed)
        if self.friction:
            slip, settles = self.slip or self.friction * self.sinks, self.settles
            if settles is None:
                settles = math.sqrt(slip * mass / (self.friction * load))
            found |= {"friction": self.friction, "slip": slip, "settles": settles}
        return found

    def depth_in_plane(self, body):
        """Depth of its deepest point in its plane, m; body : with `rotation` (3, 3) and `position` (3,) m."""
        (shape, *_), normal = self._given[0], self.plane.unit
        down = -body.rotation.T @ normal
        if shape.type in ("cylinder", "rod"):
            points, radius = _ends(shape), shape.radius * math.sqrt(max(0.0, 1.0 - (down @ shape.rotation[:, 2]) ** 2))
        else:
            points, radius = _corners(shape)
        return float((np.array(points) @ down).max() + radius + self.plane.height - normal @ body.position)

    def too_deep(self, body):
        """(depth over that under the load, depth in m) in its plane, as `depth_in_plane`; (0, 0): that is not deep."""
        _, load, _ = self._given
        depth = self.depth_in_plane(body) if self.other is None and load else 0.0
        rest = load / self.numbers["stiffness"]
        return (depth / rest, depth) if depth > DEEP * rest else (0.0, 0.0)

    @property
    def facts(self):
        """{"shapes": {body: type}, "plane": {"point", "normal"} or None, "load": N} and `numbers`, once complete."""
        shapes, load, _ = self._given
        shapes = {body: shape.type for body, shape in zip((self.body, self.other), shapes)}
        plane = {"point": list(self.plane.point), "normal": self.plane.unit.tolist()} if self.other is None else None
        return {"shapes": shapes, "plane": plane, "load": load, **self.numbers}

    @cached_property
    def as_law(self):
        """Law with its formulas, once it is complete."""
        return self._formulas.law

    @property
    def shapes(self):
        """Shapes of its bodies, once it is complete."""
        return self._given[0]

    @property
    def points(self):
        """[(number of an output on the body, normal force, what yields, arm (3,) of its force)]: signals or numbers."""
        found = self._formulas
        own = [(k, arm) for k, (body, arm) in enumerate(found.arms) if body == self.body]
        return [(k, *names, arm) for (k, arm), *names in zip(own, found.normals, found.yields)]

    @cached_property
    def _formulas(self):
        shapes, load, _ = self._given
        found = _Formulas(self.name, self.numbers, load)
        if self.other is not None:
            radius = max(getattr(shape, "radius", 0.0) for shape in shapes)
            short = max(SHORT * radius, self._weight / self.numbers["stiffness"])
            return _touch_each_other(found, (self.body, self.other), shapes, short)
        return _touch_plane(found, self.body, shapes[0], rotation_z_to(self.plane.unit), self.plane.height)

    def on_bodies(self, child_of):
        """Names of the bodies that it reads or acts on."""
        return [self.body] if self.other is None else sorted((self.body, self.other))

    def at_centres(self, com):
        """Entries that change if body frames are at the centres of mass; com : {body: (3,) m}."""
        shapes, load, _ = self._given
        found = {"load": load} if self._load_acts else {}
        for key, name, shape in zip(("shape", "other_shape"), (self.body, self.other), shapes):
            found[key] = _contact_shape(shape, com.get(name, 0.0))
        return found


def drawn_by_contacts(scene):
    """{body: [shape]} of the bodies of a Scene that have no shape but those of their contacts."""
    found = {}
    for contact in (force for force in scene.forces if force.type == "contact"):
        for name, shape in zip((contact.body, contact.other), contact.shapes):
            if shape not in found.setdefault(name, []):
                found[name].append(shape)
    return {body.name: found[body.name] for body in scene.bodies if body.shape is None and body.name in found}


def outline(shape, around=32):
    """(k, 3) m, points of a shape whose convex hull has its form, in the body frame; around : of them on a circle."""
    if shape.type == "hull":
        local = np.array(shape.points)
    elif shape.type == "box":
        local = 0.5 * np.array(list(product((-1.0, 1.0), repeat=3))) * shape.size
    else:
        turns = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)
        rise = np.linspace(0.0, 0.5 * np.pi, around // 4 + 1) if shape.type in ROUND else np.zeros(1)
        rings = [(math.cos(a) * math.cos(b), math.cos(a) * math.sin(b), math.sin(a)) for a in rise for b in turns]
        half = np.unique(np.round(shape.radius * np.array(rings), 12), axis=0)
        half[:, 2] += 0.5 * getattr(shape, "length", 0.0)
        local = np.unique(np.concatenate([half, half * (1.0, 1.0, -1.0)]), axis=0)
    return np.array(shape.position) + local @ shape.rotation.T


def faces(points):
    """(m, 3) numbers of the corners of the triangles of the convex hull of points (k, 3); each is seen from outside."""
    hull = scipy.spatial.ConvexHull(points)
    one, other = np.diff(points[hull.simplices], axis=1).swapaxes(0, 1)
    turned = (np.cross(one, other) * hull.equations[:, :3]).sum(axis=1) < 0.0
    return np.where(turned[:, None], hull.simplices[:, ::-1], hull.simplices)


def note_of_starts(scene):
    """Note on contacts of a Scene that start deep inside their planes, a list: of several the deepest one."""
    bodies = {body.name: body for body in scene.bodies}
    found = [(*force.too_deep(bodies[force.body]), force) for force in scene.forces if force.type == "contact"]
    found = [each for each in found if each[0]]
    if not found:
        return []
    times, depth, force = max(found, key=lambda each: each[0])
    more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
    return [
        f"changes the motion: start inside a plane, which throws out {force.body}: {depth:.3g} m deep in contact "
        f"{force.name}{more}, {times:.0f} times its depth under the load; start higher, or lower the plane"
    ]


def stiffest(forces):
    """(s, name) of the contact that acts within the shortest time, sqrt(mass / stiffness); (inf, ""): none."""
    found = []
    for force in forces:
        if force.type == "contact":
            (_, load, mass), numbers = force._given, force.numbers
            along = numbers["friction"] * load / numbers["slip"] if force.friction else 0.0  # of the bristle
            found.append((math.sqrt(mass / max(numbers["stiffness"], along)), force.name))
    return min(found, default=(math.inf, ""))


def stiff_note(forces, step):
    """Note on the contact that is stiffest for the mass of its bodies, if steps in s are too long for it; a list."""
    time, name = stiffest(forces)
    if step <= time:
        return []
    return [
        f"stiff: contact {name} acts within {time:.2g} s, sqrt(mass / stiffness): give steps well below that, an "
        "accuracy in place of the method, or less stiffness"
    ]


def _contact_shape(shape, moved):
    """A shape as one of CONTACT_SHAPES, in a frame that moved by a vector."""
    kind = {"rod": "cylinder"}.get(shape.type, shape.type)
    cls = next(cls for cls in CONTACT_SHAPES if cls.model_fields["type"].default == kind)
    keys = [key for key in ("radius", "length", "size", "points") if key in cls.model_fields]
    turn = tuple(scipy.spatial.transform.Rotation.from_matrix(shape.rotation).as_quat().tolist())
    place = tuple((np.array(shape.position) - moved).tolist())
    return cls(position=place, quaternion=turn, **{key: getattr(shape, key) for key in keys})


def damping_of(restitution, speed):
    """c in s/m of a contact that a mass meets with a speed in m/s, and leaves with restitution times this speed."""

    def lost(y):  # y = -ln(1 - e a): the exponential keeps digits where the way out is slow
        out = -math.expm1(-y)
        return out / restitution - math.log1p(out / restitution) + out - y

    if restitution >= 1.0:
        return 0.0
    y = scipy.optimize.brentq(lost, 1e-3 * (1.0 - restitution), 2.0 + 1.0 / restitution, xtol=1e-15)
    return -math.expm1(-y) / restitution / speed


# ---------------------------------------------------------------- formulas: a number, or a text in brackets


def _times(a, b):
    if isinstance(a, str) and not isinstance(b, str):
        a, b = b, a
    if not isinstance(a, str):
        if not isinstance(b, str):
            return a * b
        if a in (0.0, 1.0):
            return b if a else 0.0
        a = repr(float(a))
    return f"({a}*{b})"


def _plus(*terms):
    number = sum(term for term in terms if not isinstance(term, str))
    texts = [term for term in terms if isinstance(term, str)]
    if not texts:
        return number
    return f"({' + '.join([*texts, *([repr(float(number))] if number else [])])})"


def _minus(a, b):
    return _plus(a, _times(-1.0, b))


def _dot(a, b):
    return _plus(*map(_times, a, b))


def _scaled(number, vector):
    return [_times(number, each) for each in vector]


def _sum(*vectors):
    return [_plus(*each) for each in zip(*vectors)]


def _difference(a, b):
    return [_minus(x, y) for x, y in zip(a, b)]


def _cross(a, b):
    return [_minus(_times(a[i], b[j]), _times(a[j], b[i])) for i, j in ((1, 2), (2, 0), (0, 1))]


def _clip(value, low, high):
    return f"clip({value}, {low!r}, {high!r})"


def _state(rate, scale=1.0):
    return LawState.model_construct(rate=str(rate), update=None, start=0.0, scale=scale)


def _axis_of(shape, body):
    """(2, 3) m, ends of the axis of a round shape of a body at the start, world axes; those of a sphere are equal."""
    half = 0.5 * getattr(shape, "length", 0.0) * shape.rotation[:, 2]
    return [body.position + body.rotation @ (np.array(shape.position) + sign * half) for sign in (-1.0, 1.0)]


def _apart(one, other):
    """Distance of two segments, each given by its ends, m."""

    def from_point(point, ends):
        along = ends[1] - ends[0]
        part = np.clip((point - ends[0]) @ along / (along @ along or 1.0), 0.0, 1.0)
        return np.linalg.norm(point - ends[0] - part * along)

    found = [from_point(point, other) for point in one] + [from_point(point, one) for point in other]
    sides = np.column_stack([one[1] - one[0], other[0] - other[1]])
    if np.linalg.matrix_rank(sides) == 2:  # the lines cross, perhaps within both segments
        parts, *_ = np.linalg.lstsq(sides, other[0] - one[0])
        if (parts >= 0.0).all() and (parts <= 1.0).all():
            found.append(np.linalg.norm(other[0] - one[0] - sides @ parts))
    return min(found)


class _Formulas:
    """Formulas of the law of a contact.

    normals, depths : [name] of the normal force and of the depth of each point
    arms    : [(body, arm (3,))] of each output
    yields  : [name] of what is positive where a point that presses slips, "" without friction
    """

    def __init__(self, name, numbers, load):
        self._name, self._numbers, self._load = name, numbers, load
        self._inputs, self._names, self._signals, self._states, self._outputs = {}, {}, {}, {}, []
        self.normals, self.yields, self.arms, self.depths, self._powers, self._near = [], [], [], [], [], ""
        self._follows, self.is_geometry, self.closing = set(), False, []
        self._load = load

    @property
    def law(self):
        """The Law. What others can read: the sum of normal forces in N, the largest depth in m, the work in J."""
        depths = list(dict.fromkeys(self.depths))
        deepest = depths[0] if len(depths) == 1 else f"max({', '.join(depths)})"
        shown = {"normal_force": _plus(*self.normals), "depth": deepest}
        power = _plus(*self._powers)
        if self._near:
            power = f"{power} if {self._near[:-5]} else 0"
        law = Law.model_construct(
            name=self._name,
            inputs={name: LawInput(quantity=quantity, point=point) for (quantity, point), name in self._inputs.items()},
            parameters=self._numbers,
            states=self._states | {WORK: _state(power, self._load or 1.0)},
            signals=self._signals | shown,
            outputs=tuple(self._outputs),
        )
        law._jumps, law._follows, law._bends, law._closing = False, self._follows, set(self.yields), self.closing
        return law

    def let(self, text):
        """Name of a formula, which is evaluated once; a number stays one."""
        if not isinstance(text, str) or text.isidentifier():
            return text
        key = text, self.is_geometry
        if key not in self._names:
            self._names[key] = name = f"_{len(self._signals)}"
            self._signals[name] = text
            if self.is_geometry:
                self._follows.add(name)
        return self._names[key]

    def _read(self, body, part, point=None):
        key = f"{body}.{part}", point
        return self._inputs.setdefault(key, f"_in{len(self._inputs)}")

    def direction(self, body, vector):
        """A vector of a body in world axes."""
        return [self._read(body, f"n{part}", tuple(map(float, vector))) for part in "xyz"]

    def spin(self, body):
        """Angular velocity of a body, world axes."""
        return [self._read(body, f"o{part}") for part in "xyz"]

    def _origin(self, body, part=""):
        """Origin of the frame of a body, or with the part d its velocity, world axes."""
        return [self._read(body, part + component) for component in "xyz"]

    def _across(self, body, vector):
        """Products of a vector in world axes with the axes of a body."""
        return [self.let(_dot(vector, self.direction(body, axis))) for axis in np.eye(3)]

    def place_along(self, vector, body, point):
        """Position of a point of a body along a vector in world axes. What its points share is evaluated once."""
        return _plus(self.let(_dot(vector, self._origin(body))), _dot(point, self._across(body, vector)))

    def rate_along(self, vector, body, point):
        """Its velocity along a vector in world axes."""
        turning = self._across(body, [self.let(each) for each in _cross(vector, self.spin(body))])
        return _plus(self.let(_dot(vector, self._origin(body, "d"))), _dot(point, turning))

    def place(self, body, point):
        """Position of a point of a body, world axes."""
        return [self.let(self.place_along(axis, body, point)) for axis in np.eye(3).tolist()]

    def rate(self, body, point):
        """Its velocity, world axes."""
        return [self.let(self.rate_along(axis, body, point)) for axis in np.eye(3).tolist()]

    def approach(self, reach):
        """Let the points that follow matter only where the depth `reach` of a sphere around them is positive.

        returns its name
        """
        reach = self.let(reach)
        self._near = f"{reach} > 0 and "
        return reach

    def close_to_plane(self, depth, body, reach):
        """Note how far a point of a body, `reach` from its origin, may turn in a step while it is near a plane, m."""
        self.closing.append((depth, (body, None), (reach, 0.0), LOOK * reach))

    def press(self, depth, leaving, slips, axes, part=1.0, presses=""):
        """Force of a point of contact, world axes.

        depth, leaving : m, and the speed in m/s with which it becomes smaller; slips : m/s, along the axes (k, 3)
        axes : the normal, then two tangents; or None in place of these, for the world's axes
        part : change of the depth by one of the point along the normal; of two points that share it, with the share
        presses : condition beside that of the depth
        """
        force = self.push(depth, leaving, part, presses)
        drags = self.rub(force, slips, axes)
        across = drags if axes[1] is None else _sum(*map(_scaled, drags, axes[1]))
        return _sum(_scaled(force, axes[0]), across) if drags else _scaled(force, axes[0])

    def push(self, depth, leaving, part=1.0, presses=""):
        """Name of the normal force of a point, see `press`."""
        depth, leaving = self.let(depth), self.let(leaving)
        self.depths.append(depth)
        presses = presses and f" and {presses}"
        self._pushes = pushes = f"{self._near}{depth} > 0{presses} and damping*{leaving} < 1"
        force = self.let(f"{_times(f'(stiffness*{depth}*(1 - damping*{leaving}))', part)} if {pushes} else 0")
        self._powers.append(self._if_pushing(_times(force, leaving)))
        return force

    def rub(self, force, slips, axes):
        """Friction under a normal force, along the axes of the slip speeds; none of them: []. See `press`."""
        self.normals.append(force)
        self.yields.append("")
        if "friction" not in self._numbers:
            return []
        slips = [self.let(each) for each in slips]
        first = len(self._states)
        bristle = [f"_bristle{first + k}" for k in range(len(slips))]
        bent = bristle
        if axes[1] is None:  # what the normal has turned away no longer counts
            along = self.let(_dot(axes[0], bristle))
            bent = [self.let(each) for each in _difference(bristle, _scaled(along, axes[0]))]
        square, along = self.let(_dot(bent, bent)), self.let(_dot(bent, slips))
        most = self.let(f"sqrt(sqrt(({force}/{self._load!r})**8 + {LIGHT**8!r}))")
        yields = self.let(
            f"2*{along}*({square} - {most})/({square}**2 + {most}**2) if {square} > {most} and {along} > 0 else 0"
        )
        self.yields[-1] = yields
        rates = [self.let(f"({speed} - {each}*{yields})/slip") for speed, each in zip(slips, bent)]
        for name, rate in zip(bristle, rates):
            self._states[name] = _state(f"{rate} if {self._pushes} else 0")
        bent = [self.let(f"{each} + settles/slip*{speed}") for each, speed in zip(bent, slips)]
        square = _dot(bent, bent)
        if axes[1] is not None and len(slips) == 3:
            square, bent = self._of_rim(bent, most)
        drag = self.let(f"-friction*{force}/sqrt(max({square}, {most}))")
        self._powers.append(self._if_pushing(_times(drag, _dot(bent, slips))))
        return _scaled(drag, bent)

    def _of_rim(self, bent, most):
        """(D^2, its derivatives / 2) of a bristle in two directions and one of the spin, see `_touch_with_rim`."""
        across, turned = self.let(_dot(bent[:2], bent[:2])), self.let(_times(bent[2], bent[2]))
        both = self.let(f"{most} + {across} + {turned}")
        parts = [self.let(f"1 - 0.5*{each}*({most} + {each})/{both}**2") for each in (turned, across)]
        square = self.let(f"{across} + {turned} - 0.5*{across}*{turned}/{both}")
        return square, [self.let(_times(each, parts[k // 2])) for k, each in enumerate(bent)]

    def only_with(self, depth):
        """Condition of what follows: that this depth is positive."""
        self._pushes = f"{self._near}{depth} > 0"
        return self._pushes

    def _if_pushing(self, text):
        """Name of a formula of the last point of contact: only where that pushes, the laws evaluate it."""
        return self.let(f"{text} if {self._pushes} else 0") if isinstance(text, str) else text

    def act(self, body, point, force, arm, couple=None):
        """Let a force in world axes act on a body at `arm` from a point of the body, with a couple in N m."""
        torque = _cross(arm, force) if couple is None else _sum(_cross(arm, force), couple)
        torque, force = ([self._if_pushing(each) for each in vector] for vector in (torque, force))
        texts = [tuple(str(each) for each in vector) for vector in (torque, force)]
        self.arms.append((body, tuple(arm)))
        point = tuple(map(float, point))
        self._outputs.append(
            LawOutput.model_construct(body=body, torque=texts[0], force=texts[1], point=point, axes="world")
        )


def _ends(shape):
    """Centres of the end faces of a shape along its z axis, m, in the body frame."""
    half = 0.5 * shape.length * shape.rotation[:, 2]
    return [np.array(shape.position) + sign * half for sign in (-1.0, 1.0)]


def _corners(shape):
    """Points of a shape that can touch a plane, and the radius around them, both in m."""
    if shape.type == "sphere":
        return [np.array(shape.position)], shape.radius
    if shape.type == "capsule":
        return _ends(shape), shape.radius
    local = 0.5 * np.array(list(product(*((-s, s) for s in shape.size)))) if shape.type == "box" else shape.points
    return np.array(shape.position) + np.array(local) @ shape.rotation.T, 0.0


def _around(shape):
    """Middle of a shape in the body frame, and the radius of a sphere around it, m."""
    place = np.array(shape.position)
    if shape.type == "sphere":
        return place, shape.radius
    if shape.type == "capsule":
        return place, shape.radius + 0.5 * shape.length
    if shape.type in ("cylinder", "rod"):
        return place, math.hypot(shape.radius, 0.5 * shape.length)
    points = np.array(
        shape.points if shape.type == "hull" else [0.5 * np.array(shape.size), -0.5 * np.array(shape.size)]
    )
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    return place + shape.rotation @ middle, np.linalg.norm(points - middle, axis=1).max()


def _touch_plane(found, body, shape, axes, height):
    """Contact of a body with a plane; axes (3, 3) : columns tangents and normal;  height : m, along the normal."""
    (t, s, n), slides = axes.T.tolist(), "friction" in found._numbers
    if shape.type != "sphere":
        middle, far = _around(shape)
        near = found.approach(_minus(far + height, found.place_along(n, body, middle)))
        found.close_to_plane(near, body, np.linalg.norm(middle))
    if shape.type in ("cylinder", "rod"):
        for end in _ends(shape):
            _touch_with_rim(found, body, shape, end, (n, (t, s)), height)
        return found
    points, radius = _corners(shape)
    for point in points:
        slips = [found.rate_along(each, body, point) for each in (t, s)]
        if radius and slides:
            spin = found.spin(body)
            slips = [_minus(slips[0], _times(radius, _dot(s, spin))), _plus(slips[1], _times(radius, _dot(t, spin)))]
        depth = _minus(radius + height, found.place_along(n, body, point))
        force = found.press(depth, found.rate_along(n, body, point), slips, (n, (t, s)))
        found.act(body, point, force, _scaled(-radius, n))
        found.close_to_plane(found.depths[-1], body, np.linalg.norm(point))
    return found


def _touch_with_rim(found, body, shape, end, axes, height):
    """Contact of four points of the rim of a cylinder, the first of them the lowest one.

    Its friction acts at their centre of pressure c, and as a couple: so it moves smoothly with a cylinder that stands,
    whose lowest point jumps around the rim. The third slip speed is that of the spin times l = r - c^2 / r, which is r
    where all press evenly, 0 on one point. With w = (x, z), of slip and spin, the friction is -mu N min(1, D / n) D',

        D^2 = x^2 + z^2 - x^2 z^2 / (2 (n^2 + x^2 + z^2))

    It is that of a rim with even pressure if it slides or spins, or mostly; between, it is off by 0.11 mu N at most.
    Where it sticks it is a gradient D D', so that it does no work on a loop.
    """
    n, tangents = axes
    centre, speed, spin = found.place(body, end), found.rate(body, end), found.spin(body)
    axis, side = (found.direction(body, shape.rotation[:, k]) for k in (2, 0))
    # (n . axis) axis - n, without a difference of numbers near one where the cylinder stands.
    axis_n, *lean = (found.let(_dot(each, axis)) for each in (n, *tangents))
    parts = [*(_times(axis_n, each) for each in lean), _times(-1.0, _dot(lean, lean)), STANDING]
    down = [found.let(each) for each in _sum(*map(_scaled, parts, (*tangents, n, side)))]
    length = found.let(f"sqrt({_dot(down, down)})")
    radial = [found.let(f"{each}/{length}") for each in down]
    arms, forces = [], []
    for arm in (radial, _cross(axis, radial)):
        for sign in (shape.radius, -shape.radius):
            arms.append([found.let(each) for each in _scaled(sign, arm)])
            leaving = _dot(n, _sum(speed, _cross(spin, arms[-1])))
            forces.append(found.push(_minus(height, _dot(n, _sum(centre, arms[-1]))), leaving))
            found.close_to_plane(found.depths[-1], body, math.hypot(np.linalg.norm(end), shape.radius))
    force = found.let(f"{_plus(*forces)} if {found.only_with(found.depths[-4])} else 0")
    # Before an event ends a step a force may be negative, and so would be shares of a sum near zero.
    found.is_geometry = True
    pressing = [found.let(f"max({each}, 0)") for each in forces]
    found.is_geometry = False
    whole = found.let(f"{_plus(*pressing)} + 1e-300")
    shares = [found.let(f"{each}/{whole}") for each in pressing[1:]]
    # From the lowest point on, which is the only one where nothing presses yet.
    ways = [_difference(arm, arms[0]) for arm in arms[1:]]
    arm = [found.let(each) for each in _sum(arms[0], *map(_scaled, shares, ways))]
    rate = [found.let(each) for each in _sum(speed, _cross(spin, arm))]
    lever = found.let(f"{shape.radius!r} - {_dot(arm, arm)}/{shape.radius!r}")
    drags = found.rub(force, [*(_dot(each, rate) for each in tangents), _times(lever, _dot(n, spin))], axes)
    across = [_scaled(force, n), *map(_scaled, drags, tangents)]
    found.act(body, end, _sum(*across), arm, _scaled(_times(lever, drags[2]), n) if drags else None)


def _nearest(found, bodies, shapes, barrel):
    """Nearest points of the axes of two round bodies, for `_touch_at`: see `_touch_each_other`.

    returns {"mine": [point of the axis of one body], "theirs": point of the other}, with two points also what
    `_line` gives
    """
    first, second = ([found.place(body, end) for end in _skeleton(shape)] for body, shape in zip(bodies, shapes))
    if len(first) == len(second) == 1:
        return {"mine": first, "theirs": second[0]}
    along = [_difference(ends[-1], ends[0]) for ends in (first, second)]
    along = [[found.let(each) for each in vector] for vector in along]
    apart = [found.let(each) for each in _difference(first[0], second[0])]
    a, b, e = (found.let(_dot(x, y)) for x, y in ((along[0], along[0]), (along[0], along[1]), (along[1], along[1])))
    c, f = (found.let(_dot(vector, apart)) for vector in along)

    def at(ends, part, vector):
        return [found.let(each) for each in _sum(ends[0], _scaled(found.let(part), vector))]

    if len(second) == 1:
        return {"mine": [at(first, _clip(f"(-{c}/{a})", 0.0, 1.0), along[0])], "theirs": second[0]}
    if len(first) == 1:
        return {"mine": first, "theirs": at(second, _clip(f"({f}/{e})", 0.0, 1.0), along[1])}
    # Ericson, Real-Time Collision Detection, 5.1.9, of a sum of squares that has one minimum: also if parallel.
    parts, a = [], found.let(_plus(a, barrel))
    for pull in PULLS:
        shifted = found.let(_plus(c, -pull * barrel))
        s = _clip(f"(({b}*{f} - {shifted}*{e})/({a}*{e} - {b}*{b}))", 0.0, 1.0)
        t = found.let(_clip(f"(({b}*{found.let(s)} + {f})/{e})", 0.0, 1.0))
        free = found.let(f"({b}*{t} - {shifted})/{a}")
        parts.append((found.let(_clip(free, 0.0, 1.0)), t, free))
    (begin, *_), (s, t, free), (end, *_) = parts
    line = _line(found, barrel, (begin, s, end), (f"{free} < 1", f"{free} > 0"))
    return {"mine": [at(first, each, along[0]) for each in (begin, end)], "theirs": at(second, t, along[1])} | (
        line | {"own": at(first, s, along[0])}
    )


def _line(found, barrel, parts, presses):
    """What an axis with two points adds for `_touch_at`.

    parts : (first, middle, last), where they and what is nearest between them are;  presses : conditions that they do
    """
    begin, s, end = parts
    share = found.let(f"({end} - {s} + {LEAST_PART!r}*(1 - {s}))/({end} - {begin} + {LEAST_PART!r})")
    return {
        "more": f"({barrel!r}*({s} - {PULLS[1]!r})**2)",
        "shares": [(share, presses[0]), (found.let(f"1 - {share}"), presses[1])],
    }


def _skeleton(shape):
    """Ends of the axis of a capsule, or the centre, in the body frame."""
    return _ends(shape) if shape.type == "capsule" else [np.array(shape.position)]


def _in_box(found, bodies, shapes):
    """(axes of the box in the world, ends of the axis of the other body from its middle, in these axes, its middle)."""
    (round_body, box), (shape, solid) = bodies, shapes
    middle, ends = found.place(box, solid.position), []
    axes = [found.direction(box, solid.rotation[:, k]) for k in range(3)]
    for end in _skeleton(shape):
        apart = [found.let(each) for each in _difference(found.place(round_body, end), middle)]
        ends.append([found.let(_dot(apart, axis)) for axis in axes])
    return axes, ends, middle


def _nearest_to_box(found, bodies, shapes, barrel):
    """As `_nearest`, of the axis of a sphere or a capsule and of a box; with the condition that it is in the box.

    The derivative of the sum in `_touch_each_other` is linear between the places where the axis crosses the planes of
    the faces.
    """
    axes, ends, middle = _in_box(found, bodies, shapes)
    halves = [0.5 * size for size in shapes[1].size]
    own, line, mine = ends[0], {}, ends[:1]
    if len(ends) == 2:
        along = [found.let(each) for each in _difference(ends[1], ends[0])]

        def at(s):
            return [found.let(_plus(each, _times(s, rate))) for each, rate in zip(ends[0], along)]

        def slope(s):
            """f'(s) / 2."""
            beyond = [_minus(each, _clip(each, -half, half)) for each, half in zip(at(s), halves)]
            return found.let(_dot(along, beyond))

        # An axis along a face does not cross its plane: any place does, and its distance changes by round-off only.
        least, breaks = 1e-9 * shapes[0].length, [0.0, 1.0]
        for begin, rate, half in zip(ends[0], along, halves):
            for face in (-half, half):
                crossing = f"(({face!r} - {begin})/{rate} if abs({rate}) > {least!r} else 0)"
                breaks.append(found.let(_clip(crossing, 0.0, 1.0)))
        slopes, parts = [slope(s) for s in breaks], []
        for pull in PULLS:
            rates = [found.let(f"{g} + {barrel!r}*({s} - {pull})") for g, s in zip(slopes, breaks)]
            before = [found.let(f"{each} < 0") for each in rates]
            s, g = (
                (
                    found.let(f"max({', '.join(f'{x} if {c} else {v[0]}' for x, c in zip(v, before))})"),
                    found.let(f"min({', '.join(f'{v[1]} if {c} else {x}' for x, c in zip(v, before))})"),
                )
                for v in (breaks, rates)
            )
            s = found.let(f"{s[0]} - ({s[1]} - {s[0]})*{g[0]}/({g[1]} - {g[0]} + {1e-12 * barrel!r})")
            parts.append((s, rates[:2]))
        (first, _), (s, (low, high)), (last, _) = parts
        line = _line(found, barrel, (first, s, last), (f"{high} > 0", f"{low} < 0"))
        own, mine = at(s), [at(first), at(last)]
    beyond = [found.let(f"abs({each}) - {half!r}") for each, half in zip(own, halves)]
    most = found.let(f"max({', '.join(beyond)})")
    inside, nearest = found.let(f"{most} < 0"), []
    for each, half, outside in zip(own, halves, beyond):
        face = f"({half!r} if {each} > 0 else {-half!r})"
        nearest.append(found.let(f"{face} if {inside} and {outside} >= {most} else {_clip(each, -half, half)}"))

    def in_world(point):
        return [found.let(each) for each in _sum(middle, *map(_scaled, point, axes))]

    return {"mine": [in_world(each) for each in mine], "theirs": in_world(nearest), "inside": inside} | (
        line and line | {"own": in_world(own)}
    )


def _touch_each_other(found, bodies, shapes, short):
    """Contact of two bodies.

    The point of an axis that is nearest jumps where the axis lies along the other body. So what acts is the fraction s
    where f(s) + b (s - 1/2)^2 is least, with the squared distance f: this sum is strictly convex, as f is convex, so
    that s moves with the bodies without jumps, and no change of the part of f in which it is has to be an event. The
    force is the gradient of the minimum, so that nothing but damping and friction takes energy. With b = 0.8 short
    times the sum of the radii, s is at an end from a lean of 0.4 short along the axis on, where the depth is 0.1 short
    less than that of the end.

    A capsule hands this force to two points of its axis that have s as the centre of their pressure: where the sum has
    its minimum with -1 and with 2 in place of 1/2. They are the ends of an axis along the other body, and are one where
    two axes cross. Damping and friction are theirs: so a capsule that lies on a body comes to rest, and resists a spin.
    """
    if shapes[0].type == "box" or shapes[0].type == shapes[1].type == "capsule" and shapes[0].length > shapes[1].length:
        bodies, shapes = bodies[::-1], shapes[::-1]
    nearest = _nearest_to_box if shapes[1].type == "box" else _nearest
    barrel = 0.8 * short * sum(getattr(shape, "radius", 0.0) for shape in shapes)
    found.is_geometry = True
    points = nearest(found, bodies, shapes, barrel)
    found.is_geometry = False
    _touch_at(found, bodies, shapes, **points)
    reach = [np.linalg.norm(shape.position) + _around(shape)[1] for shape in shapes]
    size = LOOK * sum(0.5 * min(shape.size) if shape.type == "box" else shape.radius for shape in shapes)
    found.closing = [(found.depths[0], bodies, reach, size)]
    return found


def _touch_at(found, bodies, shapes, mine, theirs, own=None, more=0.0, shares=((1.0, ""),), inside=None):
    """Contact of two bodies at points of the axis of one, world axes; see `_touch_each_other`.

    mine   : the points;  theirs : point of the axis of the other body, or of the box, that is nearest to `own`
    own    : what is nearest on the axis, default: the only point
    more   : m^2, is added to the squared distance
    shares : (share in the force, condition that there is one) of each point
    inside : condition that `own` is in the box, so that its distance is negative; None: there is no box
    """
    radii = [getattr(shape, "radius", 0.0) for shape in shapes]
    apart = [found.let(each) for each in _difference(own or mine[0], theirs)]
    length = reach = found.let(f"sqrt({_dot(apart, apart)})")
    part = 1.0
    if more:
        length = found.let(f"sqrt({reach}**2 + {more})")
        part = found.let(f"{reach}/{length}")
    if inside is not None:
        length = found.let(f"({_minus(f'sqrt({more})' if more else 0.0, reach)} if {inside} else {length})")
        reach = found.let(f"(-{reach} if {inside} else {reach})")
        part = found.let(f"(1 if {inside} else {part})") if more else 1.0
    normal = [found.let(f"{each}/{reach}") for each in apart]
    depth = found.let(_minus(sum(radii), length))
    # In the middle of the region that both would occupy.
    down = [found.let(each) for each in _scaled(found.let(_minus(_times(0.5, depth), radii[0])), normal)]
    for point, (share, presses) in zip(mine, shares):
        middle = [found.let(each) for each in _sum(point, down)]
        arms, speeds = [], []
        for body, shape in zip(bodies, shapes):
            arm = [found.let(each) for each in _difference(middle, found.place(body, shape.position))]
            arms.append(arm)
            speeds.append(_sum(found.rate(body, shape.position), _cross(found.spin(body), arm)))
        speed = [found.let(each) for each in _difference(*speeds)]
        leaving = found.let(_dot(normal, speed))
        slips = _difference(speed, _scaled(leaving, normal))
        force = found.press(depth, leaving, slips, (normal, None), _times(part, share), presses)
        force = [found.let(each) for each in force]
        for body, shape, arm, sign in zip(bodies, shapes, arms, (1.0, -1.0)):
            found.act(body, shape.position, _scaled(sign, force), arm)
