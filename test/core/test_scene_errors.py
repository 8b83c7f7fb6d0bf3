# SPDX-License-Identifier: Apache-2.0
"""Invalid scene files are refused in one line with file, line, key path and remedy."""

import re
import time
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scene_files import text_of

from liegroup_core import load_scene
from liegroup_core.errors import SceneError
from liegroup_core.layout import make_layout
from liegroup_core.scene import scene_from_text, yaml_text

GOOD = (Path(__file__).parent / "rig.yaml").read_text(encoding="utf-8")
PARSERS = sorted({yaml.SafeLoader, getattr(yaml, "CSafeLoader", yaml.SafeLoader)}, key=lambda parser: parser.__name__)


@pytest.fixture(params=PARSERS, ids=lambda parser: parser.__name__)
def parser(request, monkeypatch):
    """Run the test with each YAML parser that may be installed."""
    monkeypatch.setattr(yaml_text, "_PARSER", request.param)


def refusal(text, source="config/x.yaml"):
    """Message of the SceneError that a scene text raises; asserts that it is one line."""
    with pytest.raises(SceneError) as caught:
        scene_from_text(text, source=source)
    message = str(caught.value)
    assert len(message.splitlines()) == 1
    return message


def wrong_scenes():
    """Cases (base, old text, new text, line, *texts of the message) of wrong_scenes.yaml."""
    table = yaml.safe_load(Path(__file__).with_name("wrong_scenes.yaml").read_text(encoding="utf-8"))
    return [(base.partition(",")[0], *row) for base, rows in table.items() for row in rows]


def base_text(name):
    if name == "rig.yaml":
        return GOOD
    return text_of(name) if name.endswith(".yaml") else load_scene(name).text


@pytest.mark.parametrize("case", wrong_scenes(), ids=str)
def test_a_wrong_change_of_a_scene_is_refused_in_one_line(parser, case):
    base, old, new, line, *says = case
    text = base_text(base)
    assert old in text
    with pytest.raises(SceneError) as caught:
        make_layout(scene_from_text(text.replace(old, new, 1), source="config/x.yaml"))
    message = str(caught.value)
    assert message.startswith(f"config/x.yaml:{line}: ") and len(message.splitlines()) == 1, message
    assert all(part in message for part in says) and message.count("got ") <= 1, message


@pytest.mark.parametrize(
    "text, what",
    [
        ("", "is empty"),
        ("# only a comment\n", "is empty"),
        ("---\n", "is empty"),
        ("~", "is empty"),
        ("just text", "must be a mapping"),
        ("- a\n- b\n", "must be a mapping"),
        ("42", "must be a mapping"),
        ("{}", "name is missing"),
        ("[" * 100_000, "nested deeper"),
        ("a: " * 3, "is not YAML"),
        ("{a: " * 5000, "nested deeper"),
        ("- " * 5000, "nested deeper"),
        ("\ud800", "is not YAML"),
        ("%YAML 7.0\n---\na: b", "is not YAML"),
        ("? {a: b}\n: c\n", "a key must be text"),
        ("name: 'rig", "is not YAML"),
    ],
)
def test_text_that_is_not_a_scene_is_refused_in_one_line(parser, text, what):
    message = refusal(text)
    assert re.match(r"config/x\.yaml:\d+: ", message)
    assert what in message


def test_an_alias_bomb_is_refused_at_once(parser):
    """Ten levels of ten aliases expand to 10^10 values, which must not be created."""
    levels = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    levels += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 10)]
    start = time.perf_counter()
    message = refusal("\n".join(levels))
    assert "aliases repeat more than 100000 values: write them out" in message
    # line 5 holds 10^5 values and their lists; all lines before it fit
    assert message.startswith("config/x.yaml:5: ")
    # a few hundred parser events; expanding only 10^8 values would already take seconds
    assert time.perf_counter() - start < 1.0


# ---------------------------------------------------------------- whatever may come

NUMBERS = st.floats(allow_nan=True, allow_infinity=True) | st.integers()
PLAIN = (
    st.none()
    | st.booleans()
    | NUMBERS
    | st.text(max_size=8)
    | st.sampled_from(["world", "top", "rod", "spherical", "spring_damper", "1e3", "*a", "&a"])
)
ANYTHING = st.recursive(
    PLAIN,
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(
            st.text(max_size=6) | st.sampled_from(["name", "type", "position", "mass"]), inner, max_size=4
        )
    ),
    max_leaves=8,
)
bounded = settings(max_examples=200, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])


def loads_or_is_refused(text):
    try:
        return scene_from_text(text, source="x.yaml")
    except SceneError as error:
        assert len(str(error).splitlines()) == 1
        number = re.match(r"x\.yaml:(\d+): \S", str(error))
        assert number and 1 <= int(number[1]) <= max(1, len(text.splitlines()))
        return None


def places(value, path=()):
    """Path of every value in nested mappings and lists."""
    yield path
    for key, part in value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ():
        yield from places(part, (*path, key))


@bounded
@given(st.data())
@pytest.mark.turn(3)
def test_any_value_anywhere_loads_or_is_refused(data):
    """One or two values of a valid scene are replaced by arbitrary values."""
    values = yaml.safe_load(GOOD.replace("1e4", "1.0e4").replace("2e-1", "0.2"))
    for _ in range(data.draw(st.integers(1, 2))):
        path = data.draw(st.sampled_from(list(places(values))[1:]))
        inner = values
        for key in path[:-1]:
            inner = inner[key]
        inner[path[-1]] = data.draw(ANYTHING)
    loads_or_is_refused(yaml.safe_dump(values, sort_keys=False, default_flow_style=None))


@bounded
@given(
    position=st.integers(0, len(GOOD)),
    length=st.integers(0, 40),
    inserted=st.text(max_size=6) | st.text("{}[]:,-?&*!|>'\"%@` \t\n#x1", max_size=12),
)
def test_any_damage_to_the_text_loads_or_is_refused(position, length, inserted):
    loads_or_is_refused(GOOD[:position] + inserted + GOOD[position + length :])


@bounded
@given(st.text(max_size=60) | st.text("{}[]:,-?&*!|>'\"%@` \t\n#x1", max_size=60))
def test_any_text_is_refused(text):
    assert loads_or_is_refused(text) is None
