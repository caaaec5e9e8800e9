"""What the documents say about results: named numbers as they are printed, and conclusions that hold or do not.

Each function is a document or a section of one. The prose stands in Markdown (:mod:`bench.reporting.documents`), and
says no more of a conclusion than its condition: all that it names is tested case by case, on the same data.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bench.errors import InputError
from bench.scoring.comparison import Comparison, Errors, adjusted, compare

K, C, PRIMARY = "k_over_m_error_pct", "c_over_m_error_pct", ("k_over_m_error_pct", "c_over_m_error_pct", "rmse")
ON_BOUND = ("shooting", "mcmc", "pinn", "collocation")
WHOLE = (*ON_BOUND, "ekf", "ukf")
"""The methods that take the equation of motion as a whole, output error apart."""
USUAL = (40, 30, 20, 10)
"""The noise levels (dB) where the errors are small enough for the bound to hold."""
NEAR = 1.25
"""An excess that 50 replicates do not tell from 1."""
REFERENCE = ("table2", "table3", "table5")
"""The experiments that hold Table 5: its 20 dB are those of Tables 2 and 3."""
FACTS = ["experiment", "label", "system", "snr_db", "initial_state", "disturbance", "description"]


@dataclass
class Facts:
    """Numbers by name, as they are printed, and conclusions by name."""

    numbers: dict[str, str] = field(default_factory=dict)
    conclusions: dict[str, bool] = field(default_factory=dict)

    def say(self, form: Callable[[Any], str] | None = None, /, **numbers: Any) -> None:
        """Name numbers, each name once, printed in a form (:func:`count`); of several values ``low to high``."""
        assert not self.numbers.keys() & numbers.keys()
        self.numbers |= {name: printed(value, form or count) for name, value in numbers.items()}

    def hold(self, **conclusions: Any) -> None:
        """Name conclusions: a truth value, or one of each case."""
        assert not self.conclusions.keys() & conclusions.keys()
        self.conclusions |= {name: bool(np.all(value)) for name, value in conclusions.items()}


class Published:
    """The files below a folder of results; what was never measured is an InputError."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._tables: dict[str, pd.DataFrame] = {}

    def table(self, name: str) -> pd.DataFrame:
        """``results/<name>`` (CSV or Parquet), without the lines of cells that were not run."""
        if name not in self._tables:
            path = self.folder / name
            if not path.is_file():
                raise InputError("results", path, "there is no such file; python -m bench tables writes the tables")
            data = pd.read_parquet(path) if path.suffix == ".parquet" else pd.read_csv(path)
            self._tables[name] = data[data.metric != "not run"] if "metric" in data else data
        return self._tables[name]

    def rows(self, name: str, **wanted: Any) -> pd.DataFrame:
        """The lines of ``<name>.csv`` with these values, one or several a column, each of which is in some line."""
        data = self.table(name if "." in name else f"{name}.csv")
        wanted = {column: value if isinstance(value, tuple) else (value,) for column, value in wanted.items()}
        for column, values in wanted.items():
            data = data[data[column].isin(values)]
        for column, values in wanted.items():
            if missing := [value for value in values if not (data[column] == value).any()]:
                raise InputError("results", name, f"no line has {column} = {', '.join(map(str, missing))}")
        return data

    def value(self, name: str, column: str, **wanted: Any) -> float:
        """The one value of a column that the lines have."""
        values = self.rows(name, **wanted)[column].dropna().unique()
        if len(values) != 1:
            raise InputError("results", name, f"{len(values)} values of {column}, not one")
        return float(values[0])

    def cells(self, experiments: Sequence[str], **wanted: Any) -> pd.DataFrame:
        """The published cells with these facts that were first run for one of these experiments."""
        cells = self.rows("archive/cells.parquet", **wanted)
        return cells[cells.experiment.isin(experiments)]

    def fits(self, experiments: Sequence[str], columns: Sequence[str], **wanted: Any) -> pd.DataFrame:
        """The fits of such cells, a line a fit; a failed one has no errors."""
        cells = self.cells(experiments, **wanted)[["identity", *FACTS]]
        columns = ["identity", "replicate", "message", *columns]
        files = [f"archive/rows/{name}.parquet" for name in cells.experiment.unique()]
        return pd.concat([pd.read_parquet(self.folder / file, columns=columns) for file in files]).merge(cells)

    def common(self, experiment: str, column: str, **wanted: Any) -> pd.DataFrame:
        """One column of such fits, a column a label, of the data sets that all of them answered."""
        return (
            self.fits((experiment,), [column], **wanted)
            .pivot(index="replicate", columns="label", values=column)
            .dropna()
        )

    def study(self, file: str, section: str = "") -> pd.DataFrame:
        """The first Markdown table of a page below a heading, its first column as the index; every entry is text."""
        path = self.folder / file
        text = path.read_text("utf-8") if path.is_file() else ""
        table = re.search(r"(?:^\|.*\n)+", text.partition(f"## {section}\n" if section else "\n")[2], re.MULTILINE)
        if not table:
            raise InputError("results", path, f"no table below {section!r}")
        split = [line[1:].rstrip().removesuffix("|").split("|") for line in table[0].splitlines()]
        head, _, *rest = [[entry.strip() for entry in line] for line in split]
        return pd.DataFrame([(line + [""] * len(head))[: len(head)] for line in rest], columns=head).set_index(
            head[0], drop=False
        )


def floats(column: pd.Series) -> pd.Series:
    """The number that each text begins with; NaN for a dash."""
    return column.str.replace(",", "").str.extract(r"(-?[\d.]+(?:e[+-]?\d+)?)", expand=False).astype(float)


# ---- numbers as they are printed


def number(value: float, digits: int = 2) -> str:
    """With that many significant digits, thousands parted: ``0.93``, ``38``, ``1,363``."""
    rounded = float(f"{value:.{digits}g}")
    if abs(rounded) < 1:
        return f"{rounded:.{digits}g}"
    return f"{value:,.{max(0, digits - len(f'{abs(rounded):.0f}'))}f}"


def fold(value: float) -> str:
    """An excess over the bound, or a ratio: hundredths below 10, whole above."""
    return f"{value:.2f}" if value < 9.995 else f"{value:,.0f}"


def percent(share: float) -> str:
    """A share in whole percent, without the sign."""
    return f"{100 * share:.0f}"


def rough(value: float) -> str:
    """With one significant digit."""
    return number(value, 1)


def fine(value: float) -> str:
    """With three significant digits."""
    return number(value, 3)


def tenth(value: float) -> str:
    """With one decimal."""
    return f"{value:.1f}"


def count(value: float | str) -> str:
    """A whole number, thousands parted, or what is text already."""
    return value if isinstance(value, str) else f"{value:,.0f}"


def printed(value: Any, form: Callable[[Any], str]) -> str:
    """One value in a form, or ``low to high`` of several, which is one where both are written alike."""
    values = [value] if isinstance(value, str) else np.ravel(value).tolist()
    low, high = form(min(values)), form(max(values))
    return low if low == high else f"{low} to {high}"


# ---- README, the paper, the cost


