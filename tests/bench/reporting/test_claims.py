"""What the documents say about results is what the results say, and a claim that is false is found out."""

from __future__ import annotations

import csv
import re
from functools import cache
from pathlib import Path, PurePosixPath

import pandas as pd
import pytest
from conftest import REPOSITORY

from bench.commands.main import main
from bench.errors import InputError
from bench.reporting.claims import free_decay, systems
from bench.reporting.claims.claim import Claim, exceptions, fold, listed, number, said, span
from bench.reporting.claims.document import SECTIONS, Document, check, documents, typed, typed_in_claims
from bench.reporting.claims.evidence import Evidence
from bench.reporting.claims.panels import CHOSEN, chosen
from bench.store.store import open_store

RESULTS = REPOSITORY / "results"
FREE_DECAY = "docs/explanation/free_decay.md"
COST = "docs/explanation/how_to_read.md"


@cache
def evidence(folder: Path = RESULTS) -> Evidence:
    """Read what is published, or tables of another folder beside the published cells; all tests share it."""
    return Evidence(folder, open_store(str(folder / "rows"), str(RESULTS / "archive")))


def copied(root: Path) -> Path:
    """The documents in a folder of their own."""
    for page in documents(REPOSITORY):
        (root / page.path).parent.mkdir(parents=True, exist_ok=True)
        (root / page.path).write_text(page.text, encoding="utf-8")
    return root


def page(text: str, path: str = "README.md") -> Document:
    return Document(PurePosixPath(path), text)


def command(root: Path, *more: str) -> int:
    """The command on the documents of a folder, with what is published."""
    (root / "rows").mkdir(exist_ok=True)
    places = [f"root={root}", f"results={RESULTS}", f"store={root / 'rows'}"]
    return main(["tables", "what=claims", *places, f"archive={RESULTS / 'archive'}", *more])


def changed(folder: Path, table: str, lines: str, column: str, value: float) -> Evidence:
    """The results with one column of some lines (a pandas query) of one table changed."""
    for path in RESULTS.iterdir():
        if path.stem != table:
            (folder / path.name).symlink_to(path)
    data = pd.read_csv(RESULTS / f"{table}.csv")
    found = data.query(lines).index
    assert len(found)
    data.loc[found, column] = value
    data.to_csv(folder / f"{table}.csv", index=False)
    return evidence(folder)


def test_the_documents_pass_a_number_changed_by_hand_does_not_and_write_puts_it_right(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    document = copied(tmp_path) / FREE_DECAY
    text = document.read_text(encoding="utf-8")
    assert command(tmp_path) == 0, capsys.readouterr().out
    wrong = re.sub(r"(their excess is )[\d.]+", r"\g<1>0.99", text)
    assert wrong != text
    document.write_text(wrong, encoding="utf-8")
    capsys.readouterr()
    assert command(tmp_path) == 1
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "DIFFERS" in line]
    assert line.startswith("on_the_bound: ")
    assert document.read_text(encoding="utf-8") == wrong, "without write=true the document is left alone"
    assert command(tmp_path, "write=true") == 0
    assert document.read_text(encoding="utf-8") == text


