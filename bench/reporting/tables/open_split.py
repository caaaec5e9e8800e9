"""All scenarios of the open split together: how far each method is from the bound, how often grossly, at what cost.

It stands for every experiment whose ``table`` has the form ``open``: scenarios drawn from stated ranges, one replicate
each. What is pooled over them is the error over each scenario's own bound.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bench.reporting.frame import ERROR, Frame, Result, group
from bench.reporting.labels import in_order
from bench.reporting.labels import title as title_of
from bench.reporting.rounding import excess_text, number
from bench.reporting.tables.common import Line, csv, failure_notes, markdown_table
from bench.reporting.tables.pooling import lower_median
from bench.scoring.comparison import gross
from bench.scoring.statistics import wilson_interval

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


@dataclass(frozen=True)
class Pooled:
    """One method by one metric: errors over bounds (n,), infinite where it failed, and hits of its 95 % intervals."""

    ratios: np.ndarray
    hits: np.ndarray

    @property
    def answered(self) -> np.ndarray:
        """The finite ones."""
        return np.asarray(self.ratios[np.isfinite(self.ratios)])

    @property
    def median(self) -> float:
        """Over all scenarios, infinite where most failed."""
        return lower_median(self.ratios) if self.ratios.size else math.nan

    @property
    def rms(self) -> float:
        """Over those answered."""
        return float(np.sqrt(np.mean(self.answered**2))) if self.answered.size else math.nan

    @property
    def gross(self) -> tuple[float, float, float]:
        """Share of gross errors (:func:`bench.scoring.comparison.gross`), with Wilson's interval."""
        return _share(int(np.sum(gross(self.ratios, 1.0))), self.ratios.size)

    @property
    def coverage(self) -> tuple[float, float, float]:
        """Share of the 95 % intervals that held the truth, with Wilson's interval."""
        return _share(int(self.hits.sum()), self.hits.size)


def _share(k: int, n: int) -> tuple[float, float, float]:
    return (k / n, *wilson_interval(k, n)) if n else (math.nan,) * 3


def pooled(results: Iterable[Result], metric: str, bounds: Mapping[str, float]) -> Pooled:
    """The replicates of one method over the scenarios that tell a metric; ``bounds`` are by question.

    A reference row that states no error of its own, and a method that does not tell the metric, count as failed.
    """
    ratios, hits = [], []
    for result in results:
        bound = bounds.get(result.question, math.nan)
        told = math.isfinite(bound) and bound > 0 and (metric == "rmse" or bound < UNTOLD)
        if told and result.stored:
            ratios.append(result.errors(metric) / bound)
            hits.append(result.successful(f"{metric.removesuffix(ERROR)}_coverage_95"))
    none = np.empty(0)
    return Pooled(np.concatenate([none, *ratios]), np.concatenate([none, *hits]))


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
    """One line a part, method and metric."""
    bounds = {metric: bounds_of(results, metric) for metric in METRICS}
    return [
        _line(part, method, metric, by_method[method], pooled(by_method[method], metric, bounds[metric]))
        for part, own in parts(results).items()
        for by_method in [group(own, lambda result: result.label)]
        for method in in_order(by_method)
        for metric in METRICS
    ]


def _line(part: str, method: str, metric: str, results: Sequence[Result], found: Pooled) -> Line:
    times = np.concatenate([np.empty(0), *(result.cpu_s[result.ok] for result in results if result.stored)])
    gross, coverage = found.gross, found.coverage
    return {
        "part": part, "method": method, "metric": metric, "n": found.ratios.size, "n_answered": found.answered.size,
        "median_over_bound": found.median, "rms_over_bound": found.rms,
        "gross": gross[0], "gross_low": gross[1], "gross_high": gross[2],
        "n_coverage": found.hits.size, "coverage_95": coverage[0], "low_95": coverage[1], "high_95": coverage[2],
        "median_cpu_s": float(np.median(times)) if times.size else math.nan,
    }  # fmt: skip


def _panel(data: Sequence[Line], results: Sequence[Result]) -> str:
    rows = []
    by_method = group(results, lambda result: result.label)
    for method in dict.fromkeys(line["method"] for line in data):
        own = [line for line in data if line["method"] == method]
        ran = sum(result.n for result in by_method[method])
        answered = sum(result.n_ok for result in by_method[method])
        time = own[0]["median_cpu_s"]
        cells = [cell for line in own for cell in _cells(line)]
        took = "-" if math.isnan(time) else f"{time:.2g}"
        rows.append([title_of(method), f"{answered}/{ran}" if ran else "not run", *cells, took])
    what = ("median", "RMS", "gross %", "95 %")
    shown = [f"{name} {one}" for metric, name in METRICS.items() for one in what if _has(metric, one)]
    return markdown_table(rows, ["method", "answered", *shown, "time (s)"])


def _has(metric: str, column: str) -> bool:
    """Whether a metric has a column: nobody states an interval of the displacement as one number."""
    return metric != "rmse" or column != "95 %"


def _cells(line: Line) -> list[str]:
    if not line["n"]:
        return ["-"] * (4 if _has(line["metric"], "95 %") else 3)
    median = line["median_over_bound"]
    cells = [number(median) if not math.isfinite(median) else excess_text(median), excess_text(line["rms_over_bound"])]
    cells.append(_percent(line["gross"], line["gross_low"], line["gross_high"]))
    covered = _percent(line["coverage_95"], line["low_95"], line["high_95"])
    return [*cells, covered] if _has(line["metric"], "95 %") else cells


def _percent(share: float, low: float, high: float) -> str:
    return "-" if math.isnan(share) else f"{100 * share:.0f} ({100 * low:.0f} to {100 * high:.0f})"


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
    data, name = lines(frame.results), frame.experiment
    said = LEGEND.format(
        n=len(scenarios), release=frame.table.get("release", ""), name=name, sparse=sum(map(sparse, scenarios))
    )  # fmt: skip
    texts = [f"# {frame.title}", said]
    for part, own in parts(frame.results).items():
        n = len({result.question for result in own})
        panel = _panel([line for line in data if line["part"] == part], own)
        texts += [f"## {part.capitalize()}: {n} scenarios", panel]
    notes = failure_notes(frame)
    texts += [f"## What failed\n\n{notes}"] if notes else []
    texts.append(f"Regenerate: `{frame.command}`")
    return {f"{name}.md": "\n\n".join(texts) + "\n", f"{name}.csv": csv(data, 5, COLUMNS)}
