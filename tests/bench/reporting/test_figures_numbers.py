"""What the pictures show is what is stored: numbers read off the drawn figures, and recomputed another way."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from scipy.linalg import expm
from stored import BOUND, CORRELATION, NOISE, SD_C, SD_K, described, displacement, fill, recorded, save, scored

from bench.contract.estimate import Status
from bench.information.fisher import compute_bound, information
from bench.scenario.scenario import Scenario
from bench.scoring.row import Row
from bench.scoring.summary import metric_bounds
from bench.store.store import Store

pytest.importorskip("matplotlib")

from bench.reporting.figures.basin import clusters, draw_basin, misfit
from bench.reporting.figures.gallery import Gallery, Nothing
from bench.reporting.pictures.maps import draw_failures, share
from bench.reporting.pictures.panels import bound_covariance, covered, draw_coverage, draw_noise, draw_scatter, ellipse
from bench.reporting.pictures.responses import (
    band,
    draw_reconstruction,
    draw_record,
    draw_training,
    draw_two_masses,
    simulated,
)
from bench.reporting.pictures.rows import SHARES, draw_profiles, draw_time, excess_interval, factors

REFERENCE_COVARIANCE = np.array([[SD_K**2, CORRELATION * SD_K * SD_C], [CORRELATION * SD_K * SD_C, SD_C**2]])


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path / "rows")
    store.prepare()
    return store


def test_the_record_is_the_stored_one(store: Store) -> None:
    fill(store, ["shooting"])
    shown = draw_record(Gallery(store)).figure.data
    values = displacement(np.linspace(0, 10, 25)) + NOISE * np.random.default_rng(0).standard_normal(25)
    drawn = shown[shown.samples.notna()]
    assert np.allclose(drawn[["time", "samples"]].T, [np.linspace(0, 10, 25), values], atol=1e-5)
    assert np.allclose(drawn.high - drawn.low, 2 * NOISE, rtol=1e-3)


def test_a_method_without_a_reconstruction_is_shown_by_its_parameters(store: Store) -> None:
    """Against the closed form at the ratios that were scored; started from the fitted start where it is not told."""
    rows = scored("ls", 5, spread=3.0)
    for told in ("known", "unknown"):
        save(store, described("ls", told=told, n=5), rows, recorded(rows, False, False))
    gallery = Gallery(store)
    for cell in gallery.cells:
        k, c = (8.0 * rows[0].scores["k_over_m_ratio"], 0.4 * rows[0].scores["c_over_m_ratio"])
        arrays = gallery.arrays(cell)
        curve = simulated(cell, arrays)
        assert curve is not None
        if cell.initial_state == "known":
            assert np.allclose(curve[0], displacement(arrays["dense_times"], k, c), atol=1e-4)
        else:
            basis = free_basis(k, c, arrays["sample_times"])
            start = np.linalg.lstsq(basis, arrays["sample_values"], rcond=None)[0]
            assert np.allclose(curve[0], free_basis(k, c, arrays["dense_times"]) @ start, atol=1e-4)
    assert draw_reconstruction(gallery).figure.data.panel.nunique() == 1


def free_basis(k: float, c: float, times: np.ndarray) -> np.ndarray:
    """Responses to a unit displacement and to a unit velocity, by the matrix exponential, shape (n, 2)."""
    return np.array([expm(np.array([[0.0, 1.0], [-k, -c]]) * t)[0] for t in times])


def test_the_noise_picture_draws_root_mean_squares_and_bounds(store: Store) -> None:
    fill(store, ["shooting", "sindy"], (40.0, 20.0, 10.0))
    gallery = Gallery(store)
    drawn = draw_noise(gallery).figure.data.set_index(["method", "quantity", "SNR"])
    names = {"shooting": "Multiple shooting", "sindy": "SINDy"}
    for cell in gallery.cells:
        assert cell.stored is not None
        rows = store.load(cell.stored.identity)
        assert rows is not None
        for metric, name, factor in (("k_over_m_error_pct", "k/m (%)", 1.0), ("rmse", "displacement (mm)", 1000.0)):
            shown = drawn.loc[(names[cell.label], name, cell.snr_db)]
            assert shown.bound == pytest.approx(factor * metric_bounds(BOUND)[metric], rel=1e-4)
            rms = factor * np.sqrt(np.mean([row.scores[metric] ** 2 for row in rows.rows]))
            assert shown.error == pytest.approx(rms, rel=1e-4)
    assert drawn.bound.notna().sum() == 2 * 3 * 3


def test_methods_near_the_bound_are_counted_without_the_oracle(store: Store) -> None:
    for label, spread in (("ls", 4.0), ("shooting", 1.0), ("sindy", 3.0), ("oracle", 1.0)):
        save(store, described(label, n=200), scored(label, 200, spread))
    picture = draw_noise(Gallery(store))
    assert picture.caption.startswith("1 of 3 methods stay within twice the bound at every noise level.")
    series = dict(zip(picture.figure.data.method, picture.figure.data.series, strict=True))
    assert series["LS, finite differences"] == "LS, finite differences"  # a method of the paper
    assert series["Multiple shooting"] == "others"


def test_the_papers_points_stand_only_beside_its_own_system(store: Store) -> None:
    rows = scored("pinn", 5)
    save(store, described("pinn", n=5, parameters={"m": 2.0, "c": 0.4, "k": 8.0}), rows)
    assert "in the paper" not in draw_noise(Gallery(store)).caption
    save(store, described("pinn", n=5), rows)
    save(store, described("pinn", 10.0, n=5), rows)
    save(store, described("ls", n=5), scored("ls", 5))
    picture = draw_noise(Gallery(store))
    assert "PINN in the paper" in picture.caption
    shown = picture.figure.data
    printed = shown[shown.series == "PINN in the paper"]
    assert sorted(printed.error) == [13.0, 16.0, 21.0, 35.0, 56.0]  # mm, the paper's Table 5
    assert set(printed.quantity) == {"displacement (mm)"}


def test_the_ellipse_is_the_bound_of_the_stored_sds() -> None:
    """The correlation comes back from the three standard deviations; the ellipse is at the chi-squared quantile."""
    cell = type("C", (), {"bound": staticmethod(lambda metric: metric_bounds(BOUND)[metric])})()
    covariance = bound_covariance(cell)  # type: ignore[arg-type]
    assert covariance is not None
    assert np.allclose(covariance, REFERENCE_COVARIANCE, rtol=1e-9)
    logs = np.log1p(ellipse(covariance) / 100.0)
    distance = np.einsum("in,ij,jn->n", logs, np.linalg.inv(REFERENCE_COVARIANCE), logs)
    assert np.allclose(distance, stats.chi2.ppf(0.95, 2), rtol=1e-3)


def test_the_correlation_is_that_of_the_fisher_information(reference: Scenario) -> None:
    """From the bounds of k/m, c/m and damping ratio alone, against the inverse information of the same scenario."""
    bound = compute_bound(reference)
    cell = type("C", (), {"bound": staticmethod(lambda metric: metric_bounds(bound)[metric])})()
    told = information(reference)
    k, c = np.array([-1.0, 0.0, 1.0]), np.array([-1.0, 1.0, 0.0])  # exponents of m, c, k
    want = np.array([[a @ told.covariance @ b for b in (k, c)] for a in (k, c)])
    assert np.allclose(bound_covariance(cell), want, rtol=1e-6, atol=1e-12)  # type: ignore[arg-type]


def test_the_scatter_draws_every_replicate_or_counts_it(store: Store) -> None:
    rows = scored("shooting", 40)
    rows[3] = replace(rows[3], scores={**rows[3].scores, "k_over_m_ratio": 1.5})
    rows[4] = Row(4, Status.DIVERGED)
    save(store, described("shooting", n=40), rows)
    gallery = Gallery(store)
    shown = draw_scatter(gallery).figure.data
    drawn = shown[shown.place == "on the panel"][["k/m", "c/m"]]
    want = [
        100 * (np.array([r.scores["k_over_m_ratio"], r.scores["c_over_m_ratio"]]) - 1)
        for r in rows
        if r.replicate not in (3, 4)
    ]
    assert np.allclose(drawn, want, atol=1e-3)
    assert set(shown.method) == {"Multiple shooting\n1 outside"}


def test_the_misfit_is_that_of_the_stored_samples(store: Store) -> None:
    """Against matrix exponentials: with the start told, and with the best start at each point."""
    rows = scored("shooting", 5)
    for told in ("known", "unknown"):
        save(store, described("shooting", told=told, n=5), rows, recorded(rows, True, False))
    gallery = Gallery(store)
    for cell in gallery.cells:
        arrays = gallery.arrays(cell)
        surface = misfit(cell, arrays, np.array([8.0, 3.0]), np.array([0.4, 2.0, 9.0]))
        assert surface.shape == (3, 2)
        for i, c in enumerate((0.4, 2.0, 9.0)):  # the last is overdamped
            for j, k in enumerate((8.0, 3.0)):
                basis = free_basis(k, c, arrays["sample_times"])
                start = np.array([1.0, 0.0])
                if cell.initial_state == "unknown":
                    start = np.linalg.lstsq(basis, arrays["sample_values"], rcond=None)[0]
                left = arrays["sample_values"] - basis @ start
                assert surface[i, j] == pytest.approx(np.sqrt(np.mean(left**2)), rel=1e-5)


def test_estimates_that_touch_share_a_marker_that_counts_them(store: Store) -> None:
    parts = {
        "a": np.array([0.5, 0.5]),
        "b": np.array([0.51, 0.49]),
        "c": np.array([0.5, 0.6]),
        "d": np.array([0.1, 0.5]),
    }
    assert clusters(parts) == [["a", "b"], ["c"], ["d"]]
    rows = scored("shooting", 5)
    for label in ("shooting", "pinn", "ls"):
        save(store, described(label, n=5), rows, recorded(rows, True, False))
    off = [replace(row, scores={**row.scores, "k_over_m_ratio": 2.0}) for row in rows]
    save(store, described("sindy", n=5), off, recorded(off, True, False))
    picture = draw_basin(Gallery(store))
    wide, floor = picture.figure.axes[:2]
    assert [text.get_text() for text in wide.texts] == ["SINDy"]
    names, count = (text.get_text().replace("\n", " ") for text in floor.texts)
    assert (names, count) == ("Multiple shooting; PINN; LS, finite differences", "3")
    assert picture.caption.startswith("3 of 4 methods end on the floor")


def test_excess_and_interval_of_normal_errors() -> None:
    """The interval of a root mean square over n normal errors is that of a chi-squared variable."""
    errors = np.append(2.0 * np.random.default_rng(3).standard_normal(400), np.inf)
    excess, low, high = excess_interval(errors, 2.0)
    assert excess == pytest.approx(np.sqrt(np.mean(errors[:400] ** 2)) / 2.0)
    want = excess * np.sqrt(stats.chi2.ppf([0.025, 0.975], 400) / 400)
    assert np.allclose([low, high], want, atol=0.03)
    assert np.isnan(excess_interval(np.array([1.0, np.inf]), 2.0)).all()
    assert np.isnan(excess_interval(errors, np.nan)).all()


def test_the_coverage_of_uniform_levels_is_the_diagonal(store: Store) -> None:
    n = 200
    nominal = np.array([0.1, 0.5, 0.95])
    assert np.allclose(covered((np.arange(n) + 0.5) / n, nominal), nominal, atol=1 / n)
    assert np.allclose(covered(np.full(n, 0.5), nominal), 1.0)
    rows = [Row(i, Status.OK, scores={"k_over_m_pit": (i + 0.5) / n, "c_over_m_pit": 1e-6}) for i in range(n)]
    save(store, described("mcmc", n=n), rows)
    picture = draw_coverage(Gallery(store))
    assert "in 1 of 1 methods" in picture.caption
    shown = picture.figure.data
    assert np.allclose(shown["k/m"], shown.level, atol=100 / n)
    assert np.allclose(shown["c/m"], 0.0)


def test_leads_name_the_methods_that_are_off(store: Store) -> None:
    """One biased by ten times its spread; intervals that hold the truth always are not as often as 95 of 100."""
    save(store, described("shooting", n=100), scored("shooting", 100))
    rows = scored("ls", 100, bias=10.0 * SD_K)
    rows = [replace(row, scores={**row.scores, "k_over_m_pit": 0.5}) for row in rows]
    save(store, described("ls", n=100), rows, recorded(rows, True, False))
    gallery = Gallery(store)
    assert draw_scatter(gallery).caption.startswith(
        "All methods scatter around the truth except LS, finite differences."
    )
    assert "in 1 of 2 methods" in draw_coverage(gallery).caption


def test_coverage_is_shown_on_the_seed_with_most_replicates(store: Store) -> None:
    for seed, n in ((0, 30), (4711, 60)):
        save(store, described("shooting", seed=seed, n=n), scored("shooting", n))
    assert "seed 4711" in draw_coverage(Gallery(store)).caption


READ = ("quarter", "median", "three quarters", "most")


def test_a_profile_rises_where_the_ratio_of_errors_is(store: Store) -> None:
    """One method always three times worse, failing on a quarter of the data sets."""
    for label, error, failing in (("shooting", 1.0, 0), ("sindy", 3.0, 5)):
        rows = [
            Row(i, Status.TIMEOUT) if i < failing else Row(i, Status.OK, scores={"k_over_m_error_pct": error * (1 + i)})
            for i in range(20)
        ]
        save(store, described(label, n=20), rows)
    best, other = draw_profiles(Gallery(store)).figure.data.to_dict("records")
    assert best == {"method": "Multiple shooting", "quantity": "k/m", **dict.fromkeys(READ, 1.0)}
    assert [other[column] for column in READ] == [3.0, 3.0, 3.0, 200.0]  # the last beyond the edge, at 100


def test_factors_are_read_off_the_profile() -> None:
    """Each read where the profile, a sum over the data sets, first reaches the share."""
    rng = np.random.default_rng(5)
    values = {name: np.exp(rng.standard_normal(203)) for name in "abc"}
    values["b"][::4] = np.inf
    least = np.min(list(values.values()), axis=0)
    for name, own in factors(values).items():
        for share_of, factor in zip(SHARES, own, strict=True):
            if np.isfinite(factor):
                before, reached = (np.mean(values[name] <= factor * near * least) for near in (1.0 - 1e-9, 1.0 + 1e-9))
                assert before < share_of <= reached
    assert np.isinf(factors(values)["b"][3])
    assert np.all(np.isfinite(factors(values)["a"]))


def test_profiles_compare_on_data_that_all_methods_were_given(store: Store) -> None:
    fill(store, ["shooting", "sindy"], (40.0, 20.0))
    fill(store, ["mcmc"], (20.0,), n=12)
    caption = draw_profiles(Gallery(store)).caption
    assert "Over 2 scenarios" in caption  # 2 methods on 2 scenarios are more than 3 on 1
    assert "first 30 replicates" in caption


def test_failures_tell_unsupported_from_failed(store: Store) -> None:
    statuses = [Status.DIVERGED] * 3 + [Status.TIMEOUT] * 2 + [Status.UNSUPPORTED] * 4 + [Status.OK] * 11
    save(store, described("shooting", n=20), [Row(i, status) for i, status in enumerate(statuses)])
    save(store, described("sindy", n=20), [Row(i, Status.OK, scores={"rmse": 1.0}) for i in range(20)])
    save(store, described("ls", 10.0, n=20), [Row(i, Status.OK, scores={"rmse": 1.0}) for i in range(20)])
    gallery = Gallery(store)
    cell = next(c for c in gallery.cells if c.label == "shooting")
    own = share(cell)
    assert (own.failed, own.status, own.absent) == (0.25, Status.DIVERGED, Status.UNSUPPORTED)
    picture = draw_failures(gallery)
    (entry,) = picture.figure.data.to_dict("records")
    assert entry == {"test": "sdof", "method": "Multiple shooting", "failed": 25.0, "shown": "25\nd"}
    assert "No fit of these failed there: LS, finite differences; SINDy." in picture.caption
    assert "Of all 56 replicates that were tried 5 failed" in picture.caption


def test_a_row_of_failures_is_the_noise_level_with_most_and_rows_without_any_are_left_out(store: Store) -> None:
    for snr, failing in ((40.0, 0), (20.0, 2), (10.0, 15)):
        rows = [Row(i, Status.TIMEOUT if i < failing else Status.OK, scores={"rmse": 1.0}) for i in range(20)]
        save(store, described("sindy", snr, n=20), rows)
    absent = [Row(i, Status.UNSUPPORTED) for i in range(20)]
    save(store, {**described("sindy", n=20, duration=5.0), "system": "elsewhere"}, absent)
    picture = draw_failures(Gallery(store))
    assert picture.figure.data[["test", "shown"]].to_numpy().tolist() == [["sdof", "75\nt"]]
    assert "1 of 2 kinds of test" in picture.caption


def test_time_is_the_median_fit(store: Store) -> None:
    seconds = [0.5, 0.1, 9.0, 0.2, 0.3]
    rows = [replace(row, cpu_s=s) for row, s in zip(scored("shooting", 5), seconds, strict=True)]
    save(store, described("shooting", n=5), rows)
    (shown,) = draw_time(Gallery(store)).figure.data.to_dict("records")
    assert (shown["seconds"], shown["slowest"]) == (0.3, 9.0)
    rms = np.sqrt(np.mean([row.scores["k_over_m_error_pct"] ** 2 for row in rows]))
    assert shown["excess"] == pytest.approx(rms / (100 * SD_K), rel=1e-4)


def test_methods_far_from_the_bound_are_pale_but_named(store: Store) -> None:
    """Fastest first; the one that is called the fastest near the bound is not the fastest of all."""
    for label, spread, seconds in (("ls", 9.0, 0.1), ("shooting", 1.0, 0.2), ("pinn", 1.0, 3.0)):
        rows = [replace(row, cpu_s=seconds) for row in scored(label, 100, spread)]
        save(store, described(label, n=100), rows)
    picture = draw_time(Gallery(store))
    near = dict(zip(picture.figure.data.method, picture.figure.data.near, strict=True))
    assert near == {"LS, finite differences": False, "Multiple shooting": True, "PINN": True}
    left = picture.figure.to_dict()["hconcat"][0]
    assert left["layer"][0]["encoding"]["y"]["sort"] == ["LS, finite differences", "Multiple shooting", "PINN"]
    assert picture.caption.startswith("Multiple shooting is the fastest method near the bound.")


def test_training_draws_the_stored_traces(store: Store) -> None:
    fill(store, ["pinn"])
    shown = draw_training(Gallery(store)).figure.data.set_index("panel")
    steps = np.arange(1.0, 31.0)
    for panel, values in (("whole loss", 1e4 / steps**2), ("data", 1.0 / steps)):
        assert np.allclose(shown.loc[panel, ["evaluations", "value"]].T, [steps, values], rtol=1e-5)


CHAIN = {"m1": 1.0, "m2": 0.8, "c1": 0.2, "c2": 0.15, "k1": 12.0, "k2": 9.0}


def chain_response(times: np.ndarray, k1: float = 12.0) -> np.ndarray:
    """Two masses in a chain released from the first, by the matrix exponential, shape (2, n)."""
    p = {**CHAIN, "k1": k1}
    mass = np.diag([p["m1"], p["m2"]])
    stiff = np.array([[p["k1"] + p["k2"], -p["k2"]], [-p["k2"], p["k2"]]])
    damp = np.array([[p["c1"] + p["c2"], -p["c2"]], [-p["c2"], p["c2"]]])
    a = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(mass, stiff), -np.linalg.solve(mass, damp)]])
    return np.array([expm(a * t)[:2, 0] for t in times]).T


def chain_store(store: Store, told: str) -> Gallery:
    """A cell whose one uncertain parameter is k1, known to 1 %."""
    dense, times = np.linspace(0, 10, 120), np.linspace(0, 10, 40)
    logs = np.log([CHAIN[name] for name in ("m1", "m2", "c1", "c2", "k1", "k2")])
    arrays = {
        "sample_times": np.tile(times, 2), "sample_values": chain_response(times).ravel(),
        "sample_dof": np.repeat([0, 1], 40), "dense_times": dense, "true_displacement": chain_response(dense),
        "displacement": chain_response(dense, 12.05), "mean": logs, "covariance": np.diag([0, 0, 0, 0, 1e-4, 0.0]),
    }  # fmt: skip
    data = {"system": "chain", "options": {"n": 2}, "parameters": CHAIN, "initial": [[1.0, 0.0], [0.0, 0.0]]}
    rows = [Row(i, Status.OK, scores={"rmse": 0.01, **{f"{name}_ratio": 1.0 for name in CHAIN}}) for i in range(3)]
    save(store, {**described("shooting", told=told, n=3, **data), "system": "chain2"}, rows, arrays)
    return Gallery(store)


def test_the_band_of_two_masses_is_that_of_the_stated_covariance(store: Store) -> None:
    """To first order: the derivative of the response by log k1, by differences of matrix exponentials, times 1 %."""
    gallery = chain_store(store, "known")
    cell = gallery.cells[0]
    sd, _ = band(cell, gallery.arrays(cell))
    assert sd is not None
    times = np.linspace(0, 10, 120)
    slope = (chain_response(times, 12.0 * 1.001) - chain_response(times, 12.0 / 1.001)) / (2 * np.log(1.001))
    want = 0.01 * np.abs(slope)
    assert np.allclose(sd, want, atol=0.12 * want.max())
    assert np.mean(sd) == pytest.approx(np.mean(want), rel=0.1)
    error = 1000 * (chain_response(times, 12.05) - chain_response(times))
    for dof, row in enumerate(draw_two_masses(gallery).figure.vconcat):
        drawn = row.hconcat[1].data
        assert np.allclose(drawn.error, error[dof], atol=1e-2)
        assert np.allclose(drawn.high - drawn.low, 2000 * 1.96 * sd[dof], rtol=1e-3, atol=1e-3)


def test_a_mass_without_a_sensor_has_no_samples(store: Store) -> None:
    gallery = chain_store(store, "known")
    cell = gallery.cells[0]
    first = {name: a[:40] if name.startswith("sample_") else a for name, a in gallery.arrays(cell).items()}
    stored = store.load(cell.stored.identity)
    assert stored is not None
    store.save(replace(stored, arrays=first))
    gallery = Gallery(store)
    assert draw_record(gallery).figure.data.panel.nunique() == 1
    assert "40 noisy samples of the displacement" in draw_record(gallery).caption
    left = [row.hconcat[0].data for row in draw_two_masses(gallery).figure.vconcat]
    assert [own.samples.notna().sum() for own in left] == [40, 0]


def test_no_band_is_made_up_where_the_start_was_not_told(store: Store) -> None:
    gallery = chain_store(store, "unknown")
    cell = gallery.cells[0]
    assert band(cell, gallery.arrays(cell))[0] is None
    assert "states no band" in draw_two_masses(gallery).caption


def test_of_cells_that_differ_in_settings_the_usual_one_is_shown(store: Store) -> None:
    for settings, snr in (({"steps": 1}, 20.0), ({"steps": 2}, 20.0), ({"steps": 2}, 10.0)):
        save(store, {**described("pinn", snr, n=5), "settings": settings}, scored("pinn", 5))
    shown = [(cell.snr_db, cell.settings) for cell in Gallery(store).cells]
    assert shown == [(20.0, {"steps": 2}), (10.0, {"steps": 2})]


def test_a_noise_level_of_few_methods_is_not_in_a_sweep(store: Store) -> None:
    fill(store, ["shooting", "sindy", "ls"], (40.0, 20.0))
    fill(store, ["ls"], (21.5,))
    assert {cell.snr_db for cell in Gallery(store).main} == {40.0, 20.0}


def test_what_cannot_be_drawn_says_why(store: Store) -> None:
    save(store, described("shooting", n=3), [Row(i, Status.OOM) for i in range(3)])
    gallery = Gallery(store)
    for draw in (draw_record, draw_scatter, draw_training, draw_two_masses, draw_profiles, draw_coverage):
        with pytest.raises(Nothing, match=r"stored|needs"):
            draw(gallery)
    assert draw_failures(gallery).figure.data.shown.tolist() == ["100\no"]
