# SPDX-License-Identifier: Apache-2.0
"""Consistency of a recording: settings, scene and initial state."""

import sys

from liegroup_core.methods.table import CONFIGURATION_GROUPS

from .errors import RecordingError


def is_promise(entry):
    """Whether the `promise` entry of a recording's settings is valid."""
    return isinstance(entry, dict) and all(
        isinstance(entry.get(key), (int, float)) and 0.0 < entry[key] <= sys.float_info.max
        for key in ("accuracy", "horizon", "length")
    )


def check_settings(recording, scene):
    """Raise RecordingError if settings, scene and initial state are inconsistent."""
    settings, path = recording.settings, recording.path
    lacking = [
        key for key in ("scene", "method", "group", "step", "steps_per_sample", "world_frame") if key not in settings
    ]
    if lacking:
        raise RecordingError(f"{path}: its settings lack {', '.join(lacking)}")

    def is_period(value):
        return isinstance(value, (int, float)) and not isinstance(value, bool) and 0.0 < value < 2**53

    checks = {
        "scene": isinstance(settings["scene"], str),
        "method": isinstance(settings["method"], str),
        "group": settings["group"] in CONFIGURATION_GROUPS,
        "step": isinstance(settings["step"], (int, float))
        and not isinstance(settings["step"], bool)
        and 1e-9 <= settings["step"] <= 1e6,
        "steps_per_sample": settings["steps_per_sample"] is None or is_period(settings["steps_per_sample"]),
        "world_frame": isinstance(settings["world_frame"], str),
        "options": isinstance(settings.get("options") or {}, dict),
        "versions": isinstance(settings.get("versions") or {}, dict),
        "stabilisation": isinstance(settings.get("stabilisation") or "none", str),
        "promise": settings.get("promise") is None or is_promise(settings["promise"]),
    }
    for name, good in checks.items():
        if not good:
            raise RecordingError(f"{path}: invalid setting {name}: {settings.get(name)!r:.60}")
    if recording.bodies != tuple(body.name for body in scene.bodies):
        raise RecordingError(f"{path}: the bodies of its initial state differ from those of its scene")
    pacing = recording.pacing
    if pacing is not None and not isinstance(pacing.get("lateness_us"), dict):
        raise RecordingError(f"{path}: its pacing has no lateness_us")
