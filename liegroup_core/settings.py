# SPDX-License-Identifier: Apache-2.0
"""Settings of a run: the only table of their ranges, units, defaults and texts.

Simulation checks its arguments by it. Options of commands, parameters of the node and pages are made from it.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from liegroup_core.fields.arguments import check_name, got, is_finite
from liegroup_core.methods.families import NOT_ON_SE3, ON_JOINTS
from liegroup_core.methods.table import CONFIGURATION_GROUPS, METHODS, RELATIVE

POSITIVE = math.ulp(0.0)  # the smallest positive number
KINDS = {str: "a text", bool: "true or false", int: "a whole number", float: "a number"}


@dataclass(frozen=True)
class Setting:
    """One setting.

    default : a value, or None
    text    : what it is, without its unit
    low, high, least : range of a number; from `low` = 0 on, `least` is the smallest other number
    choices : valid names
    means   : what the default stands for, if its value does not say it
    """

    name: str
    default: Any
    text: str
    unit: str = ""
    low: float = POSITIVE
    high: float = math.inf
    choices: tuple = ()
    means: str = ""
    least: float = 0.0

    @property
    def kind(self):
        """Type of its values."""
        return type(self.default) if self.default is not None else str if self.choices else float

    @property
    def meaning(self):
        """Its text, with the unit."""
        return f"{self.text}, {self.unit}" if self.unit else self.text

    @property
    def shown_default(self):
        """Text of the default."""
        text = f"{self.default:g}" if self.kind is float else str(self.default) or "empty"
        return text.lower() if self.kind is bool else text

    @property
    def allowed(self):
        """Text of the valid values."""
        if self.choices:
            return f"one of {', '.join(self.choices)}"
        what, unit = KINDS[self.kind], self.unit and f" {self.unit}"
        if self.kind not in (int, float):
            return what
        if (self.low, self.high) == (POSITIVE, math.inf):
            return "a positive number" + (" of seconds" if self.unit == "s" else unit)
        zero, low = ("0, or ", self.least) if self.low == 0.0 < self.least and self.kind is float else ("", self.low)
        return f"{zero}{what} from {low:g} to {self.high:g}{unit}"

    def check(self, value, where=""):
        """Return a value as its type. Raises ValueError; where: beginning of the message, instead of the name."""
        if self.choices:
            check_name(value, self.choices, f"{where}unknown {'value' if where else self.name} {{}}")
        elif not self._is_valid(value):
            raise ValueError(f"{where or self.name + ' '}must be {self.allowed}, {got(value)}")
        return self.kind(value)

    def _is_valid(self, value):
        if self.kind not in (int, float):
            return isinstance(value, (bool, np.bool_) if self.kind is bool else str)
        if not (is_finite(value) if self.kind is float else type(value) is int):
            return False
        return self.low <= value <= self.high and not self.low == 0.0 < value < self.least


_TABLE = (
    Setting(
        "accuracy",
        1e-4,
        "largest error in the first horizon: of positions relative to the mechanism's size, of attitudes in rad. "
        "It may grow by as much in each further horizon; see docs/how-to/choose_accuracy.md",
        low=1e-13,  # the round-off of a single step is not far below
        high=1.0,
    ),
    Setting("horizon", 60.0, "simulated time in which the error may grow by the accuracy", "s", 1e-9, 1e6),
    Setting(
        "method",
        None,
        "integration method, instead of an accuracy",
        choices=tuple(METHODS),
        means="method and step sizes that keep the accuracy",
    ),
    Setting(
        "step",
        1e-3,
        "step size of the method; with an accuracy, interval of checks and of single steps",
        "s",
        1e-9,  # the resolution of times
        1e6,
        means="0.001, with an accuracy at most 0.01 and a fiftieth of the horizon",
    ),
    Setting(
        "group",
        "auto",
        "configuration space: SE(3) or SO(3) x R^3 for every body, or relative, the product of the "
        "joints' motion groups",
        choices=("auto", *CONFIGURATION_GROUPS),
        means="relative, for rotation methods so3xr3",
    ),
    Setting(
        "stabilisation",
        "none",
        "correction of constraint drift",
        choices=("none", "projection", "baumgarte"),
        means="projection if an accuracy is set and joints would drift, else none",
    ),
    Setting("baumgarte_time", None, "time constant of the stabilisation baumgarte", "s", means="ten steps"),
    Setting(
        "dexpinv",
        "exact",
        "inverse of dexp in explicit Munthe-Kaas methods; truncated: to the powers of ad that the order needs",
        choices=("exact", "truncated"),
    ),
    Setting(
        "space",
        "auto",
        "space: also planar mechanisms move in space; auto: they move in their plane, in relative coordinates",
        choices=("auto", "space"),
    ),
    Setting("rtol", 1e-6, "relative tolerance of a method with error control"),
    Setting("atol", 1e-6, "absolute tolerance of a method with error control"),
    Setting("rho_inf", 0.8, "damping of generalized_alpha: spectral radius at infinite step size", low=0.0, high=1.0),
    Setting("estimate", True, "estimate the global error, at about 1.8 times the cost"),
)
SETTINGS = {setting.name: setting for setting in _TABLE}

OF_ENGINE = ("group", "step", "stabilisation", "baumgarte_time")


def checked(name, value):
    """Value of a setting, its default for None. Raises ValueError."""
    return SETTINGS[name].default if value is None else SETTINGS[name].check(value)


def of_engine(engine):
    """Settings of an Engine besides its method and the options of that."""
    return {name: getattr(engine, name) for name in OF_ENGINE}


def check_options(method, options):
    """Complete the options of a method with its defaults. Raises ValueError, one line."""
    found = {name: SETTINGS[name].default for name in METHODS[method].options}
    for name, value in options.items():
        if name not in found:
            has = f"it has: {', '.join(found)}" if found else "it has none"
            raise ValueError(f"method {method} has no option {name!r}; {has}")
        found[name] = SETTINGS[name].check(value)
    return found


def check_group(method, group):
    """Raise ValueError, one line, for a group that is unknown or that a method does not support."""
    SETTINGS["group"].check(group)
    family = METHODS[method].family
    if group == RELATIVE and family not in ON_JOINTS:
        raise ValueError(
            f"method {method} does not support group 'relative': choose a Munthe-Kaas method, "
            "rkmk..., generalized_alpha, constrained_rattle, or another group"
        )
    if family in NOT_ON_SE3 and group == "se3":
        others = "'so3xr3', 'relative' or 'auto'" if family in ON_JOINTS else "'so3xr3' or 'auto'"
        raise ValueError(f"method {method} does not integrate on SE(3): group must be {others}, got {group!r}")
