"""What the documents say about results: named numbers as they are printed, and conclusions that hold or do not.

Each function belongs to a page of docs/, or to a section of one. The prose stands in Markdown
(:mod:`bench.reporting.documents`) and says no more of a conclusion than its condition: whatever a sentence names is
tested case by case, on the same data sets. What a table beside the prose shows already is not repeated.
"""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bench.errors import InputError

K, C, PRIMARY = "k_over_m_error_pct", "c_over_m_error_pct", ("k_over_m_error_pct", "c_over_m_error_pct", "rmse")
POOLED = {"metric": "told_pooled"}
"""All quantities that the data determine, in one error over the bound."""
ON_BOUND = ("shooting", "mcmc", "pinn", "collocation")
WHOLE = (*ON_BOUND, "ekf", "ukf")
"""The methods that solve the equation of motion as it stands, output error apart."""
USUAL = (40, 30, 20, 10)
"""The noise levels (dB) where the errors are small enough for the bound to hold."""
NEAR = 1.25
"""An excess that 50 replicates cannot distinguish from 1."""
REFERENCE = ("table2", "table3", "table5")
"""The experiments that hold Table 5: its 20 dB are those of Tables 2 and 3."""
FACTS = ["identity", "experiment", "label", "system", "snr_db", "initial_state", "disturbance", "description"]


@dataclass
class Facts:
    """Numbers by name, as they are printed, and conclusions by name."""

    numbers: dict[str, str] = field(default_factory=dict)
    conclusions: dict[str, bool] = field(default_factory=dict)

    def say(self, form: str = ",.0f", /, **numbers: Any) -> None:
        """Name numbers, each name once, with a format specification; several values are ``low to high``."""
        assert not self.numbers.keys() & numbers.keys()
        self.numbers |= {name: printed(value, form) for name, value in numbers.items()}

    def hold(self, **conclusions: Any) -> None:
        """Name conclusions: a truth value, or one of each case."""
        assert not self.conclusions.keys() & conclusions.keys()
        self.conclusions |= {name: bool(np.all(value)) for name, value in conclusions.items()}


def printed(value: Any, form: str) -> str:
    """Print text as it is, a number in a form, and of several ``low to high``; both alike are one."""
    if isinstance(value, str):
        return value
    values = np.ravel(value)
    low, high = (format(float(end), form) for end in (values.min(), values.max()))
    return low if low == high else f"{low} to {high}"


