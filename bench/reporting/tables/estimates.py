"""Specifications of the tables of experiments, one per form that ``table`` in ``conf/experiment`` can name."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from bench.reporting.frame import ERROR, Frame, Line, Result, group, quantity, share
from bench.reporting.labels import information_used, place_of, warns
from bench.reporting.ranking import FIRST_TIER, UNINFORMATIVE, median_time
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

ORACLE = """*oracle*: maximum a posteriori (without a prior: maximum likelihood), started at the true values."""
EXCESS = """The number after × is the excess: root mean square error of the successful fits over the Cramér-Rao bound;
1 is the smallest that an unbiased method can reach; ×>1e6: some estimates are off by many orders of magnitude. A failed
fit counts as an infinite error in medians; *ok*: successful fits, of all."""
COVERAGE = """**95 %**: coverage, the share of the 95 % intervals that contain the true value, with its own 95 %
interval (Wilson)."""
DASH = "A dash: the method does not estimate it, or it is not part of the experiment."


# ---- texts that several tables share


def covered(line: Line, digits: int = 0) -> str:
    """Format the coverage of the 95 % intervals, with its own interval."""
    return percent_between(line["coverage_95"], line["low_95"], line["high_95"], digits)


def bounded(line: Line) -> str:
    """Format the bound, and the share of its variance that is due to the prior."""
    if not math.isfinite(line["bound"]):
        return "not identifiable"
    share = percent(line["prior_share"])
    return number(line["bound"]) + (f" ({share} % prior)" if share not in ("0", MISSING) else "")


def results_of(lines: Iterable[Line]) -> list[Result]:
    """Return the results of lines, each once."""
    return list(dict.fromkeys(line["result"] for line in lines))


def failures(lines: Sequence[Line]) -> list[str]:
    """List the failed fits among the results of lines."""
    return [failure_notes(results_of(lines))]


def fits(lines: Sequence[Line]) -> Texts:
    """Return the median time, the information used beyond the data, and the successful fits per noise level."""
    results = results_of(lines)
    if lines[0]["method"] == "bound":
        return {}
    return {
        "time (s)": seconds(median_time(results)), "uses": uses(results[0]),
        "ok": ", ".join(dict.fromkeys(answered(result.n_ok, result.n) for result in results)),
    }  # fmt: skip


def seconds(time: float) -> str:
    """Format a processor time."""
    return MISSING if math.isnan(time) else f"{time:.2g}"


def uses(result: Result) -> str:
    """List the information beyond the data that a method used and the scenario provided."""
    provided = {"initial": result.initial_state == "known", "prior": bool(result.prior)}
    used = information_used(result.method).split(", ")
    return ", ".join(text for text in used if provided.get(text.partition(" ")[0], True))


def place(line: Line) -> Texts:
    """Return the method and the noise level of a line."""
    return {**named(line), "SNR (dB)": f"{line['snr_db']:g}"}


def initial_state(line: Line) -> str:
    """Return the heading of a section of scenarios with the same initial state."""
    return f"Initial state {line['initial_state']}"


# ---- Tables 2 to 5: every method and the paper's numbers

HEADINGS = {
    "k_over_m_error_pct": "k/m error %", "c_over_m_error_pct": "c/m error %", "rmse": "RMSE (m)",
    "m_error_pct": "m error %", "c_error_pct": "c error %", "k_error_pct": "k error %",
}  # fmt: skip
"""Column headings by metric, in order."""


def paper_lines(frame: Frame) -> list[Line]:
    """Return one line per metric for the bound of each scenario, and for each method with the paper's number."""
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
        lines.append({**line, "prior_share": math.nan})  # a property of the bound, not of the method
    return lines


def scored(result: Result) -> list[str]:
    """Return the metrics of a result; those with a column if the cell was not run."""
    return [metric for metric in result.summary if metric != "realised_snr_db"] or list(HEADINGS)


def paper_row(line: Line) -> Texts:
    """Return the row of the paper's table, if it has several, and the method."""
    first = {4: "set", 5: "SNR (dB)"}.get(line["table"])
    return {**({first: line["row"]} if first else {}), **named(line)}


def paper_entry(line: Line) -> Texts:
    """Return a median with its excess, and the paper's number, which assumes a known initial state."""
    if line["method"] == "bound":
        return {HEADINGS[line["metric"]]: bounded(line)}
    published = f" (paper {number(line['paper'])})" if line["paper"] > 0 and line["initial_state"] == "known" else ""
    return {HEADINGS[line["metric"]]: bold(with_excess(line["median"], line["excess"]) + published, line["tied"])}


