"""What mkdocs does to every page of a site: the search works from a folder, and has a name for screen readers."""

from __future__ import annotations

from html import unescape
from importlib.metadata import version
from typing import Any

SHIM = "https://unpkg.com/iframe-worker/shim"
"""Where the theme would load from what lets the search work from a folder (iframe-worker, MIT)."""
DIALOG = 'data-md-component="search" role="dialog"'


def on_config(config: Any, **_: Any) -> Any:
    """Say in the footer of every page whose it is."""
    config.copyright = f"vibration-bench {version('vibration-bench')} · MIT licence · to cite: CITATION.cff"
    return config


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


def _finished(html: str, root: str) -> str:
    return html.replace(SHIM, f"{root}static/iframe-worker.js").replace(DIALOG, f'{DIALOG} aria-label="Search"')
