# SPDX-License-Identifier: Apache-2.0
"""The hand: a spring from the point of a body that was picked to the mouse, as a recorded pull (forces/external.py).

The spring makes the picked point swing at FREQUENCY in its most mobile direction: k = m (2 pi FREQUENCY)^2, with the
effective mass m, the smallest eigenvalue of (J M^-1 J^T)^-1 at the point. So it feels alike on light
and heavy bodies. In scenes with contacts it swings faster where it must, so that the mouse can lift bodies: LIFT of the
size of the mechanism stretches it by the weight of a body. With ctrl it is a spring of torsion about the axis that
turns the body along the mouse. A pull ends HOLD after the last one: a page that hangs lets go.
"""

import math
import threading
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from liegroup_core.forces.external import no_wrenches, set_wrench

FREQUENCY, DAMPING, LIFT = 1.0, 0.7, 0.1  # Hz; part of critical damping; of the size of the mechanism
HOLD = 0.3  # s of simulated time that a pull acts
TURN = 0.25  # of the size of the mechanism: distance of the mouse for one radian
RECENT = 150  # frames in which a pressed body is looked for: 1.5 s of a simulation in real time
SLOW = 0.02  # of the size of the mechanism: a shorter recent path needs no disc
LEAST = 0.1  # cosine of the largest angle between the mouse and the picked point, as the camera sees them
_TURN = np.linspace(0.0, 2.0 * math.pi, 25)[:-1]
DISC = (  # points and triangles, of radius 1, facing z
    np.vstack([np.zeros(3), np.stack([np.cos(_TURN), np.sin(_TURN), 0.0 * _TURN], axis=1)]),
    np.array([[0, 1 + k, 1 + (k + 1) % 24] for k in range(24)]),
)
HEAVIEST = (
    1e-3  # response, as LOCKED, below which the spring is no stiffer: near a dead centre it would be arbitrarily so
)
LOCKED = 1e-9  # response, relative to the largest one of a free body: the point cannot move


class Grip(NamedTuple):
    """What the mouse holds."""

    body: int
    point: np.ndarray  # (3,) m, in the body frame
    tip: np.ndarray  # (3,) m, world axes: the mouse
    axis: np.ndarray | None  # (3,) world axes, of a torque; None: a force
    client: int
    start: np.ndarray = None  # (3,) m, world axes: the picked point when it was pressed
    ahead: np.ndarray = None  # (3,) unit vector, world axes: from the camera to it