def paper_last(lines: Sequence[Line]) -> Texts:
    """Return the share of the mean square error of k/m and of c/m that is bias, and the columns of every table."""
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
mean square error (the median of a normal error is 0.67 times its root mean square), and the share of its variance that
is due to the prior (details: `python -m bench identifiability`). Only k/m and c/m are identifiable from free vibration:
m, c and k are determined by the prior. {ORACLE} *prior*: the nominal values, without any data. {FIRST_TIER}
bias² %: the share of the mean square errors of k/m and c/m that is the square of the mean error, which more replicates
would not average out (corrected for its expectation without bias). Time: median processor time of a fit. Uses:
information given to the method beyond the data; *prior after*: combined with the prior afterwards, by one step that all
such methods share. In brackets the paper's number: its verdicts are in the CSV, and what its data allow in
[an audit](audits.md#karkadakattil2026). All 95 % intervals are in the CSV.""",
    columns=PAPER_COLUMNS, lines=paper_lines, section=initial_state,
    panels=(
        Panel(
            paper_entry, paper_row, paper_last, of=lambda line: line["metric"] in HEADINGS,
            order=lambda line: list(HEADINGS).index(line["metric"]),
        ),
    ),
    notes=failures, latex=True,
)  # fmt: skip


# ---- calibration of stated uncertainties

FEWEST, COUNTED = 20, 5
"""Fewest replicates for the verdict "calibrated", and fewest for any statistic."""


def calibration_lines(frame: Frame) -> list[Line]:
    """Return one line per cell and quantity; the p values of all tests are adjusted together."""
    lines = [calibrated(result, name) for result in frame if result.stored for name in ("k_over_m", "c_over_m")]
    judged = [line for line in lines if line["n"] >= COUNTED]
    for line, adjusted in zip(judged, adjust_p_values([line["alone"] for line in judged]), strict=True):
        if line["n"] >= FEWEST or min(adjusted.adjusted) < LEVEL:
            line["verdict"] = adjusted.verdict
    return list(lines)


def calibrated(result: Result, name: str) -> dict[str, Any]:
    """Return coverage and normal scores of a quantity, without a verdict."""
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
    legend=f"""{COVERAGE} z: normal score of the true value under the posterior, limited to ±6; its mean is 0 and its
root mean square (RMS) 1 if the posterior is calibrated. An RMS of 2 means intervals half as wide as the errors require,
bias included (overconfident); an RMS below 1, too wide intervals (underconfident). The verdict rests on three tests
(mean of z, mean square of z, uniformity of the levels) at 5 %, adjusted over all lines of this table (Benjamini and
Hochberg): at most one in twenty of the rejections is expected to be false, and if all methods were calibrated, there
would be none with at least 95 % probability, provided that the tests are independent. The verdict "calibrated" takes
at least {FEWEST} replicates, any statistic at least {COUNTED}. Band: the share of the record (1,000 points per
replicate) where the 95 % band of the method contains the true displacement. A dash: the method states no uncertainty,
or there is no verdict.""",
    columns=(
        "method", "initial_state", "snr_db", "quantity", "n", "coverage_50", "coverage_80", "coverage_95", "low_95",
        "high_95", "mean_z", "rms_z", "uniform_p", "verdict", "band_95",
    ),
    lines=calibration_lines, section=initial_state,
    panels=(
        Panel(
            each(measured, CALIBRATED), place,
            lambda lines: {"band 95 %": percent(lines[0]["band_95"], 1), "n": str(lines[0]["n"])},
        ),
    ),
    digits=5,
)  # fmt: skip


# ---- estimates and intervals under a wrong model

RIGHT = "nothing"


def wrong(result: Result) -> str:
    """Return the kind of disturbance, ``wrong_prior``, or ``nothing``."""
    return result.disturbance or ("wrong_prior" if (result.prior or {}).get("wrong") else RIGHT)


def misspecified_lines(frame: Frame) -> list[Line]:
    """Return one line per cell and quantity; a cell that was not run has n = 0."""
    rejected = coloured(frame.results)
    return [
        {
            **line_of(result, name + ERROR), "wrong": wrong(result), "said": warning_share(result),
            "median_error_pct": result.statistic(name + ERROR, "median"),
            "coloured": np.mean(rejected[result.identity]) if np.size(rejected.get(result.identity, ())) else math.nan,
        }
        for result in frame
        for name in ("k_over_m", "c_over_m", "m")
    ]  # fmt: skip


def warning_share(result: Result) -> float:
    """Return the share of the fits that failed or came with a warning; NaN if messages are no warnings."""
    if not result.n or not warns(result.label):
        return math.nan
    return float(np.mean([not ok or bool(message) for ok, message in zip(result.ok, result.messages, strict=True)]))


