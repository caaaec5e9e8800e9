"""What the documents say about results follows from them: an unknown name or a false conclusion is found."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import pandas as pd
import pytest
from conftest import REPOSITORY

from bench.commands.main import main
from bench.errors import InputError
from bench.reporting import sentences
from bench.reporting.documents import HOLDS, documents, filled, problems, rewritten, used
from bench.reporting.sentences import Facts, Published, printed

RESULTS = REPOSITORY / "results"


@cache
def known() -> Facts:
    return sentences.facts(RESULTS)


def test_documents_and_results_agree() -> None:
    """Every name is known and used, every conclusion holds, README.md and the paper show today's numbers."""
    pages = documents(REPOSITORY)
    assert [f"{path}: {line}" for path, text in pages.items() for line in problems(text, known())] == []
    assert [path for path, text in pages.items() if rewritten(text, known()) != text] == []
    names = [used(text) for text in pages.values()]
    assert known().numbers.keys() == set().union(*(numbers for numbers, _ in names))
    assert known().conclusions.keys() == set().union(*(conclusions for _, conclusions in names))


def test_marks_are_not_seen_by_a_reader() -> None:
    """Outside the site a bare name would show; Markdown reads a mark that begins a line as HTML, ``5. a`` as a list."""
    for path, text in documents(REPOSITORY).items():
        assert not re.search(r"^\s*<!-- (holds: \w+ -->|\{\{ \w+ \}\} -->.)", text, re.MULTILINE), path
        assert not re.search(r"^\s*\{\{ \w+ \}\}\. ", HOLDS.sub("", text), re.MULTILINE), path
        assert path.is_relative_to(REPOSITORY / "docs") or not re.search(r"\{\{ \w+ \}\}(?! -->)", text), path


def test_the_site_shows_numbers_and_no_marks() -> None:
    there = Facts({"n": "5", "rows": "\n| 1 |\n"}, {"fits": True, "fails": False})
    assert filled("{{ n }} of 5. <!-- holds: fits --> So.", there) == "5 of 5. So."
    assert filled("a <!-- {{ n }} -->4<!-- / --> b", there) == "a 5 b"
    assert rewritten("<!-- {{ rows }} -->\n| 2 |\n<!-- / -->", there) == "<!-- {{ rows }} -->\n| 1 |\n<!-- / -->"
    for wrong in ("{{ nobody }}", "x <!-- holds: nobody -->", "x <!-- holds: fails -->"):
        with pytest.raises(InputError, match=r"nobody|fails"):
            filled(wrong, there)


def test_the_command_finds_a_number_changed_by_hand_and_writes_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    right = (REPOSITORY / "README.md").read_text("utf-8")
    readme, words = tmp_path / "README.md", ["tables", "what=claims", f"root={tmp_path}", f"results={RESULTS}"]
    readme.write_text(re.sub(r"(-->)25(<!--)", r"\g<1>26\g<2>", right).replace("| Multiple", "| Single"), "utf-8")
    assert readme.read_text("utf-8") != right
    assert main(words) == 1
    assert "README.md: a number differs" in capsys.readouterr().out
    assert main([*words, "write=true"]) == 0
    assert readme.read_text("utf-8") == right


def test_the_excess_of_four_methods_is_that_of_table_5() -> None:
    lines = pd.read_csv(RESULTS / "table5.csv").query("snr_db >= 10 and metric in @sentences.PRIMARY")
    excess = lines[lines.method.isin(["shooting", "mcmc", "pinn", "collocation"])].excess
    assert len(excess) == 4 * 3 * 4 * 2  # methods, metrics, noise levels, initial states
    largest = excess.nlargest(2).to_list()
    assert known().numbers["on_bound"] == f"{excess.min():.2f} to {largest[1]:.2f}"
    assert known().numbers["off_bound"] == f"{largest[0]:.2f}"
    assert printed([1.004, 0.996, 1.0], ".2f") == "1.00"


@pytest.mark.parametrize(
    ("topic", "conclusion", "table", "lines", "column", "value"),
    [
        (
            "free_decay",
            "one_row_of_four_is_off_the_bound",
            "table5",
            "method == 'mcmc' and snr_db == 10",
            "excess",
            1.6,
        ),
        ("free_decay", "spline_is_as_good_as_the_network", "table5", "method == 'pinn' and snr_db == 5", "excess", 40),
        ("free_decay", "intervals_of_the_noise_hold", "calibration", "method == 'shooting'", "coverage_95", 0.7),
        ("systems", "mcmc_under_a_step_is_off", "table6", "method == 'ekf'", "excess", 9),
        ("open_split", "shooting_is_in_the_first_tier", "leaderboard", "part == 'beyond Nyquist'", "tier", 2),
        ("pinn_family", "no_weighting_is_nearer", "pinn_family", "row == 'causal'", "value", 0.1),
    ],
)
def test_a_case_that_contradicts_a_conclusion_breaks_it(
    tmp_path: Path, topic: str, conclusion: str, table: str, lines: str, column: str, value: float
) -> None:
    for path in RESULTS.iterdir():
        if path.name != f"{table}.csv":
            (tmp_path / path.name).symlink_to(path)
    data = pd.read_csv(RESULTS / f"{table}.csv")
    data.loc[data.query(lines).index, column] = value
    data.to_csv(tmp_path / f"{table}.csv", index=False)
    changed = Facts()
    getattr(sentences, topic)(Published(tmp_path), changed)
    assert known().conclusions[conclusion]
    assert not changed.conclusions[conclusion]


def test_what_was_never_measured_cannot_be_said(tmp_path: Path) -> None:
    """The linear chain has no place in the table of nonlinear systems."""
    with pytest.raises(InputError, match="chain2"):
        Published(RESULTS).rows("table8", system=("bouc_wen", "chain2"), method="shooting")
    with pytest.raises(InputError, match="no such file"):
        sentences.facts(tmp_path)
    with pytest.raises(InputError, match="README"):
        documents(tmp_path)
