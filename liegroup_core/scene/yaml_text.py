# SPDX-License-Identifier: Apache-2.0
"""YAML reader of scene files: values with their line numbers.

Plain values are those of YAML 1.2 (numbers such as 1e4, true, false, null; everything else is
text). Tags, several documents and repeated keys are refused.

Own code on the events of PyYAML: its fast loader and that of ruamel.yaml crash the process on deep
nesting, and ruamel.yaml's loader with line numbers takes 20 times as long and drops tags silently.
"""

import re

import yaml

from liegroup_core.errors import SceneError
from liegroup_core.fields.values import QUOTE, shown

from .description import Scene

# A scene has five levels. Aliases may repeat parts of it, up to a limit.
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
_WORDS |= {sign + word: float(sign + "inf") for sign in ("", "+", "-") for word in (".inf", ".Inf", ".INF")}


class YamlNode:
    """Value of the file, with its line and the lines of its parts.

    value : dict, list, str, int, float, bool or None
    line  : 1-based line of its start; in a mapping, that of its key
    parts : entries by key or index
    size  : number of values in it; an alias counts with all its values
    key   : in an unfinished mapping, the entry of the key whose value comes next
    done  : False while its parts are being read
    """

    __slots__ = ("value", "line", "parts", "size", "key", "done")

    def __init__(self, value, line, done=True):
        self.value, self.line, self.done = value, line, done
        self.parts, self.size, self.key = {}, 1, None

    def add(self, part):
        """Add the next key, value or list entry."""
        self.size += part.size
        if isinstance(self.value, list):
            self.parts[len(self.value)] = part
            self.value.append(part.value)
        elif self.key is None:
            if not isinstance(part.value, str):
                raise _Refused(part.line, f"a key must be text, got {shown(part.value)}; {QUOTE}")
            if part.value in self.parts:
                raise _Refused(
                    part.line,
                    f"key {shown(part.value)} is given twice, first on line {self.parts[part.value].line}: keep one",
                )
            self.key = part
        else:
            part.line = self.key.line
            self.parts[self.key.value] = part
            self.value[self.key.value] = part.value
            self.key = None

    def line_of(self, place):
        """Line of the innermost existing part on the path to a place."""
        entry = self
        for step in place:
            if step not in entry.parts:
                break
            entry = entry.parts[step]
        return entry.line


class Lines:
    """Places in a text: Lines(source, root)(path inside the text) is "file:line"."""

    def __init__(self, source, root):
        self._source, self._root = source, root

    def __call__(self, place):
        return f"{self._source}:{self._root.line_of(place)}"

    def located(self, error):
        """SceneError with file and line."""
        return SceneError(f"{self(error.place or ())}: {error}", error.place)


class _Refused(Exception):
    """Content on a line that a scene must not have."""

    def __init__(self, line, message):
        super().__init__(message)
        self.line = line


def read_yaml(text, source, what="a scene", keys=tuple(Scene.model_fields)):
    """Root entry of a YAML text, or SceneError."""
    odd = _NOT_YAML.search(text)
    if odd:
        line = len(text[: odd.end()].splitlines())
        raise SceneError(f"{source}:{line}: is not YAML: contains the character {odd.group()!a}; remove it")
    # The parser reports a premature end of the file on the line after the last one.
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
        raise SceneError(f"{source}:1: is empty: {what} has the keys {', '.join(keys)}")
    return root


def _root(events, last_line, most):
    """Root entry of the parser's events, with at most `most` values; None if there is no document.

    An explicit stack prevents a recursion error for deeply nested input. An alias shares its value, so
    its size is known, and refused if too large, before it is expanded.
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
            stack.append(YamlNode(value, line, done=False))
            anchors[event.anchor] = stack[-1]
            if len(stack) > DEEPEST:
                raise _Refused(
                    line, f"is nested deeper than {DEEPEST} levels: a scene is a flat list of bodies, joints and forces"
                )
            continue
        if isinstance(event, yaml.CollectionEndEvent):
            entry = stack.pop()
            entry.done = True
        elif isinstance(event, yaml.ScalarEvent):
            entry = anchors[event.anchor] = YamlNode(_scalar(event), line)
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
    # Python limits the digits of integers that it parses. Floats have no such limit.
    return int(text) if len(text) < 18 and text.lstrip("+-").isdigit() else float(text)


def _repeated(anchor, anchors, line):
    """YamlNode for an alias."""
    target = anchors.get(anchor)
    if target is None or not target.done:
        raise _Refused(line, f"the alias *{anchor:.40} has no anchor before it: write the value out")
    entry = YamlNode(target.value, line)
    entry.parts, entry.size = target.parts, target.size
    return entry
