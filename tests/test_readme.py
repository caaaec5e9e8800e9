"""What the documents show is what there is: tables, files, imports."""

from __future__ import annotations

import ast
import re
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DOCUMENTS = ("README.md", "CONTRIBUTING.md", "docs/clusters.md", "docs/kit.md")


def test_the_readme_shows_the_generated_table_3() -> None:
    """The panel for a known start in the README is the one in results/table3.md, to the letter."""
    generated = (ROOT / "results" / "table3.md").read_text(encoding="utf-8")
    panel = generated.split("## Initial state known")[1].split("##")[0].strip()
    assert panel in (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("document", DOCUMENTS)
def test_every_file_that_is_pointed_to_is_there(document: str) -> None:
    """Links, and paths of this repository in code marks."""
    text = (ROOT / document).read_text(encoding="utf-8")
    for target in re.findall(r"\]\((?!http)([^)#]+)\)", text):
        assert ((ROOT / document).parent / target).exists(), target
    for target in re.findall(r"`((?:bench|methods|tests|conf|docs|results)/[\w./]+?)/?`", text):
        assert (ROOT / target).exists(), target


@pytest.mark.parametrize("document", DOCUMENTS)
def test_what_a_document_imports_is_there(document: str) -> None:
    """Every ``from bench... import name`` of a Python block."""
    text = (ROOT / document).read_text(encoding="utf-8")
    for block in re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL):
        for node in ast.walk(ast.parse(block)):
            if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "bench":
                for alias in node.names:
                    assert hasattr(import_module(str(node.module)), alias.name), (document, alias.name)


@pytest.mark.parametrize("document", DOCUMENTS)
def test_every_command_of_a_document_is_there(document: str) -> None:
    """The modules that ``python -m`` is told to run."""
    text = (ROOT / document).read_text(encoding="utf-8")
    for module in re.findall(r"python -m ((?:bench|tests)[\w.]*\w)", text):
        assert find_spec(module) is not None, module
