"""The site builds without a warning, is complete, and loads nothing from elsewhere."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from html import unescape
from pathlib import Path

import pytest
from conftest import REPOSITORY
from pages import DOCUMENTS

import bench

ASSET = re.compile(r"""<(?:script|img|link|iframe|source|video|audio)\b[^>]*?(?:src|href)=["']?([^"'\s>]+)""")
SHEET = re.compile(r"""url\(["']?([^"')]+)|@import\s+["']([^"']+)""")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("mkdocs")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    path = os.pathsep.join([str(REPOSITORY), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1", "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1"}
    build = subprocess.run(command, cwd=REPOSITORY, env=environment, capture_output=True, text=True)
    assert build.returncode == 0, build.stderr
    return folder


@pytest.mark.slow
def test_every_page_is_in_the_site(site: Path) -> None:
    for path in DOCUMENTS:
        if (REPOSITORY / "docs") in path.parents:
            assert (site / path.relative_to(REPOSITORY / "docs")).with_suffix(".html").is_file(), path
    assert (site / "results" / "index.html").is_file()
    assert (site / "search" / "search_index.json").is_file()  # the search of a site on a server


@pytest.mark.slow
def test_the_site_loads_nothing_from_elsewhere(site: Path) -> None:
    pages = list(site.rglob("*.html"))
    assert len(pages) > len(DOCUMENTS) / 2
    for page in pages:
        for target in ASSET.findall(page.read_text(encoding="utf-8")):
            assert not re.match(r"(?:https?:)?//", unescape(target)), (page, target)
    for sheet in site.rglob("*.css"):
        for urls in SHEET.findall(sheet.read_text(encoding="utf-8")):
            assert not re.match(r"(?:https?:)?//", "".join(urls)), (sheet, urls)


@pytest.mark.slow
def test_links_of_the_site_lead_to_files(site: Path) -> None:
    pages = [page for page in site.rglob("*.html") if page.name != "404.html" and "results" not in page.parts]
    for page in pages:
        for target in re.findall(r"""<a\b[^>]*?href=["']?([^"'\s>#]+)""", page.read_text(encoding="utf-8")):
            if not re.match(r"\w+:", unescape(target)):
                assert (page.parent / unescape(target)).exists(), (page, target)


@pytest.mark.slow
def test_every_public_name_command_and_term_is_shown(site: Path) -> None:
    python = (site / "reference" / "python.html").read_text(encoding="utf-8")
    assert [name for name in bench.__all__ if f'id="bench.{name}"' not in python] == []
    commands = (site / "reference" / "commands.html").read_text(encoding="utf-8")
    assert "python -m bench certify" in commands
    assert "usage: python -m bench method=" in commands
    guide = (site / "how_to" / "run_cells.html").read_text(encoding="utf-8")
    assert re.search(r'href="?\.\./reference/glossary\.html#cell"? title="One method', guide)
