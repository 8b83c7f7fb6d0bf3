# SPDX-License-Identifier: Apache-2.0
"""Robot files for tests: one arm in three formats, random trees, and mechanisms with loops."""

import numpy as np

# Two links on a rotated base, a tool that is fixed to the second one, a slide without mass at its end.
ARM_URDF = """<?xml version="1.0"?>
<robot name="arm">
  <link name="base"><collision><geometry><box size="1 1 1"/></geometry></collision></link>
  <link name="upper">
    <inertial>
      <origin xyz="0.1 0.02 -0.03" rpy="0.3 -0.2 0.5"/>
      <mass value="2.5"/>
      <inertia ixx="0.02" iyy="0.03" izz="0.025" ixy="0.001" ixz="-0.002" iyz="0.0015"/>
    </inertial>
    <visual><origin xyz="0.1 0 0"/><geometry><box size="0.2 0.05 0.04"/></geometry></visual>
  </link>
  <link name="slide">
    <inertial>
      <origin xyz="0 0.05 0.01" rpy="0 0 0.4"/>
      <mass value="1.2"/>
      <inertia ixx="0.004" iyy="0.005" izz="0.006" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <link name="tool">
    <inertial>
      <origin xyz="0 0 0.1"/>
      <mass value="0.4"/>
      <inertia ixx="0.001" iyy="0.001" izz="0.0005" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <link name="tip"/>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/>
    <origin xyz="0.1 0.2 0.3" rpy="0.2 0.1 -0.3"/>
    <axis xyz="0.3 -0.5 1"/>
    <limit lower="-1" upper="2" effort="10" velocity="3"/>
    <dynamics damping="0.7" friction="0.1"/>
  </joint>
  <joint name="extend" type="prismatic">
    <parent link="upper"/><child link="slide"/>
    <origin xyz="0.3 0 0.05" rpy="0.5 0 0"/>
    <axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="10" velocity="3"/>
    <dynamics damping="4"/>
  </joint>
  <joint name="flange" type="fixed">
    <parent link="slide"/><child link="tool"/><origin xyz="0 0.1 0" rpy="0 0.7 0"/>
  </joint>
  <joint name="tip_joint" type="continuous">
    <parent link="tool"/><child link="tip"/><axis xyz="0 0 1"/>
  </joint>
  <transmission name="drive"/>
</robot>
"""

ARM_SDF = """<?xml version="1.0"?>
<sdf version="1.9">
  <model name="arm">
    <pose>0 0 0 0 0 0</pose>
    <frame name="mount"><pose>0.1 0.2 0.3 0.2 0.1 -0.3</pose></frame>
    <link name="upper">
      <pose relative_to="mount"/>
      <inertial>
        <pose>0.1 0.02 -0.03 0.3 -0.2 0.5</pose><mass>2.5</mass>
        <inertia><ixx>0.02</ixx><iyy>0.03</iyy><izz>0.025</izz>
          <ixy>0.001</ixy><ixz>-0.002</ixz><iyz>0.0015</iyz></inertia>
      </inertial>
    </link>
    <link name="slide">
      <pose relative_to="upper">0.3 0 0.05 0.5 0 0</pose>
      <inertial>
        <pose>0 0.05 0.01 0 0 0.4</pose><mass>1.2</mass>
        <inertia><ixx>0.004</ixx><iyy>0.005</iyy><izz>0.006</izz></inertia>
      </inertial>
    </link>
    <link name="tool">
      <pose relative_to="slide">0 0.1 0 0 0.7 0</pose>
      <inertial>
        <pose>0 0 0.1 0 0 0</pose><mass>0.4</mass>
        <inertia><ixx>0.001</ixx><iyy>0.001</iyy><izz>0.0005</izz></inertia>
      </inertial>
    </link>
    <joint name="shoulder" type="revolute">
      <parent>world</parent><child>upper</child>
      <axis><xyz>0.3 -0.5 1</xyz><dynamics><damping>0.7</damping></dynamics></axis>
    </joint>
    <joint name="extend" type="prismatic">
      <pose relative_to="slide"/>
      <parent>upper</parent><child>slide</child>
      <axis><xyz expressed_in="slide">0 1 0</xyz><dynamics><damping>4</damping></dynamics></axis>
    </joint>
    <joint name="flange" type="fixed"><parent>slide</parent><child>tool</child></joint>
  </model>
</sdf>
"""

