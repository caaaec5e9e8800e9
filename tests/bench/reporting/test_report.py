"""The report is one whole, quiet, readable page whatever the store holds, and works in a browser without network."""

from __future__ import annotations

import hashlib
import json
import math
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import REPOSITORY
from scipy.stats import chi2
from stored import described, recorded, save, scored

from bench.commands.report import main
from bench.contract.estimate import Status
from bench.information.fisher import Bound
from bench.reporting.frame import Result
from bench.reporting.page import drawing, headline, leaderboard, neighbours, origin, page
from bench.reporting.page.drawing import chance_band
from bench.reporting.page.first_replicate import first_replicate, stated_interval
from bench.reporting.page.reading import Panel, Table, read
from bench.reporting.page.standing import rank
from bench.reporting.page.typical import typical
from bench.scoring.row import Row
from bench.scoring.summary import summarise
from bench.store.store import Store
from bench.store.stored import StoredCell
from bench.store.version import version_of

pytest.importorskip("jinja2")
pytest.importorskip("matplotlib")

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
HOSTILE = "<script>alert(1)</script>\"'&{{7*7}}"
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
    summary = {name: dict(vars(line)) for name, line in summarise(rows, BOUND).items()}
    origin = {"commit": "c" * 40, "packages": {"numpy": "2"}, "started": "2026-01-01T00:00:00+00:00"}
    return StoredCell(identity, what, rows, summary, BOUND.prior_share, BOUND.identifiable, 1.0, origin)


def results(*found: StoredCell) -> list[Result]:
    """Stored cells as the page reads them."""
    return list(map(Result.of_stored, found))


def panel_of(*found: StoredCell) -> Panel:
    """A panel that no experiment describes."""
    return Panel(tuple(results(*found)), ())


@pytest.fixture(autouse=True)
def without_experiments(monkeypatch: pytest.MonkeyPatch) -> None:
    """No configuration is composed: these stores hold what no experiment describes."""
    from bench.reporting.page import reading

    monkeypatch.setattr(reading, "table_experiments", list)


@pytest.fixture
def cells(tmp_path: Path) -> Cells:
    """Makes a store of the given cells."""

    def make(*found: StoredCell) -> Store:
        store = Store(tmp_path / "results" / "rows")
        store.prepare()
        for cell in found:
            store.save(cell)
        return store

    return make


def made(store: Store) -> str:
    """The page of a store, by the command."""
    out = store.folder.parent / "report.html"
    assert main([f"store={store.folder}", f"out={out}"]) == 0
    return out.read_text(encoding="utf-8")


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


def words(text: str) -> str:
    """The text of a page with single blanks."""
    return " ".join(Page(text).text.split())


