"""The report is a site that stays whole, quiet and readable whatever the store holds, and works from a disk alone."""

from __future__ import annotations

import base64
import hashlib
import io
import json
import math
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import pytest
from conftest import REPOSITORY, Python
from scipy.stats import binom, binomtest

from bench.commands.main import main
from bench.contract.estimate import Status
from bench.information.fisher import Bound
from bench.reporting.frame import Result
from bench.reporting.page import board, charts, home, origin, pictures, told
from bench.reporting.page.addresses import scenario_slugs, slug, slugs
from bench.reporting.page.reading import ScenarioPanel, TableOfExperiment
from bench.reporting.page.situations import Advice, advice
from bench.reporting.pictures import png
from bench.scoring.row import Row
from bench.scoring.summary import summarise
from bench.store.store import Store
from bench.store.stored import StoredCell
from bench.store.version import settings_version

pytest.importorskip("jinja2")
pytest.importorskip("mkdocs")
pytest.importorskip("PIL")

AXE = Path(__file__).parent / "axe" / "axe.min.js"

BOUND = Bound(
    ("m", "c", "k"),
    {"m": 0.02, "c": 0.04, "k": 0.02, "k_over_m": 0.005, "c_over_m": 0.035},
    {"m": False, "c": False, "k": False, "k_over_m": True, "c_over_m": True},
    {"m": 0.999, "c": 0.25, "k": 0.95, "k_over_m": 0.001, "c_over_m": 0.001},
    0.0107,
    0.006,
    (),
)
SIZES = {"k_over_m_error_pct": 0.5, "c_over_m_error_pct": 3.5, "rmse": 0.01, "m_error_pct": 2.0}
HOSTILE = "<script>alert(1)</script>\"'&{{7*7}}</title>"
OTHER_SCRIPTS = "метод 方法 طريقة"
Cells = Callable[..., Store]


def stored(
    label: str, worse: float = 1.0, *, failed: int = 0, n: int = 40, system: str = "sdof", snr: float = 20.0,
    told: str = "unknown", message: str = "", method: str | None = None,
) -> StoredCell:  # fmt: skip
    """A cell whose errors are half-normal of the bound's size times ``worse``; the same draws for every method."""
    draws = np.abs(np.random.default_rng(1).standard_normal((n, len(SIZES))))
    own = np.random.default_rng(len(label)).uniform(0.999, 1.001, n)
    rows = tuple(
        Row(i, Status.DIVERGED, message)
        if i < failed
        else Row(
            i,
            Status.OK,
            scores={m: worse * size * draws[i, j] * own[i] for j, (m, size) in enumerate(SIZES.items())},
            cpu_s=0.01 * worse,
        )
        for i in range(n)
    )
    data = {
        "system": "sdof", "options": {}, "parameters": {"m": 1.0, "c": 0.4, "k": 8.0}, "initial": [[1.0], [0.0]],
        "snr_db": snr, "duration": 10.0, "samples": 25, "force": None,
    }  # fmt: skip
    prior = {"mass": 0.02, "damping": 1.0, "stiffness": 0.5, "other": 0.5, "wrong": False}
    what = {
        "method": method or label, "label": label, "settings": {}, "seed": 0, "data": data, "system": system,
        "snr_db": snr, "initial_state": told, "told": {"initial_state": told, "prior": prior}, "sigma": [0.0375],
    }  # fmt: skip
    identity = hashlib.sha256(repr((label, system, snr, told)).encode()).hexdigest()[:20]
    summary = summarise(rows, BOUND)
    origin = {"commit": "c" * 40, "packages": {"numpy": "2"}, "started": "2026-01-01T00:00:00+00:00"}
    return StoredCell(identity, what, rows, summary, BOUND.prior_share, BOUND.identifiable, 1.0, origin)


def results(*found: StoredCell) -> list[Result]:
    """Stored cells as the page reads them."""
    return list(map(Result.of_stored, found))


def panel_of(*found: StoredCell) -> ScenarioPanel:
    """A panel that no experiment describes."""
    return ScenarioPanel(tuple(results(*found)), ())


@pytest.fixture(autouse=True)
def without_experiments(monkeypatch: pytest.MonkeyPatch) -> None:
    """No configuration is composed: these stores hold what no experiment describes."""
    from bench.reporting.page import reading

    monkeypatch.setattr(reading, "table_experiments", list)