def overview(r: Published, f: Facts) -> None:
    """What is compared and published, and what Tables 2 to 5 cost."""
    from bench.entrants.registry import registered

    methods, cells = set(registered()), r.table("archive/cells.parquet")
    lines = pd.concat([r.table(f"table{i}.csv") for i in range(2, 10)])
    panels = lines[(lines.n_ok > 0) & lines.method.isin(methods)].groupby(["system", "initial_state", "snr_db"])
    size = sum(path.stat().st_size for path in (r.folder / "archive").rglob("*.parquet"))
    spent = cells[cells.experiment.isin([f"table{i}" for i in range(2, 6)])].groupby("label").cpu_s.sum() / 60
    share = spent / spent.sum()
    f.say(methods=len(methods), methods_on_the_same=panels.method.nunique().max())
    f.say(chosen_rows=_markdown(r.study("table3.md", "Initial state unknown").loc[list(CHOSEN), list(COLUMNS)]))
    known = (r.folder / "table3.md").read_text("utf-8").partition("## Initial state known\n")[2].partition("\n##")[0]
    f.say(table_3_known=known)
    f.say(cells=len(cells))
    f.say(fine, archive_mb=size / 1e6)
    f.say(number, cost_minutes=spent.sum())
    f.say(percent, cost_paper_training=share["pinn_adam"], cost_next=share.drop("pinn_adam").max())
    f.hold(
        every_method_stands_in_a_table=methods <= {*lines.method, *r.table("pinn_family.csv").method},
        the_papers_training_costs_most=share.idxmax() == "pinn_adam",
    )


CHOSEN = (
    "bound", "prior (no data)", "Multiple shooting", "Bayesian MCMC", "PINN", "Matrix pencil", "IQML",
    "Logarithmic decrement", "SINDy", "LS, finite differences", "DDNN",
)  # fmt: skip
"""One method of each kind, beside the bound and what is known without data, as README shows them."""
COLUMNS = ("method", "k/m error %", "c/m error %", "RMSE (m)")


def _markdown(table: pd.DataFrame) -> str:
    lines = [list(table), ["---"] * len(table.columns), *table.values.tolist()]
    return "\n" + "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


# ---- free decay


def free_decay(r: Published, f: Facts) -> None:
    """What each method is worth on Tables 3 and 5: the methods on the bound, and the network."""
    lines = r.rows("table5", method=ON_BOUND, metric=PRIMARY, snr_db=USUAL)
    wide = lines.pivot(index=["initial_state", "snr_db", "metric"], columns="method", values="excess")
    median = r.rows("table3", method="shooting", initial_state="known").set_index("metric")["median"]
    paper = r.value("table3", "paper", method="pinn", metric="rmse", initial_state="known")
    cycles = floats(r.study("pinn.md", "Cost and reach").query("method == 'pinn'").loc["30 cycles"][["CPU s a fit"]])
    both = r.rows("table5", method=("pinn", "collocation"), metric=PRIMARY)
    both = both.pivot(index=["initial_state", "snr_db", "metric"], columns="method", values="excess")
    apart = np.abs(both.pinn / both.collocation - 1)
    f.say(fold, on_bound=lines.excess)
    f.say(on_bound_n=lines.n)
    f.say(percent, on_bound_apart=(wide.max(axis=1) / wide.min(axis=1)).max() - 1)
    f.say(percent, spline_time=seconds(r, "collocation") / seconds(r, "pinn"))
    f.say(rough, on_bound_k=median[K], on_bound_mm=1000 * median["rmse"], pinn_s_30_cycles=cycles.iloc[0])
    f.say(rough, spline_apart=100 * apart.max(), **{f"{name}_s": seconds(r, name, 30, 20, 10, 5) for name in ON_BOUND})
    f.say(rough, pinn_s_40_db=seconds(r, "pinn", 40))
    f.say(number, on_bound_c=median[C], paper_mm=1000 * paper)
    f.hold(
        four_are_on_the_bound=lines.excess < NEAR,
        displacement_better_than_the_papers=median["rmse"] < paper,
        spline_is_as_good_as_the_network=apart < 0.05,
        spline_is_cheaper=seconds(r, "collocation").to_numpy() < seconds(r, "pinn").to_numpy(),
    )
    wrong = {}
    for disturbance in ("none", "irregular"):
        cells = {"system": "sdof_nyquist", "disturbance": disturbance, "label": ("pinn", "collocation")}
        errors = r.common("regimes", K, **cells)
        wrong[disturbance] = (errors > 5).sum()
        f.say(**{f"sparse_n_{disturbance}": len(errors)})
    f.say(**{f"sparse_{name}_{times}": wrong[times][name] for times in wrong for name in ("pinn", "collocation")})
    f.hold(
        even_times_tell_no_difference=wrong["none"] <= 1,
        irregular_times_lead_the_pinn_astray=wrong["irregular"].pinn > 5 and wrong["irregular"].collocation == 0,
    )


def seconds(r: Published, label: str, *levels: float) -> pd.Series:
    """Median processor time of a fit (s) of the reference system by noise level and start, in one order."""
    fits = r.fits(REFERENCE, ["cpu_s"], label=label, system="sdof")
    return fits[fits.snr_db.isin(levels or (40, 30, 20, 10, 5))].groupby(["snr_db", "initial_state"]).cpu_s.median()


def excesses(r: Published, method: str | tuple[str, ...], start: str, *levels: float) -> pd.Series:
    """Errors of k/m, c/m and displacement over the bound, in Table 5."""
    asked = {"metric": PRIMARY, "snr_db": levels, "initial_state": start}
    return r.rows("table5", method=method, **asked).excess.dropna()


def free_decay_training(r: Published, f: Facts) -> None:
    """The paper's own training, and its intervals."""
    quiet, middle, loud = (excesses(r, "pinn_adam", "known", *levels) for levels in ((40, 30), (20,), (10,)))
    fits = r.fits(REFERENCE, [], label="pinn_adam", system="sdof")
    ended = fits.message.str.contains("number of steps")
    at_40_db = {"metric": "rmse", "initial_state": "known", "snr_db": 40}
    paper = r.value("table5", "paper", method="pinn", **at_40_db) / r.value(
        "table5", "bound", method="bound", **at_40_db
    )
    engine, steps = (r.study("pinn.md", name) for name in (RIVALS, STEPS))
    at_40 = steps[(steps.index == "40") & (steps["steps of L-BFGS"] == "1,000")]
    held = r.rows("calibration", method=ON_BOUND, snr_db=(30, 20, 10), quantity=("k_over_m", "c_over_m"))
    ensemble = r.rows("calibration", method="pinn_ensemble", quantity=("k_over_m", "c_over_m"))
    trained = r.fits(("calibration",), ["k_over_m_coverage_95"], label="pinn_ensemble_adam").groupby("initial_state")
    trained = trained.k_over_m_coverage_95.agg(["sum", "size"])
    f.say(adam_ended=ended.sum(), adam_fits=len(fits), ensemble_held=round((ensemble.coverage_95 * ensemble.n).sum()))
    f.say(ensemble_n=ensemble.n.sum(), ensemble_adam_known=trained["sum"]["known"])
    f.say(ensemble_adam_unknown=trained["sum"]["unknown"], ensemble_adam_n=trained["size"].unique().item())
    f.say(held_n=held.n[held.method != "mcmc"], held_n_mcmc=held.n[held.method == "mcmc"])
    f.say(number, adam_s=seconds(r, "pinn_adam"))
    f.say(number, adam_s_study=float(floats(engine["seconds a fit"])["method=pinn_adam, whole fit"]))
    f.say(number, adam_s_40=float(floats(at_40["CPU s a fit"]).iloc[0]), paper_at_40_db=paper)
    f.say(fold, adam_loud=loud, adam_middle=middle, adam_quiet=quiet)
    f.say(fold, adam_unknown=excesses(r, "pinn_adam", "unknown", *USUAL))
    f.say(percent, held=held.coverage_95)
    f.hold(
        papers_training_ends_at_its_limit=ended,
        papers_training_is_on_the_bound_at_10_db=loud < NEAR,
        papers_training_is_off_with_less_noise=max(loud) < max(middle) < min(quiet),
        papers_displacement_is_far_off_at_40_db=paper > 5,
        intervals_of_the_noise_hold=(held.coverage_95 >= 0.9) & (held.coverage_95 <= 0.98),
        the_ensembles_hold_nowhere=ensemble.coverage_95 == 0,
        trained_as_in_the_paper_they_hold_seldom=trained["sum"] < 0.5 * trained["size"],
    )


