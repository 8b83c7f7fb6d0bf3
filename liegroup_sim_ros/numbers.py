# SPDX-License-Identifier: Apache-2.0
"""Numbers and names as text, common to tables, verdicts and HTML reports."""

import math

UNSURE = 0.1  # relative uncertainty from which on it is shown with an error
NO_MOMENTUM = "no component is found that every motion conserves"
NO_NUMBER = ("not a number", "infinite")
GROUPS = {"se3": "SE(3)", "so3xr3": "SO(3) x R^3", "relative": "the joints' groups"}


def shown(value, unit=""):
    """Number with three digits and its unit; NaN and infinity as words, None as "-"."""
    if value is None:
        return "-"
    if not math.isfinite(value):
        return NO_NUMBER[0] if math.isnan(value) else NO_NUMBER[1]
    number = f"{value:.3g}" if value else "0"
    return f"{number} {unit.replace(', ', ' or ')}".strip() if unit != "1" else number


def counted(number, noun):
    """A number of things as text: 1 body, 2 bodies."""
    if number != 1:
        noun = f"{noun[:-1]}ies" if noun.endswith("y") else f"{noun}es" if noun.endswith("s") else f"{noun}s"
    return f"{number:.0f} {noun}"


def error_text(entry):
    """Error as text, with its uncertainty if that is large; the uncertainty alone if it exceeds the error."""
    size, uncertainty = entry["max"], entry["uncertainty"]
    if 0.0 < uncertainty >= size:
        return f"{shown(uncertainty, entry['unit'])} (the reference uncertainty)"
    return shown(size, entry["unit"]) + (
        f" (± {shown(uncertainty, entry['unit'])})" if uncertainty > UNSURE * size else ""
    )
