"""The README shows what its commands give."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_the_readme_shows_the_generated_table_3() -> None:
    """The panel for a known start in the README is the one in results/table3.md, to the letter."""
    generated = (ROOT / "results" / "table3.md").read_text(encoding="utf-8")
    panel = generated.split("## Initial state known")[1].split("##")[0].strip()
    assert panel in (ROOT / "README.md").read_text(encoding="utf-8")


def test_every_file_the_readme_points_to_is_there() -> None:
    import re

    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for target in re.findall(r"\]\((?!http)([^)#]+)\)", text):
        assert (ROOT / target).exists(), target
