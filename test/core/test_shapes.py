# SPDX-License-Identifier: Apache-2.0
"""Mass, centre of mass and inertia of shapes, and the characteristic length of a scene."""

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss
from scene_files import text_of

from liegroup_core.errors import SceneError
from liegroup_core.layout import make_layout
from liegroup_core.lie.groups import SO3
from liegroup_core.scene import Body, Scene, scene_from_text
from liegroup_core.scene.shapes import SHAPES, Box, Capsule, Cylinder, Rod, Sphere

# Eight Gauss points a direction integrate polynomials of degree 15 exactly: all that occur here,
# in the coordinates in which each solid is a product of intervals.
POINTS, WEIGHTS = leggauss(8)


def interval(low, high):
    return (low + high + (high - low) * POINTS) / 2, WEIGHTS * (high - low) / 2


def grid(*intervals):
    """Coordinates (3, k) and weights (k,) of a product of three intervals."""
    nodes = np.meshgrid(*(nodes for nodes, _ in intervals), indexing="ij")
    weights = np.meshgrid(*(weights for _, weights in intervals), indexing="ij")
    return np.array([n.ravel() for n in nodes]), np.prod([w.ravel() for w in weights], axis=0)


def around():
    """Nodes and weights of a full turn: eight equal steps are exact up to the seventh harmonic."""
    return np.arange(8) * np.pi / 4, np.full(8, np.pi / 4)


def volume_points(shape):
    """Points (3, k) of a solid in its own axes and the volumes (k,) they stand for."""
    if shape.type == "box":
        return grid(*(interval(-edge / 2, edge / 2) for edge in shape.size))
    if shape.type == "sphere":
        (r, z, turn), weight = grid(interval(0, shape.radius), interval(-1, 1), around())
        across = np.sqrt(1 - z**2)
        return r * np.array([across * np.cos(turn), across * np.sin(turn), z]), weight * r**2
    if shape.type == "capsule":
        tube, within = volume_points(Cylinder(radius=shape.radius, length=shape.length, mass=1))
        (r, z, turn), weight = grid(interval(0, shape.radius), interval(0, 1), around())
        across = np.sqrt(1 - z**2)
        end = r * np.array([across * np.cos(turn), across * np.sin(turn), z]) + [[0], [0], [shape.length / 2]]
        return np.hstack([tube, end, -end]), np.concatenate([within, weight * r**2, weight * r**2])
    (r, z, turn), weight = grid(interval(0, shape.radius), interval(-shape.length / 2, shape.length / 2), around())
    return np.array([r * np.cos(turn), r * np.sin(turn), z]), weight * r


SOLIDS = [
    Box(size=(0.3, 0.5, 0.2), density=700.0),
    Box(size=(0.3, 0.5, 0.2), mass=2.0, position=(0.1, -0.2, 0.4), rotation_vector=(0.3, 1, -0.4)),
    Capsule(radius=0.2, length=0.7, density=1200.0, axis=(1, 2, -0.5)),
    Capsule(radius=0.2, length=0.1, mass=3.0, position=(0.1, 0, -0.3)),
    Cylinder(radius=0.2, length=0.7, density=1200.0, axis=(1, 2, -0.5)),
    Cylinder(radius=0.5, length=0.1, mass=3.0, quaternion=(0.5, 0.5, 0.5, 0.5)),
    Rod(length=0.8, mass=0.4, axis=(1, 0, 0), position=(0.4, 0, 0)),
    Rod(length=0.8, radius=0.01, density=7800.0),
    Sphere(radius=0.3, density=2000.0, position=(0, 0, 0.3)),
    Sphere(radius=0.3, mass=5.0, rotation_vector=(1, 1, 0)),
]


@pytest.mark.parametrize("shape", SOLIDS, ids=lambda shape: shape.type)
def test_mass_centre_and_inertia_are_integrals_over_the_volume(shape):
    body = Body(name="b", shape=shape)
    points, volumes = volume_points(shape)
    volume = volumes.sum()
    density = shape.density if shape.density is not None else shape.mass / volume
    # sums of 512 terms, each right to a few 1e-16
    assert body.mass == pytest.approx(density * volume, rel=1e-13)
    R, place = shape.rotation, np.array(shape.position)
    points = R @ points + place[:, None]
    np.testing.assert_allclose(body.com, points @ volumes / volume, atol=1e-14)
    from_centre = points - place[:, None]
    second = (from_centre * volumes) @ from_centre.T
    inertia = density * (np.trace(second) * np.eye(3) - second)
    np.testing.assert_allclose(body.inertia_matrix, inertia, rtol=0, atol=1e-13 * inertia.max())


