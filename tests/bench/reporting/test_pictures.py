"""The pictures: what they draw is what is stored, recomputed another way; what they cannot draw; letters to be read."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from conftest import REPOSITORY
from scipy import stats
from scipy.linalg import expm
from stored import (
    BOUND,
    CORRELATION,
    NOISE,
    SD_C,
    SD_K,
    described,
    displacement,
    fill,
    fill_family,
    recorded,
    save,
    scored,
)  # fmt: skip

from bench.commands.main import main
from bench.config.online import online_scenario
from bench.contract.estimate import Status
from bench.information.fisher import compute_bound, information
from bench.online.follow import Followed
from bench.reporting.labels import cards
from bench.scenario.scenario import Scenario
from bench.scoring.row import Row
from bench.scoring.summary import metric_bounds
from bench.store.store import Store

pytest.importorskip("vl_convert")

import vl_convert
from PIL import ImageFont

from bench.reporting.pictures.all_pictures import PICTURES
from bench.reporting.pictures.curves import draw_noise, draw_training
from bench.reporting.pictures.gallery import Gallery
from bench.reporting.pictures.hero import intervals
from bench.reporting.pictures.maps import bound_covariance, draw_failures, draw_scatter, ellipse, misfit
from bench.reporting.pictures.png import caption_of
from bench.reporting.pictures.responses import (
    ShownTrack,
    draw_online,
    draw_reconstruction,
    draw_record,
    draw_two_masses,
    simulated,
)  # fmt: skip
from bench.reporting.pictures.rows import coverage, draw_coverage, draw_time, excess_interval
from bench.reporting.pictures.style import Nothing, Picture, specification
from bench.reporting.pictures.theme import INK

MOST_BYTES = 150_000
COVARIANCE = np.array([[SD_K**2, CORRELATION * SD_K * SD_C], [CORRELATION * SD_K * SD_C, SD_C**2]])


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path / "rows")
    store.prepare()
    return store


def drawn(picture: Picture, column: str) -> Any:
    """The data of a picture that have a column."""
    spec = specification(picture.chart, picture.width)
    rows = next(rows for rows in spec["datasets"].values() if column in rows[0])
    return pd.DataFrame(rows)


# ---- over time


def test_the_record_is_the_stored_one(store: Store) -> None:
    fill(store, ["shooting"])
    shown = drawn(draw_record(Gallery(store)), "sample").dropna(subset="sample")
    values = displacement(np.linspace(0, 10, 25)) + NOISE * np.random.default_rng(0).standard_normal(25)
    assert np.allclose(shown[["time", "sample"]].T, [np.linspace(0, 10, 25), values], atol=1e-5)


def test_a_method_without_a_reconstruction_is_shown_by_its_parameters(store: Store) -> None:
    """Against the closed form at the ratios that were scored; from the fitted start where it is not told."""
    rows = scored("ls", 5, spread=3.0)
    for told in ("known", "unknown"):
        save(store, described("ls", told=told, n=5), rows, recorded(rows, False, False))
    for cell in Gallery(store).cells:
        k, c = 8.0 * rows[0].scores["k_over_m_ratio"], 0.4 * rows[0].scores["c_over_m_ratio"]
        arrays = cell.arrays()
        curve = simulated(cell, arrays)
        assert curve is not None
        start = np.array([1.0, 0.0])
        if cell.initial_state == "unknown":
            start = np.linalg.lstsq(free_basis(k, c, arrays["sample_times"]), arrays["sample_values"], rcond=None)[0]
        assert np.allclose(curve[0], free_basis(k, c, arrays["dense_times"]) @ start, atol=5e-4)
    assert "ls" not in draw_reconstruction(Gallery(store)).caption


def free_basis(k: float, c: float, times: np.ndarray) -> np.ndarray:
    """Responses to a unit displacement and to a unit velocity, by the matrix exponential, shape (n, 2)."""
    return np.array([expm(np.array([[0.0, 1.0], [-k, -c]]) * t)[0] for t in times])


def test_two_masses_are_drawn_with_the_stated_band_and_samples_where_a_sensor_is(store: Store) -> None:
    rows, arrays = scored("pinn", 3), recorded(scored("pinn", 3), True, False)
    twice = ("true_displacement", "displacement", "displacement_sd")
    arrays |= {name: np.tile(arrays[name], (2, 1)) for name in twice}
    save(store, described("pinn", n=3, initial=[[1.0, 0.0], [0.0, 0.0]], options={"n": 2}), rows, arrays)
    picture = draw_two_masses(Gallery(store))
    shown = drawn(picture, "low").groupby("panel", sort=False)
    error = shown.get_group("mass 2: estimate − true (mm)").dropna(subset="low")
    off = 1000.0 * (arrays["displacement"] - arrays["true_displacement"])[1]
    assert np.allclose(error.estimate, off, atol=1e-3)
    assert np.allclose(error.high - error.low, 2000 * stats.norm.ppf(0.975) * 0.01, rtol=1e-4)
    samples = [own["sample"].notna().sum() for _, own in shown]
    assert samples == [25, 0, 0, 0]


def shown_track(excesses: dict[str, float], off: float = 0.0) -> ShownTrack:
    """A record with trackers that are off by so many in the logarithm."""
    stream = online_scenario("ramp").stream(0, 0)
    quantities = stream.layout.quantities
    true = np.log(np.stack([q.value(stream.truth.parameters) * np.ones(len(stream.times)) for q in quantities], axis=1))
    none = np.zeros(len(true))
    path = Followed(true + off, np.full(true.shape, 0.01), none, none, none, 0)
    variances = {q.name: np.full(len(true), 1e-4) for q in quantities}
    return ShownTrack("ramp", stream, variances, "k_over_m", {name: (path, e) for name, e in excesses.items()})


def test_the_nearest_tracker_is_drawn_with_the_bound_and_an_end_far_off_is_on_the_panel() -> None:
    one, other = shown_track({"a": 3.0, "b": 1.0}, off=-0.9), shown_track({"a": 1.0, "b": 2.0})
    assert draw_online([one, one, other]).caption.startswith("b is most often nearest to the bound, in 2 of 3")
    assert draw_online([one, other]).caption.startswith("b and a are most often nearest to the bound, in 1 of 2")
    shown = drawn(draw_online([one]), "least")
    assert set(shown.panel) == {"ramp\nk/m, b 1.00"}
    assert np.allclose(shown.estimate, shown.true * np.exp(-0.9), rtol=1e-4)
    assert np.allclose(shown.most / shown.true, np.exp(1.96 * 0.01), atol=1e-3)


# ---- curves


def test_the_noise_picture_draws_root_mean_squares_and_bounds(store: Store) -> None:
    fill(store, ["shooting", "pinn"], (40.0, 20.0, 10.0))
    gallery = Gallery(store)
    picture = draw_noise(gallery)
    shown = drawn(picture, "series").set_index(["method", "quantity", "SNR"])
    names = {"shooting": "Multiple shooting", "pinn": "PINN"}
    for cell in gallery.cells:
        for metric, name, factor in (("k_over_m_error_pct", "k/m (%)", 1.0), ("rmse", "displacement (mm)", 1000.0)):
            at = shown.loc[(names[cell.label], name, cell.snr_db)]
            rms = factor * np.sqrt(np.mean([row.scores[metric] ** 2 for row in cell.stored.rows]))
            assert (at.bound, at.error) == pytest.approx((factor * metric_bounds(BOUND)[metric], rms), rel=1e-4)
            assert at.series == ("PINN" if cell.label == "pinn" else "other methods")
    printed = shown[shown.series == "PINN in the paper"]
    assert sorted(printed.error) == [13.0, 16.0, 21.0, 35.0, 56.0]  # mm, the paper's Table 5
    other = Store(store.folder.with_name("other"))
    other.prepare()
    save(other, described("pinn", n=5, parameters={"m": 2.0, "c": 0.4, "k": 8.0}), scored("pinn", 5))
    assert "in the paper" not in draw_noise(Gallery(other)).caption


def test_training_draws_the_stored_traces(store: Store) -> None:
    fill(store, ["pinn"])
    shown = drawn(draw_training(Gallery(store)), "term").set_index("term")
    steps = np.arange(1.0, 31.0)
    for term, values in (("whole loss", 1e4 / steps**2), ("mean square of the data", 1.0 / steps)):
        assert np.allclose(shown.loc[term, ["evaluations", "value"]].T, [steps, values], rtol=1e-5)


# ---- maps


def test_the_ellipse_is_the_bound_of_the_stored_sds_and_of_the_fisher_information(reference: Scenario) -> None:
    """The correlation comes back from three standard deviations; the ellipse is at the chi-squared quantile."""

    def covariance(bound: Any) -> np.ndarray:
        return bound_covariance(type("C", (), {"bound": staticmethod(lambda metric: metric_bounds(bound)[metric])})())

    assert np.allclose(covariance(BOUND), COVARIANCE, rtol=1e-9)
    logs = np.log1p(ellipse(COVARIANCE) / 100.0)
    distance = np.einsum("in,ij,jn->n", logs, np.linalg.inv(COVARIANCE), logs)
    assert np.allclose(distance, stats.chi2.ppf(0.95, 2), rtol=1e-3)
    groups = np.array([[-1.0, 0.0, 1.0], [-1.0, 1.0, 0.0]])  # exponents of m, c, k
    want = groups @ information(reference).covariance @ groups.T
    assert np.allclose(covariance(compute_bound(reference)), want, rtol=1e-6, atol=1e-12)


def test_the_scatter_draws_every_replicate_or_counts_it(store: Store) -> None:
    rows = scored("shooting", 40)
    rows[3] = replace(rows[3], scores={**rows[3].scores, "k_over_m_ratio": 1.5})
    rows[4] = Row(4, Status.DIVERGED)
    save(store, described("shooting", n=40), rows)
    shown = drawn(draw_scatter(Gallery(store)), "place")
    kept = [row.scores for row in rows if row.replicate not in (3, 4)]
    want = [[100 * (scores[f"{name}_ratio"] - 1) for name in ("k_over_m", "c_over_m")] for scores in kept]
    # stored ratios have five digits
    assert np.allclose(shown[shown.place == "on the panel"][["k/m", "c/m"]], want, atol=5e-3)
    assert set(shown.method) == {"Multiple\nshooting\n1 outside"}


def test_the_misfit_is_that_of_the_stored_samples(store: Store) -> None:
    """Against matrix exponentials: with the start told, and with the best start at each point."""
    rows = scored("shooting", 5)
    for told in ("known", "unknown"):
        save(store, described("shooting", told=told, n=5), rows, recorded(rows, True, False))
    for cell in Gallery(store).cells:
        arrays, damping = cell.arrays(), (0.4, 2.0, 9.0)  # the last is overdamped
        surface = misfit(cell, arrays, np.array([8.0, 3.0]), np.array(damping))
        for (i, c), (j, k) in itertools.product(enumerate(damping), enumerate((8.0, 3.0))):
            basis, start = free_basis(k, c, arrays["sample_times"]), np.array([1.0, 0.0])
            if cell.initial_state == "unknown":
                start = np.linalg.lstsq(basis, arrays["sample_values"], rcond=None)[0]
            rms = np.sqrt(np.mean((arrays["sample_values"] - basis @ start) ** 2))
            assert surface[i, j] == pytest.approx(rms, rel=1e-5)


def test_failures_are_the_worst_noise_level_and_what_was_not_tried_is_no_failure(store: Store) -> None:
    for snr, failing in ((40.0, 0), (20.0, 2), (10.0, 15)):
        rows = [Row(i, Status.TIMEOUT if i < failing else Status.OK, scores={"rmse": 1.0}) for i in range(20)]
        save(store, described("sindy", snr, n=20), rows)
    save(store, described("ls", n=20), [Row(i, Status.DIVERGED) for i in range(20)])
    absent = [Row(i, Status.UNSUPPORTED) for i in range(20)]
    save(store, {**described("sindy", n=20, duration=5.0), "system": "elsewhere"}, absent)
    save(store, {**described("ls", n=20, duration=5.0), "system": "elsewhere"}, [Row(0, Status.DIVERGED)])
    picture = draw_failures(Gallery(store))
    shown = drawn(picture, "shown").set_index(["row", "column"]).shown.to_dict()
    ls, sindy = "LS, finite differences", "SINDy"
    assert shown == {("sdof", ls): "100", ("sdof", sindy): "75", ("elsewhere", ls): "100", ("elsewhere", sindy): "–"}
    assert "17 timeout" in picture.caption
    assert "21 diverged" in picture.caption


# ---- rows


def test_excess_and_interval_of_normal_errors() -> None:
    """The interval of a root mean square over n normal errors is that of a chi-squared variable."""
    errors = np.append(2.0 * np.random.default_rng(3).standard_normal(400), np.inf)
    excess, low, high = excess_interval(errors, 2.0)
    assert excess == pytest.approx(np.sqrt(np.mean(errors[:400] ** 2)) / 2.0)
    want = excess * np.sqrt(stats.chi2.ppf([0.025, 0.975], 400) / 400)
    assert np.allclose([low, high], want, atol=0.03)
    assert np.isnan(excess_interval(np.array([1.0, np.inf]), 2.0)).all()
    assert np.isnan(excess_interval(errors, np.nan)).all()


def test_the_coverage_of_uniform_levels_is_the_nominal_one_on_the_seed_with_most_replicates(store: Store) -> None:
    n = 200
    rows = [Row(i, Status.OK, scores={"k_over_m_pit": (i + 0.5) / n, "c_over_m_pit": 1e-6}) for i in range(n)]
    save(store, described("mcmc", seed=4711, n=n), rows)
    save(store, described("mcmc", n=30), scored("mcmc", 30))
    picture = draw_coverage(Gallery(store))
    assert "for 1 of 1 methods" in picture.caption
    assert "seed 4711" in picture.caption
    shown = drawn(picture, "coverage").set_index(["quantity", "rule"])
    for level in (50, 80, 95):
        assert shown.loc[("k/m", level), "coverage"] == pytest.approx(level, abs=100 / n)
        assert shown.loc[("c/m", level), "coverage"] == 0.0
    cell = next(cell for cell in Gallery(store).cells if cell.seed == 4711)
    want = stats.binomtest(190, n).proportion_ci(method="wilson")
    assert coverage(cell, "k_over_m", 95)[1:] == pytest.approx((want.low, want.high), abs=1e-3)


def test_time_is_the_median_fit_and_rows_stand_by_tier(store: Store) -> None:
    """Within a tier the fastest comes first; the fastest of all is not, where it is far from the bound."""
    for label, spread, seconds in (("ls", 9.0, 0.1), ("shooting", 1.0, 0.2), ("pinn", 1.0, 3.0)):
        rows = [replace(row, cpu_s=9.0 if row.replicate == 7 else seconds) for row in scored(label, 100, spread)]
        save(store, described(label, n=100), rows)
    gallery = Gallery(store)
    gallery.tiers = {"shooting": 1, "pinn": 1, "ls": 2}
    picture = draw_time(gallery)
    shown = drawn(picture, "slowest").set_index("method")
    assert shown.loc["PINN", ["seconds", "slowest"]].tolist() == [3.0, 9.0]
    rms = np.sqrt(np.mean([row.scores["k_over_m_error_pct"] ** 2 for row in scored("pinn", 100)]))
    assert shown.loc["PINN", "excess"] == pytest.approx(rms / (100 * SD_K), rel=1e-4)
    order = picture.chart.to_dict()["hconcat"][0]["layer"][1]["encoding"]["y"]["sort"]
    assert order == ["Multiple shooting", "PINN", "LS, finite differences"]
    assert picture.caption.startswith("Multiple shooting is the fastest of 2 methods of the first tier")


def test_the_intervals_of_the_first_picture_are_those_of_the_stated_covariance(store: Store) -> None:
    rows, arrays = scored("pinn", 5), recorded(scored("pinn", 5), True, False)
    save(store, described("pinn", n=5), rows, arrays | {"covariance": np.diag([0.0, 4e-4, 1e-4])})
    cell = Gallery(store).cells[0]
    shown = intervals(cell, cell.arrays()).set_index("method")
    for name, score, sd in (("k/m", "k_over_m_ratio", 0.01), ("c/m", "c_over_m_ratio", 0.02)):
        low, high = stats.lognorm(sd, scale=rows[0].scores[score]).ppf([0.025, 0.975])
        assert shown.loc[name, ["low", "high"]].tolist() == pytest.approx([100 * (low - 1), 100 * (high - 1)], abs=5e-3)


# ---- what is chosen, the command, and how it looks


def test_of_cells_that_differ_in_settings_the_usual_one_is_shown_and_odd_noise_levels_are_left_out(
    store: Store,
) -> None:
    for settings, snr in (({"steps": 1}, 20.0), ({"steps": 2}, 20.0), ({"steps": 2}, 10.0)):
        save(store, {**described("pinn", snr, n=5), "settings": settings}, scored("pinn", 5))
    assert [(cell.snr_db, cell.settings) for cell in Gallery(store).cells] == [
        (20.0, {"steps": 2}),
        (10.0, {"steps": 2}),
    ]
    fill(store, ["shooting", "sindy", "ls"], (20.0, 10.0))
    fill(store, ["ls"], (21.5,))
    assert {cell.snr_db for cell in Gallery(store).main} == {20.0, 10.0}


@pytest.mark.slow
def test_what_cannot_be_drawn_says_why(store: Store, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of one method, all but failures, two masses and a family; of failed fits, the failures alone."""
    fill(store, ["pinn"])
    assert main(["tables", "what=figures", f"store={store.folder}", f"out={tmp_path / 'out'}"]) == 0
    missing = [line.split(": ")[1] for line in capsys.readouterr().err.splitlines()]
    assert missing == ["hero", "two_masses", "failures", "family"]
    failed = Store(tmp_path / "failed")
    failed.prepare()
    save(failed, described("shooting", n=3), [Row(i, Status.OOM) for i in range(3)])
    for name, draw in PICTURES.items():
        if name != "failures":
            with pytest.raises(Nothing, match=r"stored|needs"):
                draw(Gallery(failed))