class Published:
    """The files in a folder of results; asking for what was never measured is an InputError."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._tables: dict[str, pd.DataFrame] = {}

    def table(self, name: str) -> pd.DataFrame:
        """Read ``results/<name>`` (CSV or Parquet), without the lines of cells that were not run."""
        if name not in self._tables:
            path = self.folder / name
            if not path.is_file():
                raise InputError("results", path, "there is no such file; python -m bench tables writes the tables")
            data = pd.read_parquet(path) if path.suffix == ".parquet" else pd.read_csv(path)
            self._tables[name] = data[data.metric != "not run"] if "metric" in data else data
        return self._tables[name]

    def rows(self, name: str, **wanted: Any) -> pd.DataFrame:
        """Select the lines of a table with these values, one or several per column, each of which is in some line."""
        data = self.table(name if "." in name else f"{name}.csv")
        lists = {column: value if isinstance(value, tuple) else (value,) for column, value in wanted.items()}
        for column, values in lists.items():
            data = data[data[column].isin(values)]
        for column, values in lists.items():
            if missing := sorted(set(values) - set(data[column])):
                raise InputError("results", name, f"no line has {column} = {', '.join(map(str, missing))}")
        return data

    def fits(self, experiments: Sequence[str], columns: Sequence[str], **wanted: Any) -> pd.DataFrame:
        """Return the fits of the cells with these facts, one line each; a failed one has no errors."""
        cells = self.rows("archive/cells.parquet", **wanted)
        cells = cells[cells.experiment.isin(experiments)][FACTS]
        files = [f"archive/rows/{name}.parquet" for name in cells.experiment.unique()]
        columns = ["identity", "replicate", *columns]
        return pd.concat([pd.read_parquet(self.folder / file, columns=columns) for file in files]).merge(cells)

    def common(self, experiment: str, column: str, **wanted: Any) -> pd.DataFrame:
        """Return one column of such fits, a column per label, of the data sets that all of the labels answered."""
        fits = self.fits((experiment,), [column], **wanted)
        return fits.pivot(index="replicate", columns="label", values=column).dropna()

    def study(self, file: str, section: str, table: int = 0) -> pd.DataFrame:
        """Read a Markdown table of a section of a page, as text, with its first column as the index.

        Args:
            file: Name of the page.
            section: Heading of the section.
            table: Place of the table among those of the section; -1 is the last one.

        Raises:
            InputError: The section has no table.
        """
        path = self.folder / file
        text = path.read_text("utf-8").partition(f"## {section}\n")[2] if path.is_file() else ""
        tables = [part for part in text.partition("\n## ")[0].split("\n\n") if part.lstrip("\n").startswith("|")]
        if not tables:
            raise InputError("results", path, f"no table below {section!r}")
        lines = "\n".join(line.strip("| ") for line in tables[table].strip("\n").splitlines())
        separated = {"sep": r"\s*\|\s*", "engine": "python", "skiprows": [1]}
        data = pd.read_csv(io.StringIO(lines), dtype=str, keep_default_na=False, **separated)
        return data.set_index(data.columns[0])


CHOSEN = (
    "bound", "prior (no data)", "Multiple shooting", "Bayesian MCMC", "PINN", "Matrix pencil", "IQML",
    "Logarithmic decrement", "SINDy", "LS, finite differences", "DDNN",
)  # fmt: skip
"""One method of each kind, beside the bound and what is known without data, as README shows them."""


def overview(r: Published, f: Facts) -> None:
    """What is compared and published."""
    from bench.entrants.registry import registered

    methods, tables = set(registered()), [r.table(f"table{i}.csv") for i in range(2, 10)]
    shown = r.study("table3.md", "Initial state unknown").loc[list(CHOSEN)].iloc[:, :3].reset_index()
    table = [list(shown), ["---"] * 4, *shown.values.tolist()]
    f.say(chosen_rows="\n" + "".join(f"| {' | '.join(line)} |\n" for line in table))
    cells = r.table("archive/cells.parquet")
    hours = cells.groupby("experiment").cpu_s.sum() / 3600
    longest = [f"{name} {hours[name]:.1f}" for name in hours.nlargest(5).index]
    f.say(methods=len(methods), cells=len(cells), core_hours=float(hours.sum().round()), longest=", ".join(longest))
    f.hold(every_method_stands_in_a_table=methods <= {*pd.concat(tables).method, *r.table("pinn_family.csv").method})


def free_decay(r: Published, f: Facts) -> None:
    """The methods on the bound in Table 5, what they cost, and the network beside a spline."""
    lines = r.rows("table5", method=ON_BOUND, metric=PRIMARY, snr_db=USUAL)
    far = (
        (lines.method == "mcmc") & (lines.metric == "rmse") & (lines.snr_db == 40) & (lines.initial_state == "unknown")
    )
    both = r.rows("table5", method=("pinn", "collocation"), metric=PRIMARY)
    both = both.pivot(index=["initial_state", "snr_db", "metric"], columns="method", values="excess")
    apart = (both.pinn / both.collocation - 1).abs()
    fits = r.fits(REFERENCE, ["cpu_s"], label=ON_BOUND, system="sdof")
    time = fits.groupby(["label", "snr_db", "initial_state"]).cpu_s.median()
    spline = (time["collocation"] / time["pinn"]).to_numpy()
    coverage = r.rows("calibration", method=ON_BOUND, snr_db=(30, 20, 10), quantity=("k_over_m", "c_over_m"))
    f.say(".2f", on_bound=lines.excess[~far], off_bound=lines.excess[far])
    f.say(on_bound_n=lines.n, spline_time=100 * spline, held=100 * coverage.coverage_95, held_n=coverage.n)
    f.say(".1g", spline_apart=100 * apart.max(), **{f"{name}_s": time[name] for name in ON_BOUND})
    f.hold(
        one_row_of_four_is_off_the_bound=(lines.excess < NEAR) == ~far,
        spline_is_as_good_as_the_network=apart < 0.05,
        spline_is_cheaper=spline < 1,
        intervals_of_the_noise_hold=coverage.coverage_95.between(0.9, 0.98),
    )


def free_decay_others(r: Published, f: Facts) -> None:
    """Modal practice, searches from one start, regressions and their repairs, the mass."""
    usual = {"metric": PRIMARY, "initial_state": "unknown", "snr_db": USUAL}
    excess = r.rows("table5", **usual).set_index(["method", "metric", "snr_db"]).excess
    quiet = excess[excess.index.get_level_values("snr_db") >= 20]
    sindy, spline = quiet["sindy"], quiet["ls_spline"]
    plain, repaired = quiet[["ar", "ar_recursive"]], excess[["iqml", "frequency", "npe"]]
    bounds = r.rows("table5", method="bound", metric=K)[["snr_db", "initial_state", "bound"]]
    searches = r.fits(REFERENCE, [K], label=("output_error_cold", "output_error", "shooting"), system="sdof")
    searches = searches[searches.snr_db.isin(USUAL)].merge(bounds)
    astray = (~(searches[K] <= 10 * searches.bound)).groupby(searches.label).agg(["sum", "size"])
    ls = r.rows("table5", metric=K, initial_state="known", snr_db=40, method=("ls", "ls_spline")).set_index("method")
    missed = r.rows("calibration", method="ls", quantity="k_over_m", snr_db=(30, 20))
    mass = r.rows("table3", metric="m_error_pct", initial_state="known").set_index("method")
    mass = mass["median"][mass.n == mass.n.max()].dropna()  # medians on the same data sets
    f.say(".2f", pencil=excess["matrix_pencil"], ar=plain, repaired=repaired, sindy=sindy)
    f.say(plain_sindy=quiet["pysindy"].dropna())
    f.say(astray=astray["sum"]["output_error_cold"], astray_fits=astray["size"], ls_off=ls["median"]["ls"])
    f.say(".1g", ls_bound=ls.bound["ls"])
    f.say(".1f", mass=mass)
    f.hold(
        pencil_comes_close=excess["matrix_pencil"] < NEAR,
        plain_regression_is_off_the_bound=plain > NEAR,
        repairs_are_near_the_bound=repaired < NEAR,
        only_a_cold_start_goes_astray=astray["sum"].gt(0) == (astray.index == "output_error_cold"),
        differences_are_biased=ls["median"]["ls"] > 20 * ls.bound["ls"],
        their_intervals_miss=missed.coverage_95 < 0.05,
        the_spline_removes_most_of_it=ls["median"]["ls_spline"] < 0.1 * ls["median"]["ls"],
        sindy_is_like_the_spline_regression=(sindy / spline - 1).abs() < 0.05,
        the_mass_is_the_priors=(mass / mass["prior"] - 1).abs() < 0.1,
    )


def open_split(r: Published, f: Facts) -> None:
    """Drawn scenarios below and beyond the Nyquist frequency: lost fits, and coverage of multiple shooting."""
    board = r.table("leaderboard.csv").set_index("method")
    below, beyond = (board[board.part == f"{part} Nyquist"] for part in ("below", "beyond"))
    oracle = r.rows("open", part="all", metric=K, method="oracle")
    bounds = r.table("archive/summaries.parquet").query("metric == @K and bound <= 100")[["identity"]]
    fits = r.fits(("open",), ["k_over_m_coverage_95"], label="shooting").dropna().merge(bounds)
    data = pd.DataFrame(fits.description.map(lambda text: json.loads(text)["data"]).tolist())
    k_over_m = data.parameters.map(lambda values: values["k"] / values["m"])
    resolved = data.samples / data.duration > np.sqrt(k_over_m) / np.pi
    covered = fits.groupby(resolved.to_numpy()).k_over_m_coverage_95.agg(["mean", "size"])
    f.say(open_below=below.scenarios["shooting"], open_beyond=beyond.scenarios["shooting"])
    f.say(**{f"lost_{name}": below.lost[name] for name in ("shooting", "collocation", "pinn", "ls_spline", "ls")})
    f.say(lost_beyond=beyond.lost["shooting"], open_oracle=oracle.gross * oracle.n, open_n=oracle.n)
    f.say(covered_below=100 * covered["mean"][True], covered_below_n=covered["size"][True])
    f.say(covered_beyond=100 * covered["mean"][False], covered_beyond_n=covered["size"][False])
    f.hold(
        shooting_is_in_the_first_tier=[part.tier["shooting"] == 1 for part in (below, beyond)],
        regressions_are_lost_more_often=below.lost[["ls", "ls_spline"]] > 10 * below.lost[list(ON_BOUND)].max(),
        few_are_lost_below_the_nyquist_frequency=below.lost["shooting"] < 0.05 * below.scenarios["shooting"],
        many_are_lost_beyond_it=beyond.lost["shooting"] > 0.25 * beyond.scenarios["shooting"],
        intervals_hold_less_often_beyond_it=[covered["mean"][True] > 0.9, covered["mean"][False] < 0.8],
        the_maximum_near_the_truth_is_hardly_ever_lost=oracle.gross < 0.02,
    )


FORCED = ("sdof_forced", "sdof_sweep", "sdof_step", "sdof_impulse", "sdof_added_mass")


def systems(r: Published, f: Facts) -> None:
    """Tables 6 to 8: forces, noise of a force, one sensor on two masses, hysteresis; and how near to the bound."""
    forced = r.rows("table6", system=FORCED, method=WHOLE, **POOLED).set_index(["method", "system", "snr_db"]).excess
    step = ("mcmc", "sdof_step", 10)
    noisy = r.rows("table6", system="sdof_noise", method=(*WHOLE, "oracle"), snr_db=40, **POOLED).set_index("method")
    wanted = {"system": "chain2_first", "initial_state": "unknown", "snr_db": 20, "label": (*WHOLE, "output_error")}
    errors = r.common("mdof", "k1_over_m1_error_pct", **wanted)
    other = (errors > 69 / 2).sum()  # the other chain's k1/m1 is 69 % larger: 20.25 in place of 12 N/m
    bouc, carriers = {"system": "bouc_wen", **POOLED}, ("shooting", "mcmc", "ekf", "ukf")
    carried = r.rows("table8", method=carriers, snr_db=(40, 20), **bouc).excess
    smooth = r.rows("table8", method=("collocation", "pinn"), snr_db=40, **bouc)
    near = r.rows("efficiency", method=("shooting", "pinn", "mcmc"), **POOLED)
    f.say(forced_cases=len(forced), noisy_held=100 * noisy.coverage_95[list(WHOLE)], noisy_n=noisy.n)
    f.say(one_sensor_n=len(errors), one_sensor_pinn=other["pinn"], one_sensor_spline=other["collocation"])
    f.say(one_sensor_others=other.drop(["pinn", "collocation"]), near_n=near.n, near_held=100 * near.coverage_95)
    f.say(".2f", forced=forced.drop([step]), forced_step=forced[step])
    f.say(".2f", noisy=noisy.excess, near=near.excess)
    f.hold(
        mcmc_under_a_step_is_off=(forced < NEAR) == (forced.index != step),
        noise_of_the_force_costs_all_the_same=(noisy.excess / noisy.excess["oracle"] - 1).abs() < 0.05,
        noise_of_the_force_makes_intervals_too_narrow=noisy.coverage_95[list(WHOLE)] < 0.85,
        all_but_the_spline_end_at_the_other_chain_at_times=other.gt(0) == (other.index != "collocation"),
        four_carry_the_hidden_state=carried < NEAR,
        no_smooth_path_follows_the_kinks=[smooth.excess > 3, smooth.coverage_95 < 0.5],
        the_bound_is_reached_and_intervals_hold=[(near.excess - 1).abs() < 0.1, near.coverage_95 >= 0.9],
    )


def systems_ends(r: Published, f: Facts) -> None:
    """Table 9, with few samples a cycle; and chains of up to 20 masses."""
    whole, even = (*WHOLE, "output_error"), ("sdof_nyquist", "sdof_beyond_nyquist")
    irregular = tuple(f"{system}, irregular" for system in even)
    good = r.rows("table9", system=irregular, method=whole, **POOLED).excess
    wanted = {"label": whole, "disturbance": "none"}
    aliased = [r.common("regimes", K, system=system, **wanted) > 10 for system in even]
    chains = r.table("chains.csv").query("method != 'oracle'")
    solved = chains[(chains.n_ok == chains.n_fits) & (chains.rmse_excess < 3)]
    far = solved.groupby("method").n.max()
    first, rest = far[["shooting", "mcmc"]], far.drop(["shooting", "mcmc"]).max()
    f.say(alias_nyquist=aliased[0].sum(), alias_beyond=aliased[1].sum(), alias_n=[len(table) for table in aliased])
    f.say(chains_far=first, chains_next=rest, chains_n=solved.n_fits)
    f.say(".2f", irregular=good)
    f.hold(
        some_follow_an_alias=[table.to_numpy().any() for table in aliased],
        all_are_on_the_bound_at_irregular_times=good < NEAR,
        shooting_and_mcmc_get_farthest=first > rest,
    )


def pinn(r: Published, f: Facts) -> None:
    """The study of the engine, and the paper's training and uncertainty."""
    rivals = r.study("pinn.md", "Time against other inverse PINNs").replace("-", "nan")
    time, above = (rivals[name].astype(float) for name in ("seconds a fit", "above the minimum %"))
    project, others = time.index[0], time.index[time.index.str.contains("PyTorch|DeepXDE")]
    steps = r.study("pinn.md", "What the steps of first-order training buy")
    steps = steps[steps.index == "40"].set_index("steps of L-BFGS")["off by (largest)"].astype(float)
    fits = r.fits(REFERENCE, ["message", "cpu_s"], label="pinn_adam", system="sdof")
    known = r.rows("table5", method="pinn_adam", metric=PRIMARY, initial_state="known", snr_db=(40, 30, 10))
    loud = known.snr_db == 10
    spread = r.rows("calibration", method="pinn_ensemble")
    trained = r.rows("calibration", method="pinn_ensemble_adam", quantity="k_over_m").set_index("initial_state")
    f.say(".1g", engine_s=time[project], steps_off_10000=steps["10,000"])
    f.say(rivals_s=time[others], rivals_over=time[others] / time["method=pinn, whole fit"], adam_fits=len(fits))
    f.say(".1f", rivals_above=above[others], steps_off_1000=steps["1,000"])
    f.say(".1f", adam_s=fits.groupby(["snr_db", "initial_state"]).cpu_s.median())
    f.say(".2f", adam_loud=known.excess[loud], adam_quiet=known.excess[~loud])
    f.say(ensemble_n=spread.n.sum(), ensemble_adam_n=trained.n)
    f.say(**{f"ensemble_adam_{start}": trained.coverage_95[start] * trained.n[start] for start in ("known", "unknown")})
    f.hold(
        engine_is_at_the_minimum=above[project] <= 1,
        the_rivals_stop_above_it=above[others] > 1,
        papers_training_ends_at_its_limit=fits.message.str.contains(
            "step limit was reached|number of steps was reached"
        ),
        papers_training_is_on_the_bound_at_10_db_only=(known.excess < NEAR) == loud,
        more_steps_lead_to_the_minimum=[steps["1,000"] > 0.5, steps["10,000"] < 0.05],
        the_ensembles_hold_nowhere=spread.coverage_95 == 0,
        trained_as_in_the_paper_they_hold_seldom=trained.coverage_95 < 0.5,
    )


