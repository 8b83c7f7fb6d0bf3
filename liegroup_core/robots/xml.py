# SPDX-License-Identifier: Apache-2.0
"""XML reader for robot files: without entities or network access, with line numbers in errors."""

import math
import os
import re

import numpy as np
from lxml import etree

from liegroup_core.fields.values import LARGEST_NUMBER, suggestion

from .description import place, refusal, rotation_of_rpy

LARGEST_FILE = 64 * 2**20  # bytes; descriptions of large robots have 1 MB
LONGEST_NAME = 1000  # characters, also of the address of a mesh
# Prefixes of elements and attributes, declared ones, and the start of the first element.
_PREFIX = re.compile(rb"[<\s]/?([A-Za-z_][\w.-]*):[A-Za-z_][\w.-]*(?=[\s=/>])")
_DECLARED = re.compile(rb"\sxmlns:([A-Za-z_][\w.-]*)\s*=")
_ROOT = re.compile(rb"\A(?:\xef\xbb\xbf|\s|<\?.*?\?>|<!--.*?-->|<!DOCTYPE[^>]*>)*<[A-Za-z_][\w.:-]*", re.DOTALL)
MOST_PARTS = 500_000  # elements and attributes; a parsed one takes some 200 bytes


class Reader:
    """Reads values of the elements of one file; every error has the file and the line."""

    def __init__(self, file):
        self.file = str(file)

    def error(self, element, message):
        """SceneError at an element."""
        return refusal(self.file, element.sourceline if element is not None else 0, message)

    def name(self, element, key="name"):
        """Required attribute that is a name."""
        value = element.get(key)
        if not value or not value.strip():
            raise self.error(element, f"<{element.tag}> has no {key}: give one")
        if len(value) > LONGEST_NAME:
            raise self.error(
                element,
                f"{key} of <{element.tag}> has {len(value)} characters, {value[:20]!r}...: give at most {LONGEST_NAME}",
            )
        return value

    def number(self, element, text, what):
        """Finite number from a text."""
        try:
            value = float(text)
        except (TypeError, ValueError):
            raise self.error(element, f"{what} must be a number, got {_short(text)}") from None
        if not math.isfinite(value) or abs(value) > LARGEST_NUMBER:
            raise self.error(element, f"{what} must be a finite number, got {_short(text)}")
        return value

    def numbers(self, element, text, count, what):
        """(count,) finite numbers, separated by blanks."""
        parts = (text or "").split()
        if len(parts) != count:
            raise self.error(element, f"{what} must have {count} numbers, got {_short(text)}")
        return np.array([self.number(element, part, what) for part in parts])

    def attribute(self, element, key, default=None):
        """Number from an attribute, which is required if there is no default."""
        text = element.get(key)
        if text is None:
            if default is None:
                raise self.error(element, f"<{element.tag}> has no {key}: give one")
            return default
        return self.number(element, text, f"{key} of <{element.tag}>")

    def vector(self, element, key, default):
        """Vector (3,) from an attribute."""
        text = element.get(key)
        if text is None:
            return np.array(default, dtype=float)
        return self.numbers(element, text, 3, f"{key} of <{element.tag}>")

    def direction(self, element, vector, what):
        """Unit vector (3,)."""
        length = float(np.linalg.norm(vector))
        if not length > 1e-12:
            raise self.error(element, f"{what} must not be zero: give a direction")
        # A vector that already has unit length does not change.
        return vector if abs(length - 1.0) < 1e-15 else vector / length

    def pose_of(self, numbers):
        """(4, 4) pose from the numbers x y z roll pitch yaw."""
        return place(numbers[:3], rotation_of_rpy(*numbers[3:]) if numbers[3:].any() else None)

    def unknown(self, element, what, name, known):
        """SceneError for a name that does not exist."""
        hint = suggestion(name, sorted(known)) if known else "there are none"
        return self.error(element, f"{what} {name!r:.60} does not exist; {hint}")


def value_of(reader, element, key, default):
    """Number of a child element."""
    found = element.find(key)
    return float(default) if found is None else reader.number(found, found.text, f"<{key}>")


def _with_prefixes(content):
    """The bytes with a declaration of each prefix that has none, as readers that know no namespaces expect it."""
    used = set(_PREFIX.findall(content)) - set(_DECLARED.findall(content)) - {b"xml", b"xmlns"}
    root = _ROOT.search(content) if used else None
    if root is None:
        return content
    given = b"".join(b' xmlns:%s="%s"' % (prefix, prefix) for prefix in sorted(used))
    return content[: root.end()] + given + content[root.end() :]


def read_xml(path, text=None):
    """Root element of an XML file, or of `text` instead of the file's content. Raises SceneError.

    The parser expands no entities, opens no other files or addresses, and refuses elements nested deeper
    than 256 levels.
    """
    if text is None:
        with open(path, "rb") as file:
            content = file.read(LARGEST_FILE + 1)
    else:
        content = text.encode()
    if len(content) > LARGEST_FILE:
        raise refusal(path, 0, f"is larger than {LARGEST_FILE >> 20} MiB: give a robot file")
    if content.count(b"<") - content.count(b"</") + content.count(b"=") > MOST_PARTS:
        raise refusal(path, 0, f"has more than {MOST_PARTS} elements and attributes: give a robot file")
    content = _with_prefixes(content)
    parser = etree.XMLParser(
        resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False, remove_comments=True, remove_pis=True
    )
    try:
        root = etree.fromstring(content, parser, base_url=None)
    except etree.XMLSyntaxError as error:
        line = error.position[0] if error.position else 0
        raise refusal(path, line, f"is not XML: {_first_line(error)}; correct it") from None
    except ValueError as error:
        raise refusal(path, 0, f"is not XML: {_first_line(error)}; correct it") from None
    dtd = root.getroottree().docinfo.internalDTD
    if dtd is not None and any(True for _ in dtd.iterentities()):
        raise refusal(path, 1, "defines XML entities: write their texts out")
    for element in root.iter():
        if not isinstance(element.tag, str):
            raise refusal(path, element.sourceline, "contains an XML entity: write its text out")
    return root


def root_tag(path):
    """Tag of the root element of a file, or "" if it is not XML. It reads only the start of the file."""
    if os.path.getsize(path) > LARGEST_FILE:
        return ""
    with open(path, "rb") as file:
        head = file.read(4096)
    if not head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<"):
        return ""
    parser = etree.XMLPullParser(events=("start",), resolve_entities=False, no_network=True, load_dtd=False)
    try:
        parser.feed(head)
        for _, element in parser.read_events():
            return element.tag.split("}", 1)[-1] if isinstance(element.tag, str) else ""
    except etree.XMLSyntaxError:
        return ""
    return ""


def _first_line(error):
    """First line of an error's text, without the position, which the message gives in front."""
    text = str(error).splitlines()[0] if str(error) else type(error).__name__
    # The last two texts are hints for programmers, not for users.
    for end in (", line ", ", use XML_PARSE", ", see xmlCtxt"):
        text = text.split(end)[0]
    return text.strip()


def _short(text):
    """Shortened text for a message."""
    return "nothing" if text is None else repr(" ".join(str(text).split()))[:42]
