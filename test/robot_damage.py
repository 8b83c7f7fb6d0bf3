# SPDX-License-Identifier: Apache-2.0
"""Damaged texts of robots: random characters, values and lines."""

import re

WORDS = ["0", "-1", "1e308", "nan", "inf", "", "1 2", "text", "upper", "slide", "world", "<", "&a;", "\u00e9"]


def mutated(text, rng):
    """Text with one to three random changes: characters, values, lines, and what is between tags."""
    for _ in range(rng.integers(1, 4)):
        kind = rng.integers(6)
        if kind == 0:
            at = rng.integers(len(text))
            text = text[:at] + text[at + rng.integers(1, 40) :]
        elif kind == 1:
            at = rng.integers(len(text))
            text = text[:at] + WORDS[rng.integers(len(WORDS))] + text[at:]
        elif kind == 2:
            values = list(re.finditer(r'"[^"]*"', text))
            if values:
                found = values[rng.integers(len(values))]
                word = WORDS[rng.integers(len(WORDS))]
                text = f'{text[: found.start()]}"{word}"{text[found.end() :]}'
        elif kind == 3:
            lines = text.splitlines(keepends=True)
            del lines[rng.integers(len(lines))]
            text = "".join(lines)
        elif kind == 4:
            lines = text.splitlines(keepends=True)
            at = rng.integers(len(lines))
            text = "".join([*lines[:at], lines[at] * 2, *lines[at + 1 :]])
        else:
            values = list(re.finditer(r">[^<>]+<", text))
            if values:
                found = values[rng.integers(len(values))]
                word = WORDS[rng.integers(len(WORDS))]
                text = f"{text[: found.start()]}>{word}<{text[found.end() :]}"
        if not text:
            return "<"
    return text
