# SPDX-License-Identifier: Apache-2.0
"""Wheels, balls and knife edges: closed forms, the bicycle benchmark, and the independent reference."""

import numpy as np
import pytest
import scipy
from convergence import fitted_order
from scene_files import filled, text_of

from liegroup_core import Simulation
from liegroup_core.errors import SceneError
from liegroup_core.linear import change_along, linearise, trim
from liegroup_core.reference import integrate
from liegroup_core.scene.load import load_scene, scene_from_text
from liegroup_sim_ros.commands.main import main

GRAVITY = 9.81
# Meijaard, Papadopoulos, Ruina and Schwab, Proc. R. Soc. A 463 (2007) 1955, (A 1) to (A 4) and table 2, 14 digits.
M = np.array([[80.81722, 2.31941332208709], [2.31941332208709, 0.29784188199686]])
K0 = np.array([[-80.95, -2.59951685249872], [-2.59951685249872, -0.80329488458618]])
K2 = np.array([[0.0, 76.59734589573222], [0.0, 2.65431523794604]])
C1 = np.array([[0.0, 33.86641391492494], [-0.85035641456978, 1.68540397397560]])
WEAVE, CAPSIZE = 4.29238253634111, 6.02426201538837  # m/s, ends of the range of stable speeds


def scene(text):
    return scene_from_text(text, source="test")


def bicycle(speed):
    text = load_scene("bicycle").text
    for before, after in (
        ("[5, 0, 0]", f"[{speed!r}, 0, 0]"),
        ("16.666666666666668", repr(speed / 0.3)),
        ("14.285714285714286", repr(speed / 0.35)),
    ):
        assert before in text
        text = text.replace(before, after)
    return Simulation(scene(text), "rkmk4", 1e-3, estimate=False, quiet=True)


def lean_and_steer(speed):
    """A (4, 4) of lean and steer and their rates: no other state of a bicycle that runs straight acts on them."""
    system = linearise(bicycle(speed), [], [])
    own = [system.states.index(name) for name in ("frame.rx", "steer", "frame.rx.rate", "steer.rate")]
    others = [k for k in range(10) if k not in own]
    assert len(system.A) == 10 and np.abs(system.A[np.ix_(own, others)]).max() < 1e-9 * np.abs(system.A).max()
    return system.A[np.ix_(own, own)]


def moving_poles(speed):
    return np.sort_complex(np.linalg.eigvals(lean_and_steer(speed)))


@pytest.mark.parametrize("speed", [0.0, 1.0, 3.0, 4.0, 5.0, 7.0, 10.0])
def test_the_poles_of_the_bicycle_are_those_of_the_benchmark(speed):
    """Of the nonlinear scene; published coefficients have 14 digits, a simple pole about 11."""
    A = np.block(
        [
            [np.zeros((2, 2)), np.eye(2)],
            [-np.linalg.solve(M, GRAVITY * K0 + speed**2 * K2), -np.linalg.solve(M, speed * C1)],
        ]
    )
    expected = np.sort_complex(np.linalg.eigvals(A))
    assert np.abs(moving_poles(speed) - expected).max() < 5e-10


@pytest.mark.turn(3)
def test_the_bicycle_has_the_published_poles_and_the_speeds_where_it_becomes_stable():
    published = [-14.07838969279822, -0.77534188219585 - 4.46486771378823j, -0.77534188219585 + 4.46486771378823j]
    assert np.abs(moving_poles(5.0) - [*published, -0.32286642900409]).max() < 5e-10
    weave = scipy.optimize.brentq(lambda v: moving_poles(v)[2].real, 4.2, 4.4, xtol=1e-12)
    capsize = scipy.optimize.brentq(lambda v: np.linalg.det(lean_and_steer(v)), 5.9, 6.2, xtol=1e-12)
    assert weave == pytest.approx(WEAVE, rel=1e-9) and capsize == pytest.approx(CAPSIZE, rel=1e-9)


