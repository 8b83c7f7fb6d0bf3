# SPDX-License-Identifier: Apache-2.0
"""Invalid scene files are refused in one line with file, line, key path and remedy."""

import re
import time
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from liegroup_core.errors import SceneError
from liegroup_core.scene import scene_from_text, yaml_text

GOOD = (Path(__file__).parent / "rig.yaml").read_text(encoding="utf-8")
PARSERS = sorted({yaml.SafeLoader, getattr(yaml, "CSafeLoader", yaml.SafeLoader)},
                 key=lambda parser: parser.__name__)


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


# ---------------------------------------------------------------- bad files

# (what, part of GOOD, what replaces it, place, remedy); the line to be named is marked with #!
BAD = [
    ("mass negative", "mass: 2.5", "mass: -1  #!",
     'bodies[0] "top": mass', "must be greater than 0, got -1"),
    ("mass zero", "mass: 2.5", "mass: 0  #!", 'bodies[0] "top": mass', "must be greater than 0"),
    ("mass missing", "- name: top\n    mass: 2.5", "- name: top  #!",
     'bodies[0] "top":', "mass is missing: give the mass in kg"),
    ("mass with unit", "mass: 2.5", "mass: 2.5 kg  #!", 'bodies[0] "top": mass',
     "must be a number, without quotes or unit, got '2.5 kg'"),
    ("mass quoted", "mass: 2.5", "mass: '2.5'  #!", 'bodies[0] "top": mass',
     "must be a number, without quotes"),
    ("mass bool", "mass: 2.5", "mass: true  #!", 'bodies[0] "top": mass', "must be a number"),
    ("mass null", "mass: 2.5", "mass:  #!", 'bodies[0] "top":',
     "mass is missing: give the mass in kg"),
    ("mass nan", "mass: 2.5", "mass: .nan  #!", 'bodies[0] "top": mass',
     "must be finite, got nan"),
    ("mass infinite", "mass: 2.5", "mass: 1e999  #!", 'bodies[0] "top": mass', "must be finite"),
    ("mass too large", "mass: 2.5", "mass: 1e200  #!", 'bodies[0] "top": mass',
     "must be at most 1e+100"),
    ("mass of many digits", "mass: 2.5", f"mass: {'9' * 5000}  #!", 'bodies[0] "top": mass',
     "must be finite"),
    ("mass a list", "mass: 2.5", "mass: [2.5]  #!", 'bodies[0] "top": mass', "must be a number"),
    ("inertia of two", "[1.0, 1.1, 1.2]", "[1.0, 1.1]  #!", 'bodies[0] "top": inertia',
     "must have 3 numbers [Ixx, Iyy, Izz] or 6"),
    ("inertia a number", "[1.0, 1.1, 1.2]", "1.0  #!", 'bodies[0] "top": inertia',
     "must be a list"),
    ("inertia entry on its own line", "[1.0, 1.1, 1.2]", "\n    - 1.0\n    - x  #!\n    - 1.0",
     'bodies[0] "top": inertia[1]', "must be a number"),
    ("inertia negative", "[1.0, 1.1, 1.2]", "[1, -1, 1]  #!", 'bodies[0] "top": inertia',
     "must not be negative, but its principal moments are -1, 1, 1; check order and signs"),
    ("inertia beyond the triangle", "[1.0, 1.1, 1.2]", "[1, 1, 2.1]  #!",
     'bodies[0] "top": inertia', "must not exceed the sum of the other two"),
    ("inertia beyond the triangle, turned", "[1.0, 1.1, 1.2]", "[1.55, 1.55, 1, 0.55, 0, 0]  #!",
     'bodies[0] "top": inertia', "must not exceed the sum of the other two"),
    ("inertia of four on their own lines", "inertia: [1.0, 1.1, 1.2]",
     "inertia:  #!\n    - 1\n    - 1\n    - 1\n    - 0", 'bodies[0] "top": inertia',
     "must have 3 numbers"),
    ("position of two", "position: [1, 0, 0]", "position: [1, 0]  #!",
     'bodies[0] "top": position', "must have 3 numbers [x, y, z]"),
    ("position with decimal commas", "position: [1, 0, 0]", "position: [1,5, 0, 0]  #!",
     'bodies[0] "top": position', "must have 3 numbers"),
    ("quaternion of three", "[0, 0, 0, 1]", "[0, 0, 1]  #!", 'bodies[1] "rod": quaternion',
     "must have 4 numbers [x, y, z, w]"),
    ("quaternion not unit", "[0, 0, 0, 1]", "[0, 0, 0.1, 1]  #!", 'bodies[1] "rod": quaternion',
     "must have norm 1 within 0.001"),
    ("quaternion zero", "[0, 0, 0, 1]", "[0, 0, 0, 0]  #!", 'bodies[1] "rod": quaternion',
     "must have norm 1"),
    ("rotation in degrees", "quaternion: [0, 0, 0, 1]", "rotation_vector: [0, 0, 90]  #!",
     'bodies[1] "rod": rotation_vector', "the unit is rad, not degrees"),
    ("two rotations", "quaternion: [0, 0, 0, 1]",
     "quaternion: [0, 0, 0, 1]\n    rotation_vector: [0, 0, 0]  #!",
     'bodies[1] "rod":', "quaternion and rotation_vector both define the rotation: keep one"),
    ("two rotations of a frame", "{position: [0.5, 0, 0], axis: [0, 1, 0]}",
     "\n      quaternion: [0, 0, 0, 1]\n      axis: [0, 1, 0]  #!",
     'joints[1] "hinge": parent_frame:', "quaternion and axis both define the rotation: keep one"),
    ("axis zero", "axis: [0, 1, 0]}", "axis: [0, 0, 0]}  #!",
     'joints[1] "hinge": parent_frame.axis', "must not be zero: give the direction"),
    ("body named world", "name: rod", "name: world  #!", 'bodies[1] "world":', "choose another"),
    ("body named like a number", "name: rod", "name: 2  #!", "bodies[1]: name",
     "must be a name: a letter, then letters, digits or _"),
    ("body named with a blank", "name: rod", "name: my rod  #!", "bodies[1]: name",
     "must be a name"),
    ("body named twice", "name: rod", "name: top  #!", 'bodies[1] "top":',
     "this name is already used by bodies[0]: choose another"),
    ("joint and force of one name", "name: spring", "name: hinge  #!", 'forces[0] "hinge":',
     "this name is already used by joints[1]"),
    ("unknown key", "mass: 2.5", "masss: 2.5  #!", 'bodies[0] "top":',
     "unknown key 'masss'; did you mean \"mass\"?"),
    ("unknown key of no likeness", "position: [2, 0, 0]", "zzz: 1  #!", 'bodies[1] "rod":',
     "unknown key 'zzz'; choose one of: name, mass,"),
    ("unknown key of a frame", "{position: [-1, 0, 0]}", "{pos: [-1, 0, 0]}  #!",
     'joints[0] "pivot": child_frame:', "unknown key 'pos'; choose one of: position, quaternion"),
    ("unknown key of the scene", "description: Two bodies", "text: Two bodies  #!", "unknown key",
     "choose one of: name, description, gravity"),
    ("merge key", "mass: 2.5", "<<: {mass: 2.5}  #!", 'bodies[0] "top":', "unknown key '<<'"),
    ("repeated key", "mass: 2.5", "mass: 2.5\n    mass: 3  #!", "key 'mass'",
     "is given twice, first on line 8: keep one"),
    ("key that is a number", "mass: 2.5", "1: 2.5  #!", "a key must be text", "got 1"),
    ("gravity missing", "name: rig\ndescription: Two bodies\ngravity: [0, 0, -9.81]",
     "name: rig  #!", "gravity is missing", "give the gravity in m/s^2"),
    ("name missing", "name: rig\ndescription: Two bodies", "description: Two bodies  #!",
     "name is missing", "give the name of the scene"),
    ("description a number", "Two bodies", "5  #!", "description", "must be text, got 5"),
    ("bodies missing", GOOD[GOOD.index("bodies:"):], "", None, "bodies is missing: give the list"),
    ("bodies empty", GOOD[GOOD.index("bodies:"):], "bodies: []  #!", "bodies is empty",
     "give at least one body"),
    ("bodies a mapping", GOOD[GOOD.index("bodies:"):], "bodies: {top: 1}  #!", "bodies",
     "must be a list"),
    ("body a number", GOOD[GOOD.index("bodies:"):], "bodies: [5]  #!", "bodies[0]:",
     "must be a mapping with the keys name, mass"),
    ("joint a text", GOOD[GOOD.index("joints:"):], "joints: [pivot]  #!", "joints[0]:",
     "must be a mapping"),
    ("frame a number", "{position: [-1, 0, 0]}", "3  #!", 'joints[0] "pivot": child_frame',
     "must be a mapping with the keys position, quaternion"),
    ("joint without frames", "child: top\n    child_frame: {position: [-1, 0, 0]}",
     "child: top", 'joints[0] "pivot":', "parent_frame or child_frame is missing: give at least"),
    ("joint type unknown", "type: revolute", "type: revolut  #!", 'joints[1] "hinge":',
     "type 'revolut' is not known; did you mean \"revolute\"?"),
    ("joint type a list", "type: revolute", "type: [revolute]  #!", 'joints[1] "hinge":',
     "choose one of: spherical, revolute"),
    ("pitch of a joint without one", "type: revolute", "pitch: 0.1  #!\n    type: revolute",
     'joints[1] "hinge":', "unknown key 'pitch'; choose one of: name, type"),
    ("screw without a pitch", "- name: hinge\n    type: revolute",
     "- name: hinge  #!\n    type: screw", 'joints[1] "hinge":',
     "pitch is missing: give the displacement along z in m per radian"),
    ("pitch in words", "type: revolute", "type: screw\n    pitch: fine  #!",
     'joints[1] "hinge": pitch', "must be a number"),
    ("rod without length", "type: revolute",
     "type: distance\n    child_frame: {position: [-1, 0, 0]}\n    length: -2  #!",
     'joints[1] "hinge": length', "must be greater than 0"),
    ("rod with one end", "- name: hinge\n    type: revolute",
     "- name: hinge  #!\n    type: distance", 'joints[1] "hinge":', "child_frame is missing"),
    ("joint type missing", "- name: hinge\n    type: revolute", "- name: hinge  #!",
     'joints[1] "hinge":', "type is missing: give spherical or revolute"),
    ("force type unknown", "type: spring_damper", "type: spring  #!", 'forces[0] "spring":',
     "is not known; choose one of: spring_damper"),
    ("joint to an unknown body", "parent: world", "parent: ground  #!", 'joints[0] "pivot":',
     "parent 'ground' is not a body; choose one of: world, top, rod"),
    ("force on an unknown body", "child: rod\n    child_point", "child: rods  #!\n    child_point",
     'forces[0] "spring":', "child 'rods' is not a body; did you mean \"rod\"?"),
    ("joint from a body to itself", "parent: top\n    child: rod\n    parent_frame",
     "parent: top\n    child: top  #!\n    parent_frame", 'joints[1] "hinge":',
     "parent and child are both \"top\": they must differ"),
    ("joint from world to world", "parent: world\n    child: top",
     "parent: world\n    child: world  #!", 'joints[0] "pivot":', "name a body"),
    ("joint with the world as child", "parent: world\n    child: top",
     "parent: top\n    child: world  #!", 'joints[0] "pivot":', "swap parent and child"),
    ("stiffness negative", "stiffness: 1e4", "stiffness: -1e4  #!",
     'forces[0] "spring": stiffness', "must not be negative, got -10000.0"),
    ("damping negative", "damping: 2e-1", "damping: -1  #!", 'forces[0] "spring": damping',
     "must not be negative"),
    ("rest length negative", "rest_length: 0.5", "rest_length: -1  #!",
     'forces[0] "spring": rest_length', "must not be negative"),
    ("open joint", "child_frame: {position: [-1, 0, 0]}",
     "child_frame: {position: [-1, 0, 0]}\n    parent_frame: {position: [0, 0, 3]}",
     'joints[0] "pivot": is violated', "gap 3 m"),
    ("velocity against a joint", "position: [1, 0, 0]",
     "position: [1, 0, 0]\n    linear_velocity: [1, 0, 0]", 'joints[0] "pivot":',
     "are angular_velocity [0, 0, 0] and linear_velocity [0, 0, 0]"),
    ("two errors", "mass: 2.5\n    inertia: [1.0, 1.1, 1.2]",
     "mass: -1  #!\n    inertia: [1, 1, 9]", 'bodies[0] "top": mass',
     "must be greater than 0, got -1 (and 1 more)"),
    ("error in a repeated part", "mass: 2.5\n    inertia: [1.0, 1.1, 1.2]",
     "mass: 1\n    inertia: &i\n    - 1\n    - y  #!\n    - 1\n    linear_velocity: *i",
     'bodies[0] "top": inertia[1]', "must be a number, without quotes or unit, got 'y' (and 1"),
    ("tab", "    mass: 2.5", "\tmass: 2.5  #!", "is not YAML", "blanks, no tabs"),
    ("open bracket", "[1.0, 1.1, 1.2]", "[1.0, 1.1, 1.2", "is not YAML", "colons and brackets"),
    ("control character", "Two bodies", "Two\x07bodies  #!", "is not YAML", "remove it"),
    ("tag", "mass: 2.5", "mass: !!float 2.5  #!", "the tag 'tag:yaml.org,2002:float'",
     "remove it"),
    ("python tag", "mass: 2.5", "mass: !!python/object/apply:os.getcwd []  #!", "the tag",
     "is not used in scenes: remove it"),
    ("unknown alias", "mass: 2.5", "mass: *m  #!", "the alias *m", "write the value out"),
    ("alias of what is around it", "[1.0, 1.1, 1.2]", "&i [1, *i, 1]  #!", "the alias *i",
     "write the value out"),
    ("second document", "joints:", "---  #!\njoints:", "a second YAML document", "keep one"),
]


