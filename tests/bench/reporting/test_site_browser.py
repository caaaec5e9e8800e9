"""The site in a browser: what it shows, whom it asks, and who can read it."""

from __future__ import annotations

import json
import math
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import REPOSITORY
from scipy.stats import binom, binomtest
from sites import filled, made, stored

from bench.reporting.frame import Result

AXE = Path(__file__).parent / "axe" / "axe.min.js"

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
    from bench.reporting.page import origin, reading

    found = [
        stored(label, worse, system=system, told=told, failed=3 if label == "sindy" else 0)
        for system in ("sdof", "系统")
        for told in ("known", "unknown")
        for label, worse in (("ls", 1.0), ("mcmc", 1.5), ("sindy", 12.0))
    ]
    store = filled(tmp_path_factory.mktemp("results"), *found)
    keys = frozenset(Result.of_stored(one).question for one in found)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reading, "table_experiments", lambda: ["table3"])
        patch.setattr(reading, "questions", lambda name: keys)
        patch.setattr(origin, "table_experiments", list)
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
    a, b = (one.errors("k_over_m_error_pct") for one in map(Result.of_stored, own))
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
