"""What the documents say about results follows from them: a name that is unknown or a false conclusion is found."""

from __future__ import annotations

import csv
import re
from functools import cache
from pathlib import Path

import pandas as pd
import pytest
from conftest import REPOSITORY

from bench.commands.main import main
from bench.errors import InputError
from bench.reporting import sentences
from bench.reporting.documents import documents, filled, problems, rewritten, used
from bench.reporting.sentences import Facts, Published, fold, number, printed

RESULTS = REPOSITORY / "results"


@cache
def known() -> Facts:
    return sentences.facts(RESULTS)


def changed(folder: Path, table: str, lines: str, column: str, value: float) -> Published:
    """The results with one column of some lines (a pandas query) of one table changed."""
    for path in RESULTS.iterdir():
        if path.name != f"{table}.csv":
            (folder / path.name).symlink_to(path)
    data = pd.read_csv(RESULTS / f"{table}.csv")
    found = data.query(lines).index
    assert len(found)
    data.loc[found, column] = value
    data.to_csv(folder / f"{table}.csv", index=False)
    return Published(folder)


def test_every_name_of_a_document_is_known_and_every_conclusion_holds() -> None:
    assert [f"{path}: {line}" for path, text in documents(REPOSITORY).items() for line in problems(text, known())] == []


def test_what_is_computed_stands_in_a_document() -> None:
    names = [used(text) for text in documents(REPOSITORY).values()]
    assert known().numbers.keys() == set().union(*(numbers for numbers, _ in names))
    assert known().conclusions.keys() == set().union(*(conclusions for _, conclusions in names))


def test_readme_and_the_paper_show_what_the_results_say() -> None:
    for path, text in documents(REPOSITORY).items():
        assert rewritten(text, known()) == text, path


def test_a_page_outside_the_site_shows_its_numbers() -> None:
    """README.md and the paper are read as they are: there, a bare name would be seen."""
    for name in ("README.md", "paper/paper.md"):
        assert not re.search(r"\{\{ \w+ \}\}(?! -->)", (REPOSITORY / name).read_text("utf-8"))


def test_no_line_begins_with_a_mark() -> None:
    """Markdown takes such a line for HTML, and what follows in it is shown as it is typed."""
    for path, text in documents(REPOSITORY).items():
        assert not re.search(r"^\s*<!-- (holds: \w+ -->|\{\{ \w+ \}\} -->.)", text, re.MULTILINE), path


def test_the_site_shows_numbers_and_no_marks() -> None:
    there = Facts({"n": "5", "rows": "\n| 1 |\n"}, {"fits": True, "fails": False})
    assert filled("{{ n }} of 5. <!-- holds: fits --> So.", there) == "5 of 5. So."
    assert filled("a <!-- {{ n }} -->4<!-- / --> b", there) == "a 5 b"
    assert rewritten("<!-- {{ rows }} -->\n| 2 |\n<!-- / -->", there) == "<!-- {{ rows }} -->\n| 1 |\n<!-- / -->"
    for wrong, named in (
        ("{{ m }}", "m"),
        ("x <!-- holds: nothing -->", "nothing"),
        ("x <!-- holds: fails -->", "fails"),
    ):
        with pytest.raises(InputError, match=named):
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
    readme.write_text(right + "\n{{ nobody }} <!-- holds: nothing -->\n", "utf-8")
    assert main(words) == 1
    assert "no number is called nobody" in capsys.readouterr().out


def test_a_folder_without_documents_or_results_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="README"):
        documents(tmp_path)
    with pytest.raises(InputError, match="no such file"):
        sentences.facts(tmp_path)


# ---- numbers from the files by another way