UNCERTAINTY = {
    "Laplace, all weights": "laplace", "Bayesian PINN, NUTS": "nuts", "variational, mean field": "variational",
    "deep ensemble": "ensemble", "Monte-Carlo dropout": "dropout",
}  # fmt: skip

PLAIN_TRAINING = "pinn_family optimizer=lm"
"""Label of the training with all settings at their defaults."""


def pinn_family(r: Published, f: Facts) -> None:
    """Trainings side by side: weightings and intervals at 20 dB, initial state known; accuracy in all cases."""
    from scipy.stats import wilcoxon

    case = {"base": "our base", "snr_db": 20, "initial_state": "known"}
    names = ("k_over_m_excess_at_minimum", "c_over_m_excess_at_minimum")
    minima = [r.rows("pinn_family", section="Weightings", quantity=name, **case).set_index("row") for name in names]
    minimum = pd.concat([table.value.astype(float) for table in minima], axis=1)
    paper, noise = minimum.loc["fixed, all one"], minimum.loc["by the estimated noise"]
    coverage = r.rows("pinn_family", section="Ways of stating uncertainty", quantity="k_over_m_coverage_95", **case)
    coverage = coverage.set_index("row").astype({"value": float}).loc[list(UNCERTAINTY)].rename(index=UNCERTAINTY)
    fits = r.fits(("pinn",), [K, C])
    bounds = r.table("archive/summaries.parquet").pivot_table("bound", "identity", "metric")
    fits["error"] = np.hypot(*(fits[name] / fits.identity.map(bounds[name]) for name in (K, C)))
    errors = fits.pivot_table("error", ["snr_db", "initial_state", "replicate"], "label", "first")
    errors = errors.filter(regex="^(pinn_family|rival_)")
    pairs = [errors[[name, PLAIN_TRAINING]].dropna() for name in errors.columns.drop(PLAIN_TRAINING)]
    pairs = [pair for pair in pairs if len(pair) >= 20 and pair.diff(axis=1).iloc[:, 1].any()]
    p_better = np.array([wilcoxon(*pair.to_numpy().T, alternative="less").pvalue for pair in pairs])
    f.say(".2f", weighting_paper=paper, weighting_ours=noise)
    f.say(weightings_n=len(minimum), trainings_n=len(pairs))
    f.say(**{f"stated_{name}": f"{100 * row.value:.0f} % of {row.n:.0f}" for name, row in coverage.iterrows()})
    f.hold(
        the_papers_minimum_is_farther_from_the_truth=paper > noise,
        no_weighting_is_nearer=np.hypot(*minimum.T.to_numpy()) > np.hypot(*noise) - 0.014,
        the_linearisation_covers=coverage.value["laplace"] > 0.9,
        these_three_do_not=coverage.value[["variational", "ensemble", "dropout"]] < 0.5,
        no_training_beats_levenberg_marquardt=p_better * len(pairs) > 0.05,
    )