def test_trim_finds_steady_motions_of_wheels():
    """A bicycle from rest to 5 m/s has the poles there; wheels with constant speeds take a robot along a circle."""
    result = trim(bicycle(0.0), {"frame.x": 5.0})
    assert result.is_steady and result.twist[0, 3] == pytest.approx(5.0, rel=1e-12) and result.residual < 1e-9
    expected = [*moving_poles(5.0), *np.zeros(6)]
    assert np.abs(np.poly(result.system.poles) - np.poly(expected)).max() < 1e-6 * np.abs(np.poly(expected)).max()
    robot = trim(
        Simulation(load_scene("diff_drive")), {"left": 5.0, "right": 4.0}, inputs=["left.effort", "right.effort"]
    )
    forward, turning = 0.1 * (5.0 + 4.0) / 2.0, 0.1 * (4.0 - 5.0) / 0.34
    assert robot.twist[0, 3] == pytest.approx(forward, rel=1e-9) and robot.twist[0, 2] == pytest.approx(
        turning, rel=1e-9
    )
    with pytest.raises(SceneError, match="the rate of frame.x is not independent here"):
        trim(bicycle(0.0), {"hub": 16.0, "frame.x": 5.0})


def test_poles_in_axes_that_spin_are_said_to_change():
    """A wheel that rolls straight: its states are in its own axes. A bicycle and one at rest do not change."""
    text = (
        "name: w\ngravity: [0, 0, -9.81]\nbodies: [{name: w, mass: 2, inertia: [0.05, 0.1, 0.05], "
        "position: [0, 0, 0.3], linear_velocity: [%g, 0, 0], angular_velocity: [0, %g, 0]}]\n"
        "joints: [{name: c, type: wheel, parent: world, "
        "child: w, radius: 0.3, child_frame: {rotation_vector: [-1.5707963267948966, 0, 0]}}]\n"
    )
    changes = []
    for speed in (0.0, 3.0):
        simulation = Simulation(scene_from_text(text % (speed, speed / 0.3), "w"))
        changes.append(change_along(simulation, linearise(simulation, [], [])))
    assert changes[0] == 0.0 and changes[1] > 1.0
    found = trim(simulation, {"w.ry": 10.0})
    assert found.is_steady and found.change == pytest.approx(changes[1], rel=1e-6)
    assert change_along(bicycle(5.0), linearise(bicycle(5.0), [], [])) < 1e-6


def test_a_knife_edge_may_be_where_its_plane_is():
    text = (
        "name: k\ngravity: [0, 0, 0]\nbodies: [{name: b, mass: 2, inertia: [1, 1, 1]}]\njoints: [{name: c, "
        "type: knife_edge, parent: world, child: b, child_frame: {}}]\n"
    )
    assert len(linearise(Simulation(scene_from_text(text, "k"))).A) == 11


def test_a_ball_on_a_turntable_moves_in_a_circle():
    """A solid ball: its centre turns with 2/7 of the table, about a point that follows from its start."""
    omega, radius, mass, start, velocity = 3.0, 0.1, 0.5, np.array([0.4, 0.1]), np.array([0.2, -0.3])
    inertia = 0.4 * mass * radius**2
    # Without slip: v + w x (-r z) = omega z x position.
    slip = np.array([-omega * start[1], omega * start[0]]) - velocity  # = w x (-r z) = (-w_y r, w_x r)
    w = (float(slip[1]) / radius, -float(slip[0]) / radius)
    text = filled(
        text_of("turntable.yaml"),
        omega=omega,
        mass=mass,
        inertia=inertia,
        x=start[0],
        y=start[1],
        radius=radius,
        wx=repr(w[0]),
        wy=repr(w[1]),
        vx=velocity[0],
        vy=velocity[1],
    )
    simulation = Simulation(scene(text), accuracy=1e-9, quiet=True)
    rate = 2.0 / 7.0 * omega
    centre = start + np.array([-velocity[1], velocity[0]]) / rate
    for time in (0.7, 2.0, 7.3):
        simulation.advance_to(time)
        sample = simulation.sample(time)
        c, s = np.cos(rate * time), np.sin(rate * time)
        expected = centre + np.array([[c, -s], [s, c]]) @ (start - centre)
        assert np.abs(sample.pose[1, 9:11] - expected).max() < 1e-8
        assert sample.pose[1, 11] == pytest.approx(radius, abs=1e-13)


