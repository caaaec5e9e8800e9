"""The tables of experiments, each a specification in the form that the ``table`` of its file in ``conf`` names."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from bench.reporting.frame import ERROR, Frame, Line, Result, group, quantity, share
from bench.reporting.labels import place_of, told, warns
from bench.reporting.ranking import FIRST_TIER, median_time
from bench.reporting.residuals import coloured
from bench.reporting.rounding import answered, excess_text, number, percent, percent_between, with_excess
from bench.reporting.tables.pooling import lower_median, root_mean_square
from bench.reporting.tables.render import (
    MISSING,
    Columns,
    Panel,
    TableForm,
    Texts,
    bold,
    each,
    failure_notes,
    measured,
    named,
)  # fmt: skip
from bench.reporting.tables.tidy import VALUES, line_of, tidy_lines
from bench.scoring.calibration import adjust_p_values, calibration
from bench.scoring.statistics import LEVEL, counts
from bench.scoring.summary import outlier_fits
from bench.store.cell import Cell

ORACLE = """*oracle* is maximum a posteriori (without a prior: maximum likelihood) started at the truth."""
EXCESS = """The number after × is the excess: root mean square error over the Cramér-Rao bound, over the fits that gave
an answer. 1 is the best that an unbiased method can do; ×>1e6: some estimates ran away, and how far says nothing. A fit
without an answer counts as an infinite error in medians; *ok*: fits that gave an answer, of all."""
COVERAGE = """**95 %**: the share of the 95 % intervals that held the truth, with its own 95 % interval (Wilson's)."""
DASH = "A dash: the method does not tell it, or the experiment does not ask for it."


# ---- what several tables show


def covered(line: Line, digits: int = 0) -> str:
    """The share of the 95 % intervals that held the truth, with its interval."""
    return percent_between(line["coverage_95"], line["low_95"], line["high_95"], digits)


def bounded(line: Line) -> str:
    """The bound, and how much of it is the prior's."""
    if not math.isfinite(line["bound"]):
        return "not told"
    share = percent(line["prior_share"])
    return number(line["bound"]) + (f" ({share} % prior)" if share not in ("0", MISSING) else "")


def results_of(lines: Iterable[Line]) -> list[Result]:
    """The results of lines, each once."""
    return list(dict.fromkeys(line["result"] for line in lines))


def failures(lines: Sequence[Line]) -> list[str]:
    """What failed of the results of lines."""
    return [failure_notes(results_of(lines))]


def fits(lines: Sequence[Line]) -> Texts:
    """The median time, what was told beyond the data, and how many fits gave an answer at each noise level."""
    results = results_of(lines)
    if lines[0]["method"] == "bound":
        return {}
    return {
        "time (s)": seconds(median_time(results)), "uses": uses(results[0]),
        "ok": ", ".join(dict.fromkeys(answered(result.n_ok, result.n) for result in results)),
    }  # fmt: skip


def seconds(time: float) -> str:
    """A processor time."""
    return MISSING if math.isnan(time) else f"{time:.2g}"


def uses(result: Result) -> str:
    """What a method was told beyond the data, of what there was to tell here."""
    there = {"start": result.initial_state == "known", "prior": bool(result.prior)}
    return ", ".join(word for word in told(result.method).split(", ") if there.get(word.partition(" ")[0], True))


def place(line: Line) -> Texts:
    """The method and the noise level of a line."""
    return {**named(line), "SNR (dB)": f"{line['snr_db']:g}"}


def start(line: Line) -> str:
    """The reading of the initial state."""
    return f"Initial state {line['initial_state']}"


# ---- Tables 2 to 5: every method beside the paper's numbers

HEADINGS = {
    "k_over_m_error_pct": "k/m error %", "c_over_m_error_pct": "c/m error %", "rmse": "RMSE (m)",
    "m_error_pct": "m error %", "c_error_pct": "c error %", "k_error_pct": "k error %",
}  # fmt: skip
"""The metrics of these tables, in order, and what stands over them."""


def paper_lines(frame: Frame) -> list[Line]:
    """One line a metric: of each scenario the bound, of every method its errors with the paper's number."""
    lines: list[Line] = []
    scenarios = set[str]()
    columns = ("system", "initial_state", "snr_db", "metric", "bound", "prior_share")
    for line in tidy_lines(frame, scored, PAPER_COLUMNS):
        result = line["result"]
        if result.stored and result.question not in scenarios:
            scenarios.add(result.question)
            head = {"table": line["table"], "row": line["row"], "method": "bound"}
            metrics = [metric for metric in result.summary if math.isfinite(result.bound(metric))]
            lines += [{**head, **line_of(result, metric, columns)} for metric in metrics]
        lines.append({**line, "prior_share": math.nan})  # it is the bound's
    return lines


def scored(result: Result) -> list[str]:
    """The metrics of a result; those that are shown where it was not run."""
    return [metric for metric in result.summary if metric != "realised_snr_db"] or list(HEADINGS)


def paper_row(line: Line) -> Texts:
    """The row of the paper's table, where it has several, and the method."""
    first = {4: "set", 5: "SNR (dB)"}.get(line["table"])
    return {**({first: line["row"]} if first else {}), **named(line)}


def paper_entry(line: Line) -> Texts:
    """A median with its excess, and the paper's number, whose reading is the known start."""
    if line["method"] == "bound":
        return {HEADINGS[line["metric"]]: bounded(line)}
    beside = f" (paper {number(line['paper'])})" if line["paper"] > 0 and line["initial_state"] == "known" else ""
    return {HEADINGS[line["metric"]]: bold(with_excess(line["median"], line["excess"]) + beside, line["tied"])}


def paper_last(lines: Sequence[Line]) -> Texts:
    """The share of the mean square error of k/m and of c/m that is bias, and the rest."""
    if lines[0]["method"] == "bound":
        return {}
    shares = [percent(line["bias_share"]) for line in lines if line["metric"] in list(HEADINGS)[:2]]
    return {"bias² %": ", ".join(shares), **fits(lines)}


PAPER_COLUMNS = (
    "table", "row", "system", "initial_state", "snr_db", "method", "metric", "mean", "median", "ci_low", "ci_high",
    "bound", "prior_share", "excess", "bias_share", "n_ok", "n", "paper", "verdict",
)  # fmt: skip
PAPER = TableForm(
    legend=f"""Each entry: median over the replicates. {EXCESS} The row *bound* gives the Cramér-Rao bound on the root
mean square (a median lies below a root mean square: about 0.67 of it for a normal error), and how much of its variance
is the prior's (`python -m bench identifiability` says more). Free vibration tells k/m and c/m only: m, and what follows
from it, is decided by the prior. {ORACLE} *prior* is the nominal values without any data. {FIRST_TIER} bias² %: the
share of the mean square errors of k/m and c/m that is the square of their mean error, what more replicates would not
average out (less what chance makes of no bias). Time: processor time of the median fit. Uses: what a method was told
beyond the data; *prior after*: by one step that all such methods share. In brackets the paper's number: the verdicts on
it are in the CSV, and what its data allow in [an audit](audits.md#karkadakattil2026). All 95 % intervals are in the
CSV.""",
    columns=PAPER_COLUMNS, lines=paper_lines, section=start,
    panels=(
        Panel(
            paper_entry, paper_row, paper_last, of=lambda line: line["metric"] in HEADINGS,
            order=lambda line: list(HEADINGS).index(line["metric"]),
        ),
    ),
    notes=failures, latex=True,
)  # fmt: skip


# ---- whether stated uncertainties hold

FEWEST, COUNTED = 20, 5
"""Replicates below which nothing is called calibrated, and below which nothing is counted."""


def calibration_lines(frame: Frame) -> list[Line]:
    """One line a method, noise, start and quantity; the tests of all of them are adjusted together."""
    lines = [calibrated(result, name) for result in frame if result.stored for name in ("k_over_m", "c_over_m")]
    judged = [line for line in lines if line["n"] >= COUNTED]
    for line, found in zip(judged, adjust_p_values([line["alone"] for line in judged]), strict=True):
        if line["n"] >= FEWEST or min(found.adjusted) < LEVEL:
            line["verdict"] = found.verdict
    return list(lines)


def calibrated(result: Result, name: str) -> dict[str, Any]:
    """Coverage and normal scores of a quantity, without a verdict."""
    levels, inside = (result.scores(score) for score in (f"{name}_pit", "band_inside_95"))
    levels, inside = levels[~np.isnan(levels)], inside[~np.isnan(inside)]
    head = line_of(result, name + ERROR, ("method", "initial_state", "snr_db", "quantity"))
    head |= {"n": levels.size, "verdict": MISSING, "band_95": float(np.mean(inside)) if inside.size else math.nan}
    if levels.size < COUNTED:
        return head | dict.fromkeys(("coverage_95", "low_95", "high_95", "rms_z"), math.nan)
    alone = calibration(levels)
    shares = {f"coverage_{round(100 * part.level)}": part.share for part in alone.coverage}
    return {
        **head, **shares, "low_95": alone.coverage[-1].low, "high_95": alone.coverage[-1].high, "alone": alone,
        "mean_z": alone.mean_z, "rms_z": alone.rms_z, "uniform_p": alone.p_values[2],
    }  # fmt: skip


CALIBRATED: Columns[Line] = {
    "95 %": partial(covered, digits=1), "RMS of z": lambda line: excess_text(line["rms_z"]),
    "verdict": lambda line: line["verdict"],
}  # fmt: skip
CALIBRATION = TableForm(
    legend=f"""{COVERAGE} z is the truth's normal score under the belief, cut at 6: of mean 0 and root mean square (RMS)
1 if the belief is calibrated; an RMS of 2 means intervals half as wide as the errors ask for, bias included: too sure;
one below 1, too wide. The verdict is by three tests (mean of z, its mean square, uniformity of the levels) at 5 %,
adjusted over all tests of all lines of this table (Benjamini and Hochberg): of what they find, one in twenty is
expected to be a false alarm, and if all lines were calibrated, nothing would be found with 95 % probability. Fewer than
{FEWEST} replicates are not enough to call a method calibrated; fewer than {COUNTED} are not counted. Band: the share of
the record, 1,000 points in each replicate, where the true displacement lies in the method's own 95 % band. A dash: the
method states no uncertainty, or there is no verdict.""",
    columns=(
        "method", "initial_state", "snr_db", "quantity", "n", "coverage_50", "coverage_80", "coverage_95", "low_95",
        "high_95", "mean_z", "rms_z", "uniform_p", "verdict", "band_95",
    ),
    lines=calibration_lines, section=start,
    panels=(
        Panel(
            each(measured, CALIBRATED), place,
            lambda lines: {"band 95 %": percent(lines[0]["band_95"], 1), "n": str(lines[0]["n"])},
        ),
    ),
    digits=5,
)  # fmt: skip


# ---- what becomes of estimates and intervals where the model is wrong

RIGHT = "nothing"


def wrong(result: Result) -> str:
    """What is wrong: the kind of disturbance, a wrong prior, or nothing."""
    return result.disturbance or ("wrong_prior" if (result.prior or {}).get("wrong") else RIGHT)


def misspecified_lines(frame: Frame) -> list[Line]:
    """One line a cell and quantity; a cell that was not run has n = 0."""
    noticed = coloured(frame.results)
    return [
        {
            **line_of(result, name + ERROR), "wrong": wrong(result), "said": said(result),
            "median_error_pct": result.statistic(name + ERROR, "median"),
            "coloured": np.mean(noticed[result.identity]) if np.size(noticed.get(result.identity, ())) else math.nan,
        }
        for result in frame
        for name in ("k_over_m", "c_over_m", "m")
    ]  # fmt: skip


def said(result: Result) -> float:
    """The share of the fits that failed or came with a warning; NaN where messages are no warnings."""
    if not result.n or not warns(result.label):
        return math.nan
    return float(np.mean([not ok or bool(message) for ok, message in zip(result.ok, result.messages, strict=True)]))


UNDER_ERROR: Columns[Line] = {
    "error %": lambda line: with_excess(line["median_error_pct"], line["excess"]),
    "bias %": lambda line: number(line["bias_pct"]), "95 %": covered,
}  # fmt: skip
MISSPECIFIED = TableForm(
    legend=f"""What is fitted is one mass with a viscous damper and a linear spring; the data are of something else, or
the nominal values are off by three standard deviations. Errors are against what truth and model have in common: the
stiffness at small amplitude, the viscous part of the damping, the first mode. Each entry: the median error in percent.
{EXCESS} The bound is that of the right model, with white noise alone. Bias: the mean of estimate over truth, less one,
in percent. {COVERAGE} Below what they claim, a method is wrong and does not say so. Said: the share of the fits that
gave no answer or one with a warning. Residuals: the share of the answers whose residuals a user can tell from white
noise (Ljung-Box test at 5 % of the best response of k/m and c/m; the panel in which nothing is wrong shows its false
alarms). {ORACLE} It has the same wrong model. {DASH}""",
    columns=(
        "wrong", "system", "initial_state", "snr_db", "method", "quantity", "median_error_pct", "bias_pct", "excess",
        "coverage_95", "low_95", "high_95", "said", "coloured", "n_ok", "n",
    ),
    lines=misspecified_lines,
    section=lambda line: f"Wrong: {line['wrong'].replace('_', ' ')}; initial state {line['initial_state']}",
    panels=(
        Panel(
            each(measured, UNDER_ERROR), place,
            lambda lines: {
                "said %": percent(lines[0]["said"]), "residuals %": percent(lines[0]["coloured"]), **fits(lines),
            },
        ),
    ),
    notes=failures, needs=lambda result: wrong(result) != RIGHT,
)  # fmt: skip


# ---- how far each disturbance takes each method from what it does on undisturbed data

PANELS = {"k_over_m_error_pct": "k/m", "c_over_m_error_pct": "c/m", "rmse": "Displacement"}
TOLD_APART = 0.01
"""A ratio nearer to 1 than this is no change worth a star, however certain (two integrators differ by rounding)."""


def ratio(disturbed: np.ndarray, undisturbed: np.ndarray) -> tuple[float, float, float]:
    """Root mean square over root mean square of paired errors, shape (n,), with its 95 % bootstrap interval.

    Pairs in which either failed (not finite) are left out; NaNs where fewer than two are left.
    """
    good = np.isfinite(disturbed) & np.isfinite(undisturbed)
    squares = np.stack([disturbed[good], undisturbed[good]], axis=1) ** 2
    if good.sum() < 2 or not np.any(squares[:, 1]):
        return math.nan, math.nan, math.nan
    above, below = (counts(len(squares)).T @ squares).T / len(squares)
    low, high = np.quantile(np.sqrt(above / np.maximum(below, np.finfo(float).tiny)), [0.025, 0.975])
    middle = squares.mean(axis=0)
    return float(np.sqrt(middle[0] / middle[1])), float(low), float(high)


def robustness_lines(frame: Frame) -> list[Line]:
    """One line a cell and metric, beside the same of its undisturbed counterpart.

    Both have the same base noise and nominal values replicate by replicate, so their ratio is far better known than
    either.
    """
    known = {result.identity: result for result in frame}
    pairs = [(result, known.get(undisturbed(result).identity)) for result in frame]
    return [
        {**line_of(result, metric), **compared(result, plain, metric)} for result, plain in pairs for metric in PANELS
    ]


def undisturbed(result: Result) -> Cell:
    """The cell on the same data without what disturbs them."""
    assert result.cell is not None
    return replace(result.cell, scenario=result.scenario.undisturbed)


def compared(result: Result, plain: Result | None, metric: str) -> Line:
    """The columns of the undisturbed counterpart, and the ratio of the errors."""
    if plain is None:
        return dict.fromkeys(("ratio_low", "ratio_high"), math.nan)
    beside = {f"{name}_undisturbed": VALUES[name](plain, metric) for name in ("excess", "coverage_95", "n_ok")}
    both = result.stored and plain.stored
    ratios = ratio(result.errors(metric), plain.errors(metric)) if both else (math.nan,) * 3
    return {**beside, **dict(zip(("ratio", "ratio_low", "ratio_high"), ratios, strict=True))}


def disturbed(line: Line) -> str:
    """The disturbance of a line, which heads its column."""
    name = "undisturbed" if line["disturbance"] == "none" else line["disturbance"].replace("_", " ")
    return name + (" (start known)" if line["initial_state"] == "known" else "")


def robustness_entry(line: Line) -> Texts:
    """The excess, whether it differs from the undisturbed one, and how many fits gave an answer where not all did."""
    if not line["n"]:
        return {disturbed(line): "not run"}
    apart = line["ratio_low"] > 1 + TOLD_APART or line["ratio_high"] < 1 - TOLD_APART
    star = " *" if apart and line["disturbance"] != "none" else ""
    answers = f" ({line['n_ok']}/{line['n']})" if line["n_ok"] < line["n"] else ""
    return {disturbed(line): excess_text(line["excess"]) + star + answers}


ROBUSTNESS = TableForm(
    legend="""Each entry: root mean square error over the replicates, divided by the Cramér-Rao bound of the
*undisturbed* scenario: what would be possible without the disturbance (noise that is not white and normal has a bound
of its own, which may be lower); for *irregular* by the bound of its own times, which are told. The start is unknown to
the methods unless the column says otherwise. A star marks an entry whose error differs from the undisturbed one of its
reading by more than 1 %, beyond a 95 % interval (bootstrap of pairs: both cells have the same base noise). Failed
replicates are left out of the entry and counted behind it. *oracle* is maximum a posteriori started at the truth, under
the same wrong assumptions: what it loses is not the optimiser's. No method is told of a disturbance, nor that there is
one. Ratios with their intervals are in the CSV.""",
    columns=(
        "disturbance", "size", "system", "initial_state", "snr_db", "method", "metric", "excess", "excess_undisturbed",
        "ratio", "ratio_low", "ratio_high", "coverage_95", "coverage_95_undisturbed", "n_ok", "n_ok_undisturbed", "n",
    ),
    lines=robustness_lines, section=lambda line: f"{PANELS[line['metric']]}: root mean square error over the bound",
    panels=(
        Panel(robustness_entry),
        Panel(
            lambda line: {disturbed(line): percent(line["coverage_95"])},
            title="Coverage of the 95 % intervals, in percent:",
        ),
    ),
    needs=lambda result: bool(result.disturbance),
)  # fmt: skip


# ---- all scenarios of the open split together

METRICS = {"k_over_m_error_pct": "k/m", "c_over_m_error_pct": "c/m", "rmse": "displacement"}
UNTOLD = 100.0
"""A bound (%) beyond which data and prior do not tell a quantity: an error over it says nothing."""
PARTS: Mapping[str, Callable[[Result], bool]] = {
    "all": lambda result: True,
    "free": lambda result: not result.forced,
    "free at even times": lambda result: not result.forced and not result.disturbance,
    "forced": lambda result: result.forced,
}


def open_lines(frame: Frame) -> list[Line]:
    """One line a part, method and metric."""
    bounds = {metric: bounds_of(frame, metric) for metric in METRICS}
    ordered = sorted(frame, key=lambda result: place_of(result.label))
    return [
        {
            "part": part, "method": label, "metric": metric, "results": results, "median_cpu_s": median_time(results),
            **over_bounds(results, metric, bounds[metric]),
        }
        for part, has in PARTS.items()
        for label, results in group(filter(has, ordered), lambda result: result.label).items()
        for metric in METRICS
    ]  # fmt: skip


def bounds_of(results: Iterable[Result], metric: str) -> dict[str, float]:
    """The bound of each scenario by its question, from any method that stored it: one that failed may have none."""
    bounds = {result.question: result.bound(metric) for result in results if math.isfinite(result.bound(metric))}
    return {question: bound for question, bound in bounds.items() if bound > 0 and (metric == "rmse" or bound < UNTOLD)}


def over_bounds(results: Iterable[Result], metric: str, bounds: Mapping[str, float]) -> Line:
    """The errors of one method over the bounds, of the scenarios that tell a metric; ``bounds`` are by question.

    A reference row that states no error of its own, and a method that does not tell the metric, count as failed.
    """
    told = [result for result in results if result.stored and result.question in bounds]
    ratios = [np.empty(0), *(result.errors(metric) / bounds[result.question] for result in told)]
    hits = [np.empty(0), *(result.successful(f"{quantity(metric)}_coverage_95") for result in told)]
    every, held = np.concatenate(ratios), np.concatenate(hits)
    known = every[np.isfinite(every)]
    shares = dict(zip(("gross", "gross_low", "gross_high"), share(outlier_fits(every, 1.0)), strict=True))
    held_shares = dict(zip(("coverage_95", "low_95", "high_95"), share(held), strict=True))
    return {
        "n": every.size, "n_answered": known.size, "median_over_bound": lower_median(every),
        "rms_over_bound": root_mean_square(known), **shares, "n_coverage": held.size, **held_shares,
    }  # fmt: skip


def typical(line: Line) -> str:
    """The median error over the bound, infinite where most fits failed."""
    return "failed" if math.isinf(line["median_over_bound"]) else excess_text(line["median_over_bound"])


def open_last(lines: Sequence[Line]) -> Texts:
    """How many scenarios were answered, and the time."""
    results = lines[0]["results"]
    ok = answered(sum(result.n_ok for result in results), sum(result.n for result in results))
    return {"answered": ok, "time (s)": seconds(lines[0]["median_cpu_s"])}


OVER_BOUND: Columns[Line] = {
    "median": typical, "RMS": lambda line: excess_text(line["rms_over_bound"]),
    "gross %": lambda line: percent_between(line["gross"], line["gross_low"], line["gross_high"]), "95 %": covered,
}  # fmt: skip
OPEN = TableForm(
    legend=f"""One replicate of each scenario, drawn at random by the name of the release ({{release}}) from the ranges
of `conf/experiment/{{name}}.yaml`, uniformly or, of what is a size, uniformly in the logarithm. No setting was chosen
on them. Each error is divided by its scenario's own Cramér-Rao bound. **Median** is over the scenarios, a fit that
failed or gave no answer counting as infinite; at the bound it is about 0.67 of it for a normal error. **RMS** is over
those that were answered: 1 is the best that an unbiased method can do, and a few gross errors decide it. **Gross**: the
share of scenarios with an error beyond five times the bound, failures included, with its 95 % interval (Wilson's).
{COVERAGE} Left out of a quantity are scenarios whose bound for it is as large as its value: they do not tell it. The
bound is that of the sample times of the replicate. It is of first order, and knows nothing of aliases: *oracle*, which
starts at the truth, shows how near it is. With fewer than two samples a cycle at even times the data alone leave the
frequency open to everyone. Time: processor time of the median fit that gave an answer. answered: of the scenarios of
the panel.""",
    columns=(
        "part", "method", "metric", "n", "n_answered", "median_over_bound", "rms_over_bound", "gross", "gross_low",
        "gross_high", "n_coverage", "coverage_95", "low_95", "high_95", "median_cpu_s",
    ),
    lines=open_lines, section=lambda line: f"{line['part'].capitalize()} scenarios",
    panels=(Panel(each(lambda line: METRICS[line["metric"]], OVER_BOUND), last=open_last),), digits=5,
)  # fmt: skip