@pytest.mark.parametrize("what, old, new, place, remedy", BAD, ids=[row[0] for row in BAD])
def test_an_invalid_file_is_refused_in_one_line(parser, what, old, new, place, remedy):
    assert GOOD.count(old) >= 1
    text = GOOD.replace(old, new, 1)
    message = refusal(text)
    number = next((i for i, line in enumerate(text.splitlines(), 1) if line.endswith("#!")), None)
    if number is None:
        number = LINES[what]
    assert message.startswith(f"config/x.yaml:{number}: "), message
    assert (place or "") in message and remedy in message, message


# where there is no line of its own to mark: the entry the missing thing belongs to
LINES = {"bodies missing": 3, "joint without frames": 17, "open joint": 17,
         "velocity against a joint": 18, "open bracket": 10}


@pytest.mark.parametrize("text, what", [
    ("", "is empty"), ("# only a comment\n", "is empty"), ("---\n", "is empty"),
    ("~", "is empty"), ("just text", "must be a mapping"), ("- a\n- b\n", "must be a mapping"),
    ("42", "must be a mapping"), ("{}", "name is missing"), ("[" * 100_000, "nested deeper"),
    ("a: " * 3, "is not YAML"), ("{a: " * 5000, "nested deeper"), ("- " * 5000, "nested deeper"),
    ("\ud800", "is not YAML"), ("%YAML 7.0\n---\na: b", "is not YAML"),
    ("? {a: b}\n: c\n", "a key must be text"), ("name: 'rig", "is not YAML")])
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
PLAIN = st.none() | st.booleans() | NUMBERS | st.text(max_size=8) | st.sampled_from(
    ["world", "top", "rod", "spherical", "spring_damper", "1e3", "*a", "&a"])
ANYTHING = st.recursive(PLAIN, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(
    st.text(max_size=6) | st.sampled_from(["name", "type", "position", "mass"]), inner,
    max_size=4), max_leaves=8)
bounded = settings(max_examples=200, deadline=None, derandomize=True,
                   suppress_health_check=[HealthCheck.too_slow])


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
    for key, part in (value.items() if isinstance(value, dict)
                      else enumerate(value) if isinstance(value, list) else ()):
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
@given(position=st.integers(0, len(GOOD)), length=st.integers(0, 40),
       inserted=st.text(max_size=6) | st.text("{}[]:,-?&*!|>'\"%@` \t\n#x1", max_size=12))
def test_any_damage_to_the_text_loads_or_is_refused(position, length, inserted):
    loads_or_is_refused(GOOD[:position] + inserted + GOOD[position + length:])


@bounded
@given(st.text(max_size=60) | st.text("{}[]:,-?&*!|>'\"%@` \t\n#x1", max_size=60))
def test_any_text_is_refused(text):
    assert loads_or_is_refused(text) is None