def test_a_sleigh_on_a_knife_edge_turns_into_its_straight_course():
    """Chaplygin's sleigh: v = V tanh, omega = W sech, with the edge a distance a behind the centre of mass."""
    mass, inertia, a, v0, w0 = 2.0, 0.3, 0.2, 0.4, 2.0
    text = filled(text_of("sleigh.yaml"), mass=mass, inertia=inertia, w0=w0, v0=v0, vy=a * w0, a=-a)
    simulation = Simulation(scene(text), accuracy=1e-10, quiet=True)
    whole = inertia + mass * a * a
    V = np.sqrt(v0**2 + whole / mass * w0**2)
    kappa = mass * a * V / whole
    since = np.arctanh(v0 / V)
    energy = simulation.energy()
    for time in (0.5, 1.5, 4.0):
        simulation.advance_to(time)
        sample = simulation.sample(time)
        v, w = V * np.tanh(kappa * time + since), V * np.sqrt(mass / whole) / np.cosh(kappa * time + since)
        assert sample.twist[0, 3] == pytest.approx(v, rel=1e-8)
        assert sample.twist[0, 2] == pytest.approx(w, rel=1e-8)
        assert abs(sample.twist[0, 4] - a * sample.twist[0, 2]) < 1e-12
        assert sample.energy == pytest.approx(energy, rel=1e-9)


@pytest.mark.parametrize("lean", [0.2, 0.5, -0.9])
def test_a_disk_rolls_steadily_in_a_circle(lean):
    """A disk whose plane leans by `lean` from the vertical, which turns with W about it: its spin n about its axis.

    Torque about the contact point: (C + m r^2) n W cos(lean) + A W^2 sin(lean) cos(lean) = m g r sin(lean), with the
    velocity n r of the centre along the path in axes that turn with W.
    """
    mass, r, W = 1.0, 0.2, 4.0
    A, C = 0.25 * mass * r**2, 0.5 * mass * r**2
    s, c = np.sin(lean), np.cos(lean)
    n = (mass * GRAVITY * r * s - A * W**2 * s * c) / ((C + mass * r**2) * W * c)
    # Axis a in the world, forward is x: upright it is -y; the disk leans towards +y for positive lean.
    a, forward = np.array([0.0, -c, -s]), np.array([1.0, 0.0, 0.0])
    up = np.cross(a, forward)
    R = np.column_stack([forward, up, a]) if np.linalg.det(np.column_stack([forward, up, a])) > 0 else None
    centre = r * np.cross(a, forward) * (1.0 if np.cross(a, forward)[2] > 0 else -1.0)
    omega = n * a + W * (np.array([0.0, 0.0, 1.0]) - a[2] * a)
    velocity = np.cross(omega, centre)
    vector = scipy.spatial.transform.Rotation.from_matrix(R).as_rotvec()
    w, v = R.T @ omega, R.T @ velocity
    text = filled(
        text_of("disk.yaml"),
        mass=mass,
        a=A,
        c=C,
        centre=centre.tolist(),
        vector=vector.tolist(),
        w=w.tolist(),
        v=v.tolist(),
        r=r,
    )
    simulation = Simulation(scene(text), accuracy=1e-10, quiet=True)
    for time in (0.3, 1.0, 2.0):
        simulation.advance_to(time)
        sample = simulation.sample(time)
        axis = sample.pose[0, [2, 5, 8]]
        spin = sample.pose[0, :9].reshape(3, 3) @ sample.twist[0, :3]
        assert axis[2] == pytest.approx(-s, abs=1e-8)
        assert spin @ axis == pytest.approx(n, rel=1e-7)
        assert np.arctan2(axis[1], axis[0]) == pytest.approx(
            np.angle(np.exp(1j * (np.arctan2(-c, 0.0) + W * time))), abs=1e-7
        )


MIXED = text_of("mixed.yaml")


