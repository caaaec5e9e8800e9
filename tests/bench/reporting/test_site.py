"""The report is a site that stays whole and readable whatever the store holds (in a browser: test_site_browser)."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from urllib.parse import unquote

import pytest
from conftest import REPOSITORY, Python
from scipy.stats import binom
from sites import Page, filled, made, panels_of, stored, text_of

from bench.commands.main import main
from bench.contract.estimate import Status
from bench.reporting.frame import Result
from bench.reporting.page import board, home, origin
from bench.reporting.page.reading import StoreReading
from bench.reporting.page.site import Site
from bench.reporting.page.situations import Advice, advice
from bench.reporting.page.words import at_most, slug, slugs
from bench.reporting.pictures import png
from bench.reporting.rounding import time_text
from bench.store.store import Store
from bench.store.stored_cell import StoredCell
from bench.store.version import described_version

pytest.importorskip("jinja2")
pytest.importorskip("mkdocs")
pytest.importorskip("PIL")

HOSTILE = "<script>alert(1)</script>\"'&{{7*7}}</title>"
OTHER_SCRIPTS = "метод 方法 طريقة"
Cells = Callable[..., Store]


@pytest.fixture(autouse=True)
def without_experiments(monkeypatch: pytest.MonkeyPatch) -> None:
    """No configuration is composed: these stores hold what no experiment describes."""
    for module in ("reading", "origin"):
        monkeypatch.setattr(f"bench.reporting.page.{module}.table_experiments", list)


@pytest.fixture
def cells(tmp_path: Path) -> Cells:
    """Makes a store of the given cells."""
    return partial(filled, tmp_path / "results")


def test_a_damaged_store_is_one_line_and_nothing_is_written(
    cells: Cells, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store = cells(stored("ls"))
    next(store.folder.glob("*.json")).write_text("{", encoding="utf-8")
    assert main(["report", f"store={store.folder}", f"out={tmp_path / 'out'}"]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 2  # the first line announces the work
    assert not (tmp_path / "out").exists()


def test_the_site_is_the_same_each_time_and_holds_nothing_of_an_older_one(cells: Cells) -> None:
    store = cells(stored("ls"), stored("mcmc", 1.3), stored("mcmc", 1.1, told="known"))
    site = made(store)
    first = {path: path.read_bytes() for path in site.rglob("*") if path.is_file()}
    (site / "data" / "left_over.js").write_text("", encoding="utf-8")
    made(store)
    assert {path: path.read_bytes() for path in site.rglob("*") if path.is_file()} == first


def test_names_are_text_and_nothing_else(cells: Cells) -> None:
    site = made(
        cells(stored(HOSTILE, system=HOSTILE, failed=3, message=HOSTILE), stored(OTHER_SCRIPTS), stored("a$b$_c"))
    )
    for path in site.rglob("*.html"):
        assert "<script>alert(1)" not in path.read_text(encoding="utf-8"), path
    assert HOSTILE in text_of(site / "trust.html")
    assert f"One mass, free decay ({HOSTILE})" in text_of(next((site / "systems").glob("script*.html")))
    assert {HOSTILE, OTHER_SCRIPTS, "a$b$_c"} <= {
        re.sub(r" - vibration-bench.*", "", text_of(path)).replace("‹", "<").replace("›", ">")
        for path in (site / "methods").iterdir()
    }


def test_every_link_leads_to_a_file_and_nothing_comes_from_elsewhere(cells: Cells) -> None:
    """Tables and figures that lie beside the store are pages of the site, in which markup is text."""
    from PIL import Image

    store = cells(stored("ls"), stored("mcmc", 2.0), stored("ls", system="other", snr=10.0))
    folder = store.folder.parent
    table = "# A title\n\n[other](../other.md), [data](one.csv) <script>alert(1)</script>\n\n| a |\n|---|\n| <b>x |\n"
    (folder / "one.md").write_text(table, encoding="utf-8")
    (folder / "one.csv").write_text("a,b\n", encoding="utf-8")
    (folder / "figures").mkdir()
    Image.new("RGB", (1378, 700), "white").save(plain := io.BytesIO(), "PNG")
    picture = png.packed(plain.getvalue(), "First & foremost_ones. The rest.")
    (folder / "figures" / "a_b.png").write_bytes(picture)
    site = made(store)
    for path in site.rglob("*.html"):
        for tag, own in Page(path.read_text(encoding="utf-8")).elements:
            for target in filter(None, (own.get("src"), own.get("href"))):
                if re.match(r"[a-z]+:|//", target):
                    assert tag == "a", (path, target)  # of the theme's makers
                elif not target.startswith("#") and path.name != "404.html":
                    assert (path.parent / target.partition("#")[0]).is_file(), (path, tag, target)
    shown = (site / "results" / "one.html").read_text(encoding="utf-8")
    assert 'href="one.csv"' in shown
    assert not [text for text in ("<script>alert(1)", "<b>x", "other.md") if text in shown]
    assert "Tables" in text_of(site / "leaderboard.html")
    assert (site / "results" / "figures" / "a_b.png").read_bytes() == picture
    figures = Page((site / "figures.html").read_text(encoding="utf-8"))
    assert ("results/figures/a_b.png", "1378") in [(own.get("src"), own.get("width")) for _, own in figures.elements]
    assert "First & foremost_ones. The rest." in figures.text


def test_addresses_are_permanent_and_differ() -> None:
    plain, other, longer = [stored("ls")], [stored("ls", snr=10.0)], [stored("ls", duration=20.0)]
    assert [panel.slug for panel in panels_of(plain)] == ["sdof-20db-start-unknown"]
    assert [panel.slug for panel in panels_of(other, plain)][1] == "sdof-20db-start-unknown"
    first, second = panels_of(plain, longer)
    assert first.slug == "sdof-20db-start-unknown"
    assert re.fullmatch(r"sdof-20db-start-unknown-[0-9a-f]{8}", second.slug)
    assert second.title == f"{first.title}; 25 samples in 20 s"
    names = ["a b", "a-b", "A b", HOSTILE, OTHER_SCRIPTS, "x" * 200]
    assert len(set(slugs(names).values())) == len(names)
    assert slug("pinn_adam") == "pinn_adam"


# ---- what is advised


def ranked(*cells: StoredCell) -> Advice:
    """The ranking of one scenario."""
    (panel,) = panels_of(cells)
    return advice("Any", "situations/any.md", panel.results, [panel])


def test_what_is_advised_is_a_whole_tier_with_what_it_loses(cells: Cells) -> None:
    """By construction: ls and mcmc differ by 0.1 %, mcmc is slower; sindy is lost in ten of forty fits."""
    slow = stored("mcmc")
    slow = replace(slow, rows=tuple(replace(row, cpu_s=0.5) for row in slow.rows))
    found = ranked(slow, stored("ls"), stored("sindy", gross=10))
    assert {row.label for row in found.first_tier} == {"ls", "mcmc"}
    assert (found.fastest.label, time_text(found.seconds["ls"])) == ("ls", "10 ms")
    wild = found.ranking[-1]
    assert (wild.label, wild.tier, wild.lost, wild.fits) == ("sindy", 2, 10, 40)
    assert binom.cdf(10, 40, at_most(wild)) == pytest.approx(0.05, abs=1e-6)
    assert home.needs("output_error_cold") == home.needs("output_error") == "no prior needed"
    assert home.bound(found.panels) == "k/m 0.5 %, c/m 3.5 % at 20 dB"
    assert home.lost(found.ranking) == "0\u00a0% to 25\u00a0%"
    labels = ("ls", "mcmc", "sindy", "era", "ekf", "ukf")
    site = Site(cells(), Path(), StoreReading((), (), (), {}))
    assert site.tier(ranked(*map(stored, labels))).endswith(" or 2 more")
    assert ranked(stored("ls", gross=40), stored("mcmc", gross=40)).hopeless


# ---- the leaderboard


def test_the_board_shows_the_errors_whose_ratio_to_the_bound_it_shows() -> None:
    """Root mean square and share of gross errors, counted from the rows; ls differs by a factor of 1.5 at least."""
    cell = stored("mcmc", 1.5, failed=4)
    panels = panels_of([cell, stored("ls")])
    columns = board.board(panels, {"mcmc": "mcmc", "ls": "ls"})
    lines = [{own["title"]: own["values"][own["codes"][i]] for own in columns} for i in range(6)]
    line, other = (line for line in lines if line["Error of"] == "k/m (%)")
    assert (other["Standing"], line["Standing"]) == ("tied", "worse")
    errors = [row.scores["k_over_m_error_pct"] for row in cell.rows[4:]]
    rms = math.sqrt(sum(e**2 for e in errors) / 36)
    assert (line["Bound"], line["Fits ok"]) == ("0.5", "36/40")
    assert float(line["× bound"]) == pytest.approx(rms / 0.5, rel=0.005)
    assert line["Outliers"] == f"{100 * (4 + sum(e > 2.5 for e in errors)) / 40:.2g} %"
    excesses = [float(text) for text in columns[2]["values"]]
    assert excesses == sorted(excesses)


# ---- what can be trusted


def test_data_that_a_method_cannot_take_are_no_failure() -> None:
    unable = stored("era", failed=40, message="it takes one record", status=Status.UNSUPPORTED)
    results = [Result.of_stored(cell) for cell in (unable, stored("ls", failed=3))]
    assert [(one["method"], one["fits"]) for one in origin.failed_fits(results)] == [("LS, finite differences", 3)]


def test_stale_results_are_counted_and_commits_looked_up() -> None:
    before = stored("mcmc")
    today = replace(before, version=described_version(before.cell).as_json())
    cells = origin.cells_of([Result.of_stored(cell) for cell in (stored("ls"), today)])
    (stale,) = origin.counted(cells, "changed")
    assert (stale["cells"], stale["fits"]) == (1, 40)
    assert stale["changed"].startswith("method version not stated, today ")
    assert [one["cells"] for one in origin.counted(cells, "commit")] == [2]
    assert origin.commits_here(cells) in (None, 0)


def test_what_is_missing_of_an_experiment_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Table 3 with a single cell of its own stored, as its configuration describes it."""
    from bench.config.experiment import Experiment

    monkeypatch.setattr(origin, "table_experiments", lambda: ["table3", "table4"])
    identities = {cell.identity for cell in Experiment("table3").cells()}
    cells = origin.cells_of([Result.of_stored(replace(stored("ls"), identity=min(identities)))])
    expected = {"experiment": "table3", "cells": len(identities), "missing": len(identities) - 1, "stale": 1}
    assert expected in origin.experiments(cells)


