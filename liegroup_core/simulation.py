# SPDX-License-Identifier: Apache-2.0
"""Simulation of a scene with a given method and step, or to a given accuracy."""

import math
from typing import Any

from .engine import Engine
from .observables.sample import Sample
from .running_error import RunningError
from .scene.description import Scene


class Simulation(Engine):
    """Mechanism that is integrated on its Lie group, with a given step or to a given accuracy.

    Takes the arguments of Engine. Instead of method, step, group and stabilisation it takes:

    accuracy : largest error over `horizon`. Selects the configuration from measurements of this
               scene on this machine. Missing measurements are made first, once
               (docs/how-to/choose_accuracy.md)
    horizon  : s; None: chosen for the scene

    estimate : True: carry a running estimate of the global error (running_error.py), at about 1.8
               times the cost: `sample().error`, `predictable_until`

    `promise` is None, or the accuracy that is guaranteed (study/trade/accuracy.py).
    Raises SceneError for a scene that cannot be simulated, ValueError for a wrong option or a
    method that does not fit the scene.
    """

    _running = None  # RunningError

    def __init__(
        self,
        scene: Scene,
        method: str | None = None,
        step: float | None = None,
        group: str = "auto",
        stabilisation: str = "none",
        baumgarte_time: float | None = None,
        accuracy: float | None = None,
        horizon: float | None = None,
        watch: bool = True,
        estimate: bool = False,
        **options: Any,
    ) -> None:
        if accuracy is None:
            if horizon is not None:
                raise ValueError("horizon requires accuracy")
            super().__init__(
                scene, method, step, group, stabilisation, baumgarte_time, watch, **options
            )
            self._running = RunningError(self) if estimate else None
            return
        if not isinstance(scene, Scene):
            raise ValueError(
                f"expected a Scene, got {scene!r}; use load_scene to read one from a file"
            )
        if (method, step, group, stabilisation, baumgarte_time, options) != (
            None,
            None,
            "auto",
            "none",
            None,
            {},
        ):
            raise ValueError(
                "accuracy cannot be combined with method, step, group, stabilisation or their "
                "options: remove them"
            )
        from .study.trade.accuracy import choose  # slow to import, and only needed here

        choice = choose(scene, accuracy, horizon)
        super().__init__(scene, watch=watch, **choice.settings)
        self.promise = choice.promise
        self._running = RunningError(self) if estimate else None

    @property
    def predictable_until(self) -> float:
        """Simulated time in s at which the estimated error became large; inf: not yet.

        Large: a tenth of the mechanism's size, or 0.1 rad. NaN without an estimate.
        """
        return math.nan if self._running is None else self._running.predictable_until

    def sample(self) -> Sample:
        """Create a Sample of the present state, with the estimated errors if they are carried."""
        sample = super().sample()
        if self._running is not None:
            sample.errors = self._running.errors()
        return sample

    def set_state(self, *state, **more) -> None:
        """As Engine.set_state; the estimate of the error starts again from zero."""
        super().set_state(*state, **more)
        if self._running is not None:
            self._running.restart()

    def _change_wrenches(self, time, changed):
        count = len(self._applied)
        super()._change_wrenches(time, changed)
        if self._running is not None:
            self._running.changed(self._applied[count:])

    def _advance(self, steps):
        if self._running is None:
            super()._advance(steps)
            return
        end = self.steps + steps
        self._running.follow()
        while True:
            super()._advance(self._running.next_stop(self.steps, end) - self.steps)
            self._running.follow()
            if self.steps >= end:
                return