def filled(folder: Path, *found: StoredCell) -> Store:
    """A store of the given cells."""
    store = Store(folder / "rows")
    store.prepare()
    for cell in found:
        store.save(cell)
    return store


@pytest.fixture
def cells(tmp_path: Path) -> Cells:
    """Makes a store of the given cells."""
    return partial(filled, tmp_path / "results")


class Page(HTMLParser):
    """What a browser would find: elements with their attributes, and the text outside of style and script."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self._in = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        self._in = tag

    def handle_data(self, data: str) -> None:
        if self._in not in ("style", "script"):
            self.text += data

    def handle_endtag(self, tag: str) -> None:
        self._in = ""


def made(store: Store) -> Path:
    """The site of a store, by the command: its folder."""
    out = store.folder.parent / "site"
    assert main(["report", f"store={store.folder}", f"results={store.folder.parent}", f"out={out}"]) == 0
    return out


def text_of(path: Path) -> str:
    """The text of a page with single blanks."""
    return " ".join(Page(path.read_text(encoding="utf-8")).text.split())


def data_of(path: Path) -> Any:
    """What a data file hands to the page."""
    return json.loads(re.sub(r"^bench\.\w+\(|\);\n$", "", path.read_text(encoding="utf-8")))


@pytest.mark.parametrize("what", ["absent", "empty", "damaged", "argument", "file", "other folder"])
def test_what_cannot_be_shown_is_one_line_and_nothing_is_written(
    what: str, cells: Cells, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store = cells(*([] if what == "empty" else [stored("ls")]))
    out = tmp_path / "out"
    arguments = [f"store={store.folder}", f"out={out}"]
    if what == "absent":
        arguments[0] = f"store={tmp_path / 'nowhere'}"
    if what == "damaged":
        next(store.folder.glob("*.json")).write_text("{", encoding="utf-8")
    if what == "argument":
        arguments.append("stor=x")
    if what == "file":
        out.write_text("mine", encoding="utf-8")
    if what == "other folder":
        out.mkdir()
        (out / "mine.txt").write_text("mine", encoding="utf-8")
    before = sorted(path for path in tmp_path.rglob("*") if "rows" not in path.parts)
    assert main(["report", *arguments]) == 2
    error = capsys.readouterr().err
    assert error.startswith("bench: ")
    assert len(error.splitlines()) == 1
    assert sorted(path for path in tmp_path.rglob("*") if "rows" not in path.parts) == before


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
    assert HOSTILE in text_of(site / "provenance.html")
    assert f"One mass, free decay ({HOSTILE})" in text_of(next((site / "systems").glob("script*.html")))
    methods = data_of(site / "data" / "board.js")[0]
    assert set(methods["values"]) == {HOSTILE, OTHER_SCRIPTS, "a$b$_c"}
    assert all(re.fullmatch(r"methods/[a-z0-9_.-]+\.html", address) for address in methods["links"])


def test_every_link_leads_to_a_page_and_nothing_comes_from_elsewhere(cells: Cells) -> None:
    site = made(cells(stored("ls"), stored("mcmc", 2.0), stored("ls", system="other", snr=10.0)))
    for path in site.rglob("*.html"):
        for tag, own in Page(path.read_text(encoding="utf-8")).elements:
            for target in filter(None, (own.get("src"), own.get("href"))):
                if re.match(r"[a-z]+:|//", target):
                    assert tag == "a", (path, target)  # of the theme's makers
                elif not target.startswith("#") and path.name != "404.html":
                    assert (path.parent / target.partition("#")[0]).is_file(), (path, tag, target)


def test_a_scenario_keeps_its_address_when_others_come() -> None:
    one, other = panel_of(stored("ls")), panel_of(stored("ls", snr=10.0))
    assert scenario_slugs([one]) == ["sdof-20db-start-unknown"]
    assert scenario_slugs([other, one])[1] == "sdof-20db-start-unknown"
    longer = stored("ls")
    longer.cell["data"]["duration"] = 20.0
    first, second = scenario_slugs([one, panel_of(longer)])
    assert first == "sdof-20db-start-unknown"
    assert re.fullmatch(r"sdof-20db-start-unknown-[0-9a-f]{8}", second)


def test_different_names_have_different_addresses() -> None:
    names = ["a b", "a-b", "A b", HOSTILE, OTHER_SCRIPTS, "x" * 200]
    found = slugs(names)
    assert len(set(found.values())) == len(names)
    assert slug("pinn_adam") == "pinn_adam"


# ---- what is advised


def advice_on(*panels: ScenarioPanel) -> Advice:
    return advice("Any", "any.md", [result for panel in panels for result in panel.results], panels)


def with_gross(label: str, every: int, worse: float = 1.0) -> StoredCell:
    """A cell of which each so-many-th error of k/m is 20 times the bound's."""
    cell = stored(label, worse)
    rows = tuple(
        replace(row, scores={**row.scores, "k_over_m_error_pct": 10.0}) if i % every == 0 else row
        for i, row in enumerate(cell.rows)
    )
    return replace(cell, rows=rows, summary=summarise(rows, BOUND))