@pytest.mark.slow
def test_every_picture_is_the_same_each_time_as_png_and_svg(store: Store, tmp_path: Path) -> None:
    fill(store, ["shooting"])
    out, svg = tmp_path / "out", tmp_path / "svg"
    for _ in range(2):
        before = {path.name: path.read_bytes() for path in out.glob("*")}
        assert main(["tables", "what=figures", f"store={store.folder}", f"out={out}", f"svg={svg}"]) == 0
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before
    assert (svg / "forest.svg").read_text().startswith("<svg")


@pytest.mark.parametrize("path", sorted((REPOSITORY / "results" / "figures").iterdir()), ids=lambda path: path.name)
def test_a_published_picture_is_small_and_has_a_caption(path: Path) -> None:
    assert path.suffix == ".png"
    assert path.stat().st_size <= MOST_BYTES
    assert caption_of(path).endswith(".")


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Picture]:
    """Half of the known methods and two strange ones, with failures of every kind, one of two masses, and a family."""
    store = Store(tmp_path_factory.mktemp("full") / "rows")
    store.prepare()
    labels = list(dict.fromkeys([*list(cards())[::2], "pinn", "метод", "x" * 60]))
    fill(store, labels, (40.0, 20.0, 5.0), ("unknown",), n=20)
    fill(store, labels, (20.0,), ("known",), n=20)
    for i, status in enumerate(Status):
        save(store, described(labels[i], 10.0, n=40, duration=5.0), [Row(j, status) for j in range(40)])
    rows, arrays = scored("pinn", 3), recorded(scored("pinn", 3), True, False)
    save(store, described("pinn", n=20), scored("pinn", 20), arrays | {"covariance": np.diag([0.0, 4e-4, 1e-4])})
    twice = {name: np.tile(arrays[name], (2, 1)) for name in ("true_displacement", "displacement", "displacement_sd")}
    save(store, described("pinn", n=3, initial=[[1.0, 0.0], [0.0, 0.0]], options={"n": 2}), rows, {**arrays, **twice})
    fill_family(store)
    gallery = Gallery(store)
    return cache(lambda name: PICTURES[name](gallery))