def test_what_the_data_do_not_tell_is_said_and_when_it_was_computed(cells: Cells) -> None:
    site = made(cells(stored("ls"), stored("mcmc")))
    said = text_of(site / "scenarios" / "sdof-20db-start-unknown.html")
    assert "Computed 2026-01-01. Reproduce with" in said
    assert "Computed 2026-01-01. Reproduce with" in text_of(site / "methods" / "ls.html")
    said = said[said.index("Identifiability") :]
    assert re.search(r"m no 100 % c no 25 % k no 95 % k/m yes 0.1 % c/m yes 0.1 %", said)


def test_a_submitted_method_says_how_it_was_verified(cells: Cells, monkeypatch: pytest.MonkeyPatch) -> None:
    """On the page of its method, also where its only scenarios are drawn ones."""
    mine = stored("ls").marked({"rows_compared": 4, "of_rows": 40})
    monkeypatch.setattr(
        "bench.reporting.page.reading.drawn_questions", lambda: frozenset([Result.of_stored(mine).question])
    )
    said = text_of(made(cells(mine, stored("mcmc"))) / "methods" / "ls.html")
    assert "4 of its 40 rows were recomputed" in said
    assert "(submitted)" in said


@pytest.mark.slow
def test_the_site_of_the_results_is_small_and_names_nothing_beyond_itself(python: Python, tmp_path: Path) -> None:
    out, results = tmp_path / "site", REPOSITORY / "results"
    store = f"store={tmp_path}"
    done = python("-m", "bench", "report", store, f"archive={results / 'archive'}", f"results={results}", f"out={out}")
    assert done.returncode == 0, done.stderr
    files = [path for path in out.rglob("*") if path.is_file() and "results" not in path.relative_to(out).parts]
    assert sum(path.stat().st_size for path in files) <= 12_000_000
    assert max(path.stat().st_size for path in files) <= 1_500_000
    for page in set(out.rglob("*.html")) - {out / "404.html"}:
        text = page.read_text("utf-8")
        linked = re.findall(r'(?:<script[^>]* src|<link[^>]* href|<img[^>]* src|<a[^>]* href)="([^"#?]+)', text)
        missing = [own for own in linked if ":" not in own and not (page.parent / unquote(own)).is_file()]
        assert not missing, (page, missing)
