"""What the site has beyond the pages of docs/: numbers in prose, results, documents of the root, help of commands."""

from __future__ import annotations

import io
import posixpath
import re
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
SHOWN = (".md", ".png")
"""Files of results/ that the site has; the others are in the repository."""
LINK = re.compile(r"\[(?P<text>[^\[\]]*)\]\((?P<target>[^)#\s]+)(?P<part>#[^)\s]*)?\)")


def on_files(files: Files, config: MkDocsConfig, **_: Any) -> Files:
    """Add the results, the documents of the root, and the pages of what the archive holds."""
    results = [path for path in sorted((ROOT / "results").rglob("*")) if path.suffix in SHOWN]
    for path in (*(ROOT / name for name in OF_THE_ROOT), *results):
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


def on_page_markdown(markdown: str, page: Any, config: MkDocsConfig, files: Files, **_: Any) -> str:
    """Let links lead to where files stand in the site, and fill in numbers and the help of the commands."""
    documents = import_module("bench.reporting.documents")
    if any(documents.used(markdown)):
        markdown = documents.filled(markdown, _facts())
    if PLACE in markdown:
        pages = (f"## `{f'python -m bench {verb}'.strip()}`\n\n```text\n{text}\n```" for verb, text in helps().items())
        markdown = markdown.replace(PLACE, "\n\n".join(pages))
    source = page.file.src_uri

    def moved(link: re.Match[str]) -> str:
        if re.match(r"\w+:|/", link["target"]):
            return link[0]
        target = _place(source, link["target"])
        inside = posixpath.relpath(target, posixpath.dirname(source) or ".")
        if files.get_file_from_path(target):
            return f"[{link['text']}]({inside}{link['part'] or ''})"
        if (ROOT / target).exists():
            return f"[{link['text']}]({config.repo_url}/blob/main/{target})" if config.repo_url else link["text"]
        return link[0]

    return LINK.sub(moved, markdown)


def _place(source: str, target: str) -> str:
    """Where a link's target stands in the site, in which docs/ is the root beside results/ and the documents."""
    outside = source in (README, *OF_THE_ROOT) or source.startswith("results/")
    folder = posixpath.dirname(source if outside else f"docs/{source}")
    found = posixpath.normpath(posixpath.join(folder, target))
    if found.startswith("results") and (ROOT / found).is_dir():
        return "results/README.md"
    return README if found == "README.md" else found.removeprefix("docs/")


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
