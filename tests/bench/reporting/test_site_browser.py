"""The site in a browser, from a folder: leaderboard, comparison, files, charts, keyboard, phone, print, and axe."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chromium import PROGRAM, Browser
from scipy.stats import binom
from sites import filled, made, stored

from bench.reporting.frame import Result
from bench.reporting.page import reading
from bench.reporting.ranking import fits_of

pytestmark = pytest.mark.skipif(not PROGRAM, reason="no Chromium here")
AXE = Path(__file__).parent / "axe" / "axe.min.js"
SCENARIO = "scenarios/sdof-20db-start-unknown.html"
PAGES = ("index.html", "leaderboard.html", SCENARIO, "methods/ls.html", "trust.html")
OF_THE_PAGE = ("Log.entryAdded", "Runtime.exceptionThrown", "Runtime.consoleAPICalled")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site of two systems, two starts and three methods; ls is on the bound, sindy loses three fits."""
    found = [
        stored(label, worse, system=system, told=told, failed=3 if label == "sindy" else 0)
        for system in ("sdof", "系统")
        for told in ("known", "unknown")
        for label, worse in (("ls", 1.0), ("mcmc", 1.5), ("sindy", 12.0))
    ]
    store = filled(tmp_path_factory.mktemp("results"), *found)
    keys = frozenset(result.question for result in map(Result.of_stored, found))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reading, "table_experiments", lambda: ["table3"])
        patch.setattr(reading, "questions", lambda name: keys)
        return made(store)


