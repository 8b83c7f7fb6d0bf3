# SPDX-License-Identifier: Apache-2.0
"""The live page: its guard, its sources, and what a real browser with a real mouse does with them."""

import asyncio
import contextlib
import importlib.metadata
import io
import math
import shutil
import time
import urllib.error
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from http.cookiejar import CookieJar
from types import SimpleNamespace

import numpy as np
import pytest
from scene_files import text_of
from scipy.spatial.transform import Rotation
from waiting import PATIENCE, wait_for

from liegroup_core import Simulation, load_scene
from liegroup_core.errors import LieGroupSimError
from liegroup_core.forces.external import no_wrenches, set_wrench
from liegroup_core.scene.load import scene_from_text
from liegroup_sim_ros.analysis import analyse
from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.playback.resimulate import resimulate
from liegroup_sim_ros.recording import read_recording

viser = pytest.importorskip("viser")
from liegroup_sim_ros.view import export  # noqa: E402
from liegroup_sim_ros.view import server as servers  # noqa: E402
from liegroup_sim_ros.view.boxes import Boxes, camera_at  # noqa: E402
from liegroup_sim_ros.view.hand import FREQUENCY, Grip, Hand  # noqa: E402
from liegroup_sim_ros.view.local import Local  # noqa: E402
from liegroup_sim_ros.view.page import Page  # noqa: E402
from liegroup_sim_ros.view.recorded import Recorded  # noqa: E402
from liegroup_sim_ros.view.server import close_server, open_server  # noqa: E402
from liegroup_sim_ros.view.source import History  # noqa: E402

CHROMIUM = shutil.which("chromium")
GRAPHICS = "--use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader"
DRAWS = f"--no-sandbox {GRAPHICS} --force-device-scale-factor=0.25".split()
SIZE = {"width": 760, "height": 480}  # of the picture, which processors draw
BLOCK, SLOPE = text_of("block.yaml"), text_of("slope.yaml")
BOX = "box"
CODE = "<img src=x onerror=alert(1)>{x}"  # a text that a page must not take for code


@pytest.fixture(scope="module")
def browser():
    sync_api = pytest.importorskip("playwright.sync_api")
    if CHROMIUM is None:
        pytest.skip("chromium is not installed")
    with sync_api.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=DRAWS)
        yield chromium
        chromium.close()


@pytest.fixture
def opened(browser):
    """Function (Source) -> (Page, the browser's page at it)."""
    pages = []

    def show(source, **options):
        page = Page(source, port=8200, **options)
        page.start()
        shown = browser.new_page(viewport=SIZE)
        pages.append((page, shown))
        shown.set_default_timeout(1e3 * PATIENCE)
        shown.errors = []
        shown.on("pageerror", lambda error: shown.errors.append(str(error)))
        shown.goto(page.address)
        wait_for(page.clients, "page")
        return page, shown

    yield show
    for page, shown in pages:
        assert shown.errors == []
        shown.close()
        page.stop()
        page.source.close()


def pixel(page):
    """Place in the picture of the first body's origin."""
    camera = page.clients()[0].camera
    x, y, z = Rotation.from_quat(np.roll(camera.wxyz, -1)).as_matrix().T @ (
        page.source.frame().sample.rows[0, :3] - camera.position
    )
    scale = 0.5 * SIZE["height"] / math.tan(0.5 * camera.fov)
    return 0.5 * SIZE["width"] + scale * x / z, 0.5 * SIZE["height"] + scale * y / z


def pull(page, shown, across=150, up=-80):
    """Press the mouse on the first body and draw it aside; returns when a wrench acts."""
    page.clients()[0].get_render(height=90, width=160, timeout=PATIENCE)  # the first picture takes seconds

    def press():
        """Draw the mouse from the body once; whether the page has taken it for a pull."""
        x, y = pixel(page)
        shown.mouse.move(x, y)
        shown.mouse.down()
        for k in range(1, 6):
            shown.mouse.move(x + across * k / 5, y + up * k / 5)
            time.sleep(0.06)
        for _ in range(60):
            if page._hand.shown:
                return True
            time.sleep(0.05)
        shown.mouse.up()
        return False

    wait_for(press, "pull of the body")


