"""A Jupyter notebook of every example of the gallery, written when the site is built."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files, InclusionLevel
from mkdocs.structure.pages import Page

GALLERY = Path(__file__).parent / "gallery"
PART = re.compile(
    r'^```(?P<language>\w+)(?: title="(?P<title>[^"]+)")?\n(?P<code>.*?)^```$'
    r"|^!\[[^\]]*\]\((?P<picture>[^)]+)\)$",
    re.DOTALL | re.MULTILINE,
)
"""A block of code, or a picture on a line of its own."""
LINK = re.compile(r"(?<!!)\[([^\]]+)\]\((?!http)[^)]+\)")
"""A link to another page, which a downloaded notebook cannot follow."""


def on_files(files: Files, config: MkDocsConfig, **_: Any) -> Files:
    """Add a notebook for each example."""
    for example in sorted(GALLERY.glob("*.md")):
        if example.stem != "index":
            text = json.dumps(notebook(example.read_text(encoding="utf-8"), GALLERY), ensure_ascii=False, indent=1)
            name = f"gallery/{example.stem}.ipynb"
            files.append(File.generated(config, name, content=text, inclusion=InclusionLevel.NOT_IN_NAV))
    return files


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Link to the notebook below the title of an example."""
    path = Path(page.file.src_uri)
    if path.parent.name != "gallery" or path.stem == "index":
        return markdown
    title, text = markdown.split("\n", 1)
    return f"{title}\n\n[Download as a notebook]({path.stem}.ipynb)\n{text}"


def notebook(text: str, folder: Path) -> dict[str, Any]:
    """Convert an example to a notebook with its outputs and pictures.

    Args:
        text: Markdown of the example. Blocks of Python become cells of code, commands of the shell lines that begin
            with ``!``, blocks with a title cells that write that file, and blocks of text the output of the cell above.
        folder: the folder of its pictures.

    Returns:
        The content of the file, in version 4.5 of the notebook format.
    """
    cells: list[dict[str, Any]] = []
    position = 0
    for part in PART.finditer(text):
        _add_prose(cells, text[position : part.start()])
        position = part.end()
        if part["language"] == "sh":
            _add_prose(cells, part[0])
        elif part["picture"]:
            _add_picture(cells, part["picture"], (folder / part["picture"]).read_bytes())
        elif part["language"] in ("text", "txt"):
            printing = next(cell for cell in reversed(cells) if cell["cell_type"] == "code")
            printing["outputs"] = [{"output_type": "stream", "name": "stdout", "text": part["code"]}]
        elif part["title"]:
            _add_code(cells, f"%%writefile {part['title']}\n{part['code']}")
        else:
            _add_code(cells, part["code"] if part["language"] == "python" else _shell(part["code"]))
    _add_prose(cells, text[position:])
    metadata = {"kernelspec": {"name": "python3", "display_name": "Python 3"}, "language_info": {"name": "python"}}
    return {"nbformat": 4, "nbformat_minor": 5, "metadata": metadata, "cells": cells}


def _add_prose(cells: list[dict[str, Any]], text: str) -> None:
    if text.strip():
        source = LINK.sub(r"\1", text.strip())
        cells.append({"id": f"cell-{len(cells)}", "cell_type": "markdown", "metadata": {}, "source": source})


def _add_code(cells: list[dict[str, Any]], source: str) -> None:
    empty: dict[str, Any] = {"metadata": {}, "execution_count": None, "outputs": []}
    cells.append({"id": f"cell-{len(cells)}", "cell_type": "code", **empty, "source": source.rstrip()})


def _add_picture(cells: list[dict[str, Any]], name: str, content: bytes) -> None:
    if name.endswith(".svg"):
        display, kind, data = "SVG", "image/svg+xml", content.decode()
    else:
        display, kind, data = "Image", "image/png", base64.b64encode(content).decode()
    _add_code(cells, f'from IPython.display import {display}\n\n{display}("{name}")')
    cells[-1]["outputs"] = [{"output_type": "display_data", "data": {kind: data}, "metadata": {}}]


def _shell(code: str) -> str:
    """Return commands as IPython runs them; it installs packages into the environment of its own kernel."""
    lines = (re.sub(r"^python -m pip ", "%pip ", re.sub(r"\s+#.*", "", line)) for line in code.splitlines())
    return "\n".join(line if line.startswith("%") or not line else f"!{line}" for line in lines)
