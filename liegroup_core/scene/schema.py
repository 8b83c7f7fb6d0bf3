# SPDX-License-Identifier: Apache-2.0
"""JSON schema of scene files, for editors that complete and check them.

    python -m liegroup_core.scene.schema > docs/scene.schema.json

It is generated from the models in description.py. Conditions between entries (names must exist,
joints must be satisfied) are checked when a scene is read.
"""

import json

from .description import FORCES, JOINTS, SENSORS, Scene
from .shapes import SHAPES


def scene_schema():
    """JSON schema (draft 2020-12) of a scene as a dict of JSON types."""
    schema = _tidied(Scene.model_json_schema(mode="validation"))
    parts = schema["$defs"]
    for kinds, needed in (
        (JOINTS, ("parent_frame", "child_frame")),
        (FORCES, ()),
        (SENSORS, ()),
        (SHAPES, ("mass", "density")),
    ):
        for kind in kinds:
            part = parts[kind.__name__]
            part["required"] = sorted({*part.get("required", ()), "type"})
            if needed:
                part["anyOf"] = [{"required": [key]} for key in needed]
    parts["Body"]["anyOf"] = [{"required": ["shape"]}, {"required": ["mass", "inertia"]}]
    for key in ("joints", "couplings", "forces", "sensors"):  # a key without a value is an empty list
        schema["properties"][key]["type"] = ["array", "null"]
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "Scene"} | schema


def _tidied(part):
    """Part of the schema without titles (they repeat the keys) and without defaults of null."""
    if isinstance(part, list):
        return [_tidied(item) for item in part]
    if not isinstance(part, dict):
        return part
    return {
        key: _tidied(value)
        for key, value in part.items()
        if not (key == "title" and isinstance(value, str)) and not (key == "default" and value is None)
    }


def scene_schema_text():
    """Text of the schema file."""
    return json.dumps(scene_schema(), indent=1) + "\n"


if __name__ == "__main__":
    print(scene_schema_text(), end="")
