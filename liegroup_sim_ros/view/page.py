# SPDX-License-Identifier: Apache-2.0
"""The page: draws the frames of a source, shows its figures, and passes on what the user commands."""

import logging
import math
import threading
import time

import numpy as np

from liegroup_core.errors import LieGroupSimError
from liegroup_sim_ros.messages.touching import planes
from liegroup_sim_ros.report.shapes import robot_shapes, shapes_from, with_contacts

from .boxes import camera_at
from .drawing import Drawing, Look
from .hand import Hand
from .panel import Panel
from .server import close_server, open_server
from .source import SAME

log = logging.getLogger("liegroup_core")

FRAMES, FIGURES = 30.0, 5.0  # Hz, at which motion and figures are drawn
ALOFT = (1.1, -1.3, 0.7)  # direction from the mechanism to the camera at the start
# Pixels: a page from this width on has the panel at its right, else at the bottom; the panel's width with its margin;
# and the part of a page's height that a panel at the bottom leaves.
WIDE, PANEL, LEFT = 576, 340, 0.4
STEEPER = 0.55  # tangent by which a camera looks down more into the upper part of a page: it stays above the ground
SEEN = 200  # instants of a recording that the camera frames
FIELD = math.radians(75.0)  # viewing angle of the camera, vertical
LATE = 50  # views, ten seconds of them, that a slow browser may tell of late
SAME_VIEW = 1e-3  # of the mechanism: a camera that is elsewhere was moved by the user
SKY, EARTH, BRIGHT = (255, 255, 255), (140, 140, 140), 2.2  # light from above and below
MOST_TRIANGLES = 200_000  # of all visuals; they are sent once
FLOOR = 4.0  # size of the grid, relative to the mechanism


