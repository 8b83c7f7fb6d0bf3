# SPDX-License-Identifier: Apache-2.0
"""The HTML report of `liegroup_sim analyze` in a browser: animation, layout, hostile names."""

import json
import re

import numpy as np
import pytest
from browser import CHROMIUM, Browser
from made_run import PACING, PAIR, record
from rclpy.serialization import deserialize_message
from scene_files import text_of
from visualization_msgs.msg import MarkerArray

from liegroup_core import Simulation, load_scene
from liegroup_core.fields import values
from liegroup_core.layout import make_layout
from liegroup_core.scene.load import scene_from_text
from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.messages import markers
from liegroup_sim_ros.messages.touching import radius
from liegroup_sim_ros.recording.read import read_recording
from liegroup_sim_ros.report.shapes import decoded, with_contacts

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
DARK_CARD, LIGHT_CARD = "rgb(29, 33, 39)", "rgb(255, 255, 255)"
# As text of a name: what would run a script where it is taken for HTML, in a script, an attribute
# or a label of a plot.
HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)>\"'&amp;<b>%{x}"


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    browser = Browser(tmp_path_factory.mktemp("browser"))
    yield browser
    browser.close()


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """Folder with reports of one recording, of a comparison, and of several recordings."""
    folder = tmp_path_factory.mktemp("pages")
    scene = load_scene("double_pendulum")
    second = scene.bodies[1].name
    pushes = [(200, (second, (0, 0, 0, 0, 5.0, 0))), (300, (second, (0,) * 6))]
    on_time = PACING | {"overruns": 0}
    one = record(folder / "one.mcap", scene, 1000, 1e-3, pushes=pushes, pacing=on_time)
    other = record(folder / "other.mcap", scene, 1000, 1e-3)
    (folder / "bad.mcap").write_bytes(b"no log")
    assert main(["analyze", str(one), "--html", str(folder / "one.html")]) == 0
    assert main(["analyze", str(one), "--html", str(folder / "compared.html"), "--compare", str(other)]) == 0
    assert (
        main(
            [
                "analyze",
                str(folder / "*.mcap"),
                "--html",
                str(folder / "many.html"),
                *"--no-reference --max-drift 1e-12".split(),
            ]
        )
        == 2
    )
    return folder


def opened(browser, page, **look):
    """Open a page; assert that it sends no requests and raises no errors."""
    browser.open(page, **look)
    assert browser.run("document.querySelectorAll('details').forEach(d => d.open = true)") is None
    browser.run("new Promise(done => setTimeout(done, 50))")
    assert browser.errors == [] and browser.dialogs == []
    assert browser.requests == [f"file://{page}"]


@pytest.mark.turn(2)
def test_a_report_shows_the_ground_and_the_force_of_a_contact(browser, tmp_path):
    """Without a force in the fall; at rest the arrow is vertical, and begins in the drawn plane."""
    (tmp_path / "slope.yaml").write_text(text_of("slope.yaml"))
    run = ["run", str(tmp_path / "slope.yaml"), "--accuracy", "1e-6", "--duration", "2"]
    assert main([*run, "--out", str(tmp_path / "slope.mcap")]) == 0
    assert main(["analyze", str(tmp_path / "slope.mcap"), "--no-reference", "--html", str(tmp_path / "a.html")]) == 0
    opened(browser, tmp_path / "a.html")
    code = (
        "(f => { const s = document.querySelector('input'); s.value = f * s.max; s.dispatchEvent(new Event('input'));"
        " const d = views[0].plot.data, a = d.find(t => t.name === 'contact force');"
        " const p = d.findLast(t => t.type === 'mesh3d');"
        " return [[a.x, a.y, a.z], p.type, [p.x, p.y, p.z]]; })"
    )
    assert browser.run(f"{code}(0)")[0] == [[], [], []]
    arrow, kind, plane = browser.run(f"{code}(1)")
    start, tip = np.array([axis[:2] for axis in arrow], dtype=float).T
    assert kind == "mesh3d" and tip[2] - start[2] > 0.1 and tip[:2] == pytest.approx(start[:2], abs=1e-3)
    normal = np.array([np.sin(0.2), 0.0, np.cos(0.2)])
    assert normal @ plane == pytest.approx(0.0, abs=1e-9) and abs(normal @ start) < 1e-3  # it sinks by 0.25 mm