ARM_MJCF = """<mujoco model="arm">
  <compiler angle="radian" eulerseq="XYZ"/>
  <worldbody>
    <body name="upper" pos="0.1 0.2 0.3" euler="0.2 0.1 -0.3">
      <inertial pos="0.1 0.02 -0.03" mass="2.5"
        fullinertia="{upper}"/>
      <joint name="shoulder" type="hinge" axis="0.3 -0.5 1" damping="0.7"/>
      <body name="slide" pos="0.3 0 0.05" euler="0.5 0 0">
        <inertial pos="0 0.05 0.01" mass="1.2" euler="0 0 0.4" diaginertia="0.004 0.005 0.006"/>
        <joint name="extend" type="slide" axis="0 1 0" damping="4"/>
        <body name="tool" pos="0 0.1 0" euler="0 0.7 0">
          <inertial pos="0 0 0.1" mass="0.4" diaginertia="0.001 0.001 0.0005"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


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


MJCF_WITH_ALL_JOINTS = """<mujoco>
  <worldbody>
    <body name="cart"><joint name="x" type="slide" axis="1 0 0" damping="0.3"/>
      <joint name="y" type="slide" axis="0 1 0" stiffness="3" springref="0.2"/>
      <joint name="turn" type="hinge" axis="0 0 1" pos="0.1 0 0"/>
      <geom type="box" size="0.2 0.1 0.05" mass="3"/>
      <body name="arm" pos="0.2 0 0.1"><joint name="ball" type="ball" pos="0 0 0.1"/>
        <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.05" mass="1"/>
        <body name="hand" pos="0.4 0 0" euler="0 30 20">
          <joint name="wrist" type="hinge" axis="0 1 1" ref="20" stiffness="2" armature="0.1"/>
          <joint name="twist" type="hinge" axis="1 0 0" frictionloss="0.2"/>
          <geom type="box" size="0.1 0.02 0.05" mass="0.5"/></body></body></body>
    <body name="ball_free" pos="1 0 1"><freejoint name="free"/>
      <geom type="sphere" size="0.1" mass="0.2"/></body>
  </worldbody>
  <keyframe><key name="home" qpos="0.1 0.2 0.3  1 0 0 0  0.4 0.5  1 0 1 1 0 0 0"/></keyframe>
</mujoco>"""
MJCF_WITH_ACTUATORS = """<mujoco><compiler angle="radian"/><option gravity="0.3 0 -9.81"/><worldbody>
  <body name="b1"><joint name="j1" axis="0 1 0" ref="0.3"/><geom type="box" size="0.2 0.1 0.05" pos="0.2 0 0" mass="2"/>
    <body name="b2" pos="0.4 0 0"><joint name="j2" axis="0 0 1" actuatorfrcrange="-3 3"/>
      <geom type="box" size="0.1 0.1 0.05" pos="0.1 0 0" mass="1"/>
      <body name="b3" pos="0.2 0 0.1"><joint name="j3" type="slide" axis="1 0 1"/>
        <geom type="box" size="0.1 0.05 0.05" mass="0.5"/>
        <body name="b4" pos="0.1 0 0"><joint name="j4" axis="1 0 0" damping="0.1" armature="0.02"/>
          <geom type="box" size="0.1 0.05 0.07" pos="0 0.1 0" mass="0.5"/>
          <body name="b5" pos="0.1 0 0"><joint name="j5" axis="1 1 0"/>
            <geom type="box" size="0.1 0.05 0.07" pos="0 0.1 0" mass="0.5"/></body></body></body></body></body>
  <body name="f1" pos="0 1 0"><joint name="k1" axis="0 0 1" ref="0.2"/>
    <geom type="box" size="0.1 0.05 0.07" pos="0 0.1 0" mass="0.5"/></body>
  <body name="f2" pos="0 2 0"><joint name="k2" axis="0 0 1"/>
    <geom type="box" size="0.1 0.05 0.07" pos="0 0.1 0" mass="0.5"/></body></worldbody>
<equality><joint joint1="k2" joint2="k1" polycoef="0.1 -0.6 0 0 0"/></equality>
<tendon><fixed name="split"><joint joint="k1" coef="0.5"/><joint joint="k2" coef="0.7"/></fixed>
  <fixed name="one"><joint joint="j5" coef="-2"/></fixed>
  <fixed name="two"><joint joint="j2" coef="1"/><joint joint="j5" coef="-2"/></fixed></tendon>
<actuator>
  <position name="p1" joint="j1" kp="20" dampratio="0.7" gear="1.5" ctrlrange="-1 1"/>
  <position name="p2" joint="j2" kp="30" kv="2"/>
  <velocity name="v3" joint="j3" kv="4" gear="-2" forcerange="-1.5 1.5"/>
  <motor name="m3" joint="j3" gear="3" ctrlrange="-1 1" forcerange="-0.6 2"/>
  <general name="g4" joint="j4" gear="2" gainprm="3 0.2 -0.1" gaintype="affine" biastype="affine"
    biasprm="0.4 -3 -0.2" armature="0.01" damping="0.3"/>
  <intvelocity name="i5" tendon="one" kp="5"/>
  <general name="f5" joint="j5" dyntype="filterexact" dynprm="0.2" gainprm="2"/>
  <position name="grip" tendon="split" kp="40" kv="1" gear="2"/>
  <motor name="m1" joint="j1" ctrlrange="-2 3" gear="0.5"/>
</actuator>
<keyframe><key name="k" qpos="0.3 0 0 0 0 0.2 0.1" act="0.35 0.7"
  ctrl="0.4 -0.3 0.2 -0.9 0.8 0 0.7 0.6 0.5"/></keyframe></mujoco>"""
MIMIC_URDF = """<robot name="hand">
  <link name="base"/>{links}
  <joint name="drive" type="continuous"><parent link="base"/><child link="a"/><axis xyz="0 1 0"/></joint>
  <joint name="near" type="continuous"><parent link="a"/><child link="b"/><origin xyz="0.1 0 0"/>
    <axis xyz="0 0.6 0.8"/><mimic joint="drive" multiplier="-1.3" offset="0.2"/></joint>
  <joint name="far" type="prismatic"><parent link="b"/><child link="c"/><origin rpy="0.2 0.3 0"/>
    <axis xyz="1 0 0"/><limit effort="1" velocity="1" lower="-1" upper="1"/>
    <mimic joint="near" multiplier="0.05"/></joint>
</robot>"""


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
    path.write_text(MIMIC_URDF.format(links=links))
    return path