RIVALS, STEPS = "Time against other inverse PINNs", "What the steps of first-order training buy"


def free_decay_others(r: Published, f: Facts) -> None:
    """Modal practice, searches from one start, regressions, networks without physics, and the mass."""
    pencil, known = (excesses(r, "matrix_pencil", start, *USUAL) for start in ("unknown", "known"))
    decrement = {start: excesses(r, "log_decrement", start, *USUAL) for start in ("known", "unknown")}
    plain = [excesses(r, ("ar", "ar_recursive"), "unknown", level) for level in (40, 20)]
    repaired = {name: excesses(r, name, "unknown", *USUAL) for name in ("iqml", "frequency", "npe")}
    astray = {label: _astray(r, label) for label in ("output_error_cold", "output_error", "shooting")}
    cold = astray["output_error_cold"]
    f.say(fold, pencil=pencil, pencil_known=known, decrement=pd.concat(decrement), ar_40=plain[0], ar_20=plain[1])
    f.say(fold, repaired=pd.concat(repaired))
    f.say(percent, cold_right=1 - cold["mean"])
    f.say(astray_scanned=astray["output_error"]["sum"].sum(), astray_shooting=astray["shooting"]["sum"].sum())
    f.say(astray_fits=cold["size"].sum())
    f.hold(
        pencil_comes_close=pencil < NEAR,
        pencil_cannot_use_a_known_start=known.to_numpy() > pencil.to_numpy(),
        decrement_is_worse=[
            decrement[start].to_numpy() > excesses(r, "matrix_pencil", start, *USUAL).to_numpy() for start in decrement
        ],
        plain_regression_is_off_the_bound=pd.concat(plain) > 1.1,
        repairs_are_near_the_bound=pd.concat(repaired) < NEAR,
        one_cold_start_goes_astray=cold["sum"].sum() > 0,
        from_the_scan_none_goes_astray=(astray["output_error"]["sum"] + astray["shooting"]["sum"]) == 0,
    )


def _astray(r: Published, label: str) -> pd.DataFrame:
    """Fits of Table 5, from 40 to 10 dB, whose k/m is farther than ten bounds off, by noise level and start."""
    bounds = r.rows("table5", method="bound", metric=K).set_index(["snr_db", "initial_state"]).bound
    fits = r.fits(REFERENCE, [K], label=label, system="sdof")
    fits = fits[fits.snr_db.isin(USUAL)].set_index(["snr_db", "initial_state"])
    wrong = ~(fits[K] <= 10 * bounds.reindex(fits.index))
    return wrong.groupby(level=[0, 1]).agg(["sum", "size", "mean"])


def free_decay_regressions(r: Published, f: Facts) -> None:
    """Finite differences, splines, SINDy, the network without physics, and what is said of the mass."""
    at = {"metric": K, "initial_state": "known"}
    off, bound = (r.value("table5", column, method="ls", snr_db=40, **at) for column in ("median", "bound"))
    spline = {snr: r.value("table5", "excess", method="ls_spline", snr_db=snr, **at) for snr in (40, 20)}
    held = r.rows("calibration", method="ls", quantity="k_over_m", snr_db=(30, 20))
    ddnn = r.rows("table5", method="ddnn", metric="rmse", snr_db=USUAL)
    both = r.rows("table5", method=("sindy", "ls_spline"), metric=PRIMARY, snr_db=USUAL)
    wide = both.pivot(index=["snr_db", "initial_state", "metric"], columns="method", values="excess")
    sindy = wide.sindy / wide.ls_spline
    mass = r.rows("table3", metric="m_error_pct", initial_state="known")
    weighing = mass[mass.method == "prior"]["median"].item()
    medians = mass[~mass.method.isin(("bound", "prior", "oracle"))]["median"].dropna()
    paper = mass[mass.method.isin(("ls", "rls", "ddnn"))].paper
    verdicts = r.table("reproduction.csv")
    f.say(number, differences_off=off, weighing=weighing, mass=medians, mass_paper=paper)
    f.say(rough, differences_bound=bound)
    f.say(differences_held=round((held.coverage_95 * held.n).sum()), verdicts=len(verdicts))
    f.say(differences_n=held.n.sum(), ddnn_n=ddnn.n)
    f.say(fold, spline_20=spline[20], spline_40=spline[40], sindy_over_spline_10=sindy[10].max(), ddnn=ddnn.excess)
    f.say(fold, sindy_over_spline=sindy[[40, 30, 20]])
    f.say(percent, prior_share=mass[mass.method == "bound"].prior_share.item())
    f.hold(
        differences_are_biased=off > 20 * bound,
        their_intervals_miss=held.coverage_95 < 0.05,
        the_spline_removes_most_of_it=spline[40] * bound < 0.1 * off,
        the_ddnn_is_far_from_the_bound=ddnn.excess > 2,
        sindy_is_like_the_spline_regression=np.abs(sindy[[40, 30, 20]] - 1) < 0.05,
        sindy_is_not_better_at_10_db=sindy[10] > 0.99,
        the_mass_is_the_priors=np.abs(medians / weighing - 1) < 0.1,
        the_papers_baselines_are_not_the_priors=paper > 2 * weighing,
    )


def reproduction(r: Published, f: Facts) -> None:
    """Where a verdict on the paper's k is one on its mass: with errors of one sign, its k/m is nearer than ours."""
    verdicts = r.table("reproduction.csv").astype({"row": str})
    paper = verdicts.pivot(index=["table", "row", "method"], columns="metric", values="paper")
    better = verdicts[(verdicts.metric == "k_error_pct") & (verdicts["as in the protocol"] == "ours better")]
    better = better.set_index(["table", "row", "method"])
    implied = 100 * ((100 + paper.k_error_pct) / (100 + paper.m_error_pct) - 1)[better.index]
    known = pd.concat([r.rows("table3", metric=K, initial_state="known"), r.rows("table5", metric=K, snr_db=5)])
    ours = known[known.initial_state == "known"].astype({"row": str}).set_index(["table", "row", "method"])["median"]
    f.say(k_verdicts=", ".join(f"{value:g}" for value in better.paper))
    f.say(number, k_implied=implied)
    f.hold(a_better_k_follows_from_the_mass=(implied < ours[better.index]) & (len(better) == 3))


# ---- the open split


