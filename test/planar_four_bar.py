# SPDX-License-Identifier: Apache-2.0
"""Four-bar in its plane, an independent program: Munthe-Kaas RK4 on SE(2)^3.

It shares nothing with the engine. The rows of a joint are those of r_a + R_a p_a - r_b - R_b p_b,
in world axes. The engine's rows are in the child's joint frame: if a joint drifts, the two differ.
"""

import numpy as np

QUARTER = np.array([[0.0, -1.0], [1.0, 0.0]])
# (body or None for the ground, point, body, point) of joints 1 to 4
JOINTS = (
    (None, (0.0, 0.0), 0, (-0.25, 0.0)),
    (0, (0.25, 0.0), 1, (-0.5, 0.0)),
    (1, (0.5, 0.0), 2, (0.5, 0.0)),
    (None, (1.0, 0.0), 2, (-0.5, 0.0)),
)


def turn(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


class PlanarFourBar:
    """q (3, 3): angle, x, y of every bar; V (3, 3): omega and velocity in its axes."""

    def __init__(self, scene):
        self.mass = np.array([[body.inertia[2], body.mass, body.mass] for body in scene.bodies])
        self.q = np.array([(body.rotation_vector[2], *body.position[:2]) for body in scene.bodies])
        self.V = np.array([(body.angular_velocity[2], *body.linear_velocity[:2]) for body in scene.bodies])

    def acceleration(self, q, V):
        """V' out of (6.22)."""
        rows, bias, force = np.zeros((8, 9)), np.zeros(8), np.zeros(9)
        for i, (omega, *v) in enumerate(V):
            force[3 * i + 1 : 3 * i + 3] = -self.mass[i, 1] * omega * (QUARTER @ v)
        for j, (a, p_a, b, p_b) in enumerate(JOINTS):
            at = slice(2 * j, 2 * j + 2)
            for body, point, sign in ((a, p_a, -1.0), (b, p_b, 1.0)):
                if body is not None:
                    omega, v, R = V[body, 0], V[body, 1:], sign * turn(q[body, 0])
                    rows[at, 3 * body] = R @ QUARTER @ point
                    rows[at, 3 * body + 1 : 3 * body + 3] = R
                    bias[at] -= R @ (omega * (QUARTER @ v) - omega**2 * np.array(point))
        K = np.block([[np.diag(self.mass.ravel()), rows.T], [rows, np.zeros((8, 8))]])
        return np.linalg.solve(K, np.concatenate([force, bias]))[:9].reshape(3, 3)

    def step(self, h):
        """One step of the classical Runge-Kutta method in the coordinates of the group."""
        slopes = []
        for a in (0.0, 0.5, 0.5, 1.0):
            phi, change = (a * h * part for part in slopes[-1]) if slopes else np.zeros((2, 3, 3))
            V = self.V + change
            slopes.append((np.array([_dexpinv(-x, v) for x, v in zip(phi, V)]), self.acceleration(self._moved(phi), V)))
        phi, change = (h * sum(w * slope[k] for w, slope in zip((1, 2, 2, 1), slopes)) / 6.0 for k in (0, 1))
        self.q, self.V = self._moved(phi), self.V + change

    def _moved(self, phi):
        q = self.q + phi
        for i, (angle, *shift) in enumerate(phi):
            q[i, 1:] = self.q[i, 1:] + turn(self.q[i, 0]) @ _left_jacobian(angle) @ shift
        return q

    def gaps(self):
        """(4,) m, position residuals of joints 1 to 4."""

        def place(body, point):
            return point if body is None else self.q[body, 1:] + turn(self.q[body, 0]) @ point

        return [np.hypot(*np.subtract(place(a, p_a), place(b, p_b))) for a, p_a, b, p_b in JOINTS]


def _left_jacobian(angle):
    """Integral of the rotations from 0 to angle."""
    if angle == 0.0:
        return np.eye(2)
    return (np.sin(angle) * np.eye(2) + (1.0 - np.cos(angle)) * QUARTER) / angle


def _dexpinv(x, v):
    """dexpinv by its series with Bernoulli numbers; steps rotate by a tenth of a radian."""

    def ad(y):
        return np.array([0.0, *(x[0] * (QUARTER @ y[1:]) - y[0] * (QUARTER @ x[1:]))])

    total, term = v - ad(v) / 2.0, v
    for coefficient in (1 / 12, -1 / 720, 1 / 30240, -1 / 1209600):
        term = ad(ad(term))
        total = total + coefficient * term
    return total