def test_what_no_claim_wrote_fails(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A number beside the passages, and a line within one that belongs to no claim."""
    document = copied(tmp_path) / COST
    text = document.read_text(encoding="utf-8")
    document.write_text(text + "\nThe PINN is 1.8 times above the bound.\n", encoding="utf-8")
    assert command(tmp_path) == 1
    assert f"typed by hand: {COST}: " in capsys.readouterr().out
    document.write_text(text.replace("<!-- claims: cost -->\n", "<!-- claims: cost -->\n- More.\n"), encoding="utf-8")
    assert command(tmp_path) == 1


def test_a_passage_that_two_documents_show_must_be_right_in_both() -> None:
    there = evidence()
    (right,) = (one for one in documents(REPOSITORY) if str(one.path) == COST)
    wrong = page(re.sub(r"\d+ minutes", "7 minutes", right.text))
    assert wrong.text != right.text
    for pages, agrees in (([right], True), ([right, wrong], False), ([wrong], False), ([], False)):
        assert next(one.agrees for one in check(pages, there) if one.claim.name == "cost") is agrees


def test_links_of_a_claim_lead_to_results_from_any_folder() -> None:
    empty = "<!-- claims: archive -->\n<!-- /claims -->\n"
    checked = list(check([], evidence()))
    for path, link in (
        ("README.md", "](results/"),
        ("docs/a.md", "](../results/"),
        ("docs/a/b.md", "](../../results/"),
    ):
        assert link in page(empty, path).filled(checked).text


def test_every_passage_is_in_a_document_and_no_two_claims_share_a_name() -> None:
    assert {name for one in documents(REPOSITORY) for name in one.passages()} == set(SECTIONS)
    names = [claim.name for claims in SECTIONS.values() for claim in claims]
    assert len(names) == len(set(names))


def test_a_folder_without_documents_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="README"):
        documents(tmp_path)


def test_every_claim_says_what_would_make_it_false() -> None:
    there = evidence()
    assert [one.name for claims in SECTIONS.values() for one in claims if not one.said(there).conditions] == []


def test_a_passage_of_an_unknown_name_is_an_error() -> None:
    with pytest.raises(InputError, match="overview"):
        page("<!-- claims: nothing of ours -->\nx\n<!-- /claims -->").passages()


def test_an_empty_passage_ends_before_the_next() -> None:
    one = page("<!-- claims: cost -->\n<!-- /claims -->\nkept\n<!-- claims: open split -->\nx\n<!-- /claims -->\n")
    assert one.passages() == {"cost": "", "open split": "x"}
    assert "\nkept\n" in one.filled(list(check([one], evidence()))).text


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
    assert free_decay.on_the_bound.said(evidence()).numbers["excess"] == f"{min(found):.2f} to {max(found):.2f}"


def test_what_is_said_of_finite_differences_beside_an_added_mass_is_in_table_6() -> None:
    found = {
        float(line["snr_db"]): float(line["excess"])
        for line in lines("table6")
        if (line["system"], line["method"], line["metric"]) == ("sdof_added_mass", "ls", "told_pooled")
    }
    said_so = systems.all_told.said(evidence()).numbers["differences"]
    assert [int(value) for value in re.findall(r"\d+", said_so)] == [round(found[snr]) for snr in (40, 20, 10)]


def test_times_are_those_of_the_published_cells() -> None:
    """A median beside the mean, which the archive states as a sum."""
    cells = pd.read_parquet(RESULTS / "archive" / "cells.parquet").query("label == 'era' and system == 'close_modes'")
    mean = cells.cpu_s.item() / cells.replicates.item()
    assert mean / 2 < evidence().seconds("regimes", label="era", system="close_modes") < 2 * mean


# ---- what makes a claim false


@pytest.mark.parametrize(
    ("claim", "table", "changes", "column", "value"),
    [
        (
            free_decay.on_the_bound, "table5", "method == 'mcmc' and snr_db == 10 and metric == 'rmse'", "excess", 1.6,
        ),
        (free_decay.network, "table9", "method == 'pinn' and system == 'sdof_nyquist'", "excess", 40.0),
        (free_decay.intervals, "calibration", "method == 'shooting' and snr_db == 20", "coverage_95", 0.7),
        (systems.every_force, "table6", "method == 'ekf' and system == 'sdof_step'", "excess", 9.0),
        (systems.hidden_state, "table8", "method == 'collocation' and system == 'bouc_wen'", "excess", 1.1),
    ],
    ids=lambda value: value.name if isinstance(value, Claim) else "",
)  # fmt: skip
def test_results_that_contradict_a_claim_break_it(
    tmp_path: Path, claim: Claim, table: str, changes: str, column: str, value: float
) -> None:
    assert not claim.said(evidence()).broken
    assert claim.said(changed(tmp_path, table, changes, column, value)).broken


def test_what_was_never_measured_cannot_be_claimed() -> None:
    """NUTS never ran on Bouc-Wen."""
    there = evidence()
    with pytest.raises(InputError, match="nuts"):
        there.rows("table8", system="bouc_wen", method=("shooting", "nuts"))
    with pytest.raises(InputError, match="not stored"):
        there.cells("nonlinear", system="bouc_wen", label="nuts")
    with pytest.raises(InputError, match="no such table"):
        there.table("table99")
    with pytest.raises(InputError, match="not one"):
        there.value("table6", "excess", system="sdof_step", metric="told_pooled")


def test_a_claim_without_its_results_is_unknown_and_its_passage_is_left_as_it_is(tmp_path: Path) -> None:
    (one,) = (one for one in documents(REPOSITORY) if str(one.path) == FREE_DECAY)
    checked = list(check([one], evidence(tmp_path)))
    unknown = [one for one in checked if one.said is None]
    assert any("table5" in one.problem for one in unknown)
    assert not any(one.passes for one in unknown)
    assert one.filled(checked).passages() == one.passages()


def test_text_and_expression_must_name_the_same_numbers() -> None:
    for text in ("{low} to {high}", "none"):
        with pytest.raises(InputError, match="differ"):
            Claim("a", text, lambda e: said({}, low="1")).said(evidence())


# ---- numbers that are typed


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("It is 1.3 times the bound at 20 dB, and 95 % intervals hold.", ["1.3"]),
        ("All eighteen methods; twice.", ["eighteen", "twice"]),
        ("See [1.5](a/1.5), `x=3` and Table 3.", ["1.5"]),
        ("<!-- claims: cost -->\n66 minutes\n<!-- /claims -->\n```\n7\n```\nnothing", []),
        ("A mass weighed to 3 %; a mass weighed to 2 %.", ["3"]),
    ],
)
def test_a_typed_number_is_found_where_nothing_allows_it(text: str, numbers: list[str]) -> None:
    found = typed(text)
    assert len(found) == len(numbers)
    assert all(value in place for value, place in zip(numbers, found, strict=True))


def test_no_number_stands_typed_beside_the_numbers_of_a_claim() -> None:
    assert typed_in_claims() == {}


# ---- small parts


def test_a_passage_fills_lines_of_120_letters_and_keeps_its_points_apart() -> None:
    words = " ".join(["word"] * 60)
    text = Claim("a", f"- {{x}} {words}\n- {words}", lambda e: said({}, x="5")).filled(said({}, x="5"))
    filled_lines = text.split("\n")
    assert max(map(len, filled_lines)) <= 120
    assert [line[:3] for line in filled_lines].count("- 5") == 1
    assert sum(line.startswith("- ") for line in filled_lines) == 2
    assert text.split() == f"- 5 {words} - {words}".split()


def test_the_table_below_a_heading_of_a_page_is_read(tmp_path: Path) -> None:
    (tmp_path / "study.md").write_text(
        "# Page\n\n## One\n\n| a | b |\n|---|---|\n| 1 | |\n\n## Two\n\nText.\n\n| c |  d | |\n|---|---|---|\n"
        "| x y | 1,363 × |\n| z | 2 | late |\n\nafter\n",
        encoding="utf-8",
    )
    there = evidence(tmp_path)
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


def test_spans_lists_and_exceptions() -> None:
    assert (fold(0.854), fold(9.997), fold(36737.6)) == ("0.85", "10", "36,738")
    assert span([1.004, 0.996, 1.0]) == "1.00"
    assert span([1.5, 0.85]) == "0.85 to 1.50"
    assert listed([37.8, 25.6, 12.8]) == "38, 26 and 13"
    assert exceptions([("a", 2.15), ("b", 1.25), ("c", 1.28)], 1.25) == "a (2.15) and c (1.28)"
    assert exceptions([("a", 1.0)], 1.25) == "none"


def test_the_panel_of_a_table_that_is_not_the_generated_one_is_told_and_put_right(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copied(tmp_path)
    for path in ("README.md", FREE_DECAY):
        document = tmp_path / path
        text = document.read_text(encoding="utf-8")
        wrong = text.replace("| Multiple shooting ", "| Simple shooting   ")
        assert wrong != text
        document.write_text(wrong, encoding="utf-8")
        assert command(tmp_path) == 1
        assert f"{path}: its passages or the panel of a table differ" in capsys.readouterr().out
        assert command(tmp_path, "write=true") == 0
        assert document.read_text(encoding="utf-8") == text


def test_chosen_rows_are_those_of_the_table_and_a_row_that_is_gone_is_refused() -> None:
    head = "| method | k/m error % | c/m error % | RMSE (m) | ok |\n|---|---|---|---|---|\n"
    rows = [f"| {name} | 1 | 2 | {i} | 9 |" for i, name in enumerate(CHOSEN)]
    lines = chosen(head + "\n".join([*reversed(rows), "| other | 1 | 2 | 3 | 4 |"])).split("\n")
    assert lines[2:] == [f"| {name} | 1 | 2 | {i} |" for i, name in enumerate(CHOSEN)]
    with pytest.raises(InputError, match=CHOSEN[0]):
        chosen(head + "\n".join(rows[1:]))