def lines(table: str) -> list[dict[str, str]]:
    with (RESULTS / f"{table}.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_the_excess_of_the_methods_on_the_bound_is_that_of_table_5() -> None:
    found = [
        float(line["excess"])
        for line in lines("table5")
        if line["method"] in {"shooting", "mcmc", "pinn", "collocation"}
        and line["metric"] in {"k_over_m_error_pct", "c_over_m_error_pct", "rmse"}
        and float(line["snr_db"]) >= 10
    ]
    assert len(found) == 4 * 3 * 4 * 2  # methods, metrics, noise levels, starts
    assert known().numbers["on_bound"] == f"{min(found):.2f} to {max(found):.2f}"


def test_gross_errors_below_and_beyond_the_nyquist_frequency_are_those_of_the_open_table() -> None:
    """The parts, counted from single fits, make the whole of the table."""
    (line,) = (
        one for one in lines("open")
        if (one["part"], one["method"], one["metric"]) == ("all", "shooting", "k_over_m_error_pct")
    )  # fmt: skip
    below, beyond = (
        float(known().numbers[f"open_shooting_{part}"]) / 100 * int(known().numbers[f"open_n_{part}"])
        for part in ("below", "beyond")
    )
    assert round(below) + round(beyond) == round(float(line["gross"]) * int(line["n"]))


# ---- what makes a conclusion false


@pytest.mark.parametrize(
    ("topic", "conclusion", "table", "changes", "column", "value"),
    [
        ("free_decay", "four_are_on_the_bound", "table5", "method == 'mcmc' and snr_db == 10 and metric == 'rmse'",
         "excess", 1.6),
        ("free_decay", "spline_is_as_good_as_the_network", "table5", "method == 'pinn' and snr_db == 5", "excess", 40),
        ("free_decay_training", "intervals_of_the_noise_hold", "calibration", "method == 'shooting' and snr_db == 20",
         "coverage_95", 0.7),
        ("systems_forced", "only_mcmc_under_a_step_at_10_db_is_off", "table6",
         "method == 'ekf' and system == 'sdof_step'", "excess", 9),
        ("systems_more", "only_the_filters_at_10_db_are_off", "table7",
         "method == 'output_error' and system == 'chain2_first' and snr_db == 10", "excess", 6),
    ],
)  # fmt: skip
def test_a_single_case_that_contradicts_a_conclusion_breaks_it(
    tmp_path: Path, topic: str, conclusion: str, table: str, changes: str, column: str, value: float
) -> None:
    found = Facts()
    getattr(sentences, topic)(changed(tmp_path, table, changes, column, value), found)
    assert known().conclusions[conclusion]
    assert not found.conclusions[conclusion]


def test_what_was_never_measured_cannot_be_said() -> None:
    """NUTS never ran on Bouc-Wen."""
    there = Published(RESULTS)
    with pytest.raises(InputError, match="nuts"):
        there.rows("table8", system="bouc_wen", method=("shooting", "nuts"))
    with pytest.raises(InputError, match="not one"):
        there.value("table6", "excess", system="sdof_step", metric="told_pooled")


# ---- small parts


def test_the_table_below_a_heading_of_a_page_is_read(tmp_path: Path) -> None:
    (tmp_path / "study.md").write_text(
        "# Page\n\n## One\n\n| a | b |\n|---|---|\n| 1 | |\n\n## Two\n\nText.\n\n| c |  d | |\n|---|---|---|\n"
        "| x y | 1,363 × |\n| z | 2 | late |\n\nafter\n",
        encoding="utf-8",
    )
    there = Published(tmp_path)
    assert there.study("study.md", "One").to_dict("list") == {"a": ["1"], "b": [""]}
    assert there.study("study.md", "Two").to_numpy().tolist() == [["x y", "1,363 ×", ""], ["z", "2", "late"]]
    with pytest.raises(InputError, match="no table"):
        there.study("study.md", "Three")


@pytest.mark.parametrize(
    ("value", "digits", "written"),
    [(0.00337, 2, "0.0034"), (0.996, 2, "1.0"), (9.96, 2, "10"), (37.9, 2, "38"), (1362.7, 4, "1,363")],
)
def test_significant_digits(value: float, digits: int, written: str) -> None:
    assert number(value, digits) == written


def test_folds_counts_and_several_values() -> None:
    assert (fold(0.854), fold(9.997), fold(36737.6)) == ("0.85", "10", "36,738")
    assert printed([1.004, 0.996, 1.0], fold) == "1.00"
    assert printed(pd.Series([1.5, 0.85]), fold) == "0.85 to 1.50"