@pytest.mark.turn(3)
def test_a_scene_is_pulled_by_the_mouse_and_repeats_bit_by_bit(opened, tmp_path):
    """A drag changes the motion as the recorded wrenches say; without them the block would be at rest."""
    path = tmp_path / "pulled.mcap"
    source = Local(Simulation(scene_from_text(BLOCK)), "block", str(path))
    source.tell(0.0, "event", CODE)
    page, shown = opened(source)
    pull(page, shown)
    wait_for(lambda: source.frame().sample.positions[BOX][0:3].any(), "motion")
    shown.mouse.up()
    wait_for(lambda: not page._hand.shown, "release")
    wait_for(lambda: np.linalg.norm(source.frame().sample.positions[BOX]) > 1e-3, "way of the body")
    shown.get_by_role("button", name="Pause").click()
    wait_for(lambda: source.status().state == "paused", "pause")
    stamp = source.server.call("sample").result(PATIENCE).stamp_ns
    wait_for(lambda: round(source.frame().time * 1e9) == stamp, "last frame")
    before = source.frame()
    shown.get_by_role("button", name="Step").click()
    wait_for(lambda: source.frame().time > before.time, "step")
    shown.get_by_role("tab", name="Joints").click()
    shown.get_by_role("button", name="Run").click()
    slider = shown.get_by_role("slider").last
    slider.focus()
    for _ in range(5):
        slider.press("ArrowRight")
    wait_for(lambda: source.frame().sample.acting.targets[0, 0] > 0.0, "command of the slider")
    shown.get_by_role("tab", name="Events").click()
    shown.get_by_text("paused at step").first.wait_for()
    assert shown.get_by_text(CODE).count() and not shown.locator("img[src=x]").count()
    page.stop()
    source.close()
    recording = read_recording(path)
    figures = resimulate(recording)
    assert figures["identical"] == figures["samples"] > 50
    commands = [recording.inputs[k] for k in range(len(recording.inputs))]
    assert {command.source for command in commands} == {f"view/{BOX}"} and len(commands) > 3
    assert analyse(recording, reference=False).figures["pushes"]


@pytest.mark.turn(3)
def test_a_hinge_whose_frame_is_in_its_joint(opened):
    """Its position has no error, its attitude has; its slider ends at its stops."""
    text = BLOCK.replace("  - {name: box, mass: 2, inertia: [0.34, 0.33, 0.32]}\n", "").replace(
        "child_frame:", "limits: {lower: -0.5, upper: 1.2}, child_frame:"
    )
    text = text.replace("position: [3, 0, 0]", "angular_velocity: [0, 0, 0.3]")
    page, _ = opened(Local(Simulation(scene_from_text(text)), "door"))
    slider, plot = page._panel._sliders["hinge"], page._panel._error._plot
    handles = list(page._server.gui._gui_input_handle_from_uuid.values())
    shown = [handle.visible for handle in handles]
    page._panel.block("busy")  # a group of buttons cannot be disabled: it is hidden
    assert all(handle.disabled or not handle.visible for handle in handles)
    page._panel.block("")
    assert [handle.visible for handle in handles] == shown and not any(handle.disabled for handle in handles)
    assert (slider.min, slider.max) == (-0.5, 1.2)
    wait_for(lambda: len(plot.data[1]) > 5 and np.isfinite(plot.data[1][-1]), "estimated error")
    times, found, requested = plot.data[:3]
    frame = next(frame for frame in page.source.history.frames if frame.time == times[-1])
    assert not frame.sample.errors[0, 0] and found[-1] == pytest.approx(np.log10(frame.sample.errors[0, 1]))
    assert requested[-1] == pytest.approx(np.log10(frame.bound[1]))