class Hand:
    """Mouse of a Page on the bodies of a scene."""

    def __init__(self, page, layout):
        self._page, self._layout = page, layout
        self._grip, self._lock, self.shown, self._discs = None, threading.Lock(), "", {}
        lift = LIFT * layout.size if layout.touching.names else math.inf
        self._omega = max(2.0 * math.pi * FREQUENCY, math.sqrt(math.hypot(*layout.scene.gravity) / lift))
        layout.reactions.warm_up()

    def take_hold(self, drawing):
        """Let the mouse pick the shapes of a Drawing."""
        self._boxes = drawing.boxes
        for i, handles in enumerate(drawing.bodies):
            for handle in handles:
                self._listen(handle, i)

    def _listen(self, handle, body):
        """Take the drags of a node; body: its number, None for one that lies behind all of them."""
        for modifier in (None, "cmd/ctrl"):

            async def dragged(event, modifier=modifier):
                self._move(body, event, modifier is not None)

            handle.on_drag("left", modifier=modifier)(dragged)

    def catch(self):
        """Put a disc that nobody sees behind the recent path of each moving body, for each page; at a low rate.

        A body that moves is somewhere else by the time the browser looks for what was pressed. The disc takes the
        press, and `_grip_at` looks for the body where it was.
        """
        poses, clients = self._recent(), {client.client_id: client for client in self._page.clients()}
        self._discs = {key: discs for key, discs in self._discs.items() if key in clients}
        if not len(poses) or self._page.cursor is not None:
            return
        centres, radii = self._boxes.centres(poses[:: max(1, len(poses) // 10)])
        ahead = centres[0] + (centres[0] - centres[min(1, len(centres) - 1)])  # until the page shows this disc
        low, high = (each(np.concatenate([centres, ahead[None]]), axis=0) for each in (np.min, np.max))
        middle, path = 0.5 * (low + high), 0.5 * np.linalg.norm(high - low, axis=1)
        moves = (path > SLOW * self._boxes.size) & (self._page.source.status().state == "running")
        for key, client in clients.items():
            discs = self._discs.setdefault(key, {})
            for i in np.flatnonzero(moves):
                if i not in discs:
                    discs[i] = client.scene.add_mesh_simple(
                        f"/behind/{i}", *DISC, wireframe=True, opacity=0.0, cast_shadow=False, receive_shadow=False
                    )
                    self._listen(discs[i], None)
            eye = np.array(client.camera.position)
            with client.atomic():
                for i, disc in discs.items():
                    disc.visible = bool(moves[i])
                    if moves[i]:
                        away = (middle[i] - eye) / np.linalg.norm(middle[i] - eye)
                        disc.position, disc.scale = middle[i] + radii[i] * away, 1.2 * float(path[i] + radii[i])
                        disc.wxyz = np.roll(Rotation.align_vectors([-away], [[0.0, 0.0, 1.0]])[0].as_quat(), 1)

    def _recent(self):
        """Poses (m, n, 12) of the last frames, the newest first."""
        frames = self._page.source.history.frames[-RECENT:]
        return np.array([frame.sample.pose for frame in reversed(frames)])

    def _move(self, body, event, is_torque):
        """Take over an event of the mouse; runs in the server's event loop."""
        with self._lock:
            if self._grip is not None and self._grip.client != event.client_id:
                return  # another page holds something already
        past = self._page.cursor is not None
        if past and event.phase == "start":
            why = self._page._panel.blocked or "this is the past: go back to the present to pull at a body"
            self._page.say(why, failed=True)
        if event.phase == "end" or past or self._page.source.frame() is None:
            self.let_go()
            return
        eye, aim = np.array(event.client.camera.position), np.array(event.end_position)
        if not np.isfinite([*eye, *aim]).all():
            return
        along = (aim - eye) / np.linalg.norm(aim - eye)
        with self._lock:
            if event.phase == "start" or self._grip is None:
                poses = self._recent()
                k, body, point = self._boxes.picked(eye, along, poses, body)
                start = poses[k, body, 9:] + poses[k, body, :9].reshape(3, 3) @ point
                self._grip = Grip(body, point, start, None, event.client_id, start, along)
            grip = self._grip
            # The mouse is in the plane of the picked point that faces the camera.
            tip = eye + along * ((grip.start - eye) @ grip.ahead) / max(along @ grip.ahead, LEAST)
            axis = (
                np.cross(eye - grip.start, tip - grip.start) / np.linalg.norm(eye - grip.start) if is_torque else None
            )
            self._grip = grip._replace(tip=tip, axis=axis)

    def hold(self, frame):
        """Pull with the spring; called at the rate of the page."""
        with self._lock:
            grip = self._grip
        if grip is None or frame is None or self._page.cursor is not None:
            return
        found = self.spring(frame.sample, grip)
        name = self._layout.body_names[grip.body]
        if found is None:
            self.shown = f"{name} cannot {'move there' if grip.axis is None else 'turn'}"
            return
        if self._page.attempt(self._page.source.pull, name, found, HOLD, tuple(grip.point)):
            size = self._size_of(frame.sample, grip, found)
            with self._lock:
                is_held = self._grip is not None  # the mouse may have been released meanwhile
                if is_held:
                    self.shown = f"{name}: {size:.3g} {'N m' if grip.axis is not None else 'N'}"
            if not is_held:
                self._release(grip)
        else:
            self.let_go()

    def spring(self, sample, grip):
        """Values (9,) of a pull at a Sample, see commands.py; None if the body cannot move that way."""
        inertia, omega = self._inertia(sample, grip), self._omega
        if inertia is None:
            return None
        stiffness, damping = inertia * omega**2, 2.0 * DAMPING * omega * inertia
        if grip.axis is None:
            return stiffness, damping, *grip.tip.tolist(), 0.0, 0.0, 0.0, 0.0
        return 0.0, 0.0, 0.0, 0.0, 0.0, *(stiffness * grip.axis / (TURN * self._layout.size)).tolist(), damping

    def _size_of(self, sample, grip, values):
        """Magnitude of the force of a pull, N, or of its torque, N m, at a Sample."""
        pose, twist = sample.pose[grip.body], sample.twist[grip.body]
        turn = pose[:9].reshape(3, 3)
        if grip.axis is not None:
            return np.linalg.norm(np.array(values[5:8]) - values[8] * turn @ twist[:3])
        speed = turn @ (twist[3:] + np.cross(twist[:3], grip.point))
        return np.linalg.norm(values[0] * (grip.tip - pose[9:] - turn @ grip.point) - values[1] * speed)

    def _inertia(self, sample, grip):
        """Smallest effective mass of the point, kg, or moment of inertia of the body, kg m^2, over all directions."""
        layout, body = self._layout, self._layout.scene.bodies[grip.body]
        turn = sample.pose[grip.body, :9].reshape(3, 3)
        free = body.mass if grip.axis is None else float(np.linalg.eigvalsh(body.inertia_matrix).max())
        motions = []
        for local in (np.zeros(3), *(free * turn)):
            still = layout.sample(sample.pose, sample.twist, sample.time, near=sample.angles)
            external = no_wrenches(layout.offsets)
            still.acting, still.switching = sample.acting._replace(external=external), sample.switching
            wrench = [*np.cross(grip.point, local), *local] if grip.axis is None else [*local, 0.0, 0.0, 0.0]
            set_wrench(external, grip.body, tuple(map(float, wrench)), "body")
            found = still.accelerations[layout.body_names[grip.body]]
            motions.append(turn @ (found[3:] + np.cross(found[:3], grip.point) if grip.axis is None else found[:3]))
        response = np.array(motions[1:]) - motions[0]
        largest = float(np.linalg.eigvalsh(0.5 * (response + response.T)).max())
        return free / max(largest, HEAVIEST) if largest > LOCKED else None

    def line(self, frame):
        """(picked point, mouse) in world axes, to be drawn, or None."""
        with self._lock:
            grip = self._grip
        if grip is None or frame is None:
            return None
        pose = frame.sample.pose[grip.body]
        return pose[9:] + pose[:9].reshape(3, 3) @ grip.point, grip.tip

    def let_go(self):
        """End what the mouse holds."""
        with self._lock:
            held, self._grip = self._grip, None
        if held is not None:
            self._release(held)

    def _release(self, grip):
        self.shown = ""
        self._page.attempt(self._page.source.release, self._layout.body_names[grip.body])
