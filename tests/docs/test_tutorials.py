"""Tutorials are run as a reader would, in an empty folder, and what they show is what is printed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import REPOSITORY
from pages import agree, blocks

TUTORIALS = REPOSITORY / "docs" / "tutorials"
BESIDE = {"add_method", "add_optimizer", "add_system"}
"""Run by tests/bench/entrants/test_newcomer_*.py and tests/bench/systems/test_newcomer_system.py."""


def run_through(page: Path, folder: Path) -> None:
    """Run every block of a page; ``sh`` is code that is not to be run, for it needs a reader's own data."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    python_path = os.pathsep.join([str(REPOSITORY), os.environ.get("PYTHONPATH", "")])
    environment = {
        **os.environ,
        "PATH": path,
        "PYTHONPATH": python_path,
        "PYTHONDONTWRITEBYTECODE": "1",
        "COLUMNS": "80",
    }
    printed = ""
    for block in blocks(page):
        if block.title:
            (folder / block.title).write_text(block.code, encoding="utf-8")
        elif block.language in ("bash", "python"):
            command = ["bash", "-ec", block.code] if block.language == "bash" else [sys.executable, "-c", block.code]
            done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=500)
            assert done.returncode == 0, f"{block.code}\n{done.stderr}"
            printed = done.stdout
        elif block.language == "text":
            assert agree(block.code, printed), f"shown:\n{block.code}\nprinted:\n{printed}"


@pytest.mark.parametrize("tutorial", ["plan_test", "track_stream"])
def test_a_tutorial_runs_and_shows_what_is_printed(tutorial: str, tmp_path: Path) -> None:
    run_through(TUTORIALS / f"{tutorial}.md", tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("tutorial", ["first_cell", "own_record"])
def test_a_longer_tutorial_runs_and_shows_what_is_printed(tutorial: str, tmp_path: Path) -> None:
    run_through(TUTORIALS / f"{tutorial}.md", tmp_path)


def test_every_tutorial_is_run_somewhere() -> None:
    known = {"plan_test", "track_stream", "first_cell", "own_record"} | BESIDE
    assert {path.stem for path in TUTORIALS.glob("*.md")} == known


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