def test_a_first_tier_is_named_whole_and_its_fastest_said() -> None:
    """By construction: ls and mcmc differ by 0.1 %, mcmc is slower; sindy is lost in ten of forty fits."""
    slow = stored("mcmc")
    slow = replace(slow, rows=tuple(replace(row, cpu_s=0.5) for row in slow.rows))
    found = advice_on(panel_of(slow, stored("ls"), with_gross("sindy", 4)))
    row = home.advice_row(found)
    assert {label for _, label in row.methods} == {"ls", "mcmc"}
    assert (row.fastest, row.more, row.time) == ("LS, finite differences", 0, "10 ms")
    wild = found.ranking[-1]
    assert (wild.label, wild.tier, wild.lost, wild.fits) == ("sindy", 2, 10, 40)
    assert home.lost_text(wild).startswith("10 of 40 = 25 % (at most ")
    assert binom.cdf(10, 40, home.at_most(wild)) == pytest.approx(0.05, abs=1e-6)


def test_of_a_long_tier_the_number_of_others_is_said() -> None:
    row = home.advice_row(advice_on(panel_of(*map(stored, ("ls", "mcmc", "sindy", "era", "ekf", "ukf")))))
    assert (len(row.methods), row.more) == (4, 2)


def test_a_method_that_did_not_run_on_all_scenarios_stands_beside() -> None:
    panels = [ScenarioPanel(tuple(results(stored("ls"), stored("mcmc"))), ()), panel_of(stored("ls", snr=10.0))]
    found = advice_on(*panels)
    assert [one.label for one in found.first_tier] == ["ls"]
    assert [home.standing_text(one) for one in found.ranking] == ["tier 1", "beside: serves 1 of 2 scenarios"]


def test_where_all_are_wrong_none_is_advised() -> None:
    assert advice_on(panel_of(with_gross("ls", 1), with_gross("mcmc", 1))).hopeless
    assert not advice_on(panel_of(stored("ls"))).hopeless


# ---- the leaderboard's numbers


def test_equal_methods_are_in_the_first_tier_and_a_worse_one_is_behind() -> None:
    """By construction: two methods differ by 0.1 % at most, one has twice their errors on the same data."""
    panel = panel_of(stored("ls"), stored("mcmc"), stored("sindy", 2.0))
    tier = board.first_tiers([panel])[0, "k_over_m_error_pct"]
    said = {cell.label: board.standing_of(cell, tier) for cell in panel.results}
    assert said == {"ls": "first tier", "mcmc": "first tier", "sindy": "behind"}


def test_the_board_shows_the_errors_whose_ratio_to_the_bound_it_shows() -> None:
    """Root mean square and share of gross errors, counted from the rows."""
    cell = stored("mcmc", 1.5, failed=4)
    columns = board.board([panel_of(cell)], {}, ["A scenario"], ["address"], {"mcmc": "mcmc"})
    lines = [{own["title"]: own["values"][own["codes"][i]] for own in columns if not own["by"]} for i in range(4)]
    line = next(line for line in lines if line["Error of"] == "k/m (%)")
    errors = [row.scores["k_over_m_error_pct"] for row in cell.rows[4:]]
    rms = math.sqrt(sum(e**2 for e in errors) / 36)
    assert (line["Bound"], line["Fits ok"]) == ("0.5", "36/40")
    assert float(line["× bound"]) == pytest.approx(rms / 0.5, rel=0.005)
    assert line["Gross"] == f"{100 * (4 + sum(e > 2.5 for e in errors)) / 40:.2g} %"
    sorted_values = [float(text) for text in columns[2]["values"]]
    assert sorted_values == sorted(sorted_values)