def test_every_solid_is_among_the_integrated_ones():
    assert {type(shape) for shape in SOLIDS} == set(SHAPES)


def test_a_thin_rod_has_a_positive_inertia_about_its_axis():
    rod = Body(name="b", shape=Rod(length=2.0, mass=3.0, axis=(1, 0, 0)))
    along, across = rod.inertia[0], rod.inertia[1]
    assert across == pytest.approx(3.0 * 2.0**2 / 12, rel=1e-5)
    assert along == pytest.approx(0.5 * 3.0 * 0.002**2, rel=1e-14)


def test_a_shape_aligned_with_body_axes_has_exact_zero_products_of_inertia():
    for axis, order in (((1, 0, 0), (0, 1, 1)), ((0, 1, 0), (1, 0, 1)), ((0, 0, 1), (1, 1, 0))):
        inertia = Body(name="b", shape=Cylinder(radius=0.1, length=1, mass=1, axis=axis)).inertia
        assert inertia[3:] == (0.0, 0.0, 0.0)
        assert inertia[:3] == tuple((0.5 * 0.1**2, (3 * 0.1**2 + 1) / 12)[i] for i in order)


def test_a_body_with_a_shape_survives_a_text_round_trip():
    scene = Scene(
        name="s",
        gravity=(0, 0, 0),
        bodies=[
            Body(name="b", shape=Box(size=(1, 2, 3), density=1e3, position=(1, 0, 0))),
            Body(name="c", shape={"type": "rod", "length": 1, "mass": 2}),
        ],
    )
    again = scene_from_text(scene.text)
    assert repr(again.model_dump()) == repr(scene.model_dump())
    assert "inertia" not in scene.text and again.bodies[0].mass == 6000.0
    heavier = scene.bodies[1].remade(shape=Rod(length=1, mass=4))
    assert heavier.mass == 4.0


def text_with(shape):
    return f"name: s\ngravity: [0, 0, 0]\nbodies:\n- name: b\n  shape: {shape}\n"


@pytest.mark.parametrize("key, value", [("mass", "1.0"), ("inertia", "[1, 1, 1]"), ("com", "[0, 0, 1]")])
def test_a_shape_excludes_keys_that_it_defines(key, value):
    text = text_with("{type: sphere, radius: 1, mass: 1}") + f"  {key}: {value}\n"
    with pytest.raises(SceneError, match=f"x.yaml:6: .*{key} and shape both define the {key}"):
        scene_from_text(text, source="x.yaml")


def test_the_inertia_of_an_offset_solid_is_about_its_centre_of_mass():
    """The inertia contains no parallel-axis (Steiner) term, whatever the offset."""
    here, there = (
        Body(name="b", shape=Box(size=(1, 2, 3), mass=1, position=p, rotation_vector=(0.1, 0.2, 0.3)))
        for p in ((0, 0, 0), (5, -7, 9))
    )
    assert here.inertia == there.inertia
    R = SO3.exp((0.1, 0.2, 0.3))
    np.testing.assert_allclose(R.T @ here.inertia_matrix @ R, np.diag([13, 10, 5]) / 12, atol=1e-15)


# Size of a mechanism, of which an accuracy is a part.


BALL = text_of("ball_size.yaml")
LINE = "joints:\n  - {name: line, type: TYPE, parent: world, child: ball, parent_frame: {}, child_frame: {}"
SMALL = "0.02, 0.02, 0.02"


@pytest.mark.parametrize(
    "inertia, joint, size",
    [
        (SMALL, "", 0.03**0.5),  # sqrt(trace(I) / m)
        (SMALL, LINE.replace("TYPE", "distance") + "}", 3.0),
        (SMALL, LINE.replace("TYPE", "distance") + ", length: 3.0}", 3.0),
        (SMALL, LINE.replace("TYPE", "cable") + ", length: 4.0}", 4.0),
        (SMALL, LINE.replace("TYPE", "strut") + ", length: 2.0}", 2.0),
    ],
)
def test_size_is_the_largest_length(inertia, joint, size):
    scene = scene_from_text(BALL.replace("INERTIA", inertia) + joint)
    assert make_layout(scene).size == pytest.approx(size, rel=1e-15)