@pytest.fixture(scope="module")
def window(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    browser = Browser(tmp_path_factory.mktemp("profile"))
    yield browser
    browser.close()


@pytest.fixture
def browser(window: Browser) -> Browser:
    """A window of 1440 pixels, light, that has reported nothing."""
    show(window)
    window.events.clear()
    return window


def show(browser: Browser, width: int = 1440, scheme: str = "light", media: str = "") -> None:
    """Set the width of the page, its colours and its medium."""
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    features = {"prefers-color-scheme": scheme, "prefers-reduced-motion": "reduce"}
    browser.call("Emulation.setDeviceMetricsOverride", **size)
    wanted = [{"name": name, "value": value} for name, value in features.items()]
    browser.call("Emulation.setEmulatedMedia", media=media, features=wanted)


def visit(browser: Browser, site: Path, address: str) -> None:
    """Open a page, and wait for its tables."""
    path, mark, rest = address.partition("#")
    browser.visit(f"{(site / path).as_uri()}{mark}{rest}")
    browser.wait("!document.querySelector('#board') || document.querySelector('#board td')")


def column(browser: Browser, name: str) -> list[str]:
    """The texts of a column of the leaderboard."""
    cells = f"document.querySelectorAll('#board td[data-label={json.dumps(name)}]')"
    return list(browser.run(f"Array.from({cells}, (cell) => cell.textContent.trim())"))


def choose(browser: Browser, **values: str) -> None:
    """Take choices of the leaderboard."""
    for name, value in values.items():
        field = f"document.forms.choices.elements[{json.dumps(name.replace('_', ' '))}]"
        browser.run(f"{field}.value = {json.dumps(value)}")
        browser.run(f"{field}.dispatchEvent(new Event('change', {{bubbles: true}}))")


def test_the_browser_asks_for_nothing_else_and_complains_of_nothing(browser: Browser, site: Path) -> None:
    for page in PAGES:
        visit(browser, site, page)
    reported = [event["params"] for event in browser.events if event["method"] in OF_THE_PAGE]
    sent = [event["params"] for event in browser.events if event["method"] == "Network.requestWillBeSent"]
    assert reported == []
    assert sent
    assert all(one["request"]["url"].startswith(("file:", "data:", "about:", "blob:")) for one in sent)


def test_the_leaderboard_opens_best_first_and_sorts_by_value(browser: Browser, site: Path) -> None:
    visit(browser, site, "leaderboard.html")
    assert column(browser, "Standing")[0] == "tied"
    visit(browser, site, "leaderboard.html#sort=Median:desc")
    values = [math.inf if text == "–" else float(text) for text in column(browser, "Median")]
    assert len(values) == 36  # two systems, two starts, three methods, three quantities that the data tell
    assert values == sorted(values, reverse=True)


def test_choices_order_and_columns_are_in_the_address(browser: Browser, site: Path) -> None:
    visit(browser, site, "leaderboard.html#sort=Median:asc&hide=Outliers")
    choose(browser, Initial_state="known", Method="SINDy")
    shown = [column(browser, name) for name in ("Method", "Error of", "Bound", "Scenario")]
    address = str(browser.run("location.hash"))
    visit(browser, site, f"leaderboard.html{address}")
    assert [column(browser, name) for name in ("Method", "Error of", "Bound", "Scenario")] == shown
    assert len(shown[0]) == 6
    assert set(shown[0]) == {"SINDy"}
    assert column(browser, "Outliers") == []


def test_a_limit_of_time_holds_and_a_choice_that_leaves_nothing_gives_up_others(browser: Browser, site: Path) -> None:
    """Fits take 10, 15 and 120 ms by construction."""
    visit(browser, site, "leaderboard.html#hide=")
    choose(browser, Time_per_fit="0.1")
    assert set(column(browser, "Method")) == {"LS, finite differences", "Bayesian MCMC"}
    choose(browser, Time_per_fit="0.01")
    assert set(column(browser, "Method")) == {"LS, finite differences"}
    choose(browser, Method="SINDy")
    assert set(column(browser, "Method")) == {"SINDy"}


def test_two_methods_are_compared_on_the_same_data_sets(browser: Browser, site: Path) -> None:
    """Fits by the numbers of the ranking, counted by numpy."""
    chosen = "System=sdof: One mass, free decay&Initial state=unknown&A=Bayesian MCMC&B=SINDy"
    visit(browser, site, f"leaderboard.html#{chosen}")
    browser.wait("document.querySelectorAll('#scatter [aria-roledescription=point]').length === 40")
    fits = fits_of(map(Result.of_stored, (stored("mcmc", 1.5), stored("sindy", 12.0, failed=3))))
    a, b = (np.exp(fits[label][0]) for label in ("mcmc", "sindy"))
    said = browser.run("verdict.textContent")
    assert f"On 40 data sets the error of SINDy is {np.median(b / a):.3g} times that of Bayesian MCMC" in said
    assert f"Bayesian MCMC is more accurate on {np.sum(a < b)}, SINDy on {np.sum(b < a)}." in said
    assert f"Outlier fits: {np.sum(a > 9.99)} of Bayesian MCMC, {np.sum(b > 9.99)} of SINDy." in said


@pytest.mark.parametrize("n", [6, 20, 100, 4000])
def test_the_interval_of_a_median_covers_what_it_says(n: int, browser: Browser, site: Path) -> None:
    """The k-th least and the k-th largest hold the median with the probability of the binomial distribution."""
    visit(browser, site, "leaderboard.html")
    pairs = f"Array.from({{length: {n}}}, (_, i) => ({{a: 1, b: i + 1}}))"
    found = browser.run(f"bench.statistics({pairs})")
    k = int(found["low"])
    assert found["high"] == n + 1 - k
    assert 0.95 <= 1 - 2 * binom.cdf(k - 1, n, 0.5) <= 0.99


def test_a_chart_can_be_taken_as_svg_and_png_and_a_table_as_csv(browser: Browser, site: Path) -> None:
    visit(browser, site, "leaderboard.html#A=Bayesian MCMC&B=SINDy")
    browser.wait("document.querySelector('#scatter .vega-actions a')")
    links = "Array.from(document.querySelectorAll('#scatter .vega-actions a'), (link) => link.textContent)"
    assert browser.run(links) == ["Save as SVG", "Save as PNG"]
    assert browser.run("document.querySelector('.buttons-csv').textContent") == "CSV"


def test_the_keyboard_reaches_content_and_sorts(browser: Browser, site: Path) -> None:
    visit(browser, site, SCENARIO)
    for kind in ("keyDown", "keyUp"):
        browser.call("Input.dispatchKeyEvent", type=kind, key="Tab", windowsVirtualKeyCode=9)
    assert "md-skip" in browser.run("document.activeElement.className")
    browser.run("document.querySelector('article table.cards th:nth-child(3) [role=button]').focus()")
    for kind, text in (("keyDown", "\r"), ("keyUp", "")):
        browser.call("Input.dispatchKeyEvent", type=kind, key="Enter", windowsVirtualKeyCode=13, text=text)
    cells = "document.querySelector('article table.cards').querySelectorAll('tbody td:nth-child(3)')"
    values = browser.run(f"Array.from({cells}, (cell) => Number.parseFloat(cell.textContent))")
    assert len(values) == 3
    assert values == sorted(values)


@pytest.mark.parametrize("width", [390, pytest.param(800, marks=pytest.mark.slow), 1440])
def test_no_page_is_wider_than_the_screen(width: int, browser: Browser, site: Path) -> None:
    show(browser, width)
    for page in PAGES:
        visit(browser, site, page)
        assert browser.run("document.documentElement.scrollWidth") <= width, page


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("page", PAGES)
def test_axe_finds_nothing_serious(scheme: str, page: str, browser: Browser, site: Path) -> None:
    show(browser, scheme=scheme)
    visit(browser, site, page)
    browser.run(AXE.read_text(encoding="utf-8") + "; 0")
    said = "(found) => found.violations.map((one) => [one.impact, one.id, one.nodes[0].html])"
    found: list[Any] = browser.run(f"axe.run(document, {{preload: false}}).then({said})")
    assert [one for one in found if one[0] in ("serious", "critical")] == []
    shade = "getComputedStyle(document.body).backgroundColor.match(/\\d+/g).slice(0, 3).every((part) => part < 128)"
    assert browser.run(shade) == (scheme == "dark")


def test_without_scripts_a_scenario_has_its_table(browser: Browser, site: Path) -> None:
    browser.call("Emulation.setScriptExecutionDisabled", value=True)
    browser.call("Page.navigate", url=(site / SCENARIO).as_uri())
    browser.call("Emulation.setScriptExecutionDisabled", value=False)
    browser.wait("document.querySelector('article table').tBodies[0].rows.length === 3")
