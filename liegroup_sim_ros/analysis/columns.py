# SPDX-License-Identifier: Apache-2.0
"""Columns of the Catalogue along a recorded run."""

import numpy as np

from .acting import ActingInputs, sample_of

MOST_NUMBERS, LEAST_TIMES, MOST_TIMES = 48_000, 200, 1000  # of all curves; of one


def columns_along(layout, motion, names, most=None):
    """(times (m,) s of the recording, Columns, values (m, k)); gaps (NaN) between stretches.

    most : largest number of times; None: as a plot needs
    Raises SceneError for an unknown name.
    """
    columns, stretches = layout.catalogue.columns(names), motion.stretches
    most = most or min(MOST_TIMES, max(LEAST_TIMES, MOST_NUMBERS // max(1, len(columns))))
    every = max(1, -(-sum(len(stretch.steps) for stretch in stretches) // most))
    acting, times, values = ActingInputs(layout, stretches[0].step), [], []
    for stretch in stretches:
        states = _States(layout, stretch, slice(None, None, every), acting)
        times += [stretch.log_times[::every], [np.nan]]
        values += [columns.of_states(states, np.arange(len(times[-2]))), np.full((1, len(columns)), np.nan)]
    return np.concatenate(times)[:-1], columns, np.concatenate(values)[:-1]


class _States:
    """Kept samples of a Stretch as Columns.of_states takes them, with what acts."""

    def __init__(self, layout, stretch, rows, acting):
        self._layout, self._stretch, self._acting, self._samples = layout, stretch, acting, {}
        self._rows = range(*rows.indices(len(stretch.steps)))
        rotation = stretch.rotation[rows].reshape(len(self._rows), -1, 9)
        self.bodies = np.concatenate([rotation, stretch.position[rows]], axis=2), stretch.twist[rows]

    @property
    def joints(self):
        """(m, j, 2) positions and velocities of the joints with one coordinate."""
        found = [list(self.sample(k).joint_coordinates.values()) for k in range(len(self._rows))]
        return np.reshape(found, (len(self._rows), -1, 2))

    def sample(self, k):
        """Sample with what acts at its time, and its estimated errors."""
        if k not in self._samples:
            stretch, row = self._stretch, self._rows[k]
            sample = self._samples[k] = sample_of(self._layout, stretch, row)
            self._acting.complete(sample, stretch)
            sample.errors = None if stretch.errors is None else stretch.errors[row]
        return self._samples[k]
