"""The table of experiments over several systems: a panel per system, a row per method, columns per noise level.

Systems differ in their parameters, so a panel compares errors pooled over the identifiable quantities: in each
replicate, the root mean square of error over bound.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from bench.dynamics.modal import modes
from bench.reporting.frame import ERROR, Frame, Line, Result, group
from bench.reporting.labels import place_of, states_terms
from bench.reporting.ranking import FIRST_TIER, first_tier
from bench.reporting.rounding import excess_text, number, percent, with_excess
from bench.reporting.tables.estimates import DASH, EXCESS, ORACLE, bounded, failures, fits, results_of
from bench.reporting.tables.pooling import (
    MODAL,
    lower_median,
    modal_scores,
    pooled_coverage,
    pooled_excess,
    pooled_quantities,
    root_mean_square,
)
from bench.reporting.tables.render import MISSING, Panel, TableForm, Texts, bold, measured
from bench.reporting.tables.tidy import errors_of, line_of
from bench.reporting.terms import terms_found
from bench.scenario.scenario import Scenario

MANY = 8
"""Largest number of parameters with a panel for each parameter."""
SHOWN_AT = 20.0
"""Noise level (dB) of the panels for single parameters; the middle one if an experiment does not have it."""
POOLED, PARAMETERS, NOT_RUN = "told_pooled", "parameters_pooled", "not run"
"""Metrics pooled over the identifiable quantities and over all parameters, and the metric of a missing cell."""
HEADINGS = {NOT_RUN: "error", POOLED: "error", PARAMETERS: "95 %", "rmse": "RMSE (m)"}
MODAL_HEADINGS = dict(zip(MODAL, ("frequencies %", "damping ratios %", "MAC"), strict=True))
COLUMNS = (
    "table", "system", "initial_state", "snr_db", "method", "metric", "mean", "median", "ci_low", "ci_high", "bound",
    "prior_share", "excess", "coverage_95", "n_ok", "n",
)  # fmt: skip


def system_lines(frame: Frame) -> list[Line]:
    """Return one line per cell and metric (scores, pooled errors, modes), and the bounds of each panel."""
    lines: list[Line] = []
    panels = group(frame, lambda result: (panel_name(result), result.initial_state, result.kind))
    for (name, initial_state, _), results in panels.items():
        levels = list(dict.fromkeys(result.snr_db for result in results))
        parameters = {name + ERROR for name in results[0].model.names}
        head = {
            "table": frame.number or frame.experiment, "system": name, "parameters": parameters,
            "section": f"{name}, initial state {initial_state}\n\n{describe(results[0].scenario)}",
            "shown_at": SHOWN_AT if SHOWN_AT in levels else levels[len(levels) // 2],
        }  # fmt: skip
        tied: dict[tuple[str, str], frozenset[Result]] = {}
        stored = [result for result in results if result.stored]
        for question, rivals in group(stored, lambda result: result.question).items():
            metrics = identifiable_metrics(rivals[0])
            parameters |= set(metrics)
            tied |= {(question, POOLED): first_tier(rivals, metrics), (question, "rmse"): first_tier(rivals, ["rmse"])}
            lines += [{**line, **head, "method": "bound"} for line in _bounds(rivals[0], metrics)]
        for result in results:
            for metric in _metrics(result):
                marked = result in tied.get((result.question, metric["metric"]), ())
                lines.append({**line_of(result, metric["metric"]), **metric, **head, "tied": marked})
    return lines


def panel_name(result: Result) -> str:
    """Return the name of the panel of a result: the system and its disturbance."""
    return result.system + (f", {result.disturbance}" if result.disturbance else "")


def identifiable_metrics(result: Result) -> tuple[str, ...]:
    """Return the errors of the identifiable quantities."""
    return tuple(name + ERROR for name in pooled_quantities(result.model, result.identifiable))


def _bounds(result: Result, metrics: Sequence[str]) -> Iterator[Line]:
    yield {**line_of(result, POOLED), "bound": root_mean_square(np.array([result.bound(metric) for metric in metrics]))}
    yield from (line_of(result, metric) for metric in (PARAMETERS, *errors_of(result)))


def _metrics(result: Result) -> Iterator[dict[str, Any]]:
    """Yield the metrics of a result, with the values of pooled metrics and of modes."""
    if result.stored is None:
        yield {"metric": NOT_RUN}
        return
    model = result.model
    groups = tuple(group.name for group in model.groups)
    pools = {POOLED: pooled_quantities(model, result.identifiable), PARAMETERS: model.names, "groups_pooled": groups}
    for metric, names in pools.items():
        pooled = {"excess": pooled_excess(result, names), "coverage_95": pooled_coverage(result, names)}
        yield {"metric": metric, **pooled}
    yield from ({"metric": metric} for metric in errors_of(result))
    yield from ({"metric": metric, "median": lower_median(values)} for metric, values in modal_scores(result).items())


def level(line: Line, heading: str = "") -> str:
    """Return the heading of a column: noise level and statistic."""
    return f"{line['snr_db']:g} dB {heading}".strip()


def is_bound(line: Line) -> bool:
    """Return whether a line belongs to the bound."""
    return line["method"] == "bound"


def pooled(line: Line) -> Texts:
    """Return the pooled excess, the error of the displacement, or the coverage; for the bound, its size."""
    metric, result = line["metric"], line["result"]
    if metric == PARAMETERS:
        text = percent(line["coverage_95"])
    elif is_bound(line):
        text = number(line["bound"]) + (" %" if metric == POOLED else "")
    elif not result.n_ok:
        text = MISSING if metric == "rmse" else result.status.value if result.stored else NOT_RUN
    else:
        excess = f"×{excess_text(line['excess'])}" if math.isfinite(line["excess"]) else MISSING
        text = bold(excess if metric == POOLED else median(line), line["tied"])
    return {level(line, HEADINGS[metric]): text}


def median(line: Line) -> str:
    """Format a median error with its excess."""
    return with_excess(line["median"], line["excess"])


def order(line: Line) -> tuple[bool, float, str]:
    """Return the sort key of a line: the bound first, then methods in the order of their cards."""
    return not is_bound(line), *place_of(line["method"])


def notes(lines: Sequence[Line]) -> Iterator[str]:
    """Yield the terms that sparse regressions select, and the failed fits."""
    good = [result for result in results_of(lines) if result.n_ok and states_terms(result.label)]
    for name, results in group(good, lambda result: result.title).items():
        by_level = [
            f"{result.snr_db:g} dB: {terms_found(result.stored, result.scenario)}"
            for result in results
            if result.stored
        ]
        yield f"{name}, selected terms. {'; '.join(by_level)}."
    yield from failures(lines)


def describe(scenario: Scenario) -> str:
    """Describe the record and the known quantities of a scenario in a sentence."""
    system, sensors = scenario.make_system(), scenario.measured_dofs
    every = " of every mass" if len(sensors) == system.n_dof else f" of mass {', '.join(str(i + 1) for i in sensors)}"
    measured = f"{scenario.samples} samples over {scenario.duration:g} s{every if system.n_dof > 1 else ''}"
    words = [f"{len(system.names)} parameters", measured]
    if system.linear:
        frequencies = modes(system, scenario.parameters).frequencies
        finest = (scenario.samples - 1) / scenario.duration / frequencies[-1]
        cycles = f"{scenario.duration * frequencies[0]:.3g} periods of the slowest mode"
        words.append(f"{cycles}, {finest:.3g} samples per period of the fastest")
    if scenario.force:
        noisy = "" if scenario.force.noise_db is None else f" (measured with noise, {scenario.force.noise_db:g} dB)"
        hold = scenario.force.hold.replace("_", "-")
        words.append(f"known force: {scenario.force.kind}, {hold} between its samples{noisy}")
    if scenario.added_mass:
        words.append(f"a second record with {', '.join(f'{m:g}' for m in scenario.added_mass)} kg added")
    return f"{'; '.join(words)}; {scenario.prior.name if scenario.prior else 'no'} prior."


SYSTEMS = TableForm(
    legend=f"""One panel per system. For each noise level: **error**, the pooled excess of the identifiable quantities
