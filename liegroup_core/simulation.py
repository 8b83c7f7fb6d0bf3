# SPDX-License-Identifier: Apache-2.0
"""Simulation of a scene with a given method and step, or to a given accuracy."""

from typing import Any

from .engine import Engine
from .scene.description import Scene


class Simulation(Engine):
    """Mechanism that is integrated on its Lie group, with a given step or to a given accuracy.

    Takes the arguments of Engine. Instead of method, step, group and stabilisation it takes:

    accuracy : largest error over `horizon`. Selects the configuration from measurements of this
               scene on this machine. Missing measurements are made first, once
               (docs/how-to/choose_accuracy.md)
    horizon  : s; None: chosen for the scene

    `promise` is None, or the accuracy that is guaranteed (study/trade/accuracy.py).
    Raises SceneError for a scene that cannot be simulated, ValueError for a wrong option or a
    method that does not fit the scene.
    """

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
        **options: Any,
    ) -> None:
        if accuracy is None:
            if horizon is not None:
                raise ValueError("horizon requires accuracy")
            super().__init__(
                scene, method, step, group, stabilisation, baumgarte_time, watch, **options
            )
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
