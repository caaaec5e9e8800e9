"""The examples of the gallery run in an empty folder, show what they print and draw, and convert to notebooks."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from importlib.util import module_from_spec, spec_from_file_location
from itertools import pairwise
from pathlib import Path
from types import ModuleType

import pytest
from examples import excerpt, pictures, run
from pages import REPOSITORY, agree, blocks

CPU_INDEX = "https://download.pytorch.org/whl/cpu"
GALLERY = REPOSITORY / "docs" / "gallery"
EXAMPLES = sorted(path for path in GALLERY.glob("*.md") if path.stem != "index")
LONG = {"add_optimizer", "add_system"}
"""Run by tests/bench/entrants/test_newcomer_optimizer.py and tests/bench/systems/test_newcomer_system.py."""


@pytest.mark.slow
@pytest.mark.parametrize("example", [page for page in EXAMPLES if page.stem not in LONG], ids=lambda page: page.stem)
def test_an_example_shows_what_it_prints_and_draws_its_picture(example: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    for block, printed in run(example, tmp_path):
        if block.language == "text":
            assert agree(block.code, printed), f"shown:\n{block.code}\nprinted:\n{printed}"
    assert pictures(example)
    assert [name for name in pictures(example) if not (tmp_path / name).stat().st_size] == []


def test_the_gallery_is_light() -> None:
    """At most 1.5 MB, and 150 kB per picture."""
    sizes = [path.stat().st_size for path in GALLERY.iterdir()]
    assert sum(sizes) < 1_500_000
    assert max(sizes) < 150_000


@pytest.fixture(scope="module")
def notebooks() -> ModuleType:
    """The module docs/notebooks.py, a hook of the site."""
    pytest.importorskip("mkdocs")
    spec = spec_from_file_location("notebooks", REPOSITORY / "docs" / "notebooks.py")
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda page: page.stem)
def test_a_notebook_has_all_blocks_of_its_page(example: Path, notebooks: ModuleType) -> None:
    """Every command and every line of Python, outputs below the cell that prints them, and no fence of Markdown."""
    book = notebooks.notebook(example.read_text(encoding="utf-8"), GALLERY)
    code = [cell for cell in book["cells"] if cell["cell_type"] == "code"]
    for block in blocks(example):
        if block.language == "python" and not block.title:
            assert block.code.strip() in [cell["source"] for cell in code]
        if block.language in ("text", "txt"):
            assert block.code in [output.get("text") for cell in code for output in cell["outputs"]]
    assert sum("%%writefile" in cell["source"] for cell in code) == sum(bool(block.title) for block in blocks(example))
    for cell in code:
        assert "```" not in cell["source"]
        assert not re.search(r"^python ", cell["source"], re.MULTILINE)
    assert {"outputs" in cell for cell in book["cells"] if cell["cell_type"] == "markdown"} == {False}
    assert len({cell["id"] for cell in book["cells"]}) == len(book["cells"])


def test_a_notebook_is_valid(notebooks: ModuleType) -> None:
    nbformat = pytest.importorskip("nbformat")
    for example in EXAMPLES:
        nbformat.validate(notebooks.notebook(example.read_text(encoding="utf-8"), GALLERY))


@pytest.mark.parametrize(
    ("shown", "printed", "result"),
    [
        ("", "a\nb\n", "a\nb\n"),
        ("a 1\n...\n", "a 2\nb\n", "a 2\n...\n"),
        ("...\nc 1\nd\n...\n", "a\nc 2\ne\nf\n", "...\nc 2\ne\n...\n"),
    ],
)
def test_a_refreshed_output_is_cut_as_before(shown: str, printed: str, result: str) -> None:
    assert excerpt(shown, printed) == result


@pytest.mark.parametrize(
    ("shown", "printed", "same"),
    [
        ("a 1.00\n", "a 1.02\n", True),
        ("a 1.00\n", "a 1.50\n", False),
        ("a 1\n", "b 1\n", False),
        ("a\n...\n", "a\nanything 5\n", True),
        ("a\n...\nz 2\n", "a\nb\nz 2\n", True),
        ("a\n...\nz 2\n", "a\nb\nz 3\n", False),
        ("...\nb\n...\n", "a\nb\nc\n", True),
        ("...\nd\n...\n", "a\nb\nc\n", False),
        ("a\n", "a\nb\n", False),
        ("| --- | k 5 |", "| ------ | k 5 |", True),
    ],
)
def test_what_is_shown_is_compared_by_words_and_numbers(shown: str, printed: str, same: bool) -> None:
    assert agree(shown, printed) is same


@pytest.mark.slow
def test_the_readme_shows_what_its_commands_print(tmp_path: Path) -> None:
    """The commands whose output it shows; the installation before them is left out."""
    (tmp_path / "bench").symlink_to(REPOSITORY / "bench")
    readme = blocks(REPOSITORY / "README.md")
    shown = [(before, block) for before, block in pairwise(readme) if block.language == "text"]
    assert len(shown) == 2
    for before, block in shown:
        arguments = shlex.split(before.code.rpartition("&& ")[2])[1:]
        printed = subprocess.run(
            [sys.executable, *arguments], cwd=tmp_path, capture_output=True, text=True, check=True
        ).stdout
        assert agree(block.code, printed), f"shown:\n{block.code}\nprinted:\n{printed}"


def test_the_container_runs_the_command_of_the_readme() -> None:
    """The same packages and the same record; the container adds the index of the CPU build of torch."""
    command = next(block.code for block in blocks(REPOSITORY / "README.md") if "venv" in block.code)
    install, run_command = command.split(" && ")[1:]
    dockerfile = (REPOSITORY / "Dockerfile").read_text(encoding="utf-8")
    assert install.partition("-c ")[2] in dockerfile.replace(f"--extra-index-url {CPU_INDEX} ", "")
    assert shlex.split(run_command)[3:] == re.findall(r'"([^"]+)"', dockerfile.partition("CMD ")[2])
    copied = re.findall(r"^COPY (.*) \S+$", dockerfile, re.MULTILINE)
    assert [name for line in copied for name in line.split() if not (REPOSITORY / name).exists()] == []
    container = json.loads((REPOSITORY / ".devcontainer" / "devcontainer.json").read_text(encoding="utf-8"))
    assert "pip install -q -c constraints.txt -e '.[all,test]'" in container["postCreateCommand"]