@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_can_be_read_at_its_size(name: str, full: Callable[[str], Picture]) -> None:
    """As wide as it should be; no text below 7 points, none on another, all in the colour that stands out."""
    picture = full(name)
    scene = vl_convert.vegalite_to_scenegraph(specification(picture.chart, picture.width))
    assert abs(scene["width"] - picture.width) <= 8.0
    texts = list(texts_of(scene["scenegraph"], *scene["origin"]))
    assert min(size for _, size, _, _ in texts) >= 7.0
    assert {colour for *_, colour in texts} <= {INK}
    assert any("(" in text for text, *_ in texts) or name == "failures"  # every axis has a unit
    for text, _, (left, _, right, _), _ in texts:
        assert left > -2.0, text
        assert right < scene["width"] + 2.0, text
    for (a, _, first, _), (b, _, second, _) in itertools.combinations(texts, 2):
        wide = min(first[2], second[2]) - max(first[0], second[0])
        high = min(first[3], second[3]) - max(first[1], second[1])
        assert wide < 1.0 or high < 1.0, (a, b)
    lead, rest = re.split(r"(?<=[.?!])\s+(?=[A-Z0-9])", picture.caption, maxsplit=1)
    assert len(lead) <= 140  # two lines beside a picture
    assert rest


def texts_of(item: Any, x: float, y: float) -> Iterator[tuple[str, float, tuple[float, float, float, float], str]]:
    """Texts below an item of a scene graph: text, size, extent in points and colour."""
    import matplotlib

    font = Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"
    for child in item.get("items", ()):
        if child.get("text") not in (None, "") and child.get("opacity", 1) > 0:
            lines = child["text"] if isinstance(child["text"], list) else str(child["text"]).split("\n")
            size = child["fontSize"]
            measure = ImageFont.truetype(str(font), 100)
            limit = child.get("limit") or np.inf
            wide = min(limit, max(measure.getlength(str(line)) for line in lines) * size / 100)
            high = size * (1.0 + 1.2 * (len(lines) - 1))
            left = {"right": -wide, "center": -wide / 2.0}.get(child.get("align", "left"), 0.0)
            top = {"middle": -0.5, "top": 0.0, "line-top": 0.0}.get(child.get("baseline", "alphabetic"), -0.8) * high
            at = x + child.get("x", 0.0) + child.get("dx", 0.0), y + child.get("y", 0.0) + child.get("dy", 0.0)
            box = (at[0] + left, at[1] + top, at[0] + left + wide, at[1] + top + 0.9 * high)
            if child.get("angle", 0) in (-90, 270):
                box = (at[0] + top, at[1] - left - wide, at[0] + top + 0.9 * high, at[1] - left)
            yield " ".join(map(str, lines)), size, box, child["fill"]
        yield from texts_of(child, x + child.get("x", 0.0), y + child.get("y", 0.0))
