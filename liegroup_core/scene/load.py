# SPDX-License-Identifier: Apache-2.0
"""Scene files: find, read and check them; every error is one line with file and line number.

    config/x.yaml:12: bodies[0] "top": mass must be greater than 0, got -1

The text is read as YAML with the plain values of YAML 1.2 (numbers such as 1e4, true, false,
null; everything else is text). Tags, several documents and repeated keys are refused.
"""

import os
import re
import sys
from pathlib import Path

import yaml

from liegroup_core.errors import SceneError
from liegroup_core.fields.values import shown, suggestion

from .assembly import assembled
from .consistency import check_consistency
from .description import Scene

SHARE = Path("share", "liegroup_sim_ros", "config", "scenes")

# A scene file has about 200 bytes a body; this is far above the largest one that can be simulated.
LARGEST_FILE = 64 * 2**20  # bytes
# A scene is five levels deep; aliases may repeat parts of it, but not without bound.
DEEPEST = 20
MOST_REPEATED = 100_000  # values that come from aliases

_PARSER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # the former is ten times faster
_NOT_YAML = re.compile("[^\t\n\r\x20-\x7e\x85\xa0-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_NUMBER = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_WORDS = {
    word: value
    for value, words in (
        (None, ", ~, null, Null, NULL"),
        (True, "true, True, TRUE"),
        (False, "false, False, FALSE"),
        (float("nan"), ".nan, .NaN, .NAN"),
    )
    for word in words.split(", ")
}
_WORDS |= {
    sign + word: float(sign + "inf") for sign in ("", "+", "-") for word in (".inf", ".Inf", ".INF")
}


def load_scene(name_or_path: str | os.PathLike[str]) -> Scene:
    """Read a scene from a file, given by its path or, for an example scene, by its name."""
    path = find_scene(name_or_path)
    try:
        if not os.path.isfile(path):
            raise SceneError(f"{path}: is not a file: give the path of a scene file (.yaml)")
        if os.path.getsize(path) > LARGEST_FILE:
            raise SceneError(
                f"{path}: is larger than {LARGEST_FILE >> 20} MiB: "
                "give the path of a scene file (.yaml)"
            )
        content = path.read_bytes()
    except OSError as error:
        raise SceneError(f"{path}: cannot be read: {error.strerror}") from None
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise SceneError(
            f"{path}:{line}: is not UTF-8 text: give a scene file (.yaml), saved as UTF-8"
        ) from None
    return scene_from_text(text, source=str(path))


def scene_from_text(text: str, source: str = "scene") -> Scene:
    """Scene of a YAML text, such as that of a recording; assembled if it says so.

    source : path or name that errors start with; becomes scene.source
    """
    return _made(text, source, True)


def scene_as_written(text, source="scene"):
    """Scene of a YAML text before assembly: the given numbers; joints may be violated."""
    return _made(text, source, False)


def _made(text, source, complete):
    root = _read(text, source)
    if not isinstance(root.value, dict):
        raise SceneError(
            f"{source}:{root.line}: a scene must be a mapping with the keys "
            f"{', '.join(Scene.model_fields)}, got {shown(root.value)}"
        )
    try:
        scene = Scene(**root.value)
        scene = assembled(scene) if complete else scene
        scene._text, scene._source, scene._line_of = text, source, root.line_of
        if complete:
            check_consistency(scene)
    except SceneError as error:
        line = root.line_of(error.place or ())
        raise SceneError(f"{source}:{line}: {error}", error.place) from None
    return scene


def find_scene(name_or_path: str | os.PathLike[str]) -> Path:
    """Path of a scene file: an existing file, else an example scene of that name."""
    given = Path(name_or_path)
    if os.path.isfile(given):
        return given
    known = {
        path.stem: path for folder in reversed(_folders()) for path in sorted(folder.glob("*.yaml"))
    }
    name = str(given).removesuffix(".yaml")
    if name in known:
        return known[name]
    if os.path.exists(given):
        return given
    hint = suggestion(name, sorted(known)) if known else "give the path of a scene file (.yaml)"
    raise SceneError(f"{given}: is neither a file nor a known scene; {hint}")


def _folders():
    """Folders with example scenes, the nearest to this file first."""
    here = Path(__file__).resolve()
    prefixes = [
        *here.parents,
        *os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep),
        sys.prefix,
    ]
    folders = [here.parents[2] / "config" / "scenes"]
    folders += [Path(prefix) / SHARE for prefix in prefixes if prefix]
    return [folder for folder in folders if folder.is_dir()]


