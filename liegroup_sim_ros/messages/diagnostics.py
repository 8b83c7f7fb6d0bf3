# SPDX-License-Identifier: Apache-2.0
"""diagnostic_msgs/DiagnosticArray of a simulation: its figures and their severity."""

import math
import sys

from liegroup_core.pacing import SLOW

from .cdr import Template, stamp
from .codecs import Fields

TYPE = "diagnostic_msgs/msg/DiagnosticArray"
OK, WARN, ERROR = 0, 1, 2


def encode(stamp_ns, name, figures):
    """Serialized message with one status; figures: {name: number or text}."""
    level, text = judge(figures)
    template = Template()
    template.header("")
    template.put("I", 1)
    template.put("B", level)
    for string in (name, text, ""):  # the last one is the hardware id
        template.string(string)
    template.put("I", len(figures))
    for key, value in figures.items():
        template.string(key)
        template.string(value if isinstance(value, str) else f"{value:.9g}")
    return template.pack(stamp(stamp_ns))


def decode(payload):
    """(stamp in ns, {key: text} of all statuses) of a message. Raises MessageError."""
    fields, values = Fields(TYPE, payload), {}
    stamp_ns = fields.stamp_ns()
    fields.text()
    for _ in range(fields.number("I")):
        fields.number("B")
        for _ in range(3):  # name, message, hardware
            fields.text()
        for _ in range(fields.number("I")):
            key = sys.intern(fields.text())
            values[key] = fields.text()
    return stamp_ns, values


def judge(figures):
    """(severity, one line of text) for the state of a simulation."""
    if figures["state"] == "faulted":
        return ERROR, "stopped by an error: see ~/events, call ~/reset"
    if figures.get("recorder_failure"):
        return ERROR, figures["recorder_failure"]
    requested, achieved = figures["real_time_factor_wanted"], figures["real_time_factor"]
    if figures["state"] == "running" and 0.0 < achieved < SLOW * requested:
        return WARN, f"too slow: real-time factor {achieved:.3g} of {requested:.3g}"
    if figures.get("predictable_until_s", math.inf) < math.inf:
        return WARN, f"not predictable from t = {figures['predictable_until_s']:.9g} s on"
    if figures.get("accurate_until_s", math.inf) < math.inf:
        return WARN, f"accurate until t = {figures['accurate_until_s']:.9g} s only"
    if text := figures.get("machine_departs") or figures.get("machine_note"):
        return WARN, f"machine: {text}"
    return OK, figures["state"]