@pytest.mark.parametrize("name", ["mixed", "bicycle", "diff_drive"])
@pytest.mark.volume(1)
def test_rolling_is_that_of_the_independent_reference(name):
    """On a table that turns and leans, with centres of mass off the contact; a push on the first body."""
    made = scene(MIXED if name == "mixed" else load_scene(name).text.replace("velocity: 0.0", "velocity: 6.0", 1))
    simulation = Simulation(made, accuracy=1e-9, quiet=True)
    pose, twist = simulation.state()
    times = np.array([0.2, 0.6, 1.0])
    exact, _ = integrate(made, pose, twist, times)
    for k, time in enumerate(times):
        simulation.advance_to(time)
        sample = simulation.sample(time)
        assert np.abs(sample.pose[:, :9].reshape(-1, 3, 3) - exact.rotation[k]).max() < 1e-7
        assert np.abs(sample.pose[:, 9:] - exact.position[k]).max() < 1e-7
        assert sample.errors[:, :2].max() < 1e-7


@pytest.mark.parametrize("method, order", [("rkmk2", 2), ("rkmk4", 4), ("rkmk8", 6)])
def test_methods_keep_their_order_and_rows_of_velocities_are_kept(method, order):
    """Errors at the end for three steps; slip and energy with projection, after the same time."""
    made = scene(MIXED)
    sizes, errors = [0.02, 0.01, 0.005], []
    exact = Simulation(made, accuracy=1e-12, quiet=True)
    exact.advance_to(0.4)
    for step in sizes:
        simulation = Simulation(made, method, step, estimate=False, quiet=True)
        simulation.advance_to(0.4)
        errors.append(np.abs(simulation.state()[0] - exact.sample(0.4).pose).max())
    assert fitted_order(sizes, errors) > order - 0.4 or errors[-1] < 1e-11
    kept = Simulation(made, method, 0.005, stabilisation="projection", estimate=False, quiet=True)
    kept.advance_to(0.4)
    assert max(kept.sample().joint_residuals.values()) < 1e-13


def test_a_ball_without_friction_only_keeps_its_height():
    """It slides as a point mass, and spins as before; against the reference, too."""
    made = scene(
        "name: ice\ngravity: [0, 0, -9.81]\nbodies: [{name: b, mass: 2.0, inertia: [0.02, 0.02, 0.02], "
        "position: [0, 0, 0.1], linear_velocity: [1, 0, 0], angular_velocity: [0, 3, 1]}]\njoints: [{name: j, "
        "type: ball_on_plane, parent: world, child: b, child_frame: {}, radius: 0.1, frictionless: true}]\n"
    )
    simulation = Simulation(made, accuracy=1e-9, quiet=True)
    exact, _ = integrate(made, *simulation.state(), np.array([1.0]))
    simulation.advance_to(1.0)
    sample = simulation.sample()
    assert (
        sample.pose[0, 9:] == pytest.approx([1.0, 0.0, 0.1], abs=1e-9)
        and np.abs(sample.pose[0, 9:] - exact.position[0, 0]).max() < 1e-9
    )
    turn = sample.pose[0, :9].reshape(3, 3)
    assert turn @ sample.twist[0, :3] == pytest.approx([0.0, 3.0, 1.0], abs=1e-9)
    assert sample.contacts["j"] == pytest.approx((2.0 * GRAVITY, 0.0), abs=1e-9)


def test_other_methods_say_that_they_do_not_roll():
    for method in ("generalized_alpha", "constrained_rattle"):
        with pytest.raises(ValueError, match="wheels, balls that roll, or knife edges"):
            Simulation(scene(MIXED), method, 1e-3)


def test_a_wheel_that_does_not_touch_or_slips_is_refused():
    with pytest.raises(SceneError, match="place its centre above the plane so that it touches"):
        scene(MIXED.replace("assemble: true\n", ""))
    flat = "name: w\ngravity: [0, 0, -10]\nbodies: [{name: w, mass: 2, inertia: [0.1, 0.1, 0.1]}]\n"
    flat += "joints: [{name: c, type: wheel, parent: world, child: w, radius: 0.3, child_frame: {}%s}]\n"
    with pytest.raises(SceneError, match="the wheel lies flat on its plane"):
        Simulation(scene_from_text(flat % "", "w"))
    with pytest.raises(SceneError, match="mu has no meaning with frictionless: true"):
        scene_from_text(flat % ", frictionless: true, mu: 0.2", "w")