@pytest.mark.turn(2)
def test_slider_and_plots_control_the_animation(browser, pages, capsys):
    """The slider sets the recorded poses; a wrench is red; a click on a plot sets the time."""
    opened(browser, pages / "one.html")
    recording, bodies = read_recording(pages / "one.mcap"), load_scene("double_pendulum").bodies
    second = bodies[1].name
    count, times = browser.run("[views[0].motion.times.length, [...views[0].motion.times]]")
    assert count == 101 and times == pytest.approx(recording.pose[second].time, abs=1e-12)
    for k in (0, 25, 100):
        browser.run(
            f"(s => {{ s.value = {k}; s.dispatchEvent(new Event('input')); }})(document.querySelector('input'))"
        )
        drawn = browser.run(
            "(() => { const v = views[0], d = v.plot.data, m = d.find(t => t.type === 'mesh3d'),"
            " j = d.find(t => t.mode === 'markers'); return {mesh: [m.x, m.y, m.z], joints: [j.x, j.y, j.z],"
            " owner: v.motion.layers[0].points.map(p => p[0]), red: m.facecolor, faces: v.motion.layers[0].faces.map("
            "f => f[0]), text: document.querySelector('output').textContent}; })()"
        )
        mesh, owner = np.array(drawn["mesh"]).T, np.array(drawn["owner"])
        for i, (body, track) in enumerate(recording.pose.items()):
            # The middle of a solid about its centre; poses are kept as float32 of some metres.
            centre = track.position[k] + turned(track.quaternion[k], bodies[i].com)
            assert mesh[owner == i].mean(axis=0) == pytest.approx(centre, abs=2e-6)
        assert drawn["text"] == f"{k * 0.01:.3f} s"
        red = {i for i, colour in zip(drawn["faces"], drawn["red"]) if colour == "#d63a3a"}
        assert red == ({1} if k == 25 else set())
        if k == 0:
            place = np.array(drawn["joints"]).T
    assert np.abs(np.array(drawn["joints"]).T[0] - place[0]).max() < 1e-6  # fixed in the world
    assert np.abs(np.array(drawn["joints"]).T[1] - place[1]).max() > 1e-2
    browser.run("document.querySelector('.plane').emit('plotly_click', {points: [{x: 0.4}]})")
    assert browser.run("[views[0].frame, document.querySelector('.cursor').style.display]") == [40, "block"]
    browser.run("document.querySelector('.controls button').click()")
    went = browser.run(
        "new Promise(done => { const look = () => views[0].frame > 42 ? "
        "done([views[0].playing, "
        "document.querySelector('.controls button').textContent]) : "
        "setTimeout(look, 20); look(); })"
    )
    assert went == [True, "Pause"]
    browser.run("document.querySelector('.controls button').click()")
    assert browser.run("views[0].playing") is False and browser.errors == []


@pytest.mark.turn(3)
def test_joints_are_chosen_and_axes_have_numbers(browser, pages):
    """A button hides a joint in all its plots, also after a change of the theme; every axis has tick labels."""
    opened(browser, pages / "one.html")
    shown = (
        "[...document.querySelectorAll('.plane')].filter(p => p.data.some(t => t.name === 'elbow')).map("
        "p => p.data.filter(t => t._input ? t._input.visible : t.visible).map(t => t.name))"
    )
    assert browser.run(shown) == [["shoulder", "elbow"]] * 2  # positions and velocities
    press = "[...document.querySelectorAll('.chips button')].find(b => b.textContent === '{}').click()"
    browser.run(press.format("elbow"))
    assert browser.run(shown) == [["shoulder"]] * 2
    browser.look(1280, 900, dark=True)
    browser.run("new Promise(done => setTimeout(done, 300))")
    assert browser.run(shown) == [["shoulder"]] * 2
    browser.run(press.format("all"))
    assert browser.run(shown) == [["shoulder", "elbow"]] * 2
    assert browser.run("[...document.querySelectorAll('.chips button')].map(b => b.ariaPressed)")[:2] == ["true"] * 2
    labels = browser.run(
        "[...document.querySelectorAll('.plane')].map(p => ['x', 'y'].map(a => "
        "[...p.querySelectorAll(`.${a}tick text`)].filter(t => t.textContent).length))"
    )
    assert len(labels) >= 7 and min(min(pair) for pair in labels) >= 2