def test_data_that_a_method_cannot_take_are_no_failure() -> None:
    cell = stored("era", failed=40)
    unable = replace(cell, rows=tuple(Row(i, Status.UNSUPPORTED, "it takes one record") for i in range(40)))
    assert origin.failures(results(unable)) == []
    found = origin.unsupported(results(unable, stored("ls", failed=3)))
    assert found == [(40, "Eigensystem realisation", "it takes one record")]
    assert board.standing_of(results(unable)[0], None) == "unsupported"


def test_stale_results_are_counted_and_commits_looked_up() -> None:
    older = stored("ls")
    version = settings_version("ls", "sdof", {})
    today = replace(stored("mcmc"), version=settings_version("mcmc", "sdof", {}).as_json())
    lines = {name: (text, behind) for name, text, behind in origin.origin(results(older, today))}
    assert lines["Stale"][0].startswith("1 of 2 cells were computed by another version")
    assert f"method version not stated, today {version.method}" in lines["Stale"][1]
    assert lines["Commits"][0] in ("1", "1, of which this repository holds 0")


def test_errors_survive_their_packing() -> None:
    """Half-precision numbers have 11 digits of two."""
    errors = np.geomspace(0.1, 10, 999)
    back = np.frombuffer(base64.b64decode(charts.packed(errors)), "<f2").astype(float)
    assert back == pytest.approx(errors, rel=2**-10)


# ---- tables and figures


def test_a_results_file_becomes_a_page_and_its_markup_stays_text(cells: Cells) -> None:
    store = cells(stored("ls"))
    folder = store.folder.parent
    text = (
        "# A title\n\nSee [other](../other.md) and [data](one.csv) <script>alert(1)</script>\n\n| a | b |\n|---|---|\n"
    )
    (folder / "one.md").write_text(text + "| 1 | <b>x |\n\n![p](figures/p.png)\n", encoding="utf-8")
    (folder / "one.csv").write_text("a,b\n", encoding="utf-8")
    site = made(store)
    page = (site / "results" / "one.html").read_text(encoding="utf-8")
    assert "<script>alert(1)" not in page
    assert "<b>x" not in page
    assert "Tables" in text_of(site / "leaderboard.html")
    linked = {own["href"] for tag, own in Page(page).elements if tag == "a" and own.get("href")}
    assert "one.csv" in linked
    assert not [target for target in linked if "other" in target]
    assert (site / "results" / "one.csv").read_text(encoding="utf-8") == "a,b\n"


def test_a_caption_begins_with_one_sentence() -> None:
    assert pictures.first_sentence("One (20 dB, 0.5 s): two. Three is more.") == (
        "One (20 dB, 0.5 s): two.",
        "Three is more.",
    )
    assert pictures.first_sentence("Does it? It does.") == ("Does it?", "It does.")
    assert pictures.first_sentence("no end") == ("no end", "")


def test_figures_of_the_results_are_copied_into_the_site(cells: Cells) -> None:
    """Nothing of it leads out of its folder, which may be published alone."""
    from PIL import Image

    store = cells(stored("ls"))
    folder = store.folder.parent
    (folder / "figures").mkdir()
    Image.new("RGB", (1378, 700), "white").save(plain := io.BytesIO(), "PNG")
    whole = png.packed(plain.getvalue(), "First & foremost_ones. The rest.")
    (folder / "figures" / "a_b.png").write_bytes(whole)
    site = made(store)
    assert (site / "results" / "figures" / "a_b.png").read_bytes() == whole
    shown = Page((site / "figures.html").read_text(encoding="utf-8"))
    assert ("results/figures/a_b.png", "1378") in [(own.get("src"), own.get("width")) for tag, own in shown.elements]
    assert "First & foremost_ones. The rest." in shown.text


def test_what_the_data_do_not_tell_is_said(cells: Cells) -> None:
    site = made(cells(stored("ls"), stored("mcmc")))
    said = text_of(site / "scenarios" / "sdof-20db-start-unknown.html")
    said = said[said.index("What no method can find") :]
    assert "Mass m, damping c and stiffness k" in said
    assert "The motion tells only k/m and c/m" in said
    assert re.search(r"mass m ?100 % ?stiffness k ?95 % ?damping c ?25 %", said)


