# SPDX-License-Identifier: Apache-2.0
"""Scenes of any size, generated in code: chains and rows of four-bar windows.

    from liegroup_core.scene.library import chain
    simulation = Simulation(chain(100, "revolute"))

The example scenes contain the same mechanisms with ten links and with two windows.
"""

from .description import Body, Frame, Joint, Scene
from .shapes import Rod

GRAVITY = 9.81  # m/s^2


def chain(n, kind="spherical", length=0.1, mass=0.1):
    """Chain of n equal rods, hung from the origin and released at rest along world x.

    kind         : "spherical", or "revolute" with axes along world y
    length, mass : m, kg of a rod; its radius is a twentieth of its length
    Body frames are at the near ends with x along the rods. The rods are rod0, rod1, ...
    """
    shape = Rod(axis=(1, 0, 0), length=length, radius=length / 20, mass=mass, position=(length / 2, 0, 0))
    near, far = Frame(axis=(0, 1, 0)), Frame(position=(length, 0, 0), axis=(0, 1, 0))
    names = [f"rod{i}" for i in range(n)]
    return Scene(
        name="chain",
        description=f"Chain of {n} rods, {kind} joints",
        gravity=(0, 0, -GRAVITY),
        bodies=[Body(name=name, shape=shape, position=(i * length, 0, 0)) for i, name in enumerate(names)],
        joints=[
            Joint(
                name=f"pin{i}", type=kind, parent=parent, child=child, child_frame=near, parent_frame=far if i else near
            )
            for i, (parent, child) in enumerate(zip(["world", *names], names))
        ],
    )


def four_bar_windows(n):
    """n four-bar windows side by side: n + 1 cranks and n couplers, rods of 1 m and 1 kg.

    Cranks crank0, crank1, ... stand upright, 1 m apart in the x-y plane, and rotate towards
    x at -1 rad/s; coupler0, ... join their tops. Gravity is along -y. Every half turn all bars are
    collinear: there the degrees of freedom are n + 1 instead of 1.
    Source: IFToMM library of computational benchmark problems, A02, where n is 2.
    """
    upright = Rod(axis=(0, 1, 0), length=1, mass=1, position=(0, 0.5, 0))
    level = Rod(axis=(1, 0, 0), length=1, mass=1, position=(0.5, 0, 0))
    bodies = [
        Body(name=f"crank{k}", shape=upright, position=(k, 0, 0), angular_velocity=(0, 0, -1)) for k in range(n + 1)
    ]
    bodies += [Body(name=f"coupler{k}", shape=level, position=(k, 1, 0), linear_velocity=(1, 0, 0)) for k in range(n)]
    joints = [
        Joint(name=f"ground{k}", type="revolute", parent="world", child=f"crank{k}", child_frame=Frame())
        for k in range(n + 1)
    ]
    for k in range(n):
        joints += [
            Joint(
                name=f"{side}{k}",
                type="revolute",
                parent=f"crank{k + x}",
                child=f"coupler{k}",
                child_frame=Frame(position=(x, 0, 0)),
            )
            for side, x in (("left", 0), ("right", 1))
        ]
    return Scene(
        name="four_bar_windows",
        description=f"{n} four-bar windows side by side",
        gravity=(0, -GRAVITY, 0),
        bodies=bodies,
        joints=joints,
    )