def open_split(r: Published, f: Facts) -> None:
    """Gross errors and coverage of k/m on drawn scenarios, below and beyond the Nyquist frequency."""
    fits = r.fits(("open",), [K, "k_over_m_coverage_95"])
    bounds = r.table("archive/summaries.parquet").query("metric == @K")[["identity", "bound"]]
    fits = fits.merge(bounds, on="identity").query("bound <= 100")
    data = fits.description.map(lambda text: json.loads(text)["data"])
    frequency = data.map(lambda one: np.sqrt(one["parameters"]["k"] / one["parameters"]["m"]) / (2 * np.pi))
    fits["below"] = data.map(lambda one: one["samples"] / one["duration"]) > 2 * frequency
    fits["gross"] = ~(fits[K] <= 5 * fits.bound)
    free = data.map(lambda one: one.get("force") is None)
    fits["modal"] = free & (fits.disturbance == "none")
    gross = fits.pivot(index="system", columns="label", values="gross")
    scenario = fits.groupby("system")[["below", "modal"]].first()
    low, high = (r.value("open", f"gross_{end}", part="all", metric=K, method="shooting") for end in ("low", "high"))
    named = ("shooting", "mcmc", "pinn", "collocation", "output_error_cold", "oracle",
             "ls_spline", "ls")  # fmt: skip
    share, below, beyond = gross.mean(), gross[scenario.below].mean(), gross[~scenario.below].mean()
    modal, alike = gross[scenario.modal].mean(), share[["output_error", "ekf", "ukf"]]
    held = fits.groupby(["label", "below"]).k_over_m_coverage_95.agg(["mean", "count"])
    f.say(open_n=len(gross), open_n_below=scenario.below.sum(), open_n_beyond=(~scenario.below).sum())
    f.say(open_n_modal=scenario.modal.sum())
    f.say(number, open_low=100 * low, open_high=100 * high, **{f"open_{name}": 100 * share[name] for name in named})
    f.say(number, **{f"open_{name}_below": 100 * below[name] for name in ("shooting", "pinn", "collocation")})
    f.say(number, open_shooting_beyond=100 * beyond["shooting"])
    f.say(number, **{f"open_{name}_modal": 100 * modal[name] for name in ("matrix_pencil", "iqml", "shooting")})
    f.say(number, open_alike=100 * alike)
    f.say(fine, open_held_below=100 * held["mean"]["shooting", True])
    f.say(fine, open_held_beyond=100 * held["mean"]["shooting", False])
    f.hold(
        the_same_starts_are_gross_alike=(alike >= low) & (alike <= high),
        one_cold_start_is_gross_more_often=share["output_error_cold"] > alike,
        regressions_are_gross_more_often=share[["ls", "ls_spline"]] > high,
        modal_methods_are_gross_more_often=modal[["matrix_pencil", "iqml"]] > modal["shooting"],
        intervals_hold_below_the_nyquist_frequency_only=held["mean"]["shooting"][True] > 0.9
        and held["mean"]["shooting"][False] < 0.5,
    )


# ---- forces, several masses, nonlinear systems


FORCES = ("sdof_forced", "sdof_sweep", "sdof_step", "sdof_impulse")
POOLED = {"metric": "told_pooled"}


def systems_forced(r: Published, f: Facts) -> None:
    """Table 6: what a force or an added mass tells, each force, noise of the force, two masses."""
    errors = ("m_error_pct", "c_error_pct", "k_error_pct")
    bounds = r.rows("table6", system=("sdof_forced", "sdof_added_mass"), metric=errors, snr_db=20).bound.dropna()
    added = r.rows("table6", system="sdof_added_mass", method=WHOLE, **POOLED)
    off = r.rows("table6", system="sdof_added_mass", method="ls", **POOLED).excess
    forces = r.rows("table6", system=FORCES, method=WHOLE, **POOLED)
    above = forces[forces.excess > NEAR]
    noisy = r.rows("table6", system="sdof_noise", method=WHOLE, **POOLED).set_index("snr_db")
    oracle = r.value("table6", "excess", method="oracle", snr_db=40, system="sdof_noise", **POOLED)
    hidden = r.rows("table6", system="chain2_forced", method=WHOLE, snr_db=10, **POOLED).set_index("method").excess
    f.say(number, all_told_bound=bounds)
    f.say(fold, added=added.excess, added_ls=off, force_usual=forces.excess.drop(above.index))
    f.say(fold, noisy_20=noisy.excess[20], noisy_40=noisy.excess[40], hidden_near=hidden.drop(["pinn", "collocation"]))
    f.say(fold, force_mcmc_step=above.excess.max(), noisy_oracle=oracle, hidden_pinn=hidden["pinn"])
    f.say(fold, hidden_spline=hidden["collocation"])
    f.say(force_near=len(forces) - len(above), force_cases=len(forces))
    f.say(percent, noisy_held=noisy.coverage_95[40])
    f.hold(
        six_are_on_the_bound_with_an_added_mass=added.excess < NEAR,
        finite_differences_are_not=off > 5,
        only_mcmc_under_a_step_at_10_db_is_off=list(above[["method", "system", "snr_db"]].itertuples(index=False))
        == [("mcmc", "sdof_step", 10)],
        noise_of_the_force_costs_all_the_same=np.abs(noisy.excess[40] / oracle - 1) < 0.05,
        noise_of_the_force_makes_intervals_too_narrow=noisy.coverage_95[40] < 0.85,
        pinn_and_spline_run_away=hidden[["pinn", "collocation"]] > 3,
        four_stand_a_hidden_damping=hidden.drop(["pinn", "collocation"]) < 1.5,
    )


def systems_more(r: Published, f: Facts) -> None:
    """Tables 7 and 8, and how near to the bound: one sensor on two masses, hysteresis, linear and nonlinear."""
    at = {"system": "chain2_first", "initial_state": "known", **POOLED}
    known = r.rows("table7", method=(*WHOLE, "output_error"), **at)
    filters = known.method.isin(("ekf", "ukf")) & (known.snr_db == 10)
    other = r.common("mdof", "k1_over_m1_error_pct", system="chain2_first", initial_state="unknown", snr_db=20,
                     label=(*WHOLE, "output_error")) > 69 / 2  # fmt: skip
    lost = other.sum()
    five = lost.drop(["pinn", "collocation"])
    carriers = ("shooting", "mcmc", "ekf", "ukf")
    bouc = {"system": "bouc_wen", **POOLED}
    carried, exact = (r.rows("table8", method=m, snr_db=(40, 20), **bouc).excess for m in (carriers, "oracle"))
    smooth = r.rows("table8", method=("collocation", "pinn"), snr_db=40, **bouc)
    near = r.rows("efficiency", method=("shooting", "pinn", "mcmc"), **POOLED)
    first = near.method == "shooting"
    f.say(one_sensor_n=len(other), one_sensor_pinn=lost["pinn"], one_sensor_spline=lost["collocation"])
    f.say(one_sensor_lost=five, near_n=near.n[first], near_n_others=near.n[~first])
    f.say(fold, one_sensor_known=known.excess[~filters], one_sensor_filters=known.excess[filters], carried=carried)
    f.say(fold, carried_oracle=exact, smooth=smooth.excess, near_shooting=near.excess[first])
    f.say(fold, near_others=near.excess[~first])
    f.say(percent, smooth_held=smooth.coverage_95, near_held=near.coverage_95)
    f.hold(
        six_end_at_the_other_chain_at_times=lost.drop("collocation") > 0,
        the_spline_never_does=lost["collocation"] == 0,
        only_the_filters_at_10_db_are_off=(known.excess < NEAR) == ~filters,
        four_carry_the_hidden_state=carried < NEAR,
        no_smooth_path_follows_the_kinks=(smooth.excess > 3) & (smooth.coverage_95 < 0.5),
        the_bound_is_reached_and_intervals_hold=(np.abs(near.excess - 1) < 0.1) & (near.coverage_95 >= 0.9),
    )


