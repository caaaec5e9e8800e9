"""The documents agree with the repository: files, headings, imports, commands and their fields."""

from __future__ import annotations

import ast
import re
import shlex
import subprocess
import sys
from contextlib import redirect_stdout
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from io import StringIO
from pathlib import Path

import pandas as pd
import pytest
from conftest import REPOSITORY
from pages import DOCUMENTS, blocks, commands, name

from bench.commands.main import main as bench_main
from bench.commands.verbs import VERBS

README = REPOSITORY / "README.md"
FREE_GROUPS = {"method", "system", "prior", "disturbance", "settings", "hydra", "fixed", "nominal"}
"""Groups whose fields a command's help does not list: ``<field>.<name>=`` is checked by the command alone."""
EXPERIMENT_MODULES = {
    "experiment=measured": "measured_track", "experiment=online": "online", "experiment=modal": "modal",
    "experiment=atlas": "atlas",
}  # fmt: skip
"""Experiments that have their own module and fields."""


def test_the_readme_is_short_and_shows_a_picture_commands_and_a_table() -> None:
    text = README.read_text(encoding="utf-8")
    assert len(text.split()) <= 1200
    assert len(re.findall(r"^!\[", text, re.MULTILINE)) == 1
    legend, _, table = text.partition("<!-- {{ chosen_rows }} -->")
    assert "**excess**" in legend
    assert "**Bold**" in legend
    assert table.lstrip().startswith("| method |")


@pytest.mark.parametrize("document", DOCUMENTS, ids=name)
def test_linked_files_exist(document: Path) -> None:
    """Links, and paths of this repository in code spans."""
    text = document.read_text(encoding="utf-8")
    for target in re.findall(LINKED, text):
        assert (document.parent / target).exists(), target
    for target in re.findall(r"`((?:bench|methods|tests|conf|docs|results)/[\w./]+?)/?`", text):
        assert (REPOSITORY / target).exists(), target


RESULTS = REPOSITORY / "results"
LINKED = r"\]\((?!http)([^)#]+)(?:#[^)]*)?\)"


@pytest.mark.parametrize("page", sorted(RESULTS.glob("*.md")), ids=name)
def test_files_linked_by_a_page_of_results_exist(page: Path) -> None:
    for target in re.findall(LINKED, page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), target


def test_every_published_figure_is_linked_by_a_page() -> None:
    pages = {*DOCUMENTS, *RESULTS.glob("*.md")}
    linked = {(p.parent / target).resolve() for p in pages for target in re.findall(LINKED, p.read_text("utf-8"))}
    assert {path.resolve() for path in (RESULTS / "figures").iterdir()} <= linked


@pytest.mark.parametrize("document", DOCUMENTS, ids=name)
def test_linked_headings_exist(document: Path) -> None:
    """Anchors are made as by the site and the usual forges: lower case, spaces as hyphens, no other characters."""
    for target, anchor in re.findall(r"\]\((?!http)([^)#]*)#([^)]+)\)", document.read_text(encoding="utf-8")):
        text = ((document.parent / target) if target else document).read_text(encoding="utf-8")
        headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
        assert anchor in {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}, anchor


@pytest.mark.parametrize("document", DOCUMENTS, ids=name)
def test_imports_of_a_document_exist(document: Path) -> None:
    """Every Python block is valid, and every name of ``from bench... import name`` exists."""
    for block in (block for block in blocks(document) if block.language == "python"):
        for node in ast.walk(ast.parse(block.code)):
            if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "bench":
                for alias in node.names:
                    assert hasattr(import_module(str(node.module)), alias.name), alias.name


@pytest.mark.parametrize("document", DOCUMENTS, ids=name)
def test_modules_of_commands_exist(document: Path) -> None:
    """The modules behind ``python -m``, in blocks and in prose."""
    for module in re.findall(r"python -m\s((?:bench|tests)[\w.]*\w)", document.read_text(encoding="utf-8")):
        assert find_spec(module) is not None, module


def arguments(text: str) -> list[str]:
    """Return the words of a command line, which may be quoted itself: ``sbatch --wrap 'python -m bench method=ls'``."""
    return shlex.split(text.removesuffix("'") if text.count("'") % 2 else text)


def written(document: Path) -> set[tuple[str, ...]]:
    """Return the words of every command of ``python -m bench`` in a document's blocks."""
    lines = {line for block in blocks(document) if block.language in ("bash", "sh") for line in commands(block)}
    matches = [re.search(r"python -m bench ?(.*)", re.sub(r"\s[<>]\s.*", "", line)) for line in lines]
    return {tuple(arguments(match[1])) for match in matches if match}


@cache
def help_of(*words: str) -> str:
    """Return what a verb, or ``python -m bench`` itself, prints as its help."""
    with redirect_stdout(StringIO()) as out:
        bench_main([*words, "--help"])
    return out.getvalue()


@pytest.mark.parametrize("document", DOCUMENTS, ids=name)
def test_fields_of_a_command_are_in_its_help(document: Path) -> None:
    """A field that a document uses is in the help of its command, or in that of ``python -m bench``."""
    for given in written(document):
        sources = [
            "conf/config.yaml",
            *(f"bench/commands/{EXPERIMENT_MODULES[word]}.py" for word in given if word in EXPERIMENT_MODULES),
        ]
        helps = help_of() + "".join((REPOSITORY / path).read_text(encoding="utf-8") for path in sources)
        helps += help_of(given[0]) if given and given[0] in VERBS else ""
        for argument in given:
            field = re.match(r"\+?([\w./]+)=", argument)
            if field and re.split(r"[./]", field[1])[0] not in FREE_GROUPS:
                assert re.search(rf"\b{re.escape(field[1].partition('.')[0])}\b", helps), argument


@pytest.mark.slow
def test_the_examples_with_pandas_give_the_published_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    """The medians that the first question prints are those of the published table 5."""
    page = REPOSITORY / "docs" / "how_to" / "regenerate_results.md"
    code = "\n".join(block.code for block in blocks(page) if block.language == "python")
    monkeypatch.chdir(REPOSITORY)
    finished = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    printed = dict(line.split() for line in finished.stdout.splitlines()[1:6])
    table = pd.read_csv(RESULTS / "table5.csv").query("snr_db == 10 and initial_state == 'unknown'")
    known = table[table["metric"] == "k_over_m_error_pct"].set_index("method")["median"]
    assert len(printed) == 5
    for label, median in printed.items():
        assert float(median) == pytest.approx(known[label], rel=1e-4)
    assert re.search(r"^shooting +\d\.\d+ +\d+$", finished.stdout, re.MULTILINE)
    assert re.search(r"^shooting +\d\.\d\d +\d\.\d\d", finished.stdout, re.MULTILINE)
