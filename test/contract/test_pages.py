# SPDX-License-Identifier: Apache-2.0
"""Links of the Markdown pages lead to files and headings that exist, and files that they name exist."""

import re
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[2]
PAGES = sorted(
    {path for path in SOURCE.glob("*.md")}
    | {
        path
        for folder in ("docs", "liegroup_core", "liegroup_sim_ros", "test")
        for path in (SOURCE / folder).rglob("*.md")
    }
)
LINK = re.compile(r"\]\(([^()\s]+)\)")
NAMED = re.compile(r"`((?:benchmarks|config|docs|launch|test)/[\w./-]+\.\w+)")
COMMENT = re.compile(r"<!--.*?-->", re.S)
BLOCK = re.compile(r"^ *```.*?^ *```", re.M | re.S)


def anchors(text):
    """Anchors of the headings of a page, as GitHub makes them."""
    found, counts = set(), {}
    for title in re.findall(r"^#+ +(.+)$", BLOCK.sub("", text), re.M):
        slug = re.sub(r"[^\w\- ]", "", re.sub(r"\[(.*?)\]\(.*?\)", r"\1", title).strip().lower())
        slug = slug.replace(" ", "-")
        counts[slug] = counts.get(slug, -1) + 1
        found.add(f"{slug}-{counts[slug]}" if counts[slug] else slug)
    return found


def wrong_links(path, text):
    """Links of a page within the repository that lead nowhere; comments are read by the site only."""
    for link in LINK.findall(COMMENT.sub("", BLOCK.sub("", text))):
        name, _, anchor = link.partition("#")
        if re.match(r"\w+:", link):
            continue
        target = path.parent / name
        if name and not target.exists():
            yield link
        elif anchor and anchor not in anchors(target.read_text("utf-8") if name else text):
            yield link


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(SOURCE)))
def test_links_and_names_of_files_exist(path):
    text = path.read_text(encoding="utf-8")
    assert list(wrong_links(path, text)) == []
    assert [name for name in NAMED.findall(text) if not (SOURCE / name).exists()] == []


def test_wrong_links_are_found():
    text = "# A page\n[a](#a-page) [b](#b) [c](none.md) [d](https://x.org/none.md)\n"
    assert list(wrong_links(SOURCE / "x.md", text)) == ["#b", "none.md"]


def test_pages_are_found():
    assert {"README.md", "docs/architecture.md"} <= {str(p.relative_to(SOURCE)) for p in PAGES}