def test_forces_at_contacts_are_those_of_statics_and_beyond_friction_there_is_a_warning(tmp_path, caplog):
    """A robot at rest: the normal forces carry its weight, about the axle and along it. A brake needs friction."""
    made = load_scene("diff_drive")
    contacts = Simulation(made, "rkmk4", 1e-3, quiet=True).sample().contacts
    weight = sum(body.mass for body in made.bodies) * GRAVITY
    arm = (8.0 * 0.04 + 0.1 * 0.15) * GRAVITY
    assert contacts["caster_contact"][0] == pytest.approx(arm / 0.15, rel=1e-12)
    assert sum(normal for normal, _ in contacts.values()) == pytest.approx(weight, rel=1e-12)
    text = made.text.replace("radius: 0.1 ", "radius: 0.1\n    mu: 0.3 ", 1).replace("velocity: 0.0", "velocity: 40.0")
    (tmp_path / "fast.yaml").write_text(text)
    assert main(["run", str(tmp_path / "fast.yaml"), "--duration", "0.1", "--out", str(tmp_path / "a.npz")]) == 0
    (line,) = [record.getMessage() for record in caplog.records if "slip" in record.getMessage()]
    assert "left_contact at t = 0 s: there it would slip" in line
    simulation = Simulation(scene(text), quiet=True)
    normal, along = simulation.sample().contacts["left_contact"]
    # Both motors give 3 N m; the inertia of the wheels and of the caster is carried along.
    acceleration = 2.0 * 3.0 / 0.1 / (9.3 + 2.0 * 0.003 / 0.1**2 + 0.00003 / 0.03**2)
    assert along == pytest.approx(
        (3.0 - 0.003 * acceleration / 0.1) / 0.1, rel=1e-9
    ) and simulation.sample().slipping == ("left_contact",)


@pytest.mark.parametrize("mu", ["", ", mu: 0.5"])
@pytest.mark.parametrize("kind", ["ball_on_plane", "wheel"])
def test_a_contact_that_pulls_gives_a_warning_without_its_friction_too(tmp_path, caplog, kind, mu):
    """A force lifts with 20 N a body of 1 kg, which rolls straight on: the contact needs 9.81 N - 20 N."""
    frame = "" if kind == "ball_on_plane" else "rotation_vector: [-1.5707963267948966, 0, 0]"
    (tmp_path / "pull.yaml").write_text(filled(text_of("pull_rolling.yaml"), kind=kind, frame=frame, mu=mu))
    assert main(["run", str(tmp_path / "pull.yaml"), "--duration", "0.1", "--out", str(tmp_path / "a.npz")]) == 0
    (line,) = [record.getMessage() for record in caplog.records if "lift" in record.getMessage()]
    assert line.startswith("r pulls: it needs -10.19 N normal to the plane at t = 0.05")


@pytest.mark.parametrize("name", ["bicycle", "diff_drive"])
def test_bodies_rest_where_they_touch_the_plane(name):
    """Contact points are on the ground, and the material points there have no velocity, to round-off of 10 m/s."""
    simulation = Simulation(load_scene(name), "rkmk4", 1e-3, stabilisation="projection", quiet=True)
    simulation.advance(100)
    sample = simulation.sample()
    assert sample.contact_points
    for joint in simulation.scene.joints:
        if joint.name not in sample.contact_points:
            continue
        point, pose = sample.contact_points[joint.name], sample.poses[joint.child]
        w, v = np.split(sample.twists[joint.child], 2)
        assert abs(point[2]) < 1e-12
        velocity = pose[:3, :3] @ (v + np.cross(w, pose[:3, :3].T @ (point - pose[:3, 3])))
        assert np.abs(velocity[2:] if joint.frictionless else velocity).max() < 1e-11
