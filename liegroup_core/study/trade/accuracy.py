# SPDX-License-Identifier: Apache-2.0
"""A setting for an accuracy, from what was measured of the scene on this machine.

    choice = choose(load_scene("heavy_top"), 1e-6)
    simulation = choice.simulation()

The accuracy is promised over a horizon, without wrenches from outside: docs/how-to/choose_accuracy.md says what it
means. What is not known yet is measured first, in this process, and kept.
"""

import logging
from dataclasses import dataclass

from liegroup_core.engine import Engine
from liegroup_core.errors import LieGroupSimError, SimulationError
from liegroup_core.integrators.methods import is_positive

from .configurations import SHORTLIST
from .trade import BUDGET, Trade

log = logging.getLogger("liegroup_core")

# Of a core, what the integration may take where real time is asked for: messages, recording and
# what else the machine does need the rest.
SHARE = 0.5


class AccuracyError(LieGroupSimError, ValueError):
    """An accuracy that cannot be had; one line of text that says which one can."""


@dataclass(frozen=True)
class Choice:
    """What an accuracy is kept with.

    settings : arguments of Simulation
    promise  : {accuracy, horizon s, length m, error, cost_us, cpu, reference}, JSON types
    """

    scene: object
    settings: dict
    promise: dict

    def simulation(self):
        """Simulation with these settings; its `promise` is this one."""
        simulation = Engine(self.scene, **self.settings)
        simulation.promise = self.promise
        return simulation

    def __str__(self):
        return (
            f"accuracy {self.promise['accuracy']:g} over {self.promise['horizon']:g} s: "
            f"{_shown(self.settings)}, measured error {self.promise['error']:.2g}, "
            f"{self.promise['cost_us'] * 1e-6:.2g} s of CPU time per simulated second"
        )


def choose(scene, accuracy, horizon=None, usable=lambda step: True, factor=None, tell=log.warning):
    """Choice of the cheapest setting that keeps an accuracy; measures the scene when need be.

    scene    : Scene
    accuracy : largest error, see docs/how-to/choose_accuracy.md; positions in parts of the scene's length, rad
    horizon  : s, over which it is kept; None: what suits the scene
    usable   : function of a step in s, whether it may be chosen
    factor   : simulated seconds per second that must be had; None or 0: any
    tell     : function that is told, once, that something is measured, and how long it took
    raises AccuracyError, SceneError, ValueError
    """
    if not (is_positive(accuracy) and accuracy <= 1.0):
        raise AccuracyError(
            f"the accuracy must be a number above 0 and at most 1, got {accuracy!r}"
        )
    try:
        trade = measured(scene, horizon, tell)
    except SimulationError as error:
        raise AccuracyError(f"no accuracy can be promised for {scene.name}: {error}") from None

    def fits(cell):
        return usable(cell["step"])

    def in_time(cell):
        return fits(cell) and (not factor or cell["cost_us"] * 1e-6 * factor <= SHARE)

    cell = trade.cheapest(accuracy, in_time)
    if cell is None:
        raise AccuracyError(_refusal(trade, accuracy, fits, in_time, factor))
    settings = {key: cell[key] for key in ("method", "step", "group", "stabilisation")}
    return Choice(
        scene,
        settings | cell["options"],
        {
            "accuracy": float(accuracy),
            "horizon": trade.horizon,
            "length": trade.truth.length,
            "error": max(cell["error"], trade.truth.known),
            "cost_us": cell["cost_us"],
            "cpu": cell["cpu"],
            "reference": trade.truth.kind,
        },
    )


def measured(scene, horizon=None, tell=log.warning):
    """Trade of a scene, in which at least the methods of SHORTLIST are measured."""
    told = []

    def once(text):
        if not told:
            told.append(text)
            tell(
                f"measuring what {scene.name} costs and how wrong it is, once for this scene on "
                "this machine (a minute or two, kept for the next start)"
            )

    trade = Trade(scene, horizon, tell=once)
    for _ in trade.measure(SHORTLIST, budget=BUDGET, workers=1, tell=once):
        pass
    return trade


def _refusal(trade, accuracy, fits, in_time, factor):
    """One line: why there is no setting, and what there is."""
    name, over = trade.scene.name, f"over {trade.horizon:g} s on this machine"
    reaching, best = trade.cheapest(accuracy, fits), trade.best(in_time)
    if best is not None:
        can = f"{best[1]:.2g} can be had, with {_shown(best[0])}"
    elif trade.best(fits) is None:
        can = "no step can be used: choose rates or a duration that are multiples of 1 ms"
    else:
        can = "no setting that was measured is fast enough"
    if reaching is None:
        return (
            f"accuracy {accuracy:g} cannot be had for {name} {over}; "
            + (f"at {factor:g} times real time " if factor and trade.best(fits) else "")
            + can
        )
    return (
        f"accuracy {accuracy:g} cannot be had for {name} {over} at {factor:g} times real time:"
        f" the cheapest setting that reaches it, {_shown(reaching)}, leaves a factor of "
        f"{SHARE * 1e6 / reaching['cost_us']:.2g} with half of a core; at {factor:g} times "
        f"{can}"
    )


def _shown(cell):
    more = "".join(
        f", {name} {value:g}" for name, value in cell.get("options", cell).items() if name == "rtol"
    )
    return f"{cell['method']} at {cell['step'] * 1e3:g} ms on {cell['group']}{more}" + (
        f", {cell['stabilisation']}" if cell["stabilisation"] != "none" else ""
    )
