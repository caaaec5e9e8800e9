"""What the site has beyond the pages of docs/: numbers in prose, results, documents of the root, help of commands."""

from __future__ import annotations

import io
import posixpath
import re
from collections.abc import Iterator
from contextlib import redirect_stdout
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files, InclusionLevel

ROOT = Path(__file__).parents[1]
PLACE = "<!-- the help of every command, written by docs/hooks.py when the site is built -->"
FIRST = "<!-- the site has the first screen of the results in place of what is above -->"
README = "readme.md"
"""Where README.md stands in the site, whose first page is docs/index.md."""
OF_THE_ROOT = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "CITATION.cff", "LICENSE", "SECURITY.md")
LINK = re.compile(r"(?P<open>\]\()(?P<target>[^)#\s]+)(?P<rest>(?:#[^)\s]*)?\))")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the results, but for packed cells, the documents of the root, and the pages of what the archive holds."""
    for path in _beside():
        name = path.relative_to(ROOT).as_posix()
        place = README if name == "README.md" else name
        files.append(File.generated(config, place, abs_src_path=str(path), inclusion=InclusionLevel.NOT_IN_NAV))
    for name, content in _pages().items():
        if name != "index.md":
            files.append(File.generated(config, name, content=content, inclusion=InclusionLevel.NOT_IN_NAV))
    return files


def on_page_read_source(page: Any, **_: Any) -> str | None:
    """Begin the first page with the first screen of the results."""
    if page.file.src_uri != "index.md":
        return None
    return _pages()["index.md"].decode() + (ROOT / "docs" / "index.md").read_text(encoding="utf-8").partition(FIRST)[2]


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Let links lead to where files stand in the site, and fill in numbers and the help of the commands."""
    source = page.file.src_uri
    documents = import_module("bench.reporting.documents")
    if any(documents.used(markdown)):
        markdown = documents.filled(markdown, _facts())
    if PLACE in markdown:
        markdown = markdown.replace(PLACE, "\n\n".join(_helps()))
    return LINK.sub(lambda found: f"{found['open']}{_moved(source, found['target'])}{found['rest']}", markdown)


def _beside() -> Iterator[Path]:
    yield from (ROOT / name for name in OF_THE_ROOT if (ROOT / name).is_file())
    archive = ROOT / "results" / "archive"
    yield from (
        path for path in sorted((ROOT / "results").rglob("*")) if path.is_file() and archive not in path.parents
    )


def _moved(source: str, target: str) -> str:
    """The target of a link in the site: docs/ is its root, and results/ and the documents of the root stand in it."""
    if "://" in target or target.startswith(("mailto:", "/")):
        return target
    outside = source in (README, *OF_THE_ROOT) or source.startswith("results/")
    folder = posixpath.dirname(source if outside else f"docs/{source}")
    found = posixpath.normpath(posixpath.join(folder, target))
    if (ROOT / found).is_dir():
        found = "results/README.md" if found.startswith("results") else found
    inside = README if found == "README.md" else found.removeprefix("docs/")
    return posixpath.relpath(inside, posixpath.dirname(source) or ".")


def helps() -> dict[str, str]:
    """Return the page of help of a run, by the empty word, and of every verb by its name."""
    main, verbs = import_module("bench.commands.main").main, import_module("bench.commands.verbs").VERBS
    pages = {}
    for verb in ("", *verbs):
        page = io.StringIO()
        with redirect_stdout(page):
            main([*([verb] if verb else []), "--help"])
        pages[verb] = page.getvalue().strip()
    return pages


@cache
def _facts() -> Any:
    """What the documents say about results; a name that is unknown, or a conclusion that is false, ends the build."""
    return import_module("bench.reporting.sentences").facts(ROOT / "results")


@cache
def _pages() -> dict[str, bytes]:
    """The pages of the published results, and the files that they use, by path."""
    store, site = import_module("bench.store.store"), import_module("bench.reporting.page.site")
    published = store.open_store(ROOT / "build" / "no cells of one's own", str(ROOT / "results" / "archive"))
    return dict(site.site_files(published, ROOT / "results"))


def _helps() -> Iterator[str]:
    for verb, page in helps().items():
        yield f"## `python -m bench{f' {verb}' if verb else ''}`\n\n```text\n{page}\n```"