def systems_ends(r: Published, f: Facts) -> None:
    """Table 9: at the ends of damping and sampling; aliases are counted on data sets that all methods have."""
    three, regressions = ("shooting", "mcmc", "output_error"), ("ls", "ls_spline", "rls", "sindy")
    labels, even = (*three, "ekf", "ukf", "pinn"), {"nyquist": "sdof_nyquist", "beyond": "sdof_beyond_nyquist"}

    def excess(system: str, *methods: str) -> pd.Series:
        return r.rows("table9", system=system, method=methods, **POOLED).excess

    late = [f"{system}, irregular" for system in even.values()]
    irregular, pinn = (pd.concat([excess(system, *own) for system in late]) for own in (three, ("pinn",)))
    coarse = pd.concat([excess(system, *regressions) for system in (even["nyquist"], late[0])])
    close, light = excess("close_modes", "shooting", "mcmc"), excess("sdof_light", "output_error")
    wrong = {}
    for name, system in even.items():
        errors = r.common("regimes", K, system=system, label=labels, disturbance="none")
        wrong[name] = (errors > 10).sum()
        f.say(**{f"alias_n_{name}": len(errors), f"alias_{name}": wrong[name]})
    f.say(fold, irregular=irregular, irregular_pinn=pinn, coarse=coarse, close=close, light=light)
    f.hold(
        some_follow_an_alias=[wrong[name].max() > 0 for name in even],
        three_are_on_the_bound_at_irregular_times=irregular < NEAR,
        the_pinn_is_not=pinn > 5,
        regressions_are_far_off_near_the_nyquist_frequency=coarse > 5,
        close_modes_and_light_damping_are_told=pd.concat([close, light]) < NEAR,
    )


def systems_reach(r: Published, f: Facts) -> None:
    """Beside a fit by hand, and in chains of up to 20 masses."""
    hand = r.study("handwritten.md").reset_index(drop=True)
    time, right = floats(hand["time, median (s)"]), hand.success.str.extract(r"(\d+)/(\d+)").astype(int)
    by_hand, ours = hand.what.str.startswith("by hand"), hand.what == "method=shooting"
    duffing, chain = hand.system == "duffing", hand.system == "chain5"

    def ratio(system: pd.Series) -> np.ndarray:
        return np.asarray(time[system & by_hand]) / np.asarray(time[system & ours])

    table = r.table("chains.csv").sort_values("n")
    solved = (table.n_ok == table.n_fits) & (table.n_fits > 0) & (table.rmse_excess < 3)
    far = {name: _last(own.n, solved[own.index]) for name, own in table.groupby("method") if name in CHAIN}
    ten = table[(table.n == 10) & table.method.isin(("shooting", "mcmc"))]
    pinn = table[(table.method == "pinn") & (table.n == far["pinn"])]
    f.say(number, by_hand_duffing=ratio(duffing), by_hand_chain=ratio(chain), chains_ten_s=ten.cpu_s)
    f.say(number, chains_pinn_s=pinn.cpu_s.item())
    f.say(by_hand_right=right[chain & by_hand][0].sum(), by_hand_sets=right[chain & by_hand][1].sum())
    f.say(by_hand_shooting=right[chain & ours][0].sum(), **{f"chains_{name}": far[name] for name in CHAIN})
    f.say(chains_n=table.n_fits[solved])
    f.say(fold, chains_ten=ten.rmse_excess)
    f.hold(
        on_duffing_both_always_succeed=right[duffing & (by_hand | ours)][0] == right[duffing & (by_hand | ours)][1],
        on_five_masses_shooting_succeeds_more_often=right[chain & ours][0].sum() > right[chain & by_hand][0].sum(),
        and_takes_less_time=ratio(chain) > 1,
        shooting_and_mcmc_get_farthest=[
            min(far["shooting"], far["mcmc"]) > far[name] for name in CHAIN if name not in ("shooting", "mcmc")
        ],
        ten_masses_are_on_the_bound=ten.rmse_excess < NEAR,
    )


CHAIN = ("shooting", "mcmc", "ekf", "nuts", "collocation", "ukf", "pinn")


def _last(sizes: pd.Series, solved: pd.Series) -> int:
    """The largest size up to which all are solved."""
    return int(sizes[solved.cummin()].max())


# ---- physics-informed networks


def pinn_engine(r: Published, f: Facts) -> None:
    """The study of the engine: time beside other PINNs, steps of the paper's training, starts, reach."""
    rivals, steps = r.study("pinn.md", RIVALS), r.study("pinn.md", STEPS)
    time, above = floats(rivals["seconds a fit"]), floats(rivals["above the minimum %"])
    ours, pinn, adam, _, naive, deepxde = rivals.index[[0, 1, 3, 2, 4, 5]]
    at_40 = steps[steps.index == "40"].set_index("steps of L-BFGS")
    off = floats(at_40["off by (largest)"])
    weights = r.study("pinn.md", "Different random weights").loc[["pinn"]]
    deviation, half = (floats(weights[name]).item() for name in ("largest deviation", "half the 95 % interval"))
    starts = floats(r.study("pinn.md", "Different starting values").loc["pinn"])
    reach = r.study("pinn.md", "Cost and reach").query("method in ('pinn', 'collocation')")
    error, displacement = floats(reach["groups / oracle"]), floats(reach["displacement / oracle"])
    wide = reach.assign(s=floats(reach["CPU s a fit"])).pivot(index="size", columns="method", values="s").dropna()
    f.say(rough, engine_s=time[ours], steps_off_10000=off["10,000"])
    f.say(number, engine_whole_s=time[pinn], steps_off_1000=off["1,000"])
    f.say(number, steps_s_10000=floats(at_40["CPU s a fit"])["10,000"], rivals_s=time[[naive, deepxde]])
    f.say(number, rivals_above=above[[naive, deepxde]], rivals_over_pinn=time[[naive, deepxde]] / time[pinn])
    f.say(number, rivals_over_adam=time[[naive, deepxde]] / time[adam], reach_time=wide.pinn / wide.collocation)
    f.say(steps_ended=at_40["ended at the limit"].iloc[-1], weights_n=weights.initialisations.item())
    f.say(weights_apart=f"{deviation:.0e}".replace("e-0", "e-"), starts_n=starts["starting values"])
    f.say(fold, reach_off=error["5 masses"], reach_displacement=displacement["200 cycles"].max())
    f.hold(
        engine_is_at_the_minimum=above[ours] <= 1,
        the_rivals_stop_above_it=above[[naive, deepxde]] > 1,
        after_1000_steps_the_papers_training_is_short_of_it=off["1,000"] > 0.5,
        after_10000_it_is_there=off["10,000"] < 0.05,
        the_spread_is_below_a_hundredth_of_the_interval=deviation < 0.01 * half,
        all_starts_lead_to_one_minimum=starts["the same minimum"] == starts["starting values"],
        only_five_masses_are_off_the_oracle=(error < 1.15) == (error.index != "5 masses"),
        the_spline_is_cheaper_at_every_size=wide.pinn > wide.collocation,
    )


