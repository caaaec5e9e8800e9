"""Captions, notes of tables, the page and docs type definitions only: measured numbers are filled in or printed."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from conftest import REPOSITORY

from bench.reporting.claims.allowed import ALLOWED, ALLOWED_IN
from bench.reporting.claims.document import Document, documents, prose, typed

REPORTING = REPOSITORY / "bench" / "reporting"
ROOMS = ("figures", "page", "tables")
MODULES = sorted(path for room in ROOMS for path in (REPORTING / room).glob("*.py"))
DEFINITIONS = (
    *ALLOWED,
    # levels of intervals and tests, and what follows from them
    r"\b(?:95|80|5) %",
    r"95 is what a band should have",
    r"inside in 95 of 100 data sets",
    r"one case of twenty by chance",
    r"\b1\.96\b",
    r"less than (?:2 %|once in 10,000 times)",
    r"more than 1 %",
    r"about 0\.67 of it for a normal error",
    # what a number means
    r"\b[01]00? % (?:is told )?by\b|\b0 % is told",
    r"(?:[Aa]t|below|about|line at|from|:|over Cramér-Rao bound:|is better,|over the bound,) 1\b(?! %)",
    r"cut at 6: of mean 0 and root mean square \(RMS\) 1",
    r"an RMS of 2 means intervals half as wide",
    r"one below 1, too wide",
    r"one in twenty is expected",
    r"90 in 100 further runs",
    r"1 is as good as can be",
    r"fewer than 1 in #",
    # a record to show its form
    r"0\.00,10\.31 0\.02,9\.94",
    r"fixed\.m=0\.2",
    r"half of the tests below",
    r"half the squared distance",
    r"at least half of the data sets",
    r"× ?>1e6",
    r"± 1 sd",
    r"twice #",
    # which record, which figure of the paper
    r"replicate 0",
    r"Figure \d+",
    r"Table 11\b",
    r"results/table1[01]\.html",
    r"half of the 95 % interval over 1\.96\); 1 is right",
    r"hold it in 83 % of cases with two siblings, 91 % with four, 93 % with six",
    r"100 \(1 - \|y - h\| / \|y - mean y\|\) of the last 40 %, predicted from a fit of the first 60 %",
    r"1,000 points in each replicate",
    r"median and 99 % wall time",
    r"half-width of the interval in standard deviations",
)
STYLE = re.compile(r"font-size|transform=")


def sentences(path: Path) -> Iterator[str]:
    """The strings of a module with three words or more, docstrings apart; what is filled in is ``#``."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    apart = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    apart |= {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
    for node in ast.walk(tree):
        if id(node) in apart:
            continue
        if isinstance(node, ast.JoinedStr):
            text = "".join(str(part.value) if isinstance(part, ast.Constant) else "#" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            text = node.value
        else:
            continue
        text = re.sub(r"<[^>]*>?", " ", text)  # markup is no sentence
        if len(re.findall(r"[A-Za-z]{2,}", text)) >= 3 and not STYLE.search(text):
            yield text


@pytest.mark.parametrize("path", MODULES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_captions_and_notes_type_no_result(path: Path) -> None:
    assert [place for text in sentences(path) for place in typed(text, DEFINITIONS)] == []


PAGES = sorted((REPORTING / "page" / "templates").glob("*.j2"))


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_the_page_types_no_result(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    text = re.sub(r"<(style|script).*?</\1>", " ", text, flags=re.DOTALL)
    text = re.sub(r"\{%.*?%\}|\{\{.*?\}\}|\{#.*?#\}", " # ", text, flags=re.DOTALL)
    assert typed(re.sub(r"<[^>]*>", " ", text), DEFINITIONS) == []


@pytest.mark.parametrize("page", documents(REPOSITORY), ids=lambda page: str(page.path))
def test_documents_type_no_result(page: Document) -> None:
    assert page.typed() == []


def test_what_is_allowed_in_one_document_is_still_typed_there() -> None:
    """Neither a document that is gone nor a sentence that is."""
    pages = {str(page.path): page for page in documents(REPOSITORY)}
    for path, patterns in ALLOWED_IN.items():
        text = prose(pages[path].text)
        assert [pattern for pattern in patterns if not re.search(pattern, text)] == [], path


def test_a_typed_result_in_a_caption_would_be_found(tmp_path: Path) -> None:
    module = tmp_path / "caption.py"
    module.write_text('"""On 7 things said here."""\nn = 5\ncaption = f"The PINN is {n} times off, SINDy 3.4 times."\n')
    (place,) = [place for text in sentences(module) for place in typed(text, DEFINITIONS)]
    assert "3.4" in place