UNDER_ERROR: Columns[Line] = {
    "error %": lambda line: with_excess(line["median_error_pct"], line["excess"]),
    "bias %": lambda line: number(line["bias_pct"]), "95 %": covered,
}  # fmt: skip
MISSPECIFIED = TableForm(
    legend=f"""The model is one mass with a viscous damper and a linear spring; the data are of another system, or the
nominal values are off by three standard deviations. Errors refer to the parameters that system and model share: the
stiffness at small amplitude, the viscous part of the damping, the first mode. Each entry: the median error in percent.
{EXCESS} The bound is that of the right model with white noise. Bias: the mean of estimate over true value, minus one,
in percent. {COVERAGE} A coverage with all of its interval below 95 % is an error that the method does not announce.
Warned: the share of the fits that failed or came with a warning. Residuals: the share of the successful fits whose
residuals differ significantly from white noise (Ljung-Box test at 5 % of the response to the estimated k/m and c/m; the
panel in which nothing is wrong shows the false alarms). {ORACLE} It has the same wrong model. A dash: the method states
no interval, or its messages are no warnings.""",
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
                "warned %": percent(lines[0]["said"]), "residuals %": percent(lines[0]["coloured"]), **fits(lines),
            },
        ),
    ),
    notes=failures, needs=lambda result: wrong(result) != RIGHT,
)  # fmt: skip


# ---- disturbed data against undisturbed data

PANELS = {"k_over_m_error_pct": "k/m", "c_over_m_error_pct": "c/m", "rmse": "Displacement"}
SMALLEST_CHANGE = 0.01
"""Relative change of the error that gets a star; smaller ones may be rounding (two integrators differ by it)."""


def ratio(disturbed: np.ndarray, undisturbed: np.ndarray) -> tuple[float, float, float]:
    """Return the ratio of two root mean squares of paired errors, with its 95 % bootstrap interval.

    Pairs with a failed fit (an error that is not finite) are left out.

    Args:
        disturbed: Errors on disturbed data, shape (n,).
        undisturbed: Errors on the same data without the disturbance, shape (n,).

    Returns:
        Ratio, lower end and upper end; NaNs if fewer than two pairs are left.
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
    """Return one line per cell and metric, with the statistics of its undisturbed counterpart.

    Both have the same base noise and nominal values in each replicate, so the ratio of their errors is known much more
    accurately than either error.
    """
    known = {result.identity: result for result in frame}
    pairs = [(result, known.get(undisturbed(result).identity)) for result in frame]
    return [
        {**line_of(result, metric), **compared(result, plain, metric)} for result, plain in pairs for metric in PANELS
    ]


def undisturbed(result: Result) -> Cell:
    """Return the cell of the same data without the disturbance."""
    assert result.cell is not None
    return replace(result.cell, scenario=result.scenario.undisturbed)


def compared(result: Result, plain: Result | None, metric: str) -> Line:
    """Return the columns of the undisturbed counterpart, and the ratio of the errors."""
    if plain is None:
        return dict.fromkeys(("ratio_low", "ratio_high"), math.nan)
    counterpart = {f"{name}_undisturbed": VALUES[name](plain, metric) for name in ("excess", "coverage_95", "n_ok")}
    both = result.stored and plain.stored
    ratios = ratio(result.errors(metric), plain.errors(metric)) if both else (math.nan,) * 3
    return {**counterpart, **dict(zip(("ratio", "ratio_low", "ratio_high"), ratios, strict=True))}


def disturbed(line: Line) -> str:
    """Return the column heading of a line: its disturbance."""
    name = "undisturbed" if line["disturbance"] == "none" else line["disturbance"].replace("_", " ")
    return name + (" (initial state known)" if line["initial_state"] == "known" else "")


def robustness_entry(line: Line) -> Texts:
    """Return the excess, a star if it differs from the undisturbed one, and the successful fits if some failed."""
    if not line["n"]:
        return {disturbed(line): "not run"}
    changed = line["ratio_low"] > 1 + SMALLEST_CHANGE or line["ratio_high"] < 1 - SMALLEST_CHANGE
    star = " *" if changed and line["disturbance"] != "none" else ""
    successful = f" ({line['n_ok']}/{line['n']})" if line["n_ok"] < line["n"] else ""
    return {disturbed(line): excess_text(line["excess"]) + star + successful}


ROBUSTNESS = TableForm(
    legend="""Each entry: root mean square error over the replicates, divided by the Cramér-Rao bound of the