@pytest.mark.parametrize("n", [1, 30])
def test_each_method_has_a_page(n: int, cells: Cells) -> None:
    site = made(cells(*[stored(f"method-{i:02d}", 1.0 + i) for i in range(n)]))
    for i in range(n):
        assert "One mass, free decay, 20 dB, initial state unknown" in text_of(
            site / "methods" / f"method-{i:02d}.html"
        )


def test_a_store_of_failures_says_so(cells: Cells) -> None:
    site = made(cells(stored("ls", failed=40, message="no luck"), stored("mcmc", failed=40, message="none either")))
    assert "no luck" in text_of(site / "provenance.html")
    assert "failed" in text_of(site / "scenarios" / "sdof-20db-start-unknown.html")


# ---- in a browser


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Headless Chromium that can resolve no name; skipped where there is none."""
    webdriver = pytest.importorskip("selenium.webdriver")
    from selenium.webdriver.chrome.service import Service

    program, driver = shutil.which("chromium") or shutil.which("google-chrome"), shutil.which("chromedriver")
    if not program or not driver:
        pytest.skip("no Chromium here")
    options = webdriver.ChromeOptions()
    options.binary_location = program
    for argument in (
        "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
        "--host-resolver-rules=MAP * ~NOTFOUND",
    ):  # fmt: skip
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    found = webdriver.Chrome(options=options, service=Service(driver))
    yield found
    found.quit()


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site of two systems, two starts and three methods."""
    from bench.reporting.page import reading

    found = [
        stored(label, worse, system=system, told=told, failed=3 if label == "sindy" else 0)
        for system in ("sdof", "系统")
        for told in ("known", "unknown")
        for label, worse in (("ls", 1.0), ("mcmc", 1.5), ("sindy", 12.0))
    ]
    store = filled(tmp_path_factory.mktemp("results"), *found)
    keys = frozenset(one.question for one in results(*found))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reading, "table_experiments", lambda: ["table3"])
        patch.setattr(reading, "_table", lambda name: TableOfExperiment(name, 3, keys))
        return made(store)


@pytest.fixture
def shown(browser: Any, built: Path) -> tuple[Any, Path]:
    """The browser, 1440 pixels wide, and that site."""
    still = {"name": "prefers-reduced-motion", "value": "reduce"}
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [still]})
    resize(browser, 1440)
    for log in ("browser", "performance"):
        browser.get_log(log)
    return browser, built


def resize(browser: Any, width: int) -> None:
    """Give the page so many pixels."""
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)


def visit(browser: Any, site: Path, address: str) -> None:
    """Open a page, and wait until its charts and tables are there."""
    from selenium.webdriver.support.ui import WebDriverWait

    browser.get("about:blank")  # so that another part of the same page is loaded anew
    browser.get(f"{(site / address.partition('#')[0]).as_uri()}{address[len(address.partition('#')[0]) :]}")
    ready = """
    const there = (id) => document.querySelector(`#${id}`);
    return (!there("board") || bench.ready === true) && (!there("forest") || !!there("forest svg"));
    """
    WebDriverWait(browser, 20).until(lambda b: b.execute_script(ready))


def column(browser: Any, name: str) -> list[str]:
    """The texts of a column of the leaderboard."""
    script = """
    const cells = Array.from(document.querySelectorAll("#board tbody td"));
    return cells.filter((cell) => cell.dataset.label === arguments[0]).map((cell) => cell.textContent.trim());
    """
    return list(browser.execute_script(script, name))


def choose(browser: Any, name: str, value: str) -> None:
    """Take a choice, and wait for what follows."""
    from selenium.webdriver.support.ui import Select, WebDriverWait

    before = browser.execute_script("return location.hash")
    Select(browser.find_element("css selector", f"select[name='{name}']")).select_by_value(value)
    WebDriverWait(browser, 10).until(lambda b: b.execute_script("return location.hash") != before)


def test_the_browser_asks_for_nothing_else_and_complains_of_nothing(shown: tuple[Any, Path]) -> None:
    browser, site = shown
    for page in ("index.html", "leaderboard.html", "scenarios/sdof-20db-start-unknown.html", "methods/ls.html"):
        visit(browser, site, page)
        assert [entry["message"] for entry in browser.get_log("browser")] == [], page
    events = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    asked = [e["params"]["request"]["url"] for e in events if e["method"] == "Network.requestWillBeSent"]
    assert asked
    assert all(url.startswith(("file:", "data:", "about:", "blob:")) for url in asked), asked


