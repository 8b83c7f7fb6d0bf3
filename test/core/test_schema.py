# SPDX-License-Identifier: Apache-2.0
"""The JSON schema of scene files: up to date, valid, and consistent with the loader."""

import json

import jsonschema
import pytest
import yaml
from scene_files import ROOT, cases, each_scene

from liegroup_core.scene import scene_from_text
from liegroup_core.scene.description import FORCES, JOINTS, SENSORS
from liegroup_core.scene.schema import scene_schema, scene_schema_text
from liegroup_core.scene.shapes import SHAPES
from liegroup_core.scene.yaml_text import read_yaml

GOOD = (ROOT / "test" / "core" / "rig.yaml").read_text(encoding="utf-8")
VALIDATOR = jsonschema.Draft202012Validator(scene_schema())


def accepts(text):
    return VALIDATOR.is_valid(read_yaml(text, "x.yaml").value)


def test_the_schema_file_is_up_to_date():
    """python -m liegroup_core.scene.schema > docs/scene.schema.json"""
    assert (ROOT / "docs" / "scene.schema.json").read_text(encoding="utf-8") == scene_schema_text()


def test_the_schema_is_a_valid_json_schema():
    jsonschema.Draft202012Validator.check_schema(json.loads(scene_schema_text()))


@each_scene
def test_every_example_scene_validates(path):
    values = read_yaml(path.read_text(encoding="utf-8"), str(path)).value
    assert [error.message for error in VALIDATOR.iter_errors(values)] == []


def test_every_key_has_a_description():
    """Every key of every model has a description, which editors show."""
    schema = scene_schema()
    for model in ("Body", "Frame", *(kind.__name__ for kind in (*JOINTS, *FORCES, *SENSORS, *SHAPES))):
        for key, part in schema["$defs"][model]["properties"].items():
            assert part["description"], (model, key)


def test_the_schema_refuses_what_the_loader_refuses():
    """The cases of wrong_scenes.yaml that a schema can express."""
    table = yaml.safe_load((ROOT / "test" / "core" / "wrong_scenes.yaml").read_text(encoding="utf-8"))
    accepted = [row for row in table["rig.yaml, by the schema too"] if accepts(GOOD.replace(*row[:2], 1))]
    assert accepted == []


@pytest.mark.parametrize("old, new", cases("the_schema_accepts_what_the_loader_accepts"))
def test_the_schema_accepts_what_the_loader_accepts(old, new):
    text = GOOD.replace(old, new, 1)
    if new.startswith("#"):
        text = GOOD[: GOOD.index("forces:")] + "forces:\n"
    scene_from_text(text)
    assert accepts(text)