OURS, PAPERS, STATING = "our base", "the paper's base", "Ways of stating uncertainty"
STATED = {"laplace": "Laplace, all weights", "nuts": "Bayesian PINN, NUTS", "variational": "variational, mean field",
          "ensemble": "deep ensemble", "dropout": "Monte-Carlo dropout"}  # fmt: skip


def pinn_family(r: Published, f: Facts) -> None:
    """Trainings side by side at 20 dB, start known."""

    def lines(section: str, quantity: str, **base: str) -> pd.DataFrame:
        asked = {"section": section, "quantity": quantity, "snr_db": 20, "initial_state": "known", **base}
        return r.rows("pinn_family", **asked).set_index("row").astype({"value": float})

    seconds = {base: lines("Optimisers", "arrival_s", base=base) for base in (OURS, PAPERS)}
    arrived = {
        base: own.value[lines("Optimisers", "arrived_share", base=base).value > 0.5] for base, own in seconds.items()
    }
    mine, theirs, lm, adam = arrived[OURS], arrived[PAPERS], "Levenberg-Marquardt", "Adam, then L-BFGS"
    f.say(family_n=len(seconds[OURS]), family_theirs=len(theirs), family_mine=len(mine))
    f.say(family_sets=seconds[PAPERS].n, family_my_sets=seconds[OURS].n)
    f.say(rough, family_theirs_s=theirs, family_mine_lm_s=mine[lm])
    f.say(number, family_theirs_adam_s=theirs[adam], family_mine_adam_s=mine[adam])
    k, c = (lines("Weightings", f"{name}_excess_at_minimum", base=OURS).value for name in ("k_over_m", "c_over_m"))
    papers, own = "fixed, all one", "by the estimated noise"
    f.say(weightings_n=len(k))
    f.say(fold, weighting_k=k[papers], weighting_c=c[papers], weighting_own_k=k[own], weighting_own_c=c[own])
    fit = lines("Other packages", "fit_s")
    f.say(packages_n=fit.n)
    f.say(number, packages_s=fit.value)
    agree = []
    for name in ("k", "c"):
        packages = lines("Other packages", f"{name}_over_m_excess").value
        same = lines("Optimisers", f"{name}_over_m_excess", base=PAPERS).value[adam]
        f.say(fold, **{f"packages_{name}": packages, f"packages_own_{name}": same})
        agree.append(np.abs(packages / same - 1) < 0.1)
    held = pd.concat(
        [lines(STATING, "k_over_m_coverage_95", base=OURS), lines("Reference rows", "k_over_m_coverage_95")]
    )
    nuts = lines(STATING, "k_over_m_excess", base=OURS).value[STATED["nuts"]]
    compared, sets = trainings_compared(r)
    better, worse = ([not c.tie and (c.ratio < 1) == less for c in compared] for less in (True, False))
    f.say(trainings_n=len(compared), trainings_worse=sum(worse), trainings_sets=sets)
    for name, row in {**STATED, "mcmc": "Bayesian MCMC"}.items():
        f.say(**{f"stated_{name}": f"{percent(held.value[row])} % of {held.n[row]:.0f}"})
    f.say(fold, stated_nuts_off=nuts)
    f.hold(
        levenberg_marquardt_is_first_on_both=[own.idxmin() == lm for own in arrived.values()],
        the_papers_minimum_is_farther_from_the_truth=[k[papers] > k[own], c[papers] > c[own]],
        no_weighting_is_nearer=np.hypot(k, c) > np.hypot(k[own], c[own]) - 0.014,
        the_packages_agree=agree,
        the_linearisation_holds_its_level=held.value[STATED["laplace"]] > 0.89,
        these_three_do_not=held.value[[STATED[key] for key in ("variational", "ensemble", "dropout")]] < 0.5,
        nuts_is_far_off=nuts > 1.5,
        no_training_beats_levenberg_marquardt=[not any(better), len(compared) > 50],
    )


def trainings_compared(r: Published) -> tuple[list[Comparison], list[int]]:
    """Compare the errors of every training with those of Levenberg-Marquardt on our loss, on common data sets.

    Also returns how many data sets each has in common with it.
    """
    place, of_settings = ["snr_db", "initial_state"], ("method", "settings")
    bounds = r.table("archive/summaries.parquet").pivot_table("bound", "identity", "metric")
    fits = r.fits(("pinn",), [K, C])
    errors = [fits[name] / fits.identity.map(bounds[name]) for name in (K, C)]
    fits["error"] = np.hypot(*errors).fillna(np.inf)
    fits["training"] = [json.dumps([json.loads(text)[name] for name in of_settings]) for text in fits.description]
    base = fits.training[fits.label == "pinn_family"].iloc[0]
    trainings = fits[fits.label.str.match("pinn_family|rival_")]
    by_training = trainings.pivot_table("error", [*place, "replicate"], "training", "first")
    comparisons, sets = [], []
    for name in by_training.columns.drop(base):
        both = by_training[[name, base]].dropna()
        both = both.groupby(place).head(both.groupby(place).size().min())
        errors_of = Errors({each: both[each].to_numpy() for each in both}, both.groupby(place).ngroup().to_numpy())
        comparisons += compare(errors_of, [(name, base)])
        sets.append(len(both))
    return adjusted(comparisons), sets


# ---- thresholds: the atlases


def atlas(r: Published, f: Facts) -> None:
    """Free decays at large: below the Nyquist frequency, where the data alone decide, unless it is said."""
    from bench.atlas.model import TOLD, told
    from bench.atlas.point import FreeDecay
    from bench.reporting.atlas import NEAR as TIMES
    from bench.reporting.atlas import near

    table = r.table("atlas.csv.gz")
    points = table.drop_duplicates([axis.name for axis in FreeDecay.AXES])

    def of(method: str, quantity: str = "k_over_m", where: str = "") -> pd.DataFrame:
        """The points of a method that tell a quantity, with whether it is near the bound there."""
        own = told(table[table.method == method], quantity).assign(near=lambda own: near(own, quantity))
        return own.query(where) if where else own

    best, whole = of("output_error"), table[(table.method == "output_error") & (table.bound_k_over_m <= TOLD)]
    f.say(atlas_fits=table.fits.sum(), atlas_points=len(points), atlas_near=f"{TIMES:g}")
    k, c = ((points[f"bound_{name}"] <= TOLD).mean() for name in ("k_over_m", "c_over_m"))
    f.say(percent, atlas_told=TOLD, atlas_k=k, atlas_c=c, atlas_aliased=points.aliased.mean())
    f.say(percent, best_k=best.near.mean(), best_c=of("output_error", "c_over_m").near.mean())
    f.say(number, best_gross=100 * best.k_over_m_gross.mean())
    f.say(percent, whole_k=near(whole).mean())
    f.say(percent, whole_gross=whole.k_over_m_gross.mean(), whole_held=whole.k_over_m_held.mean())

    blind = ("frequency", "iqml", "matrix_pencil")
    unknown, known = (
        [of(name, where=where).near.mean() for name in blind] for where in ("~start_known", "start_known")
    )
    hidden = [of(name, where=f"bound_c_over_m > {TOLD}").near.mean() for name in ("output_error", "shooting")]
    f.say(percent, start_unknown=unknown, start_known=known, open_damping=hidden)
    cheap = {name: of(name, "c_over_m", "~start_known") for name in ("iqml", "output_error", "matrix_pencil")}
    time = {name: own.seconds.median() for name, own in cheap.items()}
    f.say(percent, **{f"cheap_{name}": own.near.mean() for name, own in cheap.items()})
    f.say(number, cheap_ratio=time["output_error"] / time["iqml"])

    ls = [of(name, where=where).near.mean() for name in ("ls", "rls") for where in ("", "snr_db > 40")]
    ar, iqml = (of(name).k_over_m_gross.mean() for name in ("ar", "iqml"))
    peaks = of("log_decrement", "c_over_m")
    f.say(percent, ls_gross=[of(name).k_over_m_gross.mean() for name in ("ls", "rls")], ar_gross=ar)
    f.say(number, iqml_gross=100 * iqml)
    f.say(rough, ls_near=100 * max(ls), peaks_near=100 * peaks.near.mean())
    f.say(percent, peaks_gross=peaks.c_over_m_gross.mean(), atlas_held_ls=of("ls").k_over_m_held.mean())
    held = np.array([100 * of(name).k_over_m_held.mean() for name in ("output_error", "shooting", *blind)])
    snr = 100 * points[points.snr_db.between(15, 25) & ~points.aliased].bound_k_over_m.quantile([0.1, 0.9])
    f.say(tenth, atlas_held=held)
    f.say(number, snr=snr)
    few, noisy = best[best.samples < 30], best[best.snr_db < 10]
    f.hold(
        damping_is_harder_to_tell=c < k,
        output_error_is_near_with_few_samples_and_in_noise=[few.near.mean() > 0.85, noisy.near.mean() > 0.8],
        not_beyond_the_nyquist_frequency=whole[whole.aliased].k_over_m_gross.mean() > 0.5,
        a_start_that_is_not_used_costs_the_bound=np.array(known) < 0.2,
        an_open_damping_does_not_hide_the_stiffness=np.array(hidden) > 0.8,
        iqml_takes_less_time=time["iqml"] < 0.5 * time["output_error"],
        ls_is_hardly_ever_near=np.array(ls) < 0.05,
        weights_are_what_ar_lacks=iqml < 0.2 * ar,
        the_decrement_is_seldom_near=peaks.near.mean() < 0.1,
        five_have_honest_intervals=(held > 92) & (held < 98),
        the_snr_says_little=snr[0.9] > 10 * snr[0.1],
    )