def test_the_first_screen_advises_and_draws(shown: tuple[Any, Path]) -> None:
    """By construction ls is on the bound, mcmc behind, and sindy has gross errors."""
    browser, site = shown
    visit(browser, site, "index.html")
    rows = browser.find_elements("css selector", "#advice tbody tr")
    first = next(row.text for row in rows if "initial state unknown" in row.text)
    assert "LS, finite differences" in first
    assert "SINDy" not in first
    assert "tells k/m and c/m, not m, c or k" in first
    lead = [line.text for line in browser.find_elements("css selector", ".three li")]
    assert any("no method can find" in text and "mass" in text.lower() for text in lead)
    drawn = browser.find_element("css selector", "#forest svg").get_attribute("textContent")
    assert all(name in drawn for name in ("LS, finite differences", "Bayesian MCMC", "SINDy"))
    assert any("data=record.csv" in text for text in lead)


def test_the_command_for_a_record_of_ones_own_is_that_of_the_tutorial_that_is_run() -> None:
    page = (REPOSITORY / "bench" / "reporting" / "page" / "templates" / "home.md.j2").read_text("utf-8")
    tutorial = (REPOSITORY / "docs" / "tutorials" / "own_record.md").read_text("utf-8")
    (command,) = re.findall(r"python -m bench[^`]* data=[^`]*", page)
    assert any(set(command.split()) <= set(line.split()) for line in tutorial.splitlines()), command


def test_errors_in_percent_are_those_of_the_rows() -> None:
    """Answers 1 % off k/m, and one grossly wrong: the root mean square of what is not gross is 1 %."""
    cell = stored("ls")
    rows = [replace(row, scores={**row.scores, "k_over_m_error_pct": 1.0}) for row in cell.rows]
    rows[0] = replace(rows[0], scores={**rows[0].scores, "k_over_m_error_pct": 1000.0})
    summary = summarise(rows, BOUND)
    panel = panel_of(replace(cell, rows=tuple(rows), summary=summary))
    assert told.accuracy([panel], "ls").startswith("k/m 1 %, ")
    assert told.tells([panel]) == "tells k/m and c/m, not m, c or k"


def test_the_leaderboard_opens_best_first_and_sorts_by_value(shown: tuple[Any, Path]) -> None:
    browser, site = shown
    visit(browser, site, "leaderboard.html#system=sdof&quantity=k/m (%25)")
    assert column(browser, "Standing")[0] == "first tier"
    visit(browser, site, "leaderboard.html#system=sdof&sort=6.desc")
    values = [math.inf if v == "–" else float(v) for v in column(browser, "Median")]
    assert len(values) == 24  # two starts, three methods, four quantities
    assert values == sorted(values, reverse=True)


def test_choices_are_kept_in_the_address_and_read_from_it(shown: tuple[Any, Path]) -> None:
    browser, site = shown
    visit(browser, site, "leaderboard.html")
    choose(browser, "start", "known")
    choose(browser, "method", "sindy")
    address = browser.current_url
    assert set(column(browser, "Method")) == {"SINDy"}
    before = [column(browser, name) for name in ("Method", "Error of", "Median", "Scenario")]
    browser.get("about:blank")
    visit(browser, site, f"leaderboard.html{address[address.index('#') :]}")
    assert [column(browser, name) for name in ("Method", "Error of", "Median", "Scenario")] == before
    assert browser.find_element("id", "count").text.startswith("1 of ")


def test_impossible_choices_are_grey_and_a_limit_of_time_holds(shown: tuple[Any, Path]) -> None:
    """Fits take 10, 15 and 120 ms by construction; none takes 1 ms; one noise level is stored."""
    browser, site = shown
    visit(browser, site, "leaderboard.html#system=sdof&method=mcmc")
    grey = """
    const options = Array.from(document.querySelector(`select[name=${arguments[0]}]`).options);
    return options.filter((option) => option.disabled).map((option) => option.value);
    """
    assert browser.execute_script(grey, "budget") == ["0.001", "0.01"]
    choose(browser, "method", "")
    choose(browser, "budget", "0.1")
    assert set(column(browser, "Method")) == {"LS, finite differences", "Bayesian MCMC"}
    assert "sindy" in browser.execute_script(grey, "method")


