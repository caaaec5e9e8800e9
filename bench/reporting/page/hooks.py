"""What mkdocs does to every site: the search works from a folder and has a name, and nothing superfluous stays."""

from __future__ import annotations

import re
import shutil
from html import unescape
from importlib.metadata import version
from pathlib import Path
from typing import Any

from mkdocs.plugins import event_priority

SHIM = "https://unpkg.com/iframe-worker/shim"
"""Where the theme would load from what lets the search work from a folder (iframe-worker, MIT)."""
DIALOG = 'data-md-component="search" role="dialog"'
NOTHING = re.compile(
    r"<meta name=\"generator\"[^>]*>|\s*</(?:li|tbody|td|th|thead|tr)>\s*"
    r"|\s+(?=</?(?:div|footer|form|h[1-6]|header|link|main|meta|nav|p|table|ul)\b)"
)
"""End tags that HTML lets one leave out (https://html.spec.whatwg.org/#optional-tags), and blanks between blocks."""
SUPERFLUOUS = ("sitemap.xml*", "search/search_index.json", "assets/**/*.map", "assets/javascripts/lunr/*")
"""Files with a date, what only debugging or another language needs, and what the search reads as a script."""


def on_config(config: Any, **_: Any) -> Any:
    """Say in the footer of every page whose it is."""
    config.copyright = f"vibration-bench {version('vibration-bench')} · MIT licence · to cite: CITATION.cff"
    return config


def on_page_markdown(markdown: str, page: Any, **_: Any) -> None:
    """Leave the numbers of tables, and what was once changed, out of the search."""
    if re.match(r"results/(?!README)|CHANGELOG", page.file.src_uri):
        page.meta["search"] = {"exclude": True}


def on_page_context(context: Any, page: Any, **_: Any) -> Any:
    """Leave no tag in a title, which the theme does not escape."""
    page.title = unescape(page.title or "").replace("<", "‹").replace(">", "›")
    return context


def on_post_page(output: str, page: Any, **_: Any) -> str:
    """Finish a page."""
    return _finished(output, "../" * page.url.count("/"))


def on_post_template(output_content: str, template_name: str, **_: Any) -> str:
    """Finish the page for what is not found."""
    return _finished(output_content, "")


@event_priority(-200)  # behind the plugin that makes a script of the search's index
def on_post_build(config: Any, **_: Any) -> None:
    """Remove what no page uses."""
    for path in (path for pattern in SUPERFLUOUS for path in Path(config.site_dir).glob(pattern)):
        shutil.rmtree(path) if path.is_dir() else path.unlink()


def _finished(html: str, root: str) -> str:
    """A page that asks for nothing elsewhere, without the theme's indentation and without end tags of cells."""
    html = html.replace(SHIM, f"{root}static/iframe-worker.js").replace(DIALOG, f'{DIALOG} aria-label="Search"')
    parts = re.split(r"(<pre\b.*?</pre>)", html, flags=re.DOTALL)
    return "".join(part if part.startswith("<pre") else _packed(part) for part in parts)


def _packed(html: str) -> str:
    return NOTHING.sub("", re.sub(r"\s*\n\s*", "\n", html))