@pytest.mark.turn(3)
def test_a_recording_plays_goes_back_and_branches(opened, tmp_path):
    path = tmp_path / "run.mcap"
    assert main(["run", "double_pendulum", "--duration", "20", "--out", str(path)]) == 0
    page, shown = opened(Recorded(path))
    wait_for(lambda: page.cursor is not None and page.cursor > 0.2, "playing")
    shown.get_by_role("button", name="Play / pause").click()
    wait_for(lambda: not page.playing, "pause")
    recorded = page.source.history.at(page.cursor).sample
    at = page.cursor = recorded.time  # of a recorded sample
    shown.get_by_role("tab", name="What if").click()
    shown.get_by_role("button", name="Branch from here").click()
    wait_for(lambda: isinstance(page.source, Local) and page.source.frame() is not None, "branch")
    branch = page.source
    assert branch.status().state == "paused"
    # The state itself is exact; a recorded attitude is a quaternion, which rounds.
    assert np.abs(branch.frame().sample.rows - recorded.rows).max() < 1e-14 * np.abs(recorded.rows).max()
    branch.ask(
        "effort",
        "shoulder" if "shoulder" in branch.layout.unit_efforts else next(iter(branch.layout.unit_efforts)),
        5.0,
    )
    shown.get_by_role("button", name="Run").click()
    wait_for(lambda: branch.frame().time > at + 0.5, "motion of the branch")
    frame = branch.frame()
    assert page.other(frame) is not None and page.distance(frame) > 1e-3  # 5 N m for half a second
    shown.get_by_role("tab", name="What if").click()
    page.cursor = at + 0.2
    shown.get_by_role("button", name="Continue with this method").click()
    wait_for(lambda: page.source is not branch, "method")
    other = page.source
    assert other.how == "rkmk4, step 0.001 s" and other.status().state == "paused"
    assert at - 0.01 <= other.frame().time <= at + 0.2
    wait_for(lambda: page.distance(other.frame()) < 1e-9, "the former motion, beside it")
    shown.get_by_role("button", name="Step").click()
    wait_for(lambda: other.frame().sample.time > 0.0 and page.source.history.times, "step")


def test_a_reference_is_shown_beside_a_recording(tmp_path):
    """Its distance is the error that the analysis finds."""
    path = tmp_path / "run.mcap"
    assert main(f"run double_pendulum --method rkmk4 --step 0.02 --duration 1 --out {path}".split()) == 0
    source = Recorded(path)
    history, text = source.reference()
    assert history.times == source.history.times and "reference integration" in text
    apart = [
        np.linalg.norm(one.sample.rows[:, :3] - other.sample.rows[:, :3], axis=1).max()
        for one, other in zip(source.history.frames, history.frames)
    ]
    found = analyse(read_recording(path)).figures["reference"]["position"]["max"]
    assert max(apart) == pytest.approx(found, rel=1e-9) and found > 1e-7


ARM = text_of("arm_view.urdf")


def test_a_robot_with_blanks_in_its_names_is_recorded_read_and_shown(tmp_path):
    """Its limit, damping and friction act, so that modes and an unwrapped angle are recorded."""
    robot, path = tmp_path / "arm.urdf", tmp_path / "run.mcap"
    robot.write_text(ARM)
    assert main(["run", str(robot), "--start", "front shoulder 100%=0.9", "--duration", "0.5", "--out", str(path)]) == 0
    assert main(["analyze", str(path), "--no-reference"]) == 0
    recording, source = read_recording(path), Recorded(path)
    assert recording.joint_modes.names == ("front shoulder 100%",)
    frame = source.dressed(source.history.frames[-1])
    ((position, *_),) = frame.sample.joint_coordinates.values()
    assert frame.sample.angles == pytest.approx([position], abs=1e-12) and abs(position) < 1.0


def test_a_branch_of_a_live_scene_is_at_the_distance_zero():
    """Without another input both motions are the same bit by bit, and the former one is not compared with itself."""
    source = Local(Simulation(load_scene("double_pendulum")), "pendulum", factor=4.0)
    page = Page(source, port=8200)
    try:
        wait_for(lambda: source.frame().time > 3.0 and len(source._marks) > 3, "marks")
        source.ask("pause")
        page.cursor = source._marks[2][0] * 1e-9
        page._panel._branch()
        began = source.frame().time
        source.ask("resume")
        wait_for(lambda: source.frame().time > began + 1.0, "motion")
        source.ask("pause")
        distances = [page.distance(frame) for frame in list(source.history.frames)]
        times = list(source.history.times)
        assert all(math.isnan(d) for t, d in zip(times, distances) if t < began - 1e-6)
        after = [d for t, d in zip(times, distances) if began <= t <= began + 1.0]
        assert max(after) == 0.0 and len(after) > 50
        # Between its frames the former motion is a cubic polynomial.
        frame = source.history.frames[50]
        places = source.history.places(frame.time + 0.004)
        twin = Simulation(load_scene("double_pendulum"), "rkmk8", 1e-3)
        twin.advance(round((frame.time + 0.004) / 1e-3))
        assert np.abs(places - twin.sample().rows[:, :3]).max() < 1e-6
    finally:
        page.stop()
        source.close()


