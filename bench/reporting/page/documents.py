"""The tables that other commands wrote as Markdown: each becomes a page, its tables sortable."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

OTHER_FORMS = (".csv", ".csv.gz", ".md")
FILES = "files"
"""The folder of the site with copies of them."""


@dataclass(frozen=True)
class ResultsDocument:
    """A page of a results file: ``files`` are the names of the forms in which it is there."""

    name: str
    title: str
    body: str
    tables: int
    files: tuple[str, ...]

    @property
    def href(self) -> str:
        return f"results/{self.name}.html"


def documents(folder: Path) -> list[ResultsDocument]:
    """Those of a folder, tables by number first."""
    found = [document(path) for path in sorted(folder.glob("*.md")) if path.name.lower() != "readme.md"]
    return sorted(found, key=lambda one: _order(one.name))


def _order(name: str) -> tuple[bool, int, str]:
    number = re.fullmatch(r"table(\d+)", name)
    return number is None, int(number.group(1)) if number else 0, name


def document(path: Path) -> ResultsDocument:
    """One of them; raises UnicodeDecodeError for what is no text."""
    text = path.read_text(encoding="utf-8")
    tokens = _parser().parse(text)
    title = next((tokens[i + 1].content for i, t in enumerate(tokens) if t.type == "heading_open"), path.stem)
    files = tuple(path.stem + ending for ending in OTHER_FORMS if path.with_name(path.stem + ending).is_file())
    return ResultsDocument(path.stem, title, _body(tokens), sum(t.type == "table_open" for t in tokens), files)


def _parser() -> Any:
    from markdown_it import MarkdownIt

    return MarkdownIt("commonmark", {"html": False}).enable("table")


FIGURE = r'<div class="scroll" tabindex="0" role="region" aria-label="\2">\1</div>'
"""A picture that stands alone: scrolled on a narrow page."""


def _body(tokens: Sequence[Any]) -> str:
    """The page's HTML, its first heading left out, links and pictures pointed at the site's copies."""
    heading, shown = "", []
    for i, token in enumerate(tokens):
        if token.type == "heading_open":
            heading = tokens[i + 1].content
        if token.type == "table_open":
            token.attrSet("data-grid", "")
            token.attrSet("data-name", heading)
        for child in token.children or ():
            _retarget(child)
        shown.append(token)
    first = next((i for i, token in enumerate(shown) if token.type == "heading_close"), -1)
    body = _parser().renderer.render(shown[first + 1 :], _parser().options, {})
    count = itertools.count(1)
    opened = '<div class="scroll" tabindex="0" role="region" aria-label="Table {} of this page"><table'
    body = re.sub("<table", lambda _: opened.format(next(count)), body)
    body = body.replace("</table>", "</table></div>")
    return re.sub(r'<p>(<img [^>]*?alt="([^"]*)"[^>]*>)</p>', FIGURE, body)


def _retarget(token: Any) -> None:
    for name in ("href", "src"):
        target = token.attrGet(name)
        if target is None or re.match(r"[a-z]+:|#", target):
            continue
        if name == "href" and re.fullmatch(r"[\w-]+\.md", target):
            token.attrSet(name, target.removesuffix(".md") + ".html")
        else:
            token.attrSet(name, f"../{target}" if target.startswith("figures/") else f"../{FILES}/{target}")
    if token.type == "image":
        token.attrSet("loading", "lazy")
