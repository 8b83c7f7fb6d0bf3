# SPDX-License-Identifier: Apache-2.0
"""JSON document with the results of analyses; its schema is config/analysis.schema.json."""

import json
import math

FORMAT = 1


def document(found, comparison=None, max_error=None, max_drift=None, exceeded=()):
    """JSON text of the figures of several recordings, with the bounds that they exceed."""
    return (
        json.dumps(
            plain(
                {
                    "format": FORMAT,
                    "logs": found,
                    "comparison": comparison,
                    "bounds": {"max_error": max_error, "max_drift": max_drift, "exceeded": list(exceeded)},
                }
            ),
            indent=1,
            allow_nan=False,
        )
        + "\n"
    )


def plain(value):
    """Figures as JSON types. NaN and infinity become texts, because JSON has neither."""
    if isinstance(value, dict):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value