@pytest.mark.turn(3)
def test_the_motion_fills_its_card(browser, pages):
    """The box of the axes, seen by a pinhole camera with plotly's field of view of 45 degrees, in a wide window."""
    opened(browser, pages / "one.html")
    scene = browser.run(
        "(s => ({eye: s.camera.eye, centre: s.camera.center, box: s.aspectratio}))(views[0].plot.layout.scene)"
    )
    eye, centre, box = (np.array([part[axis] for axis in "xyz"]) for part in scene.values())
    width, height = browser.run("(p => [p.clientWidth, p.clientHeight])(views[0].plot)")
    to = (centre - eye) / np.linalg.norm(centre - eye)
    right = np.cross(to, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(to, [0.0, 0.0, 1.0]))
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * box - eye
    seen = [corners @ side / (corners @ to) / np.tan(np.pi / 8) for side in (right, np.cross(right, to))]
    across, up = np.abs(seen[0]).max() * height / width, np.abs(seen[1]).max()
    assert max(across, up) <= 1.0 and max(across, up) > 0.75  # the rest is for the labels


def turned(quaternion, vector):
    axis, w = np.array(quaternion[:3]), quaternion[3]
    return vector + 2.0 * np.cross(axis, np.cross(axis, vector) + w * np.array(vector))


@pytest.mark.turn(3)
def test_layout_on_a_phone(browser, pages):
    """Nothing exceeds 360 px, plots follow the window width, touching a plot scrolls the page."""

    def right():
        return browser.run(
            "Math.max(document.documentElement.scrollWidth, ...[...document.querySelectorAll("
            "'.main-svg, .card, .tiles > div, canvas')].map("
            "e => e.getBoundingClientRect().right))"
        )

    opened(browser, pages / "compared.html")
    assert browser.run("document.querySelectorAll('.plane .main-svg').length") >= 8
    assert right() > 1000
    browser.look(360, 740)
    browser.run("new Promise(done => setTimeout(done, 600))")
    assert right() <= 360
    browser.open(pages / "many.html", width=360, height=740, phone=True)
    browser.run("document.querySelectorAll('.logs a')[1].click()")
    browser.run("new Promise(done => setTimeout(done, 300))")
    assert browser.run("[...document.querySelectorAll('details.log')].map(d => d.open)") == [False, True, False]
    assert browser.errors == [] and len(browser.requests) == 1
    assert right() <= 360
    assert "drift" in browser.run("document.querySelector('p.bad').textContent")
    # All that is wrong with any of them is said at the top, and counted.
    said = browser.run("[...document.querySelectorAll('main > ul.bad > li')].map(e => e.textContent)")
    assert "✗ " + str(len(said)) in browser.run("document.querySelector('.state').textContent")
    assert said.count("bad.mcap: not an MCAP file") == 1 < len(said)
    x, y = browser.run(
        "(() => { const p = document.querySelector('.plane .nsewdrag'); "
        "p.scrollIntoView({block: 'center'}); const r = p.getBoundingClientRect();"
        " return [r.x + r.width / 2, r.y + r.height / 2]; })()"
    )
    before = browser.run("scrollY")
    browser.drag(x, y, -150)
    assert browser.run("scrollY") > before + 100


