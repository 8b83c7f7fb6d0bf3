# SPDX-License-Identifier: Apache-2.0
"""Trade-off for a scene: error against cost of its configurations, measured on this machine.

    trade = Trade(load_scene("heavy_top"))
    for cell, _ in trade.measure():
        print(cell["method"], cell["step"], cell["error"], cell["cost_us"])
    print(trade.cheapest(1e-6))

Each ladder is measured from its coarsest step to finer ones, until its error reaches round-off or
the reference uncertainty, or the next step would take too long (docs/how-to/choose_accuracy.md).
"""

from liegroup_core.compiling import source_digest
from liegroup_core.engine import Engine
from liegroup_core.layout import make_layout
from liegroup_core.methods.families import fitting_methods
from liegroup_core.methods.table import METHODS
from liegroup_core.settings import SETTINGS
from liegroup_core.study.tasks import run

from .cache import Store
from .configurations import LEAST_SAMPLES, SAMPLES, Configuration, as_time, ladders, rungs, sample_spacing
from .measure import Study, measure, to_accuracy
from .reference_solution import find_truth

ACCURACIES = (1e-3, 1e-6, 1e-9)
WANTED = tuple(
    sorted({*ACCURACIES, SETTINGS["accuracy"].default}, reverse=True)
)  # accuracies of simulations to an accuracy
# A guaranteed accuracy is this factor above the measured error, because the error may be larger between
# the samples of the measurement.
MARGIN = 3.0
BUDGET = 1.0  # limit of the CPU time of a run, s
ENOUGH = 1e-11  # smallest error of interest: 1e-9 with its margin, and a reserve
# If two finer steps do not reduce the error to BETTER times its value, it is round-off; above ROUGH, the
# steps are too large for the method.
BETTER, ROUGH = 0.5, 1e-2
DEARER = 1.5  # the rule above requires that the cost grows by this factor
SETTLING = 2  # number of finer rungs whose errors must not be larger
MOST_STEPS = 1_000_000  # in a horizon, for a ladder without a finished run


class Trade:
    """Measurements of a scene over a horizon.

    scene   : Scene
    horizon : s, time over which errors are evaluated; None: default, see reference_solution.HORIZONS
    store   : Store; None: the user's cache
    tell    : function that is called with the progress as text
    raises SceneError, SimulationError if there is no reference solution, ValueError for a wrong horizon
    """

    def __init__(self, scene, horizon=None, store=None, tell=lambda text: None):
        self.scene, self.layout = scene, make_layout(scene)
        self._store = store or Store(scene)
        suits = horizon is None
        horizon = self._store.horizon() if suits else _checked(horizon)
        self.truth = horizon and self._store.truth(horizon)
        if self.truth is None:
            self.truth = find_truth(self.layout, horizon, tell)
            self._store.keep_truth(self.truth, suits)
        self._cells = {_key(cell): cell for cell in self._store.cells(self.truth.horizon)}

    @property
    def horizon(self):
        """Horizon in s."""
        return float(self.truth.horizon)

    @property
    def cells(self):
        """All measured cells, see measure.measure, sorted by ladder and from coarse to fine."""
        return sorted(self._cells.values(), key=lambda cell: (_ladder(cell), _coarseness(cell)))

    def measure(
        self,
        methods=None,
        groups=None,
        stabilisations=None,
        steps=None,
        budget=BUDGET,
        scheduler=None,
        workers=None,
        tell=lambda text: None,
    ):
        """Measure missing cells; yields (cell, (ladders done, ladders)) in order of completion.

        methods, groups, stabilisations : names; None: all methods that suit the scene, all groups, and
                                          the stabilisations none and projection
        steps              : s, divisors of the horizon, instead of ladders
        budget             : s, limit of the CPU time of a run
        scheduler, workers : see tasks.run
        tell               : function that is called with the progress before the first result
        raises TasksError, and ValueError for unsuitable steps or if no method suits the scene
        """
        if steps is not None:
            steps = [_fitting(step, self.truth.horizon) for step in sorted(steps, reverse=True)]
        chosen = ladders(self.layout, methods, groups, stabilisations)
        if not chosen:
            raise ValueError(
                f"{self.scene.name}: none of the requested methods can integrate this scene; "
                f"use: {', '.join(fitting_methods(self.layout))}"
            )
        climbs = [_Climb(ladder, self.truth, budget, steps) for ladder in chosen]
        owners = [climb for climb in climbs if climb.next(self._cells) is not None]
        if not owners:
            return
        tell("starting")
        self._compile(owners)
        study = Study(self.scene.text, self.truth, source_digest())
        done = [len(climbs) - len(owners)]

        def expand(k, cell):
            climb = owners[k]
            self._cells[_key(cell)] = cell
            self._store.keep_cell(self.truth.horizon, cell)
            climb.add(cell)
            setting = climb.next(self._cells)
            if setting is None:
                done[0] += 1
                return []
            owners.append(climb)
            return [(study, setting)]

        for _, cell in run(measure, [(study, climb.setting) for climb in owners], scheduler, workers, expand):
            yield cell, (done[0], len(climbs))

    def to_accuracies(self, accuracies=WANTED):
        """Simulations to an accuracy over the horizon, each as in measure.to_accuracy; they are not cached."""
        return [to_accuracy(self.scene, self.truth, accuracy) for accuracy in accuracies]

    def keep_only(self, methods=None, groups=None, stabilisations=None, steps=None):
        """Drop cells of other configurations from `cells`, not from the cache; arguments as for `measure`.

        So the same arguments give the same result, whatever was measured before.
        """
        chosen = set(ladders(self.layout, methods, groups, stabilisations))
        self._cells = {
            key: cell
            for key, cell in self._cells.items()
            if _ladder(cell) in chosen and (steps is None or cell["step"] in steps)
        }

    def _compile(self, climbs):
        """Compile the kernels before the workers need them."""
        families = {METHODS[climb.ladder.method].family: climb.setting for climb in climbs}
        for setting in families.values():
            try:
                Engine(self.scene, **setting.arguments())
            except ValueError:  # the run reports why
                pass

    def settled(self):
        """[(cell, error)] of finished runs. error is the largest of the cell's error, those of the next finer
        cells of its ladder and the reference uncertainty, so that errors small by chance do not count.
        """
        found = []
        by_ladder = {}
        for cell in self.cells:
            by_ladder.setdefault(_ladder(cell), []).append(cell)
        for cells in by_ladder.values():
            for i, cell in enumerate(cells):
                near = cells[i : i + 1 + SETTLING]
                if not any(other["stopped"] for other in near):
                    found.append((cell, max(self.truth.known, *(other["error"] for other in near))))
        return found

    def front(self):
        """Cells on the Pareto front of error and cost, from cheap to accurate."""
        front, best = [], float("inf")
        for cell, error in sorted(self.settled(), key=lambda pair: (pair[0]["cost_us"], pair[1])):
            if error < best:
                front.append(cell)
                best = error
        return front

    def cheapest(self, accuracy, usable=lambda cell: True):
        """Cheapest cell that meets an accuracy with its margin, or None."""
        kept = [cell for cell, error in self.settled() if MARGIN * error <= accuracy and usable(cell)]
        return min(kept, key=lambda cell: cell["cost_us"], default=None)

    def best(self, usable=lambda cell: True):
        """(most accurate cell, accuracy that it meets with its margin), or None."""
        found = [(cell, MARGIN * error) for cell, error in self.settled() if usable(cell)]
        return min(found, key=lambda pair: (pair[1], pair[0]["cost_us"]), default=None)