def test_two_methods_are_compared_on_the_same_data_sets(shown: tuple[Any, Path]) -> None:
    """The numbers of scipy and of order statistics, from the stored errors."""
    browser, site = shown
    visit(browser, site, "leaderboard.html#system=sdof&start=unknown&a=mcmc&b=sindy&of=k_over_m_error_pct")
    from selenium.webdriver.support.ui import WebDriverWait

    found = WebDriverWait(browser, 10).until(lambda b: b.execute_script("return bench.compared"))
    own = [stored("mcmc", 1.5), stored("sindy", 12.0, failed=3)]
    a, b = (one.errors("k_over_m_error_pct") for one in results(*own))
    ratios = np.sort(b / a)
    test = binomtest(int(np.sum(b < a)), 40)
    k = int(binom.ppf(0.025, 40, 0.5))
    assert (found["n"], found["nearer"], found["further"]) == (40, int(np.sum(a < b)), int(np.sum(b < a)))
    assert found["p"] == pytest.approx(test.pvalue, rel=1e-9)
    assert found["ratio"] == pytest.approx(float(np.median(ratios)), rel=0.01)
    assert found["low"] == pytest.approx(ratios[k - 1], rel=0.01)
    assert found["lost"] == [0, 3]
    said = browser.find_element("id", "verdict").text
    assert "On 40 data sets the error of SINDy is" in said
    points = browser.find_elements(
        "css selector", "#scatter svg path[aria-roledescription='point'], #scatter svg .mark-symbol path"
    )
    assert len(points) == 37


@pytest.mark.parametrize(("fewer", "n"), [(0, 5), (3, 11), (40, 100)])
def test_the_sign_test_is_scipys(fewer: int, n: int, shown: tuple[Any, Path]) -> None:
    browser, site = shown
    visit(browser, site, "leaderboard.html")
    script = """
    const pairs = Array.from({length: arguments[1]}, (_, i) => ({a: 1, b: i < arguments[0] ? 0.5 : 2}));
    return bench.statistics(pairs).p;
    """
    assert browser.execute_script(script, fewer, n) == pytest.approx(binomtest(fewer, n).pvalue, rel=1e-9)


def test_what_is_shown_can_be_taken(shown: tuple[Any, Path]) -> None:
    browser, site = shown
    visit(browser, site, "leaderboard.html#system=sdof&start=unknown&method=ls&quantity=k/m (%25)")
    browser.execute_script(
        "bench.save = (name, type, text) => { window.saved = [name, text]; };"
        "bench.copy = (text) => { window.copied = text; };"
    )
    for button in browser.find_elements("css selector", ".dt-buttons button"):
        if button.text in ("JSON", "Copy as Markdown"):
            button.click()
    name, text = browser.execute_script("return window.saved")
    (line,) = json.loads(text)
    assert name == "leaderboard.json"
    assert (line["Method"], line["Error of"], line["Fits ok"]) == ("LS, finite differences", "k/m (%)", "40/40")
    shown_now = column(browser, "Median")[0]
    assert line["Median"] == shown_now
    copied = browser.execute_script("return window.copied")
    assert copied.splitlines()[1].count("---") == copied.splitlines()[0].count("|") - 1
    latex = browser.execute_script("return bench.latex({header: ['a_b', '50 %'], body: [['x&y', '×2']]})")
    assert "a\\_b & 50 \\% \\\\" in latex
    assert "x\\&y & $\\times$2" in latex


def test_a_figure_can_be_taken_as_svg_and_png(shown: tuple[Any, Path]) -> None:
    browser, site = shown
    visit(browser, site, "index.html")
    links = [
        link.get_attribute("textContent") for link in browser.find_elements("css selector", "#forest .vega-actions a")
    ]
    assert links == ["Export as SVG", "Export as PNG"]