def atlas_theory(r: Published, f: Facts) -> None:
    """What theory has for the same tests: the threshold, how long to wait, and plans kept."""
    from scipy.stats import binom

    from bench.planning.free_decay import Decay, Oscillator, errors, information

    table = r.table("atlas.csv.gz")
    points = table[(table.method == "output_error") & ~table.aliased].head(200)
    counted = (points.k_over_m_gross * points.fits).round()
    low, high = binom.interval(0.95, points.fits, points.wrong_basin.clip(0, 1))
    inside, risky = ((low <= counted) & (counted <= high)).mean(), points[points.wrong_basin > 0.01]
    constants, light = np.linspace(0.3, 8, 155), 0.02
    oscillator = Oscillator(1.0, light)

    def damping(constant: float) -> float:
        cycles = constant / (2 * np.pi * light)
        return errors(information(oscillator, Decay(2000, cycles / oscillator.frequency, 10.0)))["c_over_m"]

    bounds = np.array([damping(float(constant)) for constant in constants])
    best = float(constants[np.argmin(bounds)])
    short, long_ = (damping(factor * best) / min(bounds) for factor in (1 / 4, 4))
    plans = r.study("plans.md")
    over = floats(plans["over the plan's"])
    f.say(threshold_points=len(points), threshold_risky=len(risky), plans_n=len(plans))
    f.say(plans_inside=(plans.inside == "yes").sum(), plans_never=over.isna().sum())
    f.say(wait_cycles=best / (2 * np.pi * light))
    f.say(tenth, threshold_inside=100 * inside, wait=best, wait_short=short, wait_long=long_, plans_more=over.median())
    f.say(number, threshold_counted=100 * risky.k_over_m_gross.mean())
    f.say(number, threshold_predicted=100 * risky.wrong_basin.mean())
    f.hold(
        the_threshold_is_where_theory_has_it=inside >= 0.92,
        too_long_costs_less_than_too_short=1 < long_ < short,
        plans_keep_what_they_promise=(plans.inside == "yes").mean() >= 0.9,
    )


def atlas_forced(r: Published, f: Facts) -> None:
    """Tests from rest under a measured force, which every method takes as exact."""
    from bench.atlas.forced import Forced
    from bench.atlas.model import TOLD, told
    from bench.reporting.atlas import near

    table = r.table("atlas_forced.csv.gz")
    points = table.drop_duplicates([axis.name for axis in Forced.AXES])
    share = {name: (points[f"bound_{name}"] <= TOLD).mean() for name in ("k_over_m", "c_over_m", "m")}
    best = told(table[table.method == "output_error"], "k_over_m").assign(near=near)
    above = best.force_snr_db - best.snr_db
    clean, noisy = best[above >= 20], best[above < 0]
    slow, fast = points[points.bandwidth < 1], points[points.bandwidth >= 1]
    mass = {}
    for name in ("srivc", "output_error", "ls"):
        own = told(table[table.method == name], "m")
        mass[name] = near(own[own.force_snr_db - own.snr_db >= 20], "m").mean()
    f.say(force_fits=table.fits.sum(), force_points=len(points), force_clean_n=len(clean), force_noisy_n=len(noisy))
    f.say(percent, **{f"force_told_{name}": value for name, value in share.items()}, force_clean=clean.near.mean())
    f.say(percent, force_clean_held=clean.k_over_m_held.mean(), force_noisy=noisy.near.mean())
    f.say(percent, force_noisy_held=noisy.k_over_m_held.mean())
    f.say(percent, **{f"force_mass_{name}": mass[name] for name in ("srivc", "output_error")})
    f.say(number, force_slow=100 * slow.bound_k_over_m.median(), force_fast=100 * fast.bound_k_over_m.median())
    f.say(number, force_slow_mass=100 * slow.bound_m.median(), force_fast_mass=100 * fast.bound_m.median())
    f.hold(
        under_a_force_damping_is_hardest=share["c_over_m"] < min(share["k_over_m"], share["m"]),
        noise_of_the_force_is_not_allowed_for=noisy.k_over_m_held.mean() < clean.k_over_m_held.mean() - 0.1,
        the_force_must_reach_the_resonance=slow.bound_k_over_m.median() > 1.5 * fast.bound_k_over_m.median(),
        the_mass_is_told_by_a_slow_force_too=slow.bound_m.median() < 1.5 * fast.bound_m.median(),
        differences_never_tell_the_mass=mass["ls"] == 0,
    )


# ---- broken assumptions, wrong models, what changes, what is measured


