# SPDX-License-Identifier: Apache-2.0
"""The hand: a spring from the point of a body that was picked to the mouse, as a recorded wrench.

The spring makes the picked point swing at FREQUENCY in its most mobile direction: k = m (2 pi FREQUENCY)^2, with the
effective mass m, the smallest eigenvalue of (J M^-1 J^T)^-1 at the point. So a force that changes thirty times a second
is stable on light and heavy bodies alike. With ctrl it is a spring of torsion about the axis that
turns the body along the mouse. A force ends HOLD after the last one: a page that hangs lets go.
"""

import math
import threading
from typing import NamedTuple

import numpy as np

from liegroup_core.forces.external import no_wrenches, set_wrench

FREQUENCY, DAMPING = 1.0, 0.7  # Hz; part of critical damping
HOLD = 0.3  # s of simulated time that a force acts
TURN = 0.25  # of the size of the mechanism: distance of the mouse for one radian
LOCKED = 1e-9  # response, relative to the largest one of a free body: the point cannot move


class Grip(NamedTuple):
    """What the mouse holds."""

    body: int
    point: np.ndarray  # (3,) m, in the body frame
    tip: np.ndarray  # (3,) m, world axes: the mouse
    axis: np.ndarray | None  # (3,) world axes, of a torque; None: a force
    client: int


class Hand:
    """Mouse of a Page on the bodies of a scene."""

    def __init__(self, page, layout):
        self._page, self._layout = page, layout
        self._grip, self._lock, self.shown = None, threading.Lock(), ""
        layout.reactions.warm_up()

    def take_hold(self, drawing):
        """Let the mouse pick the shapes of a Drawing."""
        for i, handles in enumerate(drawing.bodies):
            for handle in handles:
                for modifier in (None, "cmd/ctrl"):

                    async def dragged(event, i=i, modifier=modifier):
                        self._move(i, event, modifier is not None)

                    handle.on_drag("left", modifier=modifier)(dragged)

    def _move(self, body, event, is_torque):
        """Take over an event of the mouse; runs in the server's event loop."""
        with self._lock:
            if self._grip is not None and self._grip.client != event.client_id:
                return  # another page holds something already
        frame = self._page.source.frame()
        if event.phase == "end" or frame is None or self._page.cursor is not None:
            with self._lock:
                held, self._grip = self._grip, None
            if held is not None:
                self._release(held)
            return
        start, tip = np.array(event.start_position), np.array(event.end_position)
        if not np.isfinite([*start, *tip]).all():
            return
        with self._lock:
            if event.phase == "start" or self._grip is None:
                pose = frame.sample.pose[body]
                point = pose[:9].reshape(3, 3).T @ (start - pose[9:])
            else:
                point = self._grip.point
            axis = None
            if is_torque:
                towards = np.array(event.client.camera.position) - start
                axis = np.cross(towards / np.linalg.norm(towards), tip - start)
            self._grip = Grip(body, point, tip, axis, event.client_id)

    def hold(self, frame):
        """Apply the wrench of the spring; called at the rate of the page."""
        with self._lock:
            grip = self._grip
        if grip is None or frame is None or self._page.cursor is not None:
            return
        found = self.wrench(frame.sample, grip)
        name = self._layout.body_names[grip.body]
        if found is None:
            self.shown = f"{name} cannot {'move there' if grip.axis is None else 'turn'}"
            return
        force, torque = found
        if self._page.attempt(self._page.source.push, name, (*torque, *force), HOLD, tuple(grip.point)):
            size = np.linalg.norm(torque if grip.axis is not None else force)
            with self._lock:
                is_held = self._grip is not None  # the mouse may have been released meanwhile
                if is_held:
                    self.shown = f"{name}: {size:.3g} {'N m' if grip.axis is not None else 'N'}"
            if not is_held:
                self._release(grip)
        else:
            self.let_go()

    def wrench(self, sample, grip):
        """(force, torque) in world axes of the spring at a Sample; None if the body cannot move that way."""
        pose, twist = sample.pose[grip.body], sample.twist[grip.body]
        turn = pose[:9].reshape(3, 3)
        at = pose[9:] + turn @ grip.point
        if grip.axis is None:
            stretch, rate = grip.tip - at, turn @ (twist[3:] + np.cross(twist[:3], grip.point))
        else:
            stretch, rate = grip.axis / (TURN * self._size), turn @ twist[:3]
        inertia, omega = self._inertia(sample, grip), 2.0 * math.pi * FREQUENCY
        if inertia is None:
            return None
        pull = inertia * (omega**2 * stretch - 2.0 * DAMPING * omega * rate)
        return (pull, np.zeros(3)) if grip.axis is None else (np.zeros(3), pull)

    def _inertia(self, sample, grip):
        """Smallest effective mass of the point, kg, or moment of inertia of the body, kg m^2, over all directions."""
        layout, body = self._layout, self._layout.scene.bodies[grip.body]
        turn = sample.pose[grip.body, :9].reshape(3, 3)
        free = body.mass if grip.axis is None else float(np.linalg.eigvalsh(body.inertia_matrix).max())
        motions = []
        for local in (np.zeros(3), *(free * turn)):
            still = layout.sample(sample.pose, sample.twist, sample.time, near=sample.angles)
            still.wanted, still.motions, still.switching = sample.wanted, sample.motions, sample.switching
            still.external = no_wrenches(layout.offsets)
            wrench = [*np.cross(grip.point, local), *local] if grip.axis is None else [*local, 0.0, 0.0, 0.0]
            set_wrench(still.external, grip.body, tuple(map(float, wrench)), "body")
            found = still.accelerations[layout.body_names[grip.body]]
            motions.append(turn @ (found[3:] + np.cross(found[:3], grip.point) if grip.axis is None else found[:3]))
        response = np.array(motions[1:]) - motions[0]
        largest = float(np.linalg.eigvalsh(0.5 * (response + response.T)).max())
        return free / largest if largest > LOCKED else None

    @property
    def _size(self):
        return self._layout.size

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
