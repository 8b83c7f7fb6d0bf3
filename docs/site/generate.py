# SPDX-License-Identifier: Apache-2.0
"""Hook of MkDocs: pages that the code writes, and files outside of docs/ that pages link to.

A part of a page within `<!-- site ... -->` is on the site only.
"""

import os
import posixpath
import re
from pathlib import Path

from mkdocs.structure.files import File

import liegroup_core
import liegroup_sim_ros
from liegroup_core.scene.keys import key_tables
from liegroup_core.settings import SETTINGS
from liegroup_sim_ros.commands.main import COMMANDS, make_parser
from liegroup_sim_ros.node.entry import USAGE
from liegroup_sim_ros.node.parameter_texts import table_text

ROOT = Path(__file__).resolve().parents[2]
OUTSIDE = "repository"  # folder of the site for files outside of docs/
LINK = re.compile(r"(\]\()([^)#\s:]+)(#[^)\s]*)?(?=\))")
FENCES = re.compile(r"(^ *```.*?^ *```)", re.M | re.S)
FOLDERS = {"How to": "how-to", "Reference": "reference", "Explanation": "explanation"}
PAGES = ("architecture.md", f"{OUTSIDE}/CONTRIBUTING.md", f"{OUTSIDE}/CHANGELOG.md")


def parameters():
    """Page of the parameters of the node."""
    return f"# Parameters of the node\n\n[The node](node.md) explains them.\n\n{table_text()}\n"


def settings():
    """Page of the settings of a run."""
    lines = [
        "# Settings of a run",
        "",
        "[From Python](python.md) and [commands](commands.md) say how to give them.",
        "",
    ]
    lines += ["| setting | default | allowed | meaning |", "|---|---|---|---|"]
    for each in SETTINGS.values():
        lines.append(f"| `{each.name}` | {each.means or each.shown_default} | {each.allowed} | {each.meaning} |")
    return "\n".join([*lines, ""])


def scene_keys():
    """Page of the keys of a scene file."""
    lines = ["# Keys of a scene file", "", "[Scene format](scene_format.md) explains them."]
    for table in key_tables():
        lines += ["", f"## {table.title}", "", table.summary, ""]
        lines += ["| key | meaning | default |", "|---|---|---|"]
        lines += [f"| `{key.name}` | {key.meaning} | {key.default} |" for key in table.keys]
    return "\n".join([*lines, ""])


def command_options():
    """Page with the help of all commands."""
    os.environ["COLUMNS"] = "100"
    lines = ["# Options of the commands", "", "[Commands](commands.md) says what each is for."]
    for name in COMMANDS:
        parser = make_parser(name)
        (choice,) = (action.choices for action in parser._actions if action.choices)
        lines += ["", f"## {name}", "", "```text", choice[name].format_help().rstrip(), "```"]
    return "\n".join([*lines, "", "## sim_node", "", "```text", USAGE, "```", ""])


def python_api():
    """Page with the docstrings of all public names."""
    lines = ["# Python API", "", "[From Python](python.md) shows how to use it."]
    for module in (liegroup_core, liegroup_sim_ros):
        lines += ["", f"## {module.__name__}"]
        names = [name for name in module.__all__ if not name.startswith("_")]
        lines += [f"\n::: {module.__name__}.{name}" for name in names]
    return "\n".join([*lines, ""])


WRITTEN = {
    "reference/parameters.md": parameters,
    "reference/settings.md": settings,
    "reference/scene_keys.md": scene_keys,
    "reference/command_options.md": command_options,
    "reference/api.md": python_api,
}


def on_config(config):
    """Order of the pages: learn, do, look up, understand, change."""
    docs = Path(config.docs_dir)
    config.nav = ["README.md", "tutorial.md"]
    for title, folder in FOLDERS.items():
        pages = {f"{folder}/{path.name}" for path in (docs / folder).glob("*.md")}
        pages |= {name for name in WRITTEN if name.startswith(f"{folder}/")}
        config.nav.append({title: sorted(pages)})
    config.nav.append({"Development": list(PAGES)})
    return config


def on_files(files, config):
    """Add the written pages, and what pages link to outside of docs/."""
    for name, write in WRITTEN.items():
        files.append(File.generated(config, name, content=write()))
    waiting = [f"docs/{file.src_uri}" for file in files.documentation_pages()]
    waiting = [path for path in waiting if (ROOT / path).exists()]
    while waiting:
        path = waiting.pop()
        for _, link, _ in LINK.findall((ROOT / path).read_text(encoding="utf-8")):
            target = posixpath.normpath(posixpath.join(posixpath.dirname(path), link))
            name = _on_site(target)
            if name.startswith(OUTSIDE) and (ROOT / target).is_file() and name not in files.src_uris:
                files.append(File.generated(config, name, abs_src_path=str(ROOT / target)))
                waiting += [target] * target.endswith(".md")
    return files


def on_page_markdown(markdown, page, config, files):
    """Let links outside of docs/ lead to the files of the site; show what only the site has."""
    markdown = re.sub(r"<!-- site\s+(.*?)\s*-->", r"\1", markdown, flags=re.S)
    path = _in_repository(page.file.src_uri)

    def on_site(match):
        target = posixpath.normpath(posixpath.join(posixpath.dirname(path), match[2]))
        start = posixpath.dirname(page.file.src_uri)
        return f"{match[1]}{posixpath.relpath(_on_site(target), start or '.')}{match[3] or ''}"

    parts = FENCES.split(markdown)
    return "".join(part if k % 2 else LINK.sub(on_site, part) for k, part in enumerate(parts))


def _on_site(path):
    """Name on the site of a file of the repository."""
    inside = path.startswith("docs/")
    return path.removeprefix("docs/") if inside else f"{OUTSIDE}/{path}"


def _in_repository(name):
    """Path in the repository of a file of the site."""
    outside = name.startswith(f"{OUTSIDE}/")
    return name.removeprefix(f"{OUTSIDE}/") if outside else f"docs/{name}"