def broken(r: Published, f: Facts) -> None:
    """What disturbances do to the methods on the bound."""

    def ratio(kinds: str | tuple[str, ...], methods: str | tuple[str, ...], metrics: Any = PRIMARY) -> pd.Series:
        return r.rows("robustness", disturbance=kinds, method=methods, metric=metrics).ratio.dropna()

    small, outliers = ratio(("jitter", "bias", "drift"), ON_BOUND), ratio("outliers", ON_BOUND)
    late, pencil = ratio("late_trigger", ON_BOUND, K), ratio("late_trigger", "matrix_pencil", K)
    random, shooting = ratio("irregular", ("ls", "ls_spline"), K), ratio("irregular", "shooting", K)
    student = ratio("outliers", "shooting_student")
    clean = r.rows("robustness", disturbance="none", initial_state="unknown", metric=PRIMARY,
                   method=("shooting", "shooting_student"))  # fmt: skip
    clean = clean.pivot(index="metric", columns="method", values="excess")
    price = clean.shooting_student / clean.shooting
    f.say(fold, small=small, outliers=outliers, oracle_outliers=ratio("outliers", "oracle"), late=late)
    f.say(fold, late_pencil=pencil, random_regressions=random, random_shooting=shooting, student=student)
    f.say(fold, student_price=price)
    f.hold(
        jitter_bias_and_drift_matter_little=np.abs(small - 1) < 0.15,
        outliers_cost_all_of_them=outliers > 1.8,
        a_late_trigger_costs_all_of_them=late > 1.5,
        and_the_pencil_nothing=np.abs(pencil - 1) < 0.05,
        random_times_cost_regressions_more=random.min() > shooting.max(),
        students_errors_stand_outliers=student < 1.5,
        and_cost_little_without_them=price < 1.15,
    )


def wrong_models(r: Published, f: Facts) -> None:
    """What a wrong model or prior does to the methods of the likelihood, and who notices."""
    likelihood = ("shooting", "mcmc", "output_error", "frequency", "ekf", "ukf")

    def wrong(kind: str, quantity: str, **more: object) -> pd.DataFrame:
        return r.rows("misspecified", wrong=kind, quantity=quantity, method=likelihood, **more)

    friction, spring = wrong("added_friction", "c_over_m"), wrong("cubic_spring", "k_over_m")
    seen, unseen = (wrong("added_friction", "k_over_m", snr_db=snr).coloured for snr in (40, 20))
    alarms, mass = wrong("nothing", "k_over_m", snr_db=20).coloured, wrong("wrong_prior", "m").coverage_95
    keys = ["method", "initial_state", "snr_db", "quantity"]
    off, right = (
        pd.concat([wrong(kind, name) for name in ("k_over_m", "c_over_m")]).set_index(keys).excess
        for kind in ("wrong_prior", "nothing")
    )
    moved = np.abs(off - right.reindex(off.index))
    f.say(number, friction=friction.bias_pct, spring=spring.bias_pct, prior_moved=moved.max())
    f.say(percent, friction_held=friction.coverage_95, spring_held=spring.coverage_95, seen=seen, unseen=unseen)
    f.say(percent, alarms=alarms, spring_seen=spring.coloured, prior_mass=mass)
    f.say(wrong_n=friction.n)
    f.hold(
        friction_is_taken_for_damping=(friction.bias_pct > 20) & (friction.coverage_95 < 0.1),
        a_cubic_spring_for_stiffness=(spring.bias_pct > 2) & (spring.coverage_95 < 0.1),
        no_method_says_so=pd.concat([friction, spring]).said < 0.05,
        residuals_show_friction_at_40_db_only=[seen.min() > 0.9, unseen.max() < 0.2],
        residuals_do_not_show_the_spring=spring.coloured < 0.2,
        a_wrong_prior_leaves_the_groups=moved < 0.2,
        and_takes_the_mass=mass < 0.5,
    )


def online(r: Published, f: Facts) -> None:
    """Parameters that change: Table 10 and the study of the online methods."""
    for name, scenario in {"known": "step10_multisine", "unknown": "step10_ambient"}.items():
        lines = r.rows("table10", scenario=scenario)
        whole = lines[lines.ok == lines.ok.max()]
        wide = whole.pivot(index="method", columns="quantity", values="excess").drop(index="bound").dropna()
        best, delay = str(wide.max(axis=1).idxmin()), lines[lines.quantity == "k_over_m"].set_index("method").delay
        f.say(**{f"step_{name}_k": fold(wide.k_over_m[best]), f"step_{name}_c": fold(wide.c_over_m[best])})
        f.say(**{f"step_{name}_delay": f"{delay[best]:.0f}", f"step_{name}_bound": f"{delay['bound']:.0f}"})
        f.hold(**{f"nearest_under_a_force_{name}": best == {"known": "change_points", "unknown": "ssi"}[name]})
    same = r.study("online.md", "Nothing changes")
    window = same.index.str.contains("window")
    k, c, held = (floats(same[name]) for name in ("k/m excess", "c/m excess", "k/m cov. %"))
    alarms = same[["false alarms in 10,000 samples", "at most, stated"]].apply(floats)
    alarms = alarms.loc[["change points", "CUSUM", "likelihood ratio"]]
    faults = r.study("online.md", "Faults").drop(columns=["method", "records"])
    ratio = faults.apply(floats)
    f.say(step_n=whole.replicates.max())
    cost, live = r.study("online.md", "A long record"), r.study("online.md", "A live run").iloc[0]
    f.say(false_alarms=", ".join((f"{name} {row.iloc[0]:g} ({row.iloc[1]:g})" for name, row in alarms.iterrows())))
    f.say(sample_ekf=cost["µs a sample, median"]["EKF"], sample_points=cost["µs a sample, median"]["change points"])
    f.say(sample_ar=cost["µs a sample, median"]["AR, recursive"], live_rate=live["samples a second"])
    f.say(live_behind=live["page behind, median s"], live_most=live["largest s"], same_held=held)
    f.say(same_n=same.records.astype(int).max())
    f.say(fold, same_k=k[~window], same_c=c[~window], same_window_k=k[window], same_window_c=c[window])
    f.say(fold, faults=ratio.loc[["EKF", "IMM"]].to_numpy().ravel())
    f.hold(
        a_window_is_near_its_bound=[k[window] < 1.3, c[window] < 1.3],
        cusum_alone_gives_more_alarms_than_stated=(alarms.iloc[:, 0] > alarms.iloc[:, 1]) == (alarms.index == "CUSUM"),
        a_restart_changes_nothing=ratio["restart"] == 1,
        only_rls_behind_saturation_has_no_answer=faults.eq("no answer").stack().pipe(lambda own: list(own.index[own]))
        == [("RLS", "saturation")],
        memory_is_constant=cost["kB held after 2,000 samples"] == cost["after 100,000"],
    )


def measured(r: Published, f: Facts) -> None:
    """The Silverbox beside published recurrent networks."""
    table = r.study("silverbox.md", "Free simulation of the test parts")
    parts = table.drop(columns=["model", "fit s"]).astype(float).set_axis(["multisine", "arrow", "inside"], axis=1)
    ours, lines = (parts[parts.index.str.endswith(f"{kind} input")].iloc[0] for kind in ("cubic", "linear"))
    nets = parts.loc[["GRU", "LSTM", "OLSTM", "RNN"]]
    f.say(fine, **{f"silverbox_{part}": value for part, value in ours.items()}, silverbox_linear=lines["multisine"])
    f.say(number, **{f"networks_{part}": nets[part] for part in nets})
    f.hold(
        below_every_recurrent_network=nets > ours,
        a_linear_input_is_worse=lines > ours,
    )


TOPICS = (
    overview, free_decay, free_decay_training, free_decay_others, free_decay_regressions, reproduction, open_split,
    systems_forced, systems_more, systems_ends, systems_reach, pinn_engine, pinn_family, atlas, atlas_theory,
    atlas_forced, broken, wrong_models, online, measured,
)  # fmt: skip


def facts(folder: Path) -> Facts:
    """All numbers and conclusions over a folder of results; raises InputError where a file or a line is missing."""
    results, found = Published(folder), Facts()
    for topic in TOPICS:
        topic(results, found)
    return found
