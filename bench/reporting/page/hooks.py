"""Hooks of mkdocs for every site: search with and without a server, accessible names, smaller pages."""

from __future__ import annotations

import re
import shutil
from html import unescape
from importlib.metadata import version
from pathlib import Path
from typing import Any

SHIM = "https://unpkg.com/iframe-worker/shim"
"""Address from which the theme loads the script for a search without a server (iframe-worker, MIT)."""
DIALOG = 'data-md-component="search" role="dialog"'
REDUNDANT = re.compile(
    r"<meta name=\"generator\"[^>]*>|\s*</(?:li|tbody|td|th|thead|tr)>\s*"
    r"|\s+(?=</?(?:div|footer|form|h[1-6]|header|link|main|meta|nav|p|table|ul)\b)"
)
"""End tags that are optional in HTML (https://html.spec.whatwg.org/#optional-tags), and blanks between blocks."""
SUPERFLUOUS = ("sitemap.xml*", "assets/**/*.map", "assets/javascripts/lunr/*")
"""Files that no page uses: they contain a date, or are for debugging, other languages."""


def on_config(config: Any, **_: Any) -> Any:
    """Set the footer of every page."""
    config.copyright = f"vibration-bench {version('vibration-bench')} · MIT licence · to cite: CITATION.cff"
    return config


def on_page_markdown(markdown: str, page: Any, **_: Any) -> None:
    """Exclude tables and the changelog from the search."""
    if re.match(r"results/(?!README)|CHANGELOG", page.file.src_uri):
        page.meta["search"] = {"exclude": True}


def on_page_context(context: Any, page: Any, **_: Any) -> Any:
    """Replace angle brackets in a title, which the theme does not escape."""
    page.title = unescape(page.title or "").replace("<", "‹").replace(">", "›")
    return context


def on_post_page(output: str, page: Any, **_: Any) -> str:
    """Finish a page."""
    return _finished(output, "../" * page.url.count("/"))


def on_post_template(output_content: str, template_name: str, **_: Any) -> str:
    """Finish the page for addresses that do not exist."""
    return _finished(output_content, "")


def on_post_build(config: Any, **_: Any) -> None:
    """Remove files that no page uses."""
    for path in (path for pattern in SUPERFLUOUS for path in Path(config.site_dir).glob(pattern)):
        shutil.rmtree(path) if path.is_dir() else path.unlink()


def _finished(html: str, root: str) -> str:
    """Return a page that loads nothing from other servers, without indentation and optional end tags."""
    html = html.replace(SHIM, f"{root}static/iframe-worker.js").replace(DIALOG, f'{DIALOG} aria-label="Search"')
    parts = re.split(r"(<pre\b.*?</pre>)", html, flags=re.DOTALL)
    return "".join(part if part.startswith("<pre") else _packed(part) for part in parts)


def _packed(html: str) -> str:
    return REDUNDANT.sub("", re.sub(r"\s*\n\s*", "\n", html))