def atlas(r: Published, f: Facts) -> None:
    """Free decays at large: below the Nyquist frequency, where the data alone decide, and beyond it."""
    from scipy.stats import binom

    from bench.atlas.model import MAX_SD, determined
    from bench.atlas.point import FreeDecay
    from bench.reporting.atlas import near

    table = r.table("atlas.csv.gz")
    points = table.drop_duplicates([axis.name for axis in FreeDecay.AXES])
    share = {name: 100 * (points[f"bound_{name}"] <= MAX_SD).mean() for name in ("k_over_m", "c_over_m")}
    searched = table[table.method == "output_error"]
    best, beyond = determined(searched, "k_over_m"), searched[(searched.bound_k_over_m <= MAX_SD) & searched.aliased]
    hard = [best[best.samples < 30], best[best.snr_db < 10]]
    resolved = searched[~searched.aliased].head(200)
    low, high = binom.interval(0.95, resolved.fits, resolved.wrong_basin.clip(0, 1))
    inside = (resolved.k_over_m_gross * resolved.fits).round().between(low, high).mean()
    honest = ("output_error", "shooting", "frequency", "iqml", "matrix_pencil")
    coverage = np.array([determined(table[table.method == name], "k_over_m").k_over_m_held.mean() for name in honest])
    f.say(atlas_fits=table.fits.sum(), atlas_points=len(points), atlas_k=share["k_over_m"], atlas_c=share["c_over_m"])
    f.say(best_near=100 * near(best).mean(), best_n=len(best), beyond_n=len(beyond), atlas_held=100 * coverage)
    f.say(beyond_gross=100 * beyond.k_over_m_gross.mean(), beyond_held=100 * beyond.k_over_m_held.mean())
    f.say(threshold_n=len(resolved), threshold_inside=100 * inside, threshold_risky=(resolved.wrong_basin > 0.01).sum())
    f.say(".1g", best_gross=100 * best.k_over_m_gross.mean())
    f.hold(
        damping_is_harder_to_identify=share["c_over_m"] < share["k_over_m"],
        output_error_is_near=[near(lines).mean() > 0.8 for lines in (best, *hard)],
        not_beyond_the_nyquist_frequency=beyond.k_over_m_gross.mean() > 0.5,
        the_threshold_is_where_theory_has_it=inside >= 0.92,
        five_have_honest_intervals=(coverage > 0.92) & (coverage < 0.98),
    )