*undisturbed* scenario (noise that is not white and normal has another bound, which may be lower); for *irregular*, by
the bound of its own sample times, which are known. The initial state is unknown to the methods unless the column says
otherwise. A star: the error differs from that on undisturbed data with the same initial state by more than 1 %, beyond
a 95 % interval (paired bootstrap: both cells have the same base noise). Failed fits are left out; where there are any,
the successful fits stand in brackets. *oracle*: maximum a posteriori started at the true values, under the same wrong
assumptions; its excess is not due to the search. No method knows of any other disturbance. Ratios with their intervals
are in the CSV.""",
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


# ---- the scenarios of the open split

METRICS = {"k_over_m_error_pct": "k/m", "c_over_m_error_pct": "c/m", "rmse": "displacement"}
PARTS: Mapping[str, Callable[[Result], bool]] = {
    "all": lambda result: True,
    "free": lambda result: not result.forced,
    "free at even times": lambda result: not result.forced and not result.disturbance,
    "forced": lambda result: result.forced,
}


def open_lines(frame: Frame) -> list[Line]:
    """Return one line per part, method and metric."""
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
    """Return the informative bounds of a metric by question, from any method that stored one (a failed fit may not)."""
    bounds = {result.question: result.bound(metric) for result in results if math.isfinite(result.bound(metric))}
    return {
        question: bound
        for question, bound in bounds.items()
        if bound > 0 and (metric == "rmse" or bound < UNINFORMATIVE)
    }


def over_bounds(results: Iterable[Result], metric: str, bounds: Mapping[str, float]) -> Line:
    """Return statistics of the errors of one method over the bounds.

    A reference row without an error, and a method that does not estimate the metric, count as failed.

    Args:
        results: The cells of the method.
        metric: The error.
        bounds: Bounds of the metric by question; scenarios without one are left out.
    """
    informative = [result for result in results if result.stored and result.question in bounds]
    ratios = [np.empty(0), *(result.errors(metric) / bounds[result.question] for result in informative)]
    hits = [np.empty(0), *(result.successful(f"{quantity(metric)}_coverage_95") for result in informative)]
    every, covers = np.concatenate(ratios), np.concatenate(hits)
    finite = every[np.isfinite(every)]
    outliers = dict(zip(("gross", "gross_low", "gross_high"), share(outlier_fits(every, 1.0)), strict=True))
    coverage = dict(zip(("coverage_95", "low_95", "high_95"), share(covers), strict=True))
    return {
        "n": every.size, "n_answered": finite.size, "median_over_bound": lower_median(every),
        "rms_over_bound": root_mean_square(finite), **outliers, "n_coverage": covers.size, **coverage,
    }  # fmt: skip


def typical(line: Line) -> str:
    """Format the median error over the bound, which is infinite if most fits failed."""
    return "failed" if math.isinf(line["median_over_bound"]) else excess_text(line["median_over_bound"])


def open_last(lines: Sequence[Line]) -> Texts:
    """Return the number of successful fits, and the time."""
    results = lines[0]["results"]
    ok = answered(sum(result.n_ok for result in results), sum(result.n for result in results))
    return {"ok": ok, "time (s)": seconds(lines[0]["median_cpu_s"])}


OVER_BOUND: Columns[Line] = {
    "median": typical, "RMS": lambda line: excess_text(line["rms_over_bound"]),
    "outliers %": lambda line: percent_between(line["gross"], line["gross_low"], line["gross_high"]), "95 %": covered,
}  # fmt: skip
OPEN = TableForm(
    legend=f"""One replicate per scenario. The scenarios are drawn at random from the ranges of
`conf/experiment/{{name}}.yaml` (sizes uniformly in the logarithm, the rest uniformly), with the name of the release
({{release}}) as seed. No setting was chosen on them. Each error is divided by the Cramér-Rao bound of its scenario.
**Median**: over the scenarios, a failed or refused fit counting as infinite; about 0.67 for normal errors at the bound.
**RMS**: over the successful fits; 1 is the smallest that an unbiased method can reach, and a few outliers dominate it.
**Outliers**: the share of scenarios with an error beyond five times the bound or a failed or refused fit, with its 95 %
interval (Wilson). {COVERAGE} A quantity is left out of scenarios whose bound exceeds its value: there it is not
identifiable. The bound is that of the sample times of the replicate. It is of first order and ignores aliases; the
errors of *oracle*, which starts at the true values, show how close it is. With fewer than two samples per cycle at
equal time steps, the data alone do not determine the frequency. Time: median processor time of a successful fit; ok:
successful fits, of the scenarios of the panel.""",
    columns=(
        "part", "method", "metric", "n", "n_answered", "median_over_bound", "rms_over_bound", "gross", "gross_low",
        "gross_high", "n_coverage", "coverage_95", "low_95", "high_95", "median_cpu_s",
    ),
    lines=open_lines, section=lambda line: f"{line['part'].capitalize()} scenarios",
    panels=(Panel(each(lambda line: METRICS[line["metric"]], OVER_BOUND), last=open_last),), digits=5,
)  # fmt: skip
