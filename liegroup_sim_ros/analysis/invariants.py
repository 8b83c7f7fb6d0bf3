# SPDX-License-Identifier: Apache-2.0
"""Conserved quantities of a run: drift of energy and momentum, and constraint residuals."""

import numpy as np

from liegroup_core.mechanism.symmetry import conserved_momentum
from liegroup_core.observables.invariants import momentum_values

from .drift import MOST_POINTS, Drift, thinned

SHOWN = 4  # names of forces or joints in a text


class Energy:
    """Energy drift in J: the largest change within intervals without an applied wrench.

    drift_J is None for a scene with non-conservative forces, driven joints, stops or friction. The
    relative drift refers to the largest kinetic energy, which does not depend on the zero of the potential
    energy.
    """

    def __init__(self, layout, expected):
        self._bodies = layout.body_names
        forces = [force.name for force in layout.scene.forces if not force.is_conservative]
        self._doing_work = [
            f"{what}: {', '.join(names[:SHOWN])}" + (f" and {len(names) - SHOWN} more" if len(names) > SHOWN else "")
            for what, names in (
                ("non-conservative forces", forces),
                ("driven joints", list(layout.motions)),
                ("stops and friction", [switch.name for switch in layout.switches]),
            )
            if names
        ]
        self._drift = Drift(1, self._bodies, expected)
        self._kinetic = 0.0

    def add(self, block, energies, kinetic):
        """Add the energies (k,) in J of a Block."""
        self._kinetic = float(np.maximum(self._kinetic, kinetic.max()))  # propagates NaN
        if not self._doing_work:
            self._drift.add(block, energies[:, None])

    def figures(self, motion):
        """Figures, the entry "energy" of config/analysis.schema.json."""
        drift = self._drift
        drift.close()
        kept = drift.intervals > 0
        worst = float(drift.worst[0]) if kept else None
        return {
            "drift_J": worst,
            "final_J": float(drift.final[0]) if kept else None,
            "trend_W": float(drift.trend[0]) if kept else None,
            "trend_explains": float(drift.explained[0]) if kept else None,
            "largest_kinetic_J": self._kinetic,
            "relative_drift": worst / self._kinetic if kept and self._kinetic > 0.0 else None,
            "intervals": drift.intervals,
            "seconds": drift.seconds,
            "left_out": "; ".join(self._doing_work) if self._doing_work else _pushed_text(motion, self._bodies),
        }


class Momentum:
    """Drift of each conserved momentum component in intervals without a wrench on its bodies."""

    def __init__(self, scene, expected):
        self._scene = scene
        self._kept = [
            (
                conserved,
                Drift(len(conserved.labels), conserved.bodies, expected),
                np.zeros(len(conserved.labels)),
                np.zeros(2),
            )
            for conserved in conserved_momentum(scene)
        ]

    def add(self, block):
        """Add a Block."""
        for conserved, drift, largest, scale in self._kept:
            values = momentum_values(self._scene, conserved, block.rotation, block.position, block.twist)
            np.maximum(largest, np.abs(values).max(axis=0), out=largest)
            np.maximum(scale, self._scale(conserved, block), out=scale)
            drift.add(block, values)

    def _scale(self, conserved, block):
        """Sums of the magnitudes of the bodies' momenta, to which drifts are relative.

        returns (angular N m s, linear N s), upper bounds
        """
        angular = linear = 0.0
        about = np.zeros(3) if conserved.point is None else conserved.point
        for i, body in enumerate(self._scene.bodies):
            if body.name in conserved.bodies:
                twist = block.twist[:, i]
                momentum = body.mass * np.linalg.norm(twist[:, 3:], axis=1)
                arm = np.linalg.norm(block.position[:, i] - about, axis=1)
                linear = linear + momentum
                angular = angular + arm * momentum + np.linalg.norm(twist[:, :3] @ body.inertia_matrix, axis=1)
        return np.max(angular), np.max(linear)

    def figures(self, motion):
        """(list of figures, one per component; [(times, change)] of each)."""
        figures, curves = [], []
        for conserved, drift, largest, scale in self._kept:
            drift.close()
            evaluated = drift.intervals > 0
            for k, (label, unit) in enumerate(zip(conserved.labels, conserved.units)):
                size = float(scale[0 if unit == "N m s" else 1])
                figures.append(
                    {
                        "component": label,
                        "bodies": list(conserved.bodies),
                        "unit": unit,
                        "drift": float(drift.worst[k]) if evaluated else None,
                        "relative_drift": float(drift.worst[k]) / size if evaluated and size > 0.0 else None,
                        "trend_per_s": float(drift.trend[k]) if evaluated else None,
                        "trend_explains": float(drift.explained[k]) if evaluated else None,
                        "largest": float(largest[k]),
                        "intervals": drift.intervals,
                        "seconds": drift.seconds,
                        "left_out": _pushed_text(motion, conserved.bodies),
                    }
                )
                curves.append(drift.curves[k])
        return figures, curves


class Joints:
    """Largest position residual of each joint, in m, or as the norm of its parts in m and rad; of curved couplings."""

    def __init__(self, layout, expected):
        self._layout, joints = layout, [joint.name for joint in layout.scene.joints]
        turning = {
            owner for owner, rows in zip(layout.owners, layout.row_names) if any(row.startswith("w") for row in rows)
        }
        units = ["m, rad" if j in turning else "m" for j in range(len(joints))]
        gaps = layout.coordinates.gap_units
        self._names, self._units = [*joints, *gaps], [*units, *gaps.values()]
        self._every = -(-expected // MOST_POINTS)
        self._largest = np.full(len(self._names), -1.0)
        self._at = np.zeros(len(self._names))
        self._final = None
        self._samples, self._curves = 0, {}

    def add(self, block, residual, angles):
        """Add the residuals (k, joints) of a Block, with the angles (k, t) of its torsional springs, rad."""
        if not self._names:
            return
        if self._layout.coordinates.gap_units:
            states = zip(*self._layout.offsets.to_centres(block.pose, block.twist), angles)
            gaps = [self._layout.coordinates.gaps(*state) for state in states]
            residual = np.hstack([residual, np.abs(gaps)])
        times = block.log_times
        rows = residual.argmax(axis=0)
        values = residual[rows, np.arange(len(rows))]
        worse = ~(values <= self._largest)  # True also for NaN
        self._at[worse] = times[rows[worse]]
        self._largest = np.maximum(self._largest, values)
        self._final = residual[-1].copy()
        self._samples += len(times)
        self._curves.setdefault(id(block.stretch), []).append(
            tuple(part.copy() for part in thinned(times, residual.max(axis=1), self._every))
        )

    def figures(self):
        """({joint: figures}, number of samples, [(times, largest residual of all joints)])."""
        figures = {
            name: {
                "largest": float(self._largest[j]),
                "unit": self._units[j],
                "at_s": float(self._at[j]),
                "final": float(self._final[j]),
            }
            for j, name in enumerate(self._names)
        }
        curves = [tuple(np.concatenate(part) for part in zip(*parts)) for parts in self._curves.values()]
        return figures, self._samples, curves


def _pushed_text(motion, bodies):
    """Text with the time excluded because of applied wrenches; None if no wrench was applied."""
    seconds = sum(stretch.seconds - stretch.free_seconds(bodies) for stretch in motion.stretches)
    return f"{seconds:.4g} s with an applied wrench" if seconds > 1e-12 else None