def broken(r: Published, f: Facts) -> None:
    """What disturbances do to the methods on the bound."""

    def ratio(kinds: str | tuple[str, ...], methods: str | tuple[str, ...], metrics: Any = PRIMARY) -> pd.Series:
        return r.rows("robustness", disturbance=kinds, method=methods, metric=metrics).ratio.dropna()

    small, outliers = ratio(("jitter", "bias", "drift"), ON_BOUND), ratio("outliers", (*ON_BOUND, "oracle"))
    late, pencil = ratio("late_trigger", ON_BOUND, K), ratio("late_trigger", "matrix_pencil", K)
    regressions, shooting = ratio("irregular", ("ls", "ls_spline"), K), ratio("irregular", "shooting", K)
    student = ratio("outliers", "shooting_student")
    f.say(".2f", small=small, outliers=outliers, student=student)
    f.say(".1f", late=late, regressions=regressions, random_shooting=shooting)
    f.hold(
        jitter_bias_and_drift_matter_little=(small - 1).abs() < 0.15,
        outliers_cost_all_of_them=outliers > 1.8,
        students_errors_help=student < 1.5,
        a_late_trigger_costs_all_but_the_pencil=[late.min() > 1.5, (pencil - 1).abs().max() < 0.05],
        random_times_cost_regressions_more=regressions.min() > shooting.max(),
    )