@pytest.mark.turn(3)
def test_the_verdict_is_green_yellow_or_red(browser, pages):
    """The run of one.mcap missed no deadline, that of other.mcap two, and bad.mcap cannot be read."""
    grades = []
    for page in ("one", "many"):
        browser.open(pages / f"{page}.html")
        grades.append(browser.run("document.querySelector('.state').className"))
    assert grades == ["state good", "state bad"]
    assert main(["analyze", str(pages / "other.mcap"), "--html", str(pages / "other.html"), "--no-reference"]) == 0
    browser.open(pages / "other.html")
    assert browser.run("document.querySelector('.state').className") == "state warn"
    assert browser.run("document.querySelector('ul.warn').textContent") == "2 deadline misses of 100 ticks"


@pytest.mark.turn(3)
def test_light_and_dark_themes(browser, pages):
    """Colours of page and plots, also after a theme change while the page is open."""
    look = (
        "[getComputedStyle(document.querySelector('.card')).backgroundColor, "
        "document.querySelector('.plane')._fullLayout.font.color, "
        "document.querySelector('.plane').data[0].line.color, "
        "views[0].plot._fullLayout.scene.xaxis.gridcolor]"
    )
    dark = [DARK_CARD, "#e6e9ee", "#5b9cf5", "#363d46"]
    opened(browser, pages / "one.html", dark=True)
    assert browser.run(look) == dark
    browser.look(1280, 900)
    browser.run("new Promise(done => setTimeout(done, 300))")
    assert browser.run(look) == [LIGHT_CARD, "#1b1f24", "#2a6fd6", "#d8dde3"]
    browser.look(1280, 900, dark=True)
    browser.run("new Promise(done => setTimeout(done, 300))")
    assert browser.run(look) == dark


@pytest.mark.turn(3)
def test_hostile_names_are_shown_and_never_executed(browser, tmp_path, monkeypatch):
    """Names of bodies, joints, files and the scene, and all its texts."""
    monkeypatch.setattr(values, "_NAME", re.compile(r"[\s\S]*"))
    name = json.dumps(HOSTILE)
    text = (
        PAIR.replace("name: pair", f"name: {name}")
        .replace("left", name)
        .replace("<script>alert(1)</script> & more", HOSTILE.replace('"', '\\"'))
    )
    text += (
        f"joints:\n  - {{name: {json.dumps('j' + HOSTILE)}, type: spherical, parent: world, "
        f"parent_frame: {{position: [0, 0, 0]}}, child: {name}}}\n"
    )
    folder = tmp_path / "<"
    folder.mkdir()
    pushes = [(50, (HOSTILE, (0, 0, 1.0, 0, 0, 0))), (80, (HOSTILE, (0,) * 6))]
    log = record(folder / "script><script>alert(3)<b>.mcap", scene_from_text(text), 200, pushes=pushes)
    page = tmp_path / "a.html"
    assert main(["analyze", str(log), "--no-reference", "--html", str(page), "--compare", str(log)]) == 0
    opened(browser, page)
    shown = browser.run("document.body.innerText")
    assert browser.run("document.querySelector('h1').textContent") == HOSTILE
    assert browser.run(
        "[...document.querySelectorAll('.tables td')].map(t => t.textContent)"
        f".join().includes({json.dumps('constraint residual of j' + HOSTILE)})"
    )
    assert shown.count("alert(1)") >= 4 and "</script>" in shown and str(log) in shown
    # In the legend of a plot, as text.
    assert HOSTILE in browser.run("[...document.querySelectorAll('.legendtext')].map(t => t.textContent).join()")
    assert browser.run("document.querySelectorAll('main script, main img, main b b').length") == 0
    several = tmp_path / "b.html"
    monkeypatch.setattr("os.cpu_count", lambda: 1)  # other processes know nothing of the patch
    assert main(["analyze", str(log), str(log), "--no-reference", "--html", str(several)]) == 0
    browser.open(several)
    assert browser.run("document.querySelector('.logs a').textContent") == str(log)
    assert browser.errors == [] and browser.dialogs == [] and len(browser.requests) == 1
    # And were a script to come in, it could neither run nor tell anybody.
    assert (
        browser.run(
            "(() => { const s = document.createElement('script'); s.textContent = "
            "'window.ran = 1'; document.body.append(s); return window.ran; })()"
        )
        is None
    )
    assert browser.run("fetch('https://example.org').then(() => 'sent', () => 'refused')") == "refused"