(root mean square, over replicates and quantities, of error over Cramér-Rao bound); **RMSE**, the median displacement
error (m); **95 %**, coverage, the share of the 95 % intervals of all parameters that contain the true value. {EXCESS}
With a known force or a known added mass every parameter is identifiable, and there is no prior. In free vibration the
scale is not identifiable, and the prior (weighed masses) determines it. The row *bound* gives the bound, pooled in
percent, and that of the RMSE. {ORACLE} {FIRST_TIER} {DASH} Time: median processor time of a fit. Fits that failed or
were refused are listed below each panel. All quantities and 95 % intervals are in the CSV.""",
    columns=COLUMNS, lines=system_lines, section=lambda line: line["section"],
    panels=(
        Panel(pooled, of=lambda line: line["metric"] in HEADINGS, last=fits, order=order),
        Panel(
            lambda line: {measured(line): bounded(line) if is_bound(line) else median(line)}, order=order,
            of=lambda line: line["metric"] in line["parameters"] and line["snr_db"] == line["shown_at"]
            and len(line["parameters"]) <= 2 * MANY and line["n_ok"] > 0,
            title="Errors at {shown_at:g} dB, in percent (median ×excess):",
        ),
        Panel(
            lambda line: {level(line): bounded(line)}, row=lambda line: {"": measured(line)},
            of=lambda line: is_bound(line) and line["metric"] in line["parameters"],
            title="The bound, in percent, and the share of its variance that is due to the prior:",
        ),
        Panel(
            lambda line: {level(line, MODAL_HEADINGS[line["metric"]]): number(line["median"])}, order=order,
            of=lambda line: line["metric"] in MODAL and line["n_ok"] > 0,
            title="As modes (median over the replicates of the root mean square error over the modes, and of the "
            "lowest modal assurance criterion):",
        ),
    ),
    notes=notes, in_csv=lambda line: not is_bound(line), latex=True,
)  # fmt: skip