@pytest.mark.parametrize("what", ["absent", "empty", "damaged", "argument", "out"])
def test_what_cannot_be_shown_is_one_line(
    what: str, cells: Cells, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store = cells(*([] if what == "empty" else [stored("ls")]))
    arguments = [f"store={store.folder}", f"out={tmp_path / 'page.html'}"]
    if what == "absent":
        arguments[0] = f"store={tmp_path / 'nowhere'}"
    if what == "damaged":
        next(store.folder.glob("*.json")).write_text("{", encoding="utf-8")
    if what == "argument":
        arguments.append("stor=x")
    if what == "out":
        arguments[1] = f"out={tmp_path}"
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("bench.report: ")
    assert len(error.splitlines()) == 1
    assert not (tmp_path / "page.html").exists()
    assert not list(tmp_path.rglob("*.tmp"))


def test_the_page_is_the_same_each_time(cells: Cells) -> None:
    store = cells(stored("ls"), stored("mcmc", 1.3), stored("mcmc", 1.1, told="known"))
    assert made(store) == made(store)


def test_names_are_text_and_nothing_else(cells: Cells) -> None:
    text = made(
        cells(stored(HOSTILE, system=HOSTILE, failed=3, message=HOSTILE), stored(OTHER_SCRIPTS), stored("a$b$_c"))
    )
    found = Page(text)
    assert [tag for tag, _ in found.elements].count("script") == 1
    assert HOSTILE in found.text
    assert OTHER_SCRIPTS in found.text
    assert "a$b$_c" in found.text
    assert not [a for _, own in found.elements for a in own if a.startswith("on")]


TEMPLATES = (
    r"\74img src=x onerror=alert(1)\76", r"\g<0>", r"\1", "C:\\rigs\\new", "\\", "{{7*7}}", "{% raw %}", "${HOME}",
    "$\\frac{a$",
)  # fmt: skip
"""What a template of regular expressions, of Jinja, of a shell or of TeX would take for more than letters."""
PICTURE = 'aria-label="Record, fits and intervals: '


@pytest.mark.parametrize("name", TEMPLATES)
def test_a_name_that_a_template_would_read_is_a_name(cells: Cells, name: str) -> None:
    store, rows = cells(), scored("shooting", 30)
    for label in ("shooting", name):
        save(store, {**described(label), "system": name}, rows, recorded(rows, True, True))
    text = made(store)
    found = Page(text)
    assert name in found.text
    assert PICTURE in text
    assert [tag for tag, _ in found.elements].count("script") == 1
    assert not [a for _, own in found.elements for a in own if a.startswith("on")]
    assert not [own for _, own in found.elements if own.get("src") == "x"]


def test_a_scenario_whose_arrays_are_damaged_has_no_picture(cells: Cells) -> None:
    store, rows = cells(), scored("shooting", 30)
    for label in ("shooting", "pinn"):
        save(store, described(label), rows, recorded(rows, True, True))
    assert PICTURE in made(store)
    one, two = (store.folder / cell.arrays for cell in store)
    one.write_bytes(one.read_bytes()[:50])
    assert PICTURE in made(store)  # of the other
    two.write_bytes(b"")
    text = made(store)
    assert PICTURE not in text
    assert "Multiple shooting" in words(text)


def test_nothing_is_loaded_from_anywhere(cells: Cells) -> None:
    text = made(cells(stored("ls"), stored("mcmc")))
    for tag, own in Page(text).elements:
        for attribute in ("src", "href", "xlink:href", "action", "srcset", "data"):
            target = own.get(attribute)
            assert target is None or target.startswith(("#", "data:")), (tag, target)
    assert "@import" not in text
    assert all(target.startswith("#") for target in re.findall(r"url\((.*?)\)", text))
    assert re.search(r"default-src 'none'", text)


def test_equal_methods_are_level_and_a_worse_one_is_behind(cells: Cells) -> None:
    """By construction: two methods differ by 0.1 % at most, one has twice their errors on the same data."""
    text = words(made(cells(stored("ls"), stored("mcmc"), stored("sindy", 2.0))))
    first = text[text.index("Which method is best") : text.index("What can no method find")]
    best, real = first.split("Is the difference real?")
    assert "2 methods tie" in best
    assert "LS, finite differences" in best
    assert "Bayesian MCMC" in best
    assert "SINDy" not in best
    assert re.search(
        r"nearest of them \([^)]*\) is SINDy: its error of \S+ is (2\.00|1\.99|2\.01) times the best’s", real
    )


def test_fewer_data_leave_a_method_undecided(cells: Cells) -> None:
    """Equal errors on a quarter of the data sets: neither in the tie, nor behind, nor in what would have shown."""
    store = cells(stored("ls", n=40), stored("mcmc", n=10))
    panel = panel_of(*store)
    ranking = rank(panel, "k_over_m_error_pct")
    assert ranking is not None
    assert ranking.weak == {"mcmc"}
    text = words(made(store))
    first = text[text.index("Which method is best") : text.index("What can no method find")]
    assert "Undecided, 10 data sets only: Bayesian MCMC." in first
    assert "tie" not in first
    assert "LS, finite differences is the only method" in first
    assert "undecided (fewer data)" in text


def test_more_data_may_separate_what_ties(cells: Cells) -> None:
    """A method that the table over all scenarios finds behind in one quantity; one behind with the other start only."""
    store = cells(stored("ls"), stored("mcmc"), stored("rls"))
    lines = ["initial_state,metric,method,ratio,low,high,p_holm,tie"]
    lines += [f"unknown,{m},mcmc,1.2,1.1,1.3,0.001,{m != 'rmse'}" for m in ("k_over_m_error_pct", "rmse")]
    lines += ["unknown,rmse,ls,1,,,,True", "known,rmse,rls,1.2,1.1,1.3,0.001,False"]
    (store.folder.parent / "leaderboard.csv").write_text("\n".join(lines), encoding="utf-8")
    assert neighbours.separated(store.folder.parent, "unknown") == {"mcmc"}
    text = words(made(store))
    assert "over all scenarios of Tables 4 and 5 together, Bayesian MCMC is behind the best" in text


def test_the_board_shows_the_errors_whose_ratio_to_the_bound_it_shows(cells: Cells) -> None:
    """Successful fits only; a bound that does not exist and the prior's own share are dashes."""
    cell = stored("mcmc", 1.5, failed=4)
    summary = {name: {**line, "bound": math.inf, "excess": math.nan} for name, line in cell.summary.items()}
    panel = panel_of(cell, StoredCell(**{**vars(stored("prior")), "summary": summary}))
    lines = {(line.method, line.quantity): line for line in leaderboard.panel_lines(panel, {})}
    errors = [row.scores["k_over_m_error_pct"] for row in cell.rows[4:]]
    one, prior = lines["Bayesian MCMC", "k/m (%)"], lines["prior (no data)", "k/m (%)"]
    assert float(one.rms) == pytest.approx(math.sqrt(sum(e**2 for e in errors) / 36), rel=5e-3)
    assert float(one.rms) / float(one.bound) == pytest.approx(float(one.excess), rel=1e-2)
    assert one.prior == "0 %"
    assert (prior.bound, prior.excess, prior.prior) == ("–", "–", "–")


def test_data_that_a_method_cannot_take_are_no_failure() -> None:
    cell = stored("era", failed=40)
    rows = tuple(Row(i, Status.UNSUPPORTED, "it takes one record") for i in range(40))
    lost = {
        name: {**line, "median": math.inf, "ci_low": math.inf, "ci_high": math.inf}
        for name, line in cell.summary.items()
    }
    unable = StoredCell(**{**vars(cell), "rows": rows, "summary": lost})
    assert origin.failures(results(unable)) == []
    assert origin.unsupported(results(unable, stored("ls", failed=3))) == [
        (40, "Eigensystem realisation", "it takes one record")
    ]
    assert [line[0] for line in origin.failures(results(unable, stored("ls", failed=3)))] == [3]
    line = leaderboard.panel_lines(panel_of(unable), {})[0]
    assert (line.place, line.median, line.interval, line.rms) == ("unsupported", "–", "–", "–")


@pytest.mark.parametrize("n", [20, 100])
def test_the_band_of_chance_holds_95_of_100(n: int) -> None:
    """The sum of squares of n standard normal numbers is chi-squared."""
    low, high = chance_band(n)
    inside = chi2.cdf(n * high**2, n) - chi2.cdf(n * low**2, n)
    assert inside == pytest.approx(0.95, abs=0.005)


@pytest.mark.parametrize(
    ("p", "text"),
    [
        (0.04, "about once in 25 times"),
        (1 / 1754, "about once in 1,800 times"),
        (9e-5, "less than once in 10,000 times"),
    ],
)
def test_a_chance_is_once_in_so_many_times(p: float, text: str) -> None:
    assert headline.chance(p) == text


def test_robustness_says_how_many_data_sets_and_what_a_size_is(tmp_path: Path) -> None:
    lines = ["disturbance,size,initial_state,method,metric,excess,ratio_low,ratio_high,n_ok,n"]
    for kind, size, told in (("none", "", "unknown"), ("late_trigger", 0.02, "known"), ("other_kind", 3, "known")):
        lines += [
            f"{kind},{size},{told},{method},rmse,1.2,0.9,1.1,{n},{n}" for method, n in (("ls", 100), ("mcmc", 20))
        ]
    (tmp_path / "robustness.csv").write_text("\n".join(lines), encoding="utf-8")
    table = neighbours.robustness(tmp_path)
    assert table is not None
    assert table.headers == ("Method", "Data sets", "undisturbed", "late trigger, 0.02 s", "other kind, 3")
    assert table.groups == (("", 2), ("start unknown", 1), ("start known", 2))
    assert [row[1] for row in table.rows] == ["100", "20"]


def test_where_there_is_no_room_every_system_of_a_table_has_a_place(
    cells: Cells, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Four scenarios of a line a quantity; the first system's others give way to the second's, not to a lone cell's."""
    given = [
        stored("ls", snr=40.0),
        stored("ls", snr=20.0),
        stored("ls", snr=10.0, system="b"),
        stored("ls", system="c"),
    ]
    found = read(cells(*given))
    table = (Table("t", 1, frozenset()),)
    panels = tuple(replace(p, experiments=() if p.facts.system == "c" else table) for p in found.panels)
    panels = tuple(sorted(panels, key=lambda p: (p.facts.system != "sdof", p.facts.system, -p.facts.snr_db)))
    assert [panels[i].facts.snr_db for i in typical(panels)] == [20.0, 10.0, 20.0]
    each = len(panels[0].metrics)
    monkeypatch.setattr(leaderboard, "MOST_LINES", 2 * each)
    made_of = leaderboard.leaderboard(replace(found, panels=panels), {})
    assert [(line.system, line.snr) for line in made_of.lines] == [("sdof", "20")] * each + [("b", "10")] * each
    assert made_of.left_out == 2


def test_the_leaderboard_says_how_many_scenarios_it_has(cells: Cells, monkeypatch: pytest.MonkeyPatch) -> None:
    store = cells(stored("ls"), stored("ls", system="other"))
    assert "in every scenario" in words(made(store))
    monkeypatch.setattr(leaderboard, "MOST_LINES", 1)
    assert "in 1 of 2 scenarios; the store holds the others" in words(made(store))


def test_a_scenario_without_a_picture_is_left_out_unless_it_is_on_the_first_screen(cells: Cells) -> None:
    """None of these cells keeps arrays."""
    text = made(cells(stored("ls"), stored("ls", system="other")))
    assert 'id="scenario-0"' in text
    assert 'id="scenario-1"' not in text
    assert "1 scenario is left out here" in words(text)


def test_grossly_wrong_fits_are_not_drawn_over_the_record() -> None:
    found = {f"m{worse:g}": (Result.of_stored(stored("ls", worse)), None) for worse in (1.0, 1.5, 2.9, 3.1, 40.0)}
    assert drawing._chosen(found) == ["m1", "m1.5", "m2.9"]


@pytest.mark.parametrize(
    ("spread", "heads", "says"),
    [
        ((-5.0, 5.0), [], []),
        ((11.0, 20.0), [10.0], [("11 to 20", "right")]),
        ((-20.0, -11.0), [-10.0], [("−20 to −11", "left")]),
        ((-20.0, 5.0), [-10.0], [("← −20 to 5", "left")]),
        ((-20.0, 20.0), [-10.0, 10.0], [("↔ −20 to 20", "left")]),
    ],
)
def test_what_goes_beyond_an_edge_is_marked_there(
    spread: tuple[float, float], heads: list[float], says: list[tuple[str, str]]
) -> None:
    axis = drawing.pyplot().figure().add_subplot()
    drawing._mark_beyond(axis, 0.0, spread, 10.0, "black")
    drawing._say_beyond(axis, 0.0, np.array(spread), 10.0)
    assert [float(line.get_xdata()[0]) for line in axis.lines] == heads
    assert [(text.get_text(), text.get_horizontalalignment()) for text in axis.texts] == says


def test_of_each_kind_of_quantity_one_is_drawn() -> None:
    names = [f"{name}_error_pct" for name in ("m1", "m2", "c1", "c2", "k1", "k2", "k3")]
    assert drawing._one_of_each([*names, "rmse"]) == ["m1_error_pct", "c1_error_pct", "k1_error_pct"]
    assert drawing._one_of_each(["k_over_m_error_pct", "c_over_m_error_pct", "rmse"]) == [
        "k_over_m_error_pct", "c_over_m_error_pct",
    ]  # fmt: skip


def test_what_the_data_do_not_tell_is_said(cells: Cells) -> None:
    text = words(made(cells(stored("ls"), stored("mcmc"))))
    said = text[text.index("What can no method find") :][:700]
    assert "Mass m, damping c and stiffness k" in said
    assert "The motion tells only k/m and c/m" in said
    assert re.search(r"mass m ?100 % ?stiffness k ?95 % ?damping c ?25 %", said)


@pytest.mark.parametrize("n", [1, 30])
def test_one_method_or_thirty(n: int, cells: Cells) -> None:
    found = [stored(f"method-{i:02d}", 1.0 + i) for i in range(n)]
    text = made(cells(*found))
    assert all(f"method-{i:02d}" in words(text) for i in range(n))
    assert ("nothing to compare it with" in text) == (n == 1)


def test_a_store_of_failures_says_so(cells: Cells) -> None:
    text = words(
        made(cells(stored("ls", failed=40, message="no luck"), stored("mcmc", failed=40, message="none either")))
    )
    assert "failed: diverged" in text
    assert "Bayesian MCMC and LS, finite differences gave no answer" in text
    assert "no luck" in text
    assert "None is best in every quantity" in text


def test_figures_are_inlined_while_there_is_room(cells: Cells, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    store = cells(stored("ls"), stored("mcmc"))
    folder = store.folder.parent / "figures"
    folder.mkdir()
    for name, size in (("a_small", 100), ("b_large", 60_000)):
        path = " ".join(f"L {i} {i % 7}" for i in range(size // 8))
        body = f'<svg xmlns="http://www.w3.org/2000/svg"><script>x()</script><path d="M 0 0 {path}"/></svg>'
        (folder / f"{name}.svg").write_text(body, encoding="utf-8")
        (folder / f"{name}.txt").write_text(f"caption of {name} & more\n", encoding="utf-8")
    whole = made(store)
    assert len(re.findall(r'<img src="data:image/svg\+xml', whole)) == 2
    monkeypatch.setattr(page, "LIMIT", len(whole.encode()) - 20_000)
    short = made(store)
    assert len(short.encode()) <= page.LIMIT
    assert len(re.findall(r'<img src="data:image/svg\+xml', short)) == 1
    assert 'href="figures/b_large.svg"' in short
    assert "caption of b_large & more" in words(short)
    assert [tag for tag, _ in Page(whole).elements].count("script") == 1


def response(m: float, c: float, k: float, times: np.ndarray) -> np.ndarray:
    """Free decay from x = 1, v = 0 in closed form."""
    omega, decay = math.sqrt(k / m), c / (2 * m)
    damped = math.sqrt(omega**2 - decay**2)
    return np.exp(-decay * times) * (np.cos(damped * times) + decay / damped * np.sin(damped * times))


@pytest.mark.parametrize("agrees", [True, False])
def test_a_fit_is_made_again_only_if_its_stored_error_agrees(agrees: bool, cells: Cells) -> None:
    times, dense = np.linspace(0, 10, 25), np.linspace(0, 10, 1000)
    truth, fit = response(1.0, 0.4, 8.0, dense), response(1.01, 0.42, 8.3, dense)
    error = float(np.sqrt(np.mean((fit - truth) ** 2)))
    cell = stored("ls", told="known")
    scores = {"m_ratio": 1.01, "c_ratio": 1.05, "k_ratio": 8.3 / 8, "rmse_simulated": error * (1 if agrees else 1.1)}
    rows = (Row(0, Status.OK, scores=scores), *cell.rows[1:])
    covariance = np.diag([0.02, 0.05, 0.03]) ** 2
    arrays = {
        "sample_times": times, "sample_values": response(1.0, 0.4, 8.0, times), "sample_dof": np.zeros(25, int),
        "dense_times": dense, "true_displacement": truth[None], "mean": np.log([1.01, 0.42, 8.3]),
        "covariance": covariance,
    }  # fmt: skip
    store = cells()
    saved = store.save(StoredCell(**{**vars(cell), "rows": rows}), arrays)
    result = Result.of_stored(saved)
    one = first_replicate(store, result)
    assert one is not None
    if not agrees:
        assert one.fit is None
        return
    assert one.fit == pytest.approx(fit, abs=1e-4)
    interval = stated_interval(store, result, "k_over_m")
    # log(k/m) is a difference: variances add
    half = 2 * math.sqrt(0.02**2 + 0.03**2)
    centre = 8.3 / 1.01 / 8
    assert interval == pytest.approx((centre * math.exp(-half), centre * math.exp(half)), rel=1e-5)
    assert "samples less LS" in made(store)


def test_the_command_is_no_part_of_what_computes_a_cell() -> None:
    modules = version_of((("methods.sampling.mcmc", "MCMC"),)).modules
    assert "bench.contract.progress" in modules
    assert not [name for name in modules if name.startswith(("bench.report", "bench.reporting.page"))]


def luminance(colour: str) -> float:
    """Relative luminance of #rrggbb (WCAG 2.2)."""
    parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    r, g, b = (p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts)
    return 0.2126 * r + 0.7152 * g + 0.0722 * b


@pytest.mark.parametrize("scheme", [0, 1], ids=["light", "dark"])
def test_text_stands_out(scheme: int) -> None:
    style = (REPOSITORY / "bench" / "reporting" / "page" / "report.css").read_text(encoding="utf-8")
    colours = dict(re.findall(r"--(\w+): (#[0-9a-f]{6})", re.findall(r":root \{(.*?)\}", style, re.S)[scheme]))
    for ground in ("surface", "raised", "level", "warn"):
        for ink in ("ink", "muted", "accent"):
            high, low = sorted((luminance(colours[ink]), luminance(colours[ground])), reverse=True)
            assert (high + 0.05) / (low + 0.05) >= 4.5, (ink, ground)
    for series in ("s1", "s2", "s3", "s4"):
        high, low = sorted((luminance(colours[series]), luminance(colours["surface"])), reverse=True)
        assert (high + 0.05) / (low + 0.05) >= 3.0, series


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


@pytest.fixture
def shown(browser: Any, cells: Cells) -> Any:
    """The page of two systems, two starts and three methods in the browser, 1440 pixels wide."""
    found = [
        stored(label, worse, system=system, told=told, failed=3 if label == "sindy" else 0)
        for system in ("sdof", "系统")
        for told in ("known", "unknown")
        for label, worse in (("ls", 1.0), ("mcmc", 1.5), ("sindy", 12.0))
    ]
    made(cells(*found))
    still = {"name": "prefers-reduced-motion", "value": "reduce"}  # a click waits for no scrolling
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [still]})
    resize(browser, 1440)
    for log in ("browser", "performance"):
        browser.get_log(log)
    browser.get((Path(found_page(cells))).as_uri())
    return browser


def found_page(cells: Cells) -> str:
    """Where the fixture's page is."""
    return str(cells().folder.parent / "report.html")


def resize(browser: Any, width: int) -> None:
    """Give the page so many pixels."""
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)


def column(browser: Any, name: str) -> list[str]:
    """The visible texts of a column of the leaderboard."""
    script = """
    const board = document.getElementById("board");
    const i = Array.from(board.tHead.rows[0].cells).findIndex((c) => c.textContent.trim() === arguments[0]);
    const seen = Array.from(board.tBodies[0].rows).filter((r) => r.checkVisibility());
    return seen.map((r) => r.cells[i].textContent.trim());
    """
    return list(browser.execute_script(script, name))


def head(browser: Any, name: str) -> Any:
    """The button of a column's head."""
    return browser.find_element("xpath", f"//table[@id='board']//th[button[.='{name}']]/button")


def test_the_browser_asks_for_nothing_and_complains_of_nothing(shown: Any) -> None:
    events = [json.loads(entry["message"])["message"] for entry in shown.get_log("performance")]
    asked = [e["params"]["request"]["url"] for e in events if e["method"] == "Network.requestWillBeSent"]
    assert asked
    assert all(url.startswith(("file:", "data:")) for url in asked), asked
    assert shown.get_log("browser") == []


def test_columns_sort_by_value_and_say_so(shown: Any) -> None:
    shown.find_element("name", "all").click()
    head(shown, "Median").click()
    values = [math.inf if v == "failed" else float(v) for v in column(shown, "Median")]
    assert len(values) == 48  # two systems, two starts, three methods, four quantities
    assert values == sorted(values)
    head(shown, "Median").click()
    values = [float(v) for v in column(shown, "Median")]
    assert values == sorted(values, reverse=True)
    sorts = [h.get_attribute("aria-sort") for h in shown.find_elements("css selector", "#board th")]
    assert [s for s in sorts if s] == ["descending"]
    head(shown, "Method").click()
    names = column(shown, "Method")
    assert names == sorted(names, key=str.lower)


def test_the_keyboard_sorts_and_opens(shown: Any) -> None:
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    button = head(shown, "× bound")
    button.send_keys(Keys.ENTER)
    values = [float(v) for v in column(shown, "× bound")]
    assert values == sorted(values)
    head(shown, "× bound").send_keys(Keys.SPACE)
    values = [float(v) for v in column(shown, "× bound")]
    assert values == sorted(values, reverse=True)
    shown.refresh()
    ActionChains(shown).send_keys(Keys.TAB).perform()
    assert "skip" in shown.switch_to.active_element.get_attribute("class")
    folded = shown.find_element("css selector", "#methods summary")
    folded.send_keys(Keys.ENTER)
    assert shown.find_element("css selector", "#methods details").get_attribute("open") is not None


def test_filters_narrow_and_say_how_many(shown: Any) -> None:
    from selenium.webdriver.support.ui import Select

    assert set(column(shown, "SNR (dB)")) == {"20"}
    shown.find_element("name", "all").click()
    assert len(column(shown, "Method")) == 48
    for name, value, heading in (
        ("system", "系统", "System"),
        ("start", "known", "Start"),
        ("method", "SINDy", "Method"),
    ):
        Select(shown.find_element("name", name)).select_by_visible_text(value)
        assert set(column(shown, heading)) == {value}
    assert len(column(shown, "Method")) == 4
    assert shown.find_element("id", "count").text == "4 of 48 lines"
    shown.find_element("name", "level").click()
    assert column(shown, "Method") == []
    assert shown.find_element("id", "none").is_displayed()


def test_a_choice_that_leaves_nothing_gives_up_the_others_it_must(browser: Any, cells: Cells) -> None:
    """The other system has only another noise level; start and quantity are as they were."""
    from selenium.webdriver.support.ui import Select

    made(cells(stored("ls"), stored("mcmc"), stored("ls", system="other", snr=31.478), stored("mcmc", system="third")))
    resize(browser, 1440)
    browser.get(Path(found_page(cells)).as_uri())
    assert not browser.find_element("xpath", "//table[@id='board']//th[.='System']").is_displayed()
    Select(browser.find_element("name", "system")).select_by_visible_text("other")
    assert column(browser, "System") == ["other"]
    assert column(browser, "SNR (dB)") == ["31.5"]
    assert "other, start unknown, undisturbed, k/m (%)" in browser.find_element("css selector", "#board caption").text
    chosen = {name: browser.find_element("name", name).get_attribute("value") for name in ("snr", "start", "quantity")}
    assert chosen == {"snr": "", "start": "unknown", "quantity": "k/m (%)"}
    Select(browser.find_element("name", "snr")).select_by_visible_text("20 dB")
    assert set(column(browser, "SNR (dB)")) == {"20"}
    assert browser.find_element("name", "system").get_attribute("value") == ""
    assert browser.find_element("xpath", "//table[@id='board']//th[.='System']").is_displayed()


def test_without_its_script_the_table_is_whole(shown: Any, cells: Cells) -> None:
    path = Path(found_page(cells))
    path.write_text(re.sub(r"<script>.*?</script>", "", path.read_text(encoding="utf-8"), flags=re.S), encoding="utf-8")
    shown.get(path.as_uri())
    assert len(column(shown, "Median")) == 48
    assert not shown.find_element("id", "filter").is_displayed()
    assert not shown.find_elements("css selector", "th button")


@pytest.mark.parametrize("width", [390, 1440])
def test_the_page_is_no_wider_than_the_screen(width: int, shown: Any) -> None:
    resize(shown, width)
    shown.execute_script("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
    inside, wide = shown.execute_script("const e = document.documentElement; return [e.clientWidth, e.scrollWidth]")
    assert wide <= inside
    assert inside > 0.9 * width


@pytest.mark.parametrize(("scheme", "dark"), [("light", False), ("dark", True)])
def test_it_follows_the_colour_scheme(scheme: str, dark: bool, shown: Any) -> None:
    feature = [{"name": "prefers-color-scheme", "value": scheme}]
    shown.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": feature})
    ground = shown.execute_script("return getComputedStyle(document.body).backgroundColor")
    ink = shown.execute_script("return getComputedStyle(document.querySelector('figure.own svg text')).fill")
    levels = [sum(map(int, re.findall(r"\d+", colour)[:3])) / 765 for colour in (ground, ink)]
    assert (levels[0] < 0.5) == dark
    assert (levels[1] > 0.5) == dark


def test_a_link_to_a_method_unfolds_its_card(browser: Any, cells: Cells) -> None:
    made(cells(stored("ls"), stored("mcmc")))
    browser.get(Path(found_page(cells)).as_uri())
    browser.find_element("css selector", ".answers a[href='#method-ls']").click()
    assert browser.find_element("id", "method-ls").get_attribute("open") is not None