def test_two_recordings_are_compared_at_common_times(tmp_path):
    """The same run with other times of its samples is at the distance zero."""
    paths = [tmp_path / name for name in ("one.mcap", "nine.mcap")]
    for path, every in zip(paths, ("1", "9")):
        assert main(["run", "double_pendulum", "--duration", "2", "--every", every, "--out", str(path)]) == 0
    page = Page(Recorded(paths[0]), port=8200, beside=Recorded(paths[1]))
    try:
        distances = np.array([page.distance(frame) for frame in page.source.history.frames])
        # Steps 0, 9, ... 198, and the last one.
        assert len(distances) == 201 and np.isfinite(distances).sum() == 24
        assert not distances[np.isfinite(distances)].any()
    finally:
        page.stop()


@pytest.mark.parametrize("seconds, longest, least, most", [(0.0, 60.0, 25, 25), (0.5, 4.0, 2, 8)])
@pytest.mark.turn(3)
def test_a_video_has_the_length_of_the_motion(seconds, longest, least, most, tmp_path, monkeypatch):
    """However slowly the browser draws it: a picture takes some `seconds`, the video about `longest`."""
    av = pytest.importorskip("av")
    path = tmp_path / "run.mcap"
    assert main(["run", "double_pendulum", "--duration", "1", "--out", str(path)]) == 0
    page, files, controls = Page(Recorded(path), port=8200), {}, []

    def picture(height, width, **_):
        time.sleep(seconds)
        controls.append([handle.disabled for handle in page._server.gui._gui_input_handle_from_uuid.values()])
        return np.full((height, width, 4), 128, dtype=np.uint8)

    notice = SimpleNamespace(body="", remove=lambda: None)
    client = SimpleNamespace(
        get_render=picture,
        send_file_download=lambda name, data, **_: files.__setitem__(name, data),
        add_notification=lambda *_, **options: notice,
    )
    monkeypatch.setattr(export, "LONGEST", longest)
    try:
        assert export.save_video(page, client) == "video saved"
        assert all(map(all, controls)) and len(controls[0]) > 5 and notice.body.startswith("picture ")
        assert not any(handle.disabled for handle in page._server.gui._gui_input_handle_from_uuid.values())
    finally:
        page.stop()
    with av.open(io.BytesIO(files["view.mp4"])) as file:
        frames = sum(1 for _ in file.decode(video=0))
        assert least <= frames <= most
        assert float(frames / file.streams.video[0].average_rate) == pytest.approx(1.0, rel=0.05)


def test_the_page_of_a_simulation_continues_with_another_method(monkeypatch):
    """Bit by bit as a simulation with this method that starts from the same state."""
    simulation = Simulation(load_scene("heavy_top"))
    simulation.advance(7)
    page = simulation.view(paused=True, port=8200)
    source = page.source
    try:
        with pytest.raises(ValueError, match="method"):
            source.with_method("euler", 1e-3)
        twin = Simulation(simulation.scene, "rkmk2", simulation.step, quiet=True)
        twin.start_from(simulation)
        other = source.with_method("rkmk2", simulation.step)
        try:
            assert np.array_equal(other.frame().sample.pose, simulation.sample().pose)
            other.ask("step", 3)
            wait_for(lambda: other.frame().sample.time > simulation.time, "step")
            twin.advance(3)
            assert np.array_equal(other.server.call("sample").result(PATIENCE).sample.pose, twin.sample().pose)
        finally:
            other.close()
    finally:
        page.close()
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda **_: ())
    with pytest.raises(LieGroupSimError, match="Simulation.view: no installed package has it"):
        simulation.view()


def test_curves_compute_no_value_twice():
    history, computed = History(), []
    for k in range(1000):
        history.add(SimpleNamespace(time=0.1 * k))
    value = lambda frame: computed.append(frame.time) or 2.0 * frame.time  # noqa: E731
    for since in (0.0, 0.0, 0.3, 50.0, 50.0):
        times, values = history.curve(value, since, "twice")
        assert np.array_equal(values, 2.0 * times) and times[0] >= since and 250 <= len(times) <= 500
        assert since > 0.3 or len(computed) == 334  # every third one; without the first one, no other ones