SHAPES = {  # a contact shape, and its volume in m^3
    "{type: sphere, radius: 0.1}": 4 / 3 * np.pi * 1e-3,
    "{type: capsule, radius: 0.1, length: 0.3, axis: [1, 0, 0]}": np.pi * 0.01 * 0.3 + 4 / 3 * np.pi * 1e-3,
    "{type: cylinder, radius: 0.1, length: 0.3, position: [0, 0, 0.2]}": np.pi * 0.01 * 0.3,
    "{type: box, size: [0.1, 0.2, 0.3]}": 0.006,
    "{type: hull, points: [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]}": 1 / 6,
}


@pytest.mark.parametrize("shape", SHAPES)
def test_a_body_without_a_shape_is_drawn_by_that_of_its_contact(shape):
    """Its outline has the volume of the shape, but for the facets; and the point of contact is seen below a ball.

    The markers of the node have its extent along the axes of the body, and triangles of a hull are seen from outside.
    """
    scene = scene_from_text(
        "{name: a, gravity: [0, 0, -9.81], bodies: [{name: foot, mass: 1, inertia: [0.3, 0.3, 0.3]}],"
        f"forces: [{{name: floor, type: contact, body: foot, sinks: 1.0e-4, restitution: 0.5, shape: {shape}}}]}}"
    )
    (drawn,) = with_contacts({}, scene)["foot"]
    points, faces = decoded(drawn)
    ends = points[faces].astype(float) - points.mean(axis=0)
    volume = np.linalg.det(ends).sum() / 6.0  # of triangles that are seen from outside
    # With an angle a = 2 pi / 32 between points, circles lack a^2 / 6 of their area. Chords across are a^2 / 12 of the
    # radius below the surface in the mean, so that a ball lacks a^2 / 4 of its volume.
    assert volume == pytest.approx(SHAPES[shape], rel=(1.0 / 6.0 + 1.0 / 4.0) * (2.0 * np.pi / 32) ** 2)
    encoded = markers.Markers(make_layout(scene), "world", 1.0).encode(0, Simulation(scene, quiet=True).sample())
    body = deserialize_message(encoded, MarkerArray).markers[0]
    assert len(body.points) == (3 * len(faces) if "hull" in shape else 0)
    ends = []
    for _, kind, size, pose, corners, _ in markers.drawn(scene):
        reach, turn = 0.5 * np.array(size), np.abs(pose[:3, :3])
        if kind == markers.TRIANGLES:
            assert np.linalg.det(corners.reshape(-1, 3, 3)).sum() / 6.0 == pytest.approx(volume)
            ends += [corners.min(axis=0), corners.max(axis=0)]
            continue
        if kind == markers.CUBE:
            reach = turn @ reach
        elif kind == markers.CYLINDER:
            reach = turn[:, 2] * reach[2] + np.sqrt(1.0 - turn[:, 2] ** 2) * reach[0]
        ends += [pose[:3, 3] - reach, pose[:3, 3] + reach]
    # Points are float32.
    np.testing.assert_allclose([np.min(ends, axis=0), np.max(ends, axis=0)], [points.min(0), points.max(0)], atol=1e-7)
    lowest = points[:, 2].min()
    assert drawn["at"][2] - 0.5 * drawn["size"][2] == pytest.approx(lowest, abs=1e-6)
    ball = scene.forces[0].shapes[0]
    if ball.type in ("sphere", "capsule"):
        # Seen from 25 degrees above, the ball ends R below its centre, the octahedron (R + r) cos(25 degrees).
        assert (ball.radius + radius(scene, 0.2, 1.0)) * np.cos(np.radians(25.0)) > 1.1 * ball.radius