def wrong_models(r: Published, f: Facts) -> None:
    """What a wrong model or prior does to the methods of the likelihood, and who notices."""
    likelihood = ("shooting", "mcmc", "output_error", "frequency", "ekf", "ukf")

    def wrong(kind: str, quantity: str, **more: object) -> pd.DataFrame:
        return r.rows("misspecified", wrong=kind, quantity=quantity, method=likelihood, **more)

    friction, spring = wrong("added_friction", "c_over_m"), wrong("cubic_spring", "k_over_m")
    visible, hidden = (wrong("added_friction", "k_over_m", snr_db=snr).coloured for snr in (40, 20))
    mass = wrong("wrong_prior", "m").coverage_95
    fits = r.fits(("misspecified",), [K], label=likelihood)
    fits = fits[fits.description.map(lambda text: bool((json.loads(text)["told"]["prior"] or {}).get("wrong")))]
    aliases = (fits[K] > 1000).groupby(fits.label).agg(["sum", "size"])  # the first alias has 18 times the k/m
    f.say(friction=friction.bias_pct, seen=100 * visible, unseen=100 * hidden, spring_seen=100 * spring.coloured)
    f.say(wrong_n=friction.n, wrong_alias=aliases["sum"]["mcmc"], wrong_alias_n=aliases["size"]["mcmc"])
    f.say(".1f", spring=spring.bias_pct)
    f.hold(
        friction_is_taken_for_damping=[friction.bias_pct > 20, friction.coverage_95 < 0.1],
        a_cubic_spring_for_stiffness=[spring.bias_pct > 2, spring.coverage_95 < 0.1],
        no_method_says_so=pd.concat([friction, spring]).said < 0.05,
        residuals_show_friction_at_40_db_only=[visible.min() > 0.9, hidden.max() < 0.2],
        residuals_do_not_show_the_spring=spring.coloured < 0.2,
        a_wrong_prior_takes_the_mass=mass < 0.5,
        a_wrong_prior_misleads_mcmc_alone=aliases["sum"].gt(0) == (aliases.index == "mcmc"),
    )