def test_the_keyboard_reaches_content_and_sorts(shown: tuple[Any, Path]) -> None:
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    browser, site = shown
    visit(browser, site, "scenarios/sdof-20db-start-unknown.html")
    ActionChains(browser).send_keys(Keys.TAB).perform()
    assert "md-skip" in browser.switch_to.active_element.get_attribute("class")
    head = browser.find_element("css selector", "article table.cards thead th:nth-child(2) [role='button']")
    head.send_keys(Keys.ENTER)
    cells = browser.find_elements("css selector", "article table.cards tbody td:nth-child(2)")
    values = [float(cell.text) for cell in cells]
    assert values == sorted(values)


@pytest.mark.parametrize("width", [360, 800, 1440])
@pytest.mark.parametrize("page", ["index.html", "leaderboard.html", "scenarios/sdof-20db-start-unknown.html"])
def test_no_page_is_wider_than_the_screen(width: int, page: str, shown: tuple[Any, Path]) -> None:
    browser, site = shown
    resize(browser, width)
    visit(browser, site, page)
    inside, wide = browser.execute_script("const e = document.documentElement; return [e.clientWidth, e.scrollWidth]")
    assert wide <= inside
    assert inside > 0.9 * width


def test_a_phone_shows_rows_as_cards(shown: tuple[Any, Path]) -> None:
    browser, site = shown
    resize(browser, 360)
    visit(browser, site, "leaderboard.html")
    cell = browser.find_element("css selector", "#board tbody td")
    assert cell.value_of_css_property("display") == "grid"
    label = "return getComputedStyle(document.querySelector('#board tbody td'), '::before').content"
    assert browser.execute_script(label) == '"Method"'


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize(
    "page", ["index.html", "leaderboard.html", "scenarios/sdof-20db-start-unknown.html", "provenance.html"]
)
def test_axe_finds_nothing_serious(scheme: str, page: str, shown: tuple[Any, Path]) -> None:
    browser, site = shown
    browser.execute_cdp_cmd(
        "Emulation.setEmulatedMedia", {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
    )
    visit(browser, site, page)
    browser.execute_script(AXE.read_text(encoding="utf-8"))
    browser.set_script_timeout(60)
    run = """
    const end = arguments[0];
    const told = (one) => [one.impact, one.id, one.nodes[0].html];
    axe.run(document, {preload: false}).then((found) => end(found.violations.map(told)));
    """
    found = browser.execute_async_script(run)
    assert [one for one in found if one[0] in ("serious", "critical")] == []
    ground = browser.execute_script("return getComputedStyle(document.body).backgroundColor")
    light = sum(map(int, re.findall(r"\d+", ground)[:3])) / 765
    assert (light < 0.5) == (scheme == "dark")


def test_print_leaves_the_controls_out(shown: tuple[Any, Path]) -> None:
    browser, site = shown
    visit(browser, site, "scenarios/sdof-20db-start-unknown.html")
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    try:
        assert not browser.find_element("css selector", "header").is_displayed()
        assert browser.find_element("css selector", "article table.cards").is_displayed()
    finally:
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})


def test_without_scripts_a_scenario_has_its_table(shown: tuple[Any, Path]) -> None:
    browser, site = shown
    text = (site / "scenarios" / "sdof-20db-start-unknown.html").read_text(encoding="utf-8")
    path = site / "scenarios" / "still.html"
    path.write_text(re.sub(r"<script.*?</script>", "", text), encoding="utf-8")
    browser.get(path.as_uri())
    assert len(browser.find_elements("css selector", "article table tbody tr")) == 3


@pytest.mark.slow
def test_the_site_of_the_results_is_small_and_names_nothing_beyond_itself(python: Python, tmp_path: Path) -> None:
    out, results = tmp_path / "site", REPOSITORY / "results"
    store = f"store={tmp_path}"
    done = python("-m", "bench", "report", store, f"archive={results / 'archive'}", f"results={results}", f"out={out}")
    assert done.returncode == 0, done.stderr
    files = [path for path in out.rglob("*") if path.is_file() and "results" not in path.relative_to(out).parts]
    assert sum(path.stat().st_size for path in files) <= 12_000_000
    assert max(path.stat().st_size for path in files) <= 1_500_000
    for page in out.rglob("*.html"):
        text = page.read_text("utf-8")
        linked = re.findall(r'(?:<script[^>]* src|<link[^>]* href|<img[^>]* src|<a[^>]* href)="([^"#?]+)', text)
        missing = [own for own in linked if ":" not in own and not (page.parent / unquote(own)).is_file()]
        assert not missing, (page, missing)
