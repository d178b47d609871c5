"""Make the pages of the nodes from what they say of themselves and from the schema of the parameters.

A hook of mkdocs (see mkdocs.yml): the pages are made anew with every website and are not kept. On the page of faults
the names of the tests, which would fill most of its tables, are folded.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from dqwalk_ros.config import Spec
from dqwalk_ros.nodes.command_line import docstring, parameters_of
from dqwalk_ros.support.node_table import NODES

FOLDER = Path(__file__).resolve().parent / "nodes"
_TESTS = re.compile(r"(?<=\| )`[\w/]+\.py\b[^|]*`(?= \|)")
"""A cell that names tests."""


def page(name: str) -> str:
    """Return the page of a node."""
    what, _, about = docstring(name).partition("\n\n")
    lines = [f"# {name}", "", what, ""]
    lines += ["```text", f"ros2 run dqwalk_ros {name} --help", f"dqwalk_{name} --help", "```"]
    lines += ["", "```text", about.replace("::\n", ":\n"), "```", "", "## Parameters", ""]
    specs = parameters_of(name)
    if not specs:
        lines.append("None of its own; it takes every parameter of the package, so that one file serves all nodes.")
    else:
        lines += ["| name | default | range | meaning |", "|---|---|---|---|", *map(_row, specs)]
    return "\n".join(lines) + "\n"


def _row(spec: Spec) -> str:
    value = str(spec.default).lower() if spec.type is bool else str(spec.default)
    value = "(none)" if spec.default in ("", ()) else value
    limits = ", ".join(spec.choices)
    if not limits and (spec.low is not None or spec.high is not None):
        low, high = ("" if bound is None else f"{bound:g}" for bound in (spec.low, spec.high))
        limits = f"{low} to {high}"
    meaning = spec.meaning.replace("|", "\\|").replace("*", "\\*")
    return f"| `{spec.name}` | {value} {spec.unit}".rstrip() + f" | {limits} | {meaning} |"


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Add links to the pages of the nodes to the first page, whose source has none: they exist on the website only.

    Names of tests on the page of faults are folded.
    """
    if page.file.src_uri == "faults.md":
        return _TESTS.sub(_folded, markdown)
    if page.file.src_uri != "index.md":
        return markdown
    links = ", ".join(f"[{node}](nodes/{node}.md)" for node in NODES)
    return f"{markdown.rstrip()}\n\nPages of the nodes: {links}.\n"


def _folded(tests: re.Match[str]) -> str:
    count = tests[0].count("`") // 2
    return f"<details><summary>{count} test{'s' * (count > 1)}</summary>{tests[0]}</details>"


def on_pre_build(config: Any) -> None:
    """Write docs/nodes/NAME.md; mkdocs calls this."""
    FOLDER.mkdir(exist_ok=True)
    for node in NODES:
        (FOLDER / f"{node}.md").write_text(page(node), encoding="utf-8")
