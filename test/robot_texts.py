# SPDX-License-Identifier: Apache-2.0
"""Robot files for tests: one arm in three formats, random trees, and mechanisms with loops."""

import numpy as np
from scene_files import filled, text_of

from liegroup_core.joints.kinds import Joint

# Two links on a rotated base, a tool that is fixed to the second one, a slide without mass at its end.
ARM_URDF = text_of("arm_robot_texts.urdf")

ARM_SDF = text_of("arm_robot_texts.sdf")

ARM_MJCF = text_of("arm.xml")


def written(path, text):
    """Path of a file to which a text is written."""
    path.write_text(text)
    return path


def rotation(roll, pitch, yaw):
    """(3, 3) Rz(yaw) Ry(pitch) Rx(roll), written out for each axis."""
    (cr, cp, cy), (sr, sp, sy) = np.cos((roll, pitch, yaw)), np.sin((roll, pitch, yaw))
    Rx = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    Ry = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    Rz = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return Rz @ Ry @ Rx


def random_urdf(rng, n):
    """URDF text of a random tree of n links that move, with fixed ones between them."""
    links, joints = ['<link name="root"/>'], []
    for i in range(n):
        parent = "root" if i == 0 else f"link{rng.integers(max(0, i - 3), i)}"
        # Moments of a box, so that they belong to a body.
        a, b, c = rng.uniform(0.05, 0.4, 3) ** 2
        mass = float(rng.uniform(0.1, 3.0))
        inertia = [float(mass / 12 * value) for value in (b + c, a + c, a + b)]
        links.append(
            f'<link name="link{i}"><inertial><origin xyz="{_row(rng, 0.2)}" rpy="{_row(rng, 3)}"/>'
            f'<mass value="{mass!r}"/><inertia ixx="{inertia[0]!r}" iyy="{inertia[1]!r}" '
            f'izz="{inertia[2]!r}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        )
        kind = ("revolute", "continuous", "prismatic", "fixed")[rng.integers(4) if i else 0]
        law = "" if kind == "fixed" else f'<dynamics damping="{float(rng.uniform(0, 2))!r}"/>'
        limit = '<limit lower="-9" upper="9" effort="9" velocity="9"/>'
        joints.append(
            f'<joint name="joint{i}" type="{kind}"><parent link="{parent}"/><child link="link{i}"/>'
            f'<origin xyz="{_row(rng, 0.5)}" rpy="{_row(rng, 3)}"/><axis xyz="{_unit(rng)}"/>'
            f"{limit if kind in ('revolute', 'prismatic') else ''}{law}</joint>"
        )
    option = '<mujoco><compiler fusestatic="false" boundmass="0" boundinertia="0"/></mujoco>'
    return f'<robot name="random">{option}{"".join(links)}{"".join(joints)}</robot>'


def _row(rng, size):
    return " ".join(repr(float(value)) for value in rng.uniform(-size, size, 3))


def _unit(rng):
    axis = rng.normal(size=3)
    return " ".join(repr(float(value)) for value in axis / np.linalg.norm(axis))


BAR = (
    '<inertial><origin xyz="{half} 0 0"/><mass value="1"/>'
    '<inertia ixx="0.0001" iyy="{moment}" izz="{moment}" ixy="0" ixz="0" iyz="0"/></inertial>'
)


def bar(name, length):
    """<link> of a bar along x from its frame."""
    return f'<link name="{name}">' + BAR.format(half=length / 2, moment=length**2 / 12) + "</link>"


def pin(name, parent, child, x, yaw=0.0):
    """<joint> about z at x along the parent."""
    return (
        f'<joint name="{name}" type="continuous"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{x} 0 0" rpy="0 0 {yaw}"/><axis xyz="0 0 1"/></joint>'
    )


def five_bar_urdf():
    """Two cranks of 1 m, 1 m apart, and two bars of 1.2 m whose ends a closing joint connects."""
    links = ['<link name="ground"/>', *(bar(name, 1.0) for name in ("left", "right"))]
    links += [bar(name, 1.2) for name in ("left_bar", "right_bar")]
    links += ['<link name="left_end"/>', '<link name="right_end"/>']
    joints = [
        pin("left_crank", "ground", "left", 0.0, 2.0),
        pin("right_crank", "ground", "right", 1.0, 1.1),
        pin("left_elbow", "left", "left_bar", 1.0, -1.3),
        pin("right_elbow", "right", "right_bar", 1.0, 1.3),
    ]
    for side in ("left", "right"):
        joints.append(
            f'<joint name="{side}_tip" type="fixed"><parent link="{side}_bar"/>'
            f'<child link="{side}_end"/><origin xyz="1.2 0 0"/></joint>'
        )
    return f'<robot name="five_bar">{"".join(links)}{"".join(joints)}</robot>'


# It closes the loop of the five-bar.
FIVE_BAR_TIP = Joint(name="tip", type="revolute", parent="left_end", child="right_end", parent_frame={}, child_frame={})


def freedoms(simulation):
    """Degrees of freedom at the start."""
    return 6 * len(simulation.scene.bodies) - simulation.layout.model.row_residual.size


def stewart_sdf():
    """Stewart platform: six legs of two parts each, on universal joints below, ball joints above."""
    angles = np.radians([10, 110, 130, 230, 250, 350])
    tops = np.radians([50, 70, 170, 190, 290, 310])
    base = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(6)])
    plate = np.column_stack([0.6 * np.cos(tops), 0.6 * np.sin(tops), np.full(6, 1.2)])
    parts = [
        '<link name="plate"><pose>0 0 1.2 0 0 0</pose><inertial><mass>5</mass><inertia><ixx>0.5</ixx>'
        "<iyy>0.5</iyy><izz>0.9</izz></inertia></inertial></link>"
    ]
    for k, (low, high) in enumerate(zip(base, plate)):
        along = (high - low) / np.linalg.norm(high - low)
        yaw, tilt = np.arctan2(along[1], along[0]), np.arccos(along[2])
        for name, at, mass in (("lower", low, 1.0), ("upper", low + 0.6 * along, 0.5)):
            pose = f"{at[0]!r} {at[1]!r} {at[2]!r} 0 {tilt!r} {yaw!r}".replace("np.float64", "")
            parts.append(
                f'<link name="{name}{k}"><pose>{pose.replace("(", "").replace(")", "")}</pose>'
                f"<inertial><pose>0 0 0.3 0 0 0</pose><mass>{mass}</mass><inertia><ixx>0.03</ixx>"
                "<iyy>0.03</iyy><izz>0.001</izz></inertia></inertial></link>"
            )
        corner = " ".join(repr(float(value)) for value in high)
        parts.append(
            f'<joint name="foot{k}" type="universal"><parent>world</parent><child>lower{k}</child>'
            "<axis><xyz>1 0 0</xyz></axis><axis2><xyz>0 1 0</xyz></axis2></joint>"
            f'<joint name="leg{k}" type="prismatic"><parent>lower{k}</parent><child>upper{k}</child>'
            "<axis><xyz>0 0 1</xyz><dynamics><damping>50</damping><spring_stiffness>4000"
            "</spring_stiffness></dynamics></axis></joint>"
            f'<joint name="head{k}" type="ball"><pose relative_to="__model__">{corner} 0 0 0</pose>'
            f"<parent>plate</parent><child>upper{k}</child></joint>"
        )
    return f'<sdf version="1.9"><model name="stewart">{"".join(parts)}</model></sdf>'