class _Entry:
    """Value of the file, with its line and those of its parts.

    value : dict, list, str, int, float, bool or None
    line  : 1-based line of its start; in a mapping, that of its key
    parts : entries by key or index
    size  : number of values in it; values of aliases count in full
    key   : in an unfinished mapping, the entry of the key whose value comes next
    done  : False while its parts are being read
    """

    __slots__ = ("value", "line", "parts", "size", "key", "done")

    def __init__(self, value, line, done=True):
        self.value, self.line, self.done = value, line, done
        self.parts, self.size, self.key = {}, 1, None

    def add(self, part):
        """Take up the next key, value or list entry that was read."""
        self.size += part.size
        if isinstance(self.value, list):
            self.parts[len(self.value)] = part
            self.value.append(part.value)
        elif self.key is None:
            if not isinstance(part.value, str):
                raise _Refused(part.line, f"a key must be text, got {shown(part.value)}")
            if part.value in self.parts:
                raise _Refused(
                    part.line,
                    f"key {shown(part.value)} is given twice, first on line "
                    f"{self.parts[part.value].line}: keep one",
                )
            self.key = part
        else:
            part.line = self.key.line
            self.parts[self.key.value] = part
            self.value[self.key.value] = part.value
            self.key = None

    def line_of(self, place):
        """Line of the innermost part that the file has on the path to a place."""
        entry = self
        for step in place:
            if step not in entry.parts:
                break
            entry = entry.parts[step]
        return entry.line


class _Refused(Exception):
    """Content on a line that a scene must not have."""

    def __init__(self, line, message):
        super().__init__(message)
        self.line = line


def _read(text, source):
    """Root entry of a YAML text, or SceneError."""
    odd = _NOT_YAML.search(text)
    if odd:
        line = len(text[: odd.end()].splitlines())
        raise SceneError(
            f"{source}:{line}: is not YAML: contains the character {odd.group()!a}; remove it"
        )
    # the parser reports an end that comes too early on the line after the last one
    last_line = max(1, len(text.splitlines()))
    try:
        root = _root(yaml.parse(text, Loader=_PARSER), last_line, len(text) + MOST_REPEATED)
    except _Refused as error:
        raise SceneError(f"{source}:{error.line}: {error}") from None
    except yaml.MarkedYAMLError as error:
        line = min(error.problem_mark.line + 1, last_line)
        raise SceneError(
            f"{source}:{line}: is not YAML: {error.problem}; check indentation "
            "(blanks, no tabs), colons and brackets up to here"
        ) from None
    if root is None or root.value is None:
        raise SceneError(
            f"{source}:1: is empty: a scene has the keys {', '.join(Scene.model_fields)}"
        )
    return root


def _root(events, last_line, most):
    """Root entry of the parser's events with at most so many values; None without a document.

    It uses its own stack, so that no input can exhaust Python's. An alias shares its value: its
    size is known, and refused if too large, before it is expanded.
    """
    root, stack, anchors = None, [], {}
    for event in events:
        line = min(event.start_mark.line + 1, last_line)
        if isinstance(event, yaml.DocumentStartEvent) and root:
            raise _Refused(line, "a second YAML document starts here: keep one")
        if isinstance(event, yaml.NodeEvent) and getattr(event, "tag", None):
            raise _Refused(line, f"the tag {shown(event.tag)} is not used in scenes: remove it")
        if isinstance(event, yaml.CollectionStartEvent):
            value = {} if isinstance(event, yaml.MappingStartEvent) else []
            stack.append(_Entry(value, line, done=False))
            anchors[event.anchor] = stack[-1]
            if len(stack) > DEEPEST:
                raise _Refused(
                    line,
                    f"is nested deeper than {DEEPEST} levels: "
                    "a scene is a flat list of bodies, joints and forces",
                )
            continue
        if isinstance(event, yaml.CollectionEndEvent):
            entry = stack.pop()
            entry.done = True
        elif isinstance(event, yaml.ScalarEvent):
            entry = anchors[event.anchor] = _Entry(_scalar(event), line)
        elif isinstance(event, yaml.AliasEvent):
            entry = _repeated(event.anchor, anchors, line)
        else:
            continue
        if not stack:
            root = entry
            continue
        stack[-1].add(entry)
        if stack[-1].size > most:
            raise _Refused(line, f"aliases repeat more than {MOST_REPEATED} values: write them out")
    return root


def _scalar(event):
    """Value of a scalar: text if quoted, else by the rules of YAML 1.2."""
    text = event.value
    if not event.implicit[0]:
        return text
    if text in _WORDS:
        return _WORDS[text]
    if not _NUMBER.fullmatch(text):
        return text
    # Python limits the digits of an integer; as a float it is finite or infinite.
    return int(text) if len(text) < 18 and text.lstrip("+-").isdigit() else float(text)


def _repeated(anchor, anchors, line):
    """Entry for an alias."""
    target = anchors.get(anchor)
    if target is None or not target.done:
        raise _Refused(
            line, f"the alias *{anchor:.40} has no anchor before it: write the value out"
        )
    entry = _Entry(target.value, line)
    entry.parts, entry.size = target.parts, target.size
    return entry