def online(r: Published, f: Facts) -> None:
    """A stiffness that steps, by the methods that answered on every record: errors, and when it is noticed."""
    known, unknown = (r.rows("table10", scenario=name) for name in ("step10_multisine", "step10_ambient"))
    whole = known[(known.ok == known.replicates.max()) & (known.method != "bound")]
    excess = whole.pivot(index="method", columns="quantity", values="excess").dropna()
    delay = unknown[(unknown.quantity == "k_over_m") & (unknown.ok > 0)].set_index("method").delay
    f.say(".2f", step_excess=excess.loc["change_points"])
    f.say(
        step_n=whole.replicates, step_methods=len(excess), delay=delay.drop("bound").min(), delay_bound=delay["bound"]
    )
    f.hold(
        change_points_are_nearest=excess.max(axis=1).idxmin() == "change_points",
        multiple_models_are_as_near=abs(excess.k_over_m["imm"] / excess.k_over_m["change_points"] - 1) < 0.05,
        an_unknown_force_delays_all_of_them=delay.drop("bound") > delay["bound"],
    )


def measured(r: Published, f: Facts) -> None:
    """The Silverbox beside published recurrent networks."""
    parts = r.study("table11.md", "silverbox, duffing", table=-1).iloc[:, :3].astype(float)
    shooting = parts[parts.index.str.startswith("shooting, median")].iloc[0]
    networks = parts.loc[["GRU", "LSTM", "OLSTM", "RNN"]]
    f.say(".2f", silverbox=shooting, networks=networks)
    f.hold(below_every_recurrent_network=shooting < networks)