def scissor_lift(stages, angle=0.5):
    """(URDF text, YAML text that closes its loops) of a scissor lift of bars of 1 m.

    Frames of left bars are at their feet, those of right bars, which cross them, at their centres.
    The foot of the first right bar is pinned to a slider on the ground.
    """
    slider = (
        '<inertial><mass value="0.2"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    links = ['<link name="ground"/>', f'<link name="slider">{slider}</link>']
    joints = [
        f'<joint name="slide" type="prismatic"><parent link="ground"/><child link="slider"/>'
        f'<origin xyz="{float(np.cos(angle))!r} 0 0"/><axis xyz="1 0 0"/></joint>'
    ]
    pins = [("slider", (0, 0, 0), "right0")]
    turn = np.pi - 2 * angle
    for k in range(stages):
        links.append(bar(f"left{k}", 1.0))
        links.append(f'<link name="right{k}">{BAR.format(half=0, moment=1 / 12)}</link>')
        below = ("ground", 0.0, angle) if k == 0 else (f"right{k - 1}", 0.5, -turn)
        joints.append(pin(f"lift{k}", below[0], f"left{k}", *below[1:]))
        joints.append(pin(f"cross{k}", f"left{k}", f"right{k}", 0.5, turn))
        if k:
            pins.append((f"left{k - 1}", (1, 0, 0), f"right{k}"))
    rows = ["robot: lift.urdf", "gravity: [0, -9.81, 0]", "joints:"]
    for k, (parent, at, child) in enumerate(pins):
        rows.append(
            f"  - {{name: pin{k}, type: revolute, parent: {parent}, child: {child}, parent_frame: "
            f"{{position: {list(at)}}}, child_frame: {{position: [-0.5, 0, 0]}}}}"
        )
    text = f'<robot name="lift">{"".join(links)}{"".join(joints)}</robot>'
    return text, "\n".join(rows) + "\n"


MJCF_WITH_ALL_JOINTS = text_of("mjcf_with_all_joints.xml")
MJCF_WITH_ACTUATORS = text_of("mjcf_with_actuators.xml")
MIMIC_URDF = text_of("hand.urdf")


def mimic_urdf(folder):
    """Path of a robot with a chain of mimic joints."""
    inertial = (
        '<inertial><origin xyz="0.05 0.01 0.02"/><mass value="{}"/><inertia ixx="0.02" iyy="0.03" '
        'izz="0.025" ixy="0.001" ixz="0.002" iyz="0.0005"/></inertial>'
    )
    links = "".join(
        f'<link name="{name}">{inertial.format(mass)}</link>' for name, mass in (("a", 1.5), ("b", 0.7), ("c", 0.4))
    )
    path = folder / "hand.urdf"
    path.write_text(filled(MIMIC_URDF, links=links))
    return path
