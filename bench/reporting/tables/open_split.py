"""All scenarios of the open split together: how far each method is from the bound, how often grossly, at what cost.

It stands for every experiment whose ``table`` has the form ``open``: scenarios drawn from stated ranges, one replicate
each. What is pooled over them is the error over each scenario's own bound.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from bench.reporting.frame import ERROR, Frame, Line, Result, group, share
from bench.reporting.labels import in_order
from bench.reporting.rounding import answered, excess_text, number, percent_between
from bench.reporting.tables.pooling import lower_median, root_mean_square
from bench.reporting.tables.render import MISSING, NAMED, Columns, Rows, ending, files, panel
from bench.scoring.comparison import gross

COLUMNS = (
    "part", "method", "metric", "n", "n_answered", "median_over_bound", "rms_over_bound", "gross", "gross_low",
    "gross_high", "n_coverage", "coverage_95", "low_95", "high_95", "median_cpu_s",
)  # fmt: skip
METRICS = {"k_over_m_error_pct": "k/m", "c_over_m_error_pct": "c/m", "rmse": "displacement"}
UNTOLD = 100.0
"""A bound (%) beyond which data and prior do not tell a quantity: an error over it says nothing."""
EVEN = "free at even times"
PARTS = ("all", "free", EVEN, "forced")
LEGEND = """One replicate of each of {n} scenarios, drawn at random by the name of the release ({release}) from the
ranges of `conf/experiment/{name}.yaml`, uniformly or, of what is a size, uniformly in the logarithm. No setting was
chosen on them. Each error is divided by its scenario's own Cramér-Rao bound. **Median** is over the scenarios, a fit
that failed or gave no answer counting as infinite; at the bound it is about 0.67 of it for a normal error. **RMS** is
over those that were answered: 1 is the best that an unbiased method can do, and a few gross errors decide it.
**Gross**: the share of scenarios with an error beyond five times the bound, failures included, with its 95 % interval
(Wilson's). **95 %**: the share of the stated 95 % intervals that held the truth, likewise. Left out of a quantity are
scenarios whose bound for it is as large as its value: they do not tell it. The bound is that of the sample times of the
replicate. It is of first order, and knows nothing of aliases: *oracle*, which starts at the truth, shows how near it
is. With fewer than two samples a cycle at even times, {sparse} of the scenarios, the data alone
leave the frequency open to everyone. Time: processor time of the median fit that gave an answer. answered: of the
scenarios of the panel."""


def over_bounds(results: Iterable[Result], metric: str, bounds: Mapping[str, float]) -> Line:
    """The errors of one method over the bounds, of the scenarios that tell a metric; ``bounds`` are by question.

    A reference row that states no error of its own, and a method that does not tell the metric, count as failed.
    """
    ratios, hits = [np.empty(0)], [np.empty(0)]
    for result in results:
        bound = bounds.get(result.question, math.nan)
        told = math.isfinite(bound) and bound > 0 and (metric == "rmse" or bound < UNTOLD)
        if told and result.stored:
            ratios.append(result.errors(metric) / bound)
            hits.append(result.successful(f"{metric.removesuffix(ERROR)}_coverage_95"))
    every, held = np.concatenate(ratios), np.concatenate(hits)
    known = every[np.isfinite(every)]
    shares = dict(zip(("gross", "gross_low", "gross_high"), share(gross(every, 1.0)), strict=True))
    held_shares = dict(zip(("coverage_95", "low_95", "high_95"), share(held), strict=True))
    return {
        "n": every.size, "n_answered": known.size, "median_over_bound": lower_median(every),
        "rms_over_bound": root_mean_square(known), **shares, "n_coverage": held.size, **held_shares,
    }  # fmt: skip


def bounds_of(results: Iterable[Result], metric: str) -> dict[str, float]:
    """The bound of each scenario by its question, from any method that stored it: one that failed may have none."""
    found: dict[str, float] = {}
    for result in results:
        bound = result.bound(metric)
        if math.isfinite(bound):
            found.setdefault(result.question, bound)
    return found


def parts(results: Sequence[Result]) -> dict[str, list[Result]]:
    """All scenarios, those in free vibration, of these those at even times, and those under a force."""
    free = [result for result in results if not result.forced]
    even = [result for result in free if not result.disturbance]
    forced = [result for result in results if result.forced]
    return dict(zip(PARTS, (list(results), free, even, forced), strict=True))


def lines(results: Sequence[Result]) -> list[Line]:
    """One line a part, method and metric; ``results``: those of the method in that part."""
    bounds = {metric: bounds_of(results, metric) for metric in METRICS}
    return [
        {
            "part": part, "method": method, "metric": metric, "results": by_method[method],
            "median_cpu_s": median_time(by_method[method]), **over_bounds(by_method[method], metric, bounds[metric]),
        }
        for part, own in parts(results).items()
        for by_method in [group(own, lambda result: result.label)]
        for method in in_order(by_method)
        for metric in METRICS
    ]  # fmt: skip


def median_time(results: Iterable[Result]) -> float:
    """The median processor time (s) of the fits that gave an answer; NaN without any."""
    times = np.concatenate([np.empty(0), *(result.cpu_s[result.ok] for result in results if result.stored)])
    return float(np.median(times)) if times.size else math.nan


def _panel(data: Sequence[Line]) -> Rows:
    return panel(
        data,
        lambda one: one["method"],
        {**NAMED, "answered": _answered},
        lambda one: one["metric"],
        _metric,
        {"time (s)": lambda own: MISSING if math.isnan(own[0]["median_cpu_s"]) else f"{own[0]['median_cpu_s']:.2g}"},
    )


def _answered(own: Sequence[Line]) -> str:
    return answered(sum(one.n_ok for one in own[0]["results"]), sum(one.n for one in own[0]["results"]))


def _metric(any_line: Line) -> Columns[Line]:
    """What is shown of a metric; nobody states an interval of the displacement as one number."""
    name = METRICS[any_line["metric"]]
    columns: Columns[Line] = {
        f"{name} median": lambda one: _median(one["median_over_bound"]),
        f"{name} RMS": lambda one: excess_text(one["rms_over_bound"]),
        f"{name} gross %": lambda one: percent_between(one["gross"], one["gross_low"], one["gross_high"]),
    }
    covered = {f"{name} 95 %": lambda one: percent_between(one["coverage_95"], one["low_95"], one["high_95"])}
    return {**columns, **(covered if any_line["metric"] != "rmse" else {})}


def _median(value: float) -> str:
    return excess_text(value) if math.isfinite(value) else number(value)


def sparse(result: Result) -> bool:
    """Whether there are fewer than two samples in a natural period, at even times."""
    p = result.parameters
    periods = result.duration * math.sqrt(p["k"] / p["m"]) / (2 * math.pi)
    return not result.disturbance and result.samples - 1 < 2 * periods


def open_table(frame: Frame) -> Mapping[str, str]:
    """The files of the table by name; none where the store holds no cell of it."""
    if not frame.any_stored:
        return {}
    scenarios = {result.question: result for result in frame}.values()
    data = lines(frame.results)
    said = LEGEND.format(
        n=len(scenarios), release=frame.table.get("release", ""), name=frame.name, sparse=sum(map(sparse, scenarios))
    )  # fmt: skip
    shown: list[str | Rows] = [f"# {frame.title}", said]
    for part, own in parts(frame.results).items():
        n = len({result.question for result in own})
        shown += [f"## {part.capitalize()}: {n} scenarios", _panel([one for one in data if one["part"] == part])]
    return files(frame.name, [*shown, *ending(frame)], data, COLUMNS, 5)