class Page:
    """Page of a Source, in threads of its own from `start` on.

    host, port : of the server, see server.open_server
    beside     : Source drawn as a ghost at the same time, and the curve of its distance, or None
    robot      : path of the robot file of the scene of a recording or a node, for its visuals, or None

    address    : of the page
    Raises ViewError
    """

    def __init__(self, source, host="127.0.0.1", port=8090, beside=None, robot=None):
        self.source, self._shapes, remarks = source, {}, []
        scene = source.layout.scene
        if robot is not None:
            recording = getattr(source, "recording", None)
            self._shapes, remarks = shapes_from(
                robot, scene, recording and recording.settings.get("robot"), MOST_TRIANGLES
            )
        elif scene.robot is not None:
            self._shapes, remarks = robot_shapes(scene.robot, MOST_TRIANGLES)
        self._shapes = with_contacts(self._shapes, scene)
        for remark in remarks:
            source.tell(0.0, "shapes", remark)
        self._server, self.address = open_server(host, port, source.title)
        try:
            self._make(beside)
        except Exception:
            close_server(self._server)
            raise

    def _make(self, beside):
        source = self.source
        self._doing, self._stopping = threading.RLock(), threading.Event()
        self.look, self.ghost_shift, self._ghost, self._ghost_history = Look(), 0.0, None, None
        self._ghost_since, self._meets = -math.inf, False
        self.cursor, self.playing, self.play_speed = None, not source.is_live, 1.0  # cursor: s, None: the newest frame
        self._drawing = Drawing(self._server, source.layout, self._shapes)
        frame = source.frame()
        if frame is not None and frame.bound:
            # A halo of a tenth to the whole of the mechanism's size is the requested accuracy.
            power = math.floor(math.log10(self._drawing.size / frame.bound[0]))
            self.look = self.look._replace(magnification=10.0**power)
        self._set_the_scene()
        self._hand = Hand(self, source.layout) if "push" in source.takes else None
        if self._hand:
            self._hand.take_hold(self._drawing)
        self._panel = Panel(self, self._server.gui)
        if beside is not None:
            self.haunt(beside.history, 0.0)
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)

    def start(self):
        """Draw from now on."""
        self._thread.start()

    def stop(self):
        """End the page; the source continues."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(5.0)
        if self._hand:
            self._hand.let_go()
        close_server(self._server)

    def clients(self):
        """Handles of the pages that are open."""
        return list(self._server.get_clients().values())

    def attempt(self, action, *arguments):
        """Carry out an action of the user; a refusal is shown. Returns whether it succeeded."""
        try:
            text = action(*arguments)
        except (LieGroupSimError, ValueError) as error:
            self.say(str(error), failed=True)
            return False
        if isinstance(text, str) and text:
            self.say(text)
        return True

    def say(self, text, failed=False):
        """Show one line, and keep it among the events."""
        self._panel.note(text, failed)
        if failed:
            for client in self.clients():
                client.add_notification("Refused", text, color="red", auto_close_seconds=8.0)

    def haunt(self, history, shift, since=-math.inf):
        """Draw another motion as a ghost.

        history : its History; None ends it
        shift   : s, from its time to that of the source
        since   : s, time of the source from which it is another motion
        """
        with self._doing:
            if self._ghost is not None:
                self._ghost.remove()
            self._ghost_history, self.ghost_shift, self._ghost_since, self._ghost = history, shift, since, None
            if history is not None:
                self._ghost = Drawing(self._server, self.source.layout, self._shapes, ghost=True)
                own = self.source.history.times
                # Between common times an interpolation would be seen as a distance.
                self._meets = not self.source.polled and (not own or any(history.has(t - shift) for t in own))
            self._panel.has_changed = True

    def other(self, frame):
        """ViewFrame of the ghost at the time of a frame, or None."""
        return self._ghost_history.at(frame.time - self.ghost_shift + SAME) if self._has_other(frame) else None

    def distance(self, frame):
        """Largest distance of a body from that of the ghost at the time of a frame, m, or NaN."""
        at = frame.time - self.ghost_shift
        if not self._has_other(frame) or self._meets and not self._ghost_history.has(at):
            return math.nan
        places = self._ghost_history.places(at)
        return float(np.linalg.norm(frame.sample.rows[:, :3] - places, axis=1).max())

    def _has_other(self, frame):
        history = self._ghost_history
        if history is None or not history.times or frame.time < self._ghost_since - SAME:
            return False
        first, last = history.span()
        return first - SAME <= frame.time - self.ghost_shift <= last + SAME

    def exchange(self, source):
        """Continue with another source of the same scene, a branch."""
        with self._doing:
            before, self.source = self.source, source
            self.cursor, self.playing = None, False
            if self._hand is None and "push" in source.takes:
                self._hand = Hand(self, source.layout)
                self._hand.take_hold(self._drawing)
            self._panel.rebuild()
        if before.is_live:
            before.close()

    def go_on(self, command, *arguments):
        """Let the source run, pause or step, and look at the present."""
        self.cursor = None
        self.attempt(self.source.tell_by_event, command, *arguments)

    def seen(self):
        """The ViewFrame that is shown, or None before the first one."""
        if self.cursor is None:
            return self.source.frame()
        return self.source.history.at(self.cursor) if self.source.history.times else None

    def _run(self):
        next_frame, next_figures, shown, before = time.monotonic(), 0.0, None, time.monotonic()
        while not self._stopping.wait(max(0.0, next_frame - time.monotonic())):
            now = time.monotonic()
            next_frame = max(next_frame + 1.0 / FRAMES, now)
            try:
                self._play(now - before)
                frame = self.source.frame()
                if self.source.polled and frame is not None:
                    self.source.history.add(frame)
                frame = self.seen()
                if frame is not None and (frame is not shown or self._panel.has_changed):
                    self._panel.has_changed = False
                    self._draw(frame, shown)
                    shown = frame
                if now >= next_figures:
                    next_figures = now + 1.0 / FIGURES
                    if frame is not None:
                        self._follow(frame)
                    if self._hand:
                        self._hand.catch()
                    with self._doing:
                        self._panel.update(frame)
                if self._hand:
                    self._hand.hold(frame)
            except Exception:  # a page that fails must not end what it shows
                if self._stopping.is_set():
                    return
                log.exception("the page could not draw a frame")
                next_frame = now + 1.0
            before = now

    def _play(self, seconds):
        """Move the cursor of a recording, or of a live source that is looked back at."""
        if not self.playing or self.source.history.times == []:
            return
        first, last = self.source.history.span()
        at = (first if self.cursor is None else self.cursor) + seconds * self.play_speed
        if at > last:
            at, self.playing = (first, True) if self._panel.repeats else (last, False)
        self.cursor = at

    def _draw(self, frame, before):
        if before is not None and not -SAME <= frame.time - before.time <= 1.0:
            self._drawing.forget_trace()
        frame = self.source.dressed(frame)
        with self._doing:
            self._drawing.show(frame, self.look, self._hand.line(frame) if self._hand else None)
            if self._ghost is not None:
                other = self.other(frame)
                self._ghost.hide(other is None)
                if other is not None:
                    self._ghost.show(other, self.look)

    def _set_the_scene(self):
        """Ground, direction of up, camera."""
        layout, server = self.source.layout, self._server
        size = self._drawing.size
        gravity = np.array(layout.scene.gravity)
        up = -gravity / np.linalg.norm(gravity) if gravity.any() else np.array([0.0, 0.0, 1.0])
        server.scene.set_up_direction(tuple(up))
        middle = self._drawing.middle
        lowest = middle @ up - 0.6 * size
        cell = 10.0 ** math.floor(math.log10(size))
        plane = {0: "yz", 1: "xz", 2: "xy"}[int(np.abs(up).argmax())]
        ground = up * min(0.0, lowest) if abs(lowest) < 5.0 * size else up * lowest
        if not planes(layout.scene, middle):
            server.scene.add_grid(
                "/ground", FLOOR * size, FLOOR * size, plane=plane, cell_size=0.5 * cell, section_size=cell,
                position=tuple(middle - up * (middle @ up) + ground), plane_opacity=0.0,
            )  # fmt: skip
        # The library's environment map takes twice as long to the first picture without a GPU.
        server.scene.configure_environment_map(hdri=None)
        server.scene.add_light_hemisphere("/light", sky_color=SKY, ground_color=EARTH, intensity=BRIGHT)
        ahead = np.array(ALOFT) if plane == "xy" else np.roll(ALOFT, 1 if plane == "yz" else 2)
        self._view, self._framed, self._aimed = (ahead / np.linalg.norm(ahead), up), None, {}
        frames = self.source.history.frames
        for frame in frames if self.source.is_live else frames[:: -(-len(frames) // SEEN)]:
            self._framed = self._drawing.boxes.framed(frame.sample.pose, self._framed)
        if self._framed is None:
            self._framed = middle - 0.5 * size, middle + 0.5 * size
        self._drawing.show_planes(*self._framed)
        camera = server.initial_camera
        camera.fov, camera.near, camera.far = FIELD, 1e-3 * size, 1e3 * size
        camera.position, camera.look_at = self._camera(1400, 900)
        server.on_client_connect(self._aim)

    def _camera(self, width, height):
        """(position, point that it looks at) of a camera that shows the mechanism beside the panel, pixels."""
        window = ((-1.0, 1.0 - 2.0 * PANEL / width), (-1.0, 1.0)) if width >= WIDE else ((-1, 1), (1 - 2 * LEFT, 1))
        slope, (ahead, up) = math.tan(0.5 * FIELD), self._view
        if width < WIDE:
            ahead = (ahead + STEEPER * up) / np.linalg.norm(ahead + STEEPER * up)
        return camera_at(*self._framed, ahead, up, (slope * width / height, slope), window)

    def _aim(self, client):
        """Let a client show what is framed, unless its user has moved the camera."""
        camera, aimed = client.camera, self._aimed.get(client.client_id)
        width, height = camera.image_width, camera.image_height
        if aimed == "moved" or not width or not height:
            return
        found = self._camera(width, height)
        # A slow browser still tells of the library's view, that of the page's start, or of former ones.
        known = aimed[1] if aimed else (camera.position, self._server.initial_camera.position)
        if aimed is not None:
            is_same = lambda other: np.abs(np.subtract(camera.position, other)).max() < SAME_VIEW * self._drawing.size  # noqa: E731
            if not any(is_same(position) for position in known):
                self._aimed[client.client_id] = "moved"
                return
            if aimed[0] == (width, height, *found[0]):
                return
        self._aimed[client.client_id] = (width, height, *found[0]), (*known[:2], *known[2:][-LATE:], found[0])
        with client.atomic():
            camera.position, camera.look_at = found

    def _follow(self, frame):
        """Frame the mechanism anew where it leaves the picture."""
        before, self._framed = self._framed, self._drawing.boxes.framed(frame.sample.pose, self._framed)
        if self._framed is not before:
            self._drawing.show_planes(*self._framed)
        for client in self.clients():
            self._aim(client)