@pytest.mark.turn(3)
def test_a_node_is_shown_pulled_and_paused(opened, client, tmp_path):
    from node_process import DDS, NodeProcess

    from liegroup_sim_ros.view.remote import Remote

    scene, path = tmp_path / "block.yaml", tmp_path / "node.mcap"
    scene.write_text(BLOCK)
    with NodeProcess({"scene": scene, "record": path}), pytest.MonkeyPatch.context() as patch:
        for name, value in DDS.items():
            patch.setenv(name, value)
        client.until(path.exists, "recording")
        source = Remote("/sim_node")
        page, shown = opened(source)
        wait_for(lambda: source.frame() is not None, "frame")
        pull(page, shown)
        wait_for(lambda: np.abs(source.frame().sample.positions["box"]).max() > 1e-3, "motion")
        shown.mouse.up()
        wait_for(lambda: not page._hand.shown, "release")
        source.ask("servo", "hinge", 0.5)
        wait_for(lambda: source.frame().sample.all_efforts["hinge"] > 0.1, "effort")
        found = source.frame().sample
        position, velocity = found.joint_coordinates["hinge"][:2]
        assert found.all_efforts["hinge"] == pytest.approx(4.0 * (0.5 - position) - 3.0 * velocity, rel=1e-12)
        shown.get_by_role("button", name="Pause").click()
        wait_for(lambda: source.status().state == "paused", "pause")
        assert source.ask("resume").startswith("running")
        with pytest.raises(LieGroupSimError, match="unknown"):
            source.ask("restore", "nothing")
        page.cursor = source.history.times[len(source.history.times) // 2]
        received = page.seen().sample
        shown.get_by_role("tab", name="What if").click()
        shown.get_by_role("button", name="Branch from here").click()
        wait_for(lambda: isinstance(page.source, Local), "branch")
        branched = page.source.frame().sample
        assert np.abs(branched.rows - received.rows).max() < 1e-12 and page.source.status().state == "paused"
    recording = read_recording(path)
    figures = resimulate(recording)
    assert figures["identical"] == figures["samples"]
    assert {recording.inputs[k].source for k in range(len(recording.inputs))} == {"service/box/view"}


@pytest.mark.turn(2)
def test_a_node_with_a_contact_is_shown(client, tmp_path):
    """Touching is an event at its time, and at rest the contact carries the weight, also along the slope."""
    from geometry_msgs.msg import WrenchStamped
    from node_process import DDS, NodeProcess, stamp_of

    from liegroup_sim_ros.view.remote import Remote

    scene, weight = tmp_path / "slope.yaml", 2.0 * 9.81
    scene.write_text(SLOPE)
    events, wrenches = client.events("/sim_node"), client.listen("/sim_node/floor/wrench", WrenchStamped)
    with NodeProcess({"scene": scene, "accuracy": 1e-6, "contact_rate": 100.0}), pytest.MonkeyPatch.context() as patch:
        for name, value in DDS.items():
            patch.setenv(name, value)
        client.until(lambda: wrenches, "a wrench")
        source = Remote("/sim_node")
        page = Page(source, port=8200)
        try:
            page.start()
            client.until(lambda: source.frame() is not None and source.frame().time > 2.0, "rest")
            page._drawing._handles.pop("touch0/force", None)
            client.until(lambda: "touch0/force" in page._drawing._handles, "an arrow")
            frame, (begin, tip) = source.frame(), page._drawing._handles["touch0/force"].points[0]
            shown, points = page._drawing._touches[0].visible, page._drawing._points
            places = np.array([handle.position for handle, _ in points.values() if handle.visible])
        finally:
            page.stop()
            source.close()
    first = next(event for event in events if event.name == "contact")
    # It falls across the slope with g cos 0.2; an error of 1e-7 m is one of 1e-7 s at 0.98 m/s.
    fall = math.sqrt(2.0 * 0.05 / (9.81 * math.cos(0.2)))
    assert first.msg.endswith(" s: floor touch") and stamp_of(first) == pytest.approx(1e9 * fall, abs=100.0)
    assert float(first.msg.partition(" ")[0]) == pytest.approx(fall, abs=1e-7)
    # It leans by the moment of the friction over that of its four corners, 0.15 m away, of weight / 1 mm each.
    slope = 0.2 + weight * math.sin(0.2) * 0.05 / (4.0 * 1e3 * weight * 0.15**2)
    force, torque = (getattr(wrenches[-1].wrench, part) for part in ("force", "torque"))
    expected = (-weight * math.sin(slope), 0.0, weight * math.cos(slope))
    assert (force.x, force.y, force.z) == pytest.approx(expected, abs=1e-5)  # of this angle's square, 1e-8
    assert (torque.x, torque.y, torque.z) == pytest.approx((0.0, 0.0, 0.0), abs=1e-5)
    point, found = frame.sample.contact_forces[0]
    assert abs(point @ (math.sin(0.2), 0.0, math.cos(0.2))) < 3e-4  # it sinks 0.25 mm
    assert found == pytest.approx([0.0, 0.0, weight], abs=1e-5)
    assert np.abs(places @ (math.sin(0.2), 0.0, math.cos(0.2))).max() < 1e-3 and len(places) == 4  # corners
    assert shown and not begin.any() and tip == pytest.approx([0.0, 0.0, 2.0 * 0.3], abs=1e-5)


@pytest.mark.parametrize("width, height", [(1280, 800), (390, 844)])
def test_the_camera_stays_above_the_ground_and_follows_for_a_slow_browser(width, height):
    """The browser tells of the library's view, then of that of the start and a former one, after the page has aimed."""
    page = Page(Local(Simulation(scene_from_text(SLOPE), quiet=True), "slope", paused=True), port=8200)
    try:
        camera = SimpleNamespace(image_width=width, image_height=height, position=np.full(3, 3.0), look_at=None)
        shown = SimpleNamespace(client_id=0, camera=camera, atomic=contextlib.nullcontext)
        start, moved = page._server.initial_camera.position, []
        for seen in (None, lambda: np.full(3, 3.0), lambda: start, None, lambda: moved[1]):
            page._framed = tuple(corner + [0.5, 0.0, 0.0] for corner in page._framed)
            camera.position = seen() if seen else camera.position
            page._aim(shown)
            moved.append(camera.position)
        assert (np.diff(moved, axis=0)[:, 0] > 0.1).all() and min(each[2] for each in moved) > 0.1
        camera.position = camera.position + 0.1  # by the user
        page._aim(shown)
        assert page._aimed[0] == "moved"
    finally:
        page.stop()
        page.source.close()


def test_a_time_line_goes_back_to_every_instant_that_was_seen():
    """Also between two states that were kept, and while wrenches act: the state is that of the frame, bit by bit."""
    source = Local(Simulation(load_scene("double_pendulum")), "pendulum", factor=4.0)
    try:
        while source.frame().time < 1.0:
            source.pull("lower", (9, 1, math.sin(20 * source.frame().time), 0.3, 0.1, 0, 0, 0, 0), 0.3, (0.1, 0, 0))
            time.sleep(0.02)
        source.ask("pause")
        assert source._commands
        frames = list(source.history.frames)
        for k in (-2, len(frames) // 2 + 7, 1):
            assert source.ask("back", frames[k].time) == pytest.approx(frames[k].time, abs=1e-12)
            found = source.server.call("sample").result(PATIENCE).sample
            assert np.array_equal(found.pose, frames[k].sample.pose)
            wait_for(lambda k=k: source.history.times[-1] == source.frame().time == frames[k].time, "time")
        with pytest.raises(LieGroupSimError, match="no state was kept"):
            source.ask("back", -1.0)
        with pytest.raises(LieGroupSimError):
            source.ask("place", {next(iter(source.layout.coordinates.names)): math.nan})
        source.ask("reset")
        wait_for(lambda: source.history.times == [0.0] and source.frame().time == 0.0, "reset")
    finally:
        source.close()


@pytest.mark.parametrize("size", [(1400, 900), (390, 844)])
def test_the_camera_shows_a_box_beside_the_panel(size):
    """All corners are inside of the window, and one is at its edge: by the projection of a pinhole."""
    generator, (width, height) = np.random.default_rng(1), size
    slope = np.array([0.7 * width / height, 0.7])
    window = np.array([[-1.0, 0.5], [-1.0, 1.0]] if width > height else [[-1.0, 1.0], [0.2, 1.0]])
    for _ in range(50):
        low, edges, ahead = generator.normal(size=3), generator.uniform(0.01, 3.0, 3), generator.normal(size=3)
        ahead /= np.linalg.norm(ahead)
        position, at = camera_at(low, low + edges, ahead, np.array([0.0, 0.0, 1.0]), slope, window)
        forward = (at - position) / np.linalg.norm(at - position)
        right = np.cross(forward, (0.0, 0.0, 1.0))
        axes = np.array([right / np.linalg.norm(right), np.cross(right / np.linalg.norm(right), forward), forward])
        corners = low + edges * np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, -1).T
        x, y, depth = axes @ (corners - position).T
        seen = np.array([x, y]).T / depth[:, None] / slope
        assert depth.min() > 0.0
        room = np.concatenate([seen - window[:, 0], window[:, 1] - seen])
        assert room.min() == pytest.approx(0.0, abs=1e-9) or depth.min() < 0.1 * edges.max()


def test_the_mouse_picks_where_a_body_was():
    """A box that flies along x is found by a ray through its place of 0.3 s ago."""
    layout = Simulation(scene_from_text(BLOCK)).layout
    boxes, poses = Boxes(layout, {}), np.tile([body.ravel() for body in np.zeros((2, 12))], (40, 1, 1))
    poses[:, :, [0, 4, 8]] = 1.0
    poses[:, 0, 9] = -5.0 * np.arange(40) * 0.01  # 5 m/s; the newest instant first, 0.01 s apart
    poses[:, 1, 9] = 50.0
    edge = 0.5 * math.sqrt(6.0 * (0.33 + 0.32 - 0.34) / 2.0)  # of the homogeneous box
    k, body, point = boxes.picked(np.array([-1.5, -9.0, 0.0]), np.array([0.0, 1.0, 0.0]), poses)
    # It is met since its end, with the room for thin bodies, passed this place.
    assert body == 0 and poses[k, 0, 9] == pytest.approx(-1.5 + edge, abs=0.05 + 0.01 * boxes.size)
    assert np.abs(point).max() <= edge * 1.1
    assert boxes.picked(np.array([-1.5, -9.0, 0.0]), np.array([0.0, 1.0, 0.0]), poses, body=1)[1] == 1


@pytest.mark.parametrize(
    "name, body", [("double_pendulum", 1), ("four_bar", 1), ("heavy_top", 0), ("free_body", 0), ("slope", 0)]
)
@pytest.mark.turn(3)
def test_the_hand_pulls_with_the_stated_frequency(name, body):
    """The acceleration of the picked point along the most mobile direction is (2 pi f)^2 times the stretch.

    With a contact, the weight of a free body stretches it by a tenth of the mechanism at the most.
    """

    class Nowhere:
        source, cursor = None, None

    simulation = Simulation(scene_from_text(SLOPE) if name == "slope" else load_scene(name))
    hand, sample = Hand(Nowhere, simulation.layout), simulation.sample()
    point = np.array([0.01, 0.02, 0.03])
    pose, scene = sample.pose[body], simulation.scene
    turn, label = pose[:9].reshape(3, 3), simulation.layout.body_names[body]
    at = pose[9:] + turn @ point
    # Response of the point to forces at its place, one axis at a time.
    response = np.empty((3, 3))
    before = _acceleration(scene, label, point, np.zeros(3))
    for k, unit in enumerate(np.eye(3)):
        response[:, k] = _acceleration(scene, label, point, unit) - before
    values, vectors = np.linalg.eigh(0.5 * (response + response.T))
    stretch = 0.1 * vectors[:, -1]
    rate = turn @ (sample.twist[body, 3:] + np.cross(sample.twist[body, :3], point))
    omega = 2.0 * math.pi * FREQUENCY
    if name == "slope":
        omega = max(omega, math.sqrt(9.81 / (0.1 * simulation.layout.size)))
    k, c, *to = hand.spring(sample, Grip(body, point, at + stretch, None, 0))
    force, torque = k * (np.array(to[:3]) - at) - c * rate, np.array(to[3:])
    expected = (omega**2 * stretch - 1.4 * omega * rate) / values[-1]
    assert force == pytest.approx(expected, rel=1e-6, abs=1e-9 * np.abs(expected).max()) and not torque.any()


def _acceleration(scene, label, point, force):
    """Acceleration of a point of a body under a force in world axes, world axes."""
    simulation = Simulation(scene, "rkmk4", 1e-3)
    sample, body = simulation.sample(), simulation.layout.body_names.index(label)
    turn = sample.pose[body, :9].reshape(3, 3)
    local = turn.T @ force
    sample.acting = sample.acting._replace(external=no_wrenches(simulation.layout.offsets))
    set_wrench(sample.acting.external, body, (*np.cross(point, local), *local), "body")
    found = sample.accelerations[label]
    return turn @ (found[3:] + np.cross(found[:3], point))


def answer(address, data=None, **headers):
    """Status of a request."""
    try:
        with urllib.request.urlopen(urllib.request.Request(address, data, headers)) as response:
            return response.status
    except urllib.error.HTTPError as error:
        return error.code


def accepts(*arguments, **options):
    """Result of `_socket`, in a thread of its own: the browser's library has an event loop in this one."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(lambda: asyncio.run(_socket(*arguments, **options))).result()


async def _socket(address, origin, send=None):
    """Whether a WebSocket is accepted from an origin; send: bytes that are sent then."""
    import websockets

    protocol = f"viser-v{viser.__version__}"
    try:
        async with websockets.connect(address.replace("http", "ws"), origin=origin, subprotocols=[protocol]) as found:
            await found.recv()
            if send is not None:
                await found.send(send)
                await asyncio.wait_for(found.wait_closed(), PATIENCE)
            return True
    except websockets.exceptions.InvalidStatus:
        return False


def test_the_page_is_for_this_machine_and_this_origin_only():
    server, address = open_server("127.0.0.1", 8300, "x")
    try:
        port = server.get_port()
        assert address == f"http://127.0.0.1:{port}" and answer(address) == 200
        assert answer(address, Host="evil.example") == 403  # a name that points here
        assert answer(f"{address}/../../etc/passwd") == 404
        assert {answer(f"{address}/{'x' * count}") for count in (201, 5000, 9000, 10**6)} == {414}
        assert {answer(address, data) for data in (b"", b"x", bytes(10**6))} == {405}
        assert answer(address, Cookie="x" * 9000) == answer(address, X="y" * 9000) == 400
        for origin, accepted in ((address, True), ("http://evil.example", False), (None, False), ("null", False)):
            assert accepts(address, origin) is accepted
        # Nonsense ends its own connection, nothing else.
        assert accepts(address, address, send=b"\x00nonsense")
        assert accepts(address, address)
        kinds = {message.__name__ for message in server._websock_server._incoming_handlers}
        assert "ShareUrlRequest" not in kinds  # no tunnel to the outside
    finally:
        close_server(server)


def test_other_machines_need_the_token(monkeypatch):
    monkeypatch.setattr(servers, "MOST_CLIENTS", 0)
    server, address = open_server("0.0.0.0", 8300, "x")
    try:
        bare = address.partition("/?")[0]
        assert answer(bare) == answer(f"{bare}/?token=guess") == 403
        keeping = urllib.request.build_opener(urllib.request.HTTPCookieProcessor(CookieJar()))
        with keeping.open(address) as response:
            assert response.status == 200 and "token" not in response.url
        assert not accepts(bare, bare)
    finally:
        close_server(server)


def test_a_host_of_another_machine_is_refused_in_one_line(capsys):
    assert main(["view", "free_body", "--host", "192.0.2.1", "--no-browser"]) == 2
    assert "give an address of this machine" in capsys.readouterr().err


def test_what_is_framed_shrinks_when_bodies_come_back_and_has_shapes_of_contacts():
    """It is kept while bodies move by little, holds all of them, and is at most LARGEST times as large as they need."""
    shape = "{type: box, size: [0.1, 0.2, 0.4]}"
    scene = scene_from_text(
        "{name: a, gravity: [0, 0, -9.81], bodies: [{name: foot, mass: 1, inertia: [0.3, 0.3, 0.3]}],"
        f"forces: [{{name: floor, type: contact, body: foot, sinks: 1.0e-4, restitution: 0.5, shape: {shape}}}]}}"
    )
    page = Page(Local(Simulation(scene, quiet=True), "foot", paused=True), port=8200)
    page.stop()
    boxes = page._drawing.boxes  # of the shape of the contact: the inertia is that of an edge of 1.3 m
    np.testing.assert_allclose(boxes.halves, [[0.05, 0.1, 0.2]], rtol=1e-6)
    near = np.array([[*np.eye(3).ravel(), 0.0, 0.0, 0.3]])
    far = near + 100.0 * np.eye(12)[9]
    both = np.stack([near, far])
    start = boxes.framed(near)
    large = boxes.framed(both, start)
    assert (large[0] <= start[0]).all() and large[1][0] > 100.0
    back = boxes.framed(near, large)
    size = np.linalg.norm(back[1] - back[0])
    assert np.linalg.norm(start[1] - start[0]) <= size < 4.0 * boxes.size
    assert boxes.framed(near + 0.1 * boxes.size * np.eye(12)[9], back) is back