class _Climb:
    """State of one ladder, coarse to fine; `setting` is the next configuration."""

    def __init__(self, ladder, truth, budget, steps=None):
        self.ladder, self.setting = ladder, None
        self._rungs = (
            rungs(ladder, truth.horizon)
            if steps is None
            else (Configuration(*ladder[:1], step, *ladder[1:]) for step in steps)
        )
        self._all = steps is not None
        self._known, self._horizon, self._budget = truth.known, float(truth.horizon), budget
        self._cells = []

    def add(self, cell):
        """Add the cell of the next configuration."""
        self._cells.append(cell)
        self.setting = None

    def next(self, cells):
        """Next configuration that is not among `cells` {key: cell}, or None at the end."""
        for setting in self._rungs:
            if self._is_over(setting):
                return None
            cell = cells.get(_key_of(setting))
            if cell is None:
                self.setting = setting
                return setting
            self._cells.append(cell)
        return None

    def _is_over(self, following):
        if self._all:
            return False
        good = [cell for cell in self._cells if not cell["stopped"]]
        if not good:
            return self._horizon / following.step > MOST_STEPS
        errors = [cell["error"] for cell in good]
        if errors[-1] <= max(ENOUGH, self._known):
            return True
        last = good[-1]
        # If a tighter tolerance costs nothing, the tolerance does not determine the error yet.
        if (
            len(good) > 2
            and min(errors) < ROUGH
            and min(errors[-2:]) > BETTER * min(errors[:-2])
            and last["cost_us"] > DEARER * good[-3]["cost_us"]
        ):
            return True
        growth = last["step"] / following.step
        if len(good) > 1 and growth == 1.0:
            growth = last["cost_us"] / good[-2]["cost_us"]
        return last["cost_us"] * 1e-6 * self._horizon * growth > self._budget


def _fitting(step, horizon):
    """Step as float. Raises ValueError if too few samples of the horizon lie on whole steps."""
    step = SETTINGS["step"].check(step)
    if horizon % as_time(step) or horizon / sample_spacing(as_time(step), horizon) < LEAST_SAMPLES:
        raise ValueError(
            f"a step of {step:g} s does not divide a horizon of {float(horizon):g} s: at "
            f"least {LEAST_SAMPLES} of its {SAMPLES} samples must lie on whole steps"
        )
    return step


def _ladder(cell):
    return cell["method"], cell["group"], cell["stabilisation"]


def _coarseness(cell):
    return -cell["step"], -cell["options"].get("rtol", 0.0)


def _key(cell):
    return (*_ladder(cell), cell["step"], tuple(sorted(cell["options"].items())))


def _key_of(setting):
    return (setting.method, setting.group, setting.stabilisation, setting.step, tuple(sorted(setting.options)))


def _checked(horizon):
    """Horizon as Fraction. Raises ValueError."""
    found = as_time(SETTINGS["horizon"].check(horizon))
    # Samples and steps must be decimal numbers with few digits.
    if as_time(float(f"{horizon:.3g}")) != found:
        raise ValueError(
            f"the horizon must have at most three digits, got {horizon!r}; use {float(f'{horizon:.3g}'):g}"
        )
    return found