def audits(r: Published, f: Facts) -> None:
    """Audits of claims under the reading of their file, the paper's apart: what an error in per cent is worth."""
    lines = r.table("audits.csv")
    lines = lines[lines.reading.isna() & (lines.claim != "karkadakattil2026")]
    by_verdict, first = lines.groupby("verdict"), lines.drop_duplicates(["claim", "quantity"])
    numbers, sds = first.set_index(["claim", "quantity"]), lines.set_index("claim").sd_ratio
    narrow, wide, g = (
        numbers.loc[key] for key in (("stuckey2017", "k"), ("okazaki2025", "c"), ("singh2026_pendulum", "g"))
    )
    f.say(
        audited=len(lines), audited_claims=lines.claim.nunique(), audited_exact=len(by_verdict.get_group("bias only"))
    )
    larger = by_verdict.get_group("larger")
    f.say(audited_within=len(by_verdict.get_group("within")), audited_larger=len(larger))
    f.say(audited_far=sum(larger.score >= 10 * larger.bound), wide_posterior=sds["dixit2020_pendulum"])
    f.say(".1f", good_posterior=sds["gerend2025"], wide_within=100 * wide.score / wide.truth)
    f.say(".2f", narrow_larger=100 * narrow.score / narrow.truth, undetermined=100 * g.score / g.truth)
    f.hold(
        per_cent_alone_decides_nothing=[narrow.verdict == "larger", wide.verdict == "within"],
        a_number_may_be_right_that_data_do_not_determine=g.verdict == "not identifiable",
    )


TOPICS = (
    overview, free_decay, free_decay_others, open_split, systems, systems_ends, pinn,
    pinn_family, atlas, broken, wrong_models, online, measured, audits,
)  # fmt: skip


def facts(folder: Path) -> Facts:
    """Compute all numbers and conclusions over a folder of results; InputError where a file or a line is missing."""
    results, known = Published(folder), Facts()
    for topic in TOPICS:
        topic(results, known)
    return known
