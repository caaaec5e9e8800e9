"""The table of experiments over several systems: a panel a system, methods down, noise levels across.

Systems have parameters of their own, so what a panel compares is pooled over them: of each replicate the root mean
square over the parameters of error over bound, on those quantities that the data tell.
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
"""Parameters beyond which a panel of single parameters would not be read."""
SHOWN_AT = 20.0
"""The noise level (dB) at which single parameters are shown; the middle one where an experiment has not this."""
POOLED, PARAMETERS, NOT_RUN = "told_pooled", "parameters_pooled", "not run"
"""Metrics that are pooled over the quantities that the data tell, and over all parameters; and of a missing cell."""
HEADINGS = {NOT_RUN: "error", POOLED: "error", PARAMETERS: "95 %", "rmse": "RMSE (m)"}
MODAL_HEADINGS = dict(zip(MODAL, ("frequencies %", "damping ratios %", "MAC"), strict=True))
COLUMNS = (
    "table", "system", "initial_state", "snr_db", "method", "metric", "mean", "median", "ci_low", "ci_high", "bound",
    "prior_share", "excess", "coverage_95", "n_ok", "n",
)  # fmt: skip


def system_lines(frame: Frame) -> list[Line]:
    """One line a cell and metric: every score, the pooled ones, those of the modes; and the bounds of each panel."""
    lines: list[Line] = []
    panels = group(frame, lambda result: (called(result), result.initial_state, result.kind))
    for (name, start, _), results in panels.items():
        levels = list(dict.fromkeys(result.snr_db for result in results))
        parameters = {name + ERROR for name in results[0].model.names}
        head = {
            "table": frame.number or frame.experiment, "system": name, "parameters": parameters,
            "section": f"{name}, initial state {start}\n\n{describe(results[0].scenario)}",
            "shown_at": SHOWN_AT if SHOWN_AT in levels else levels[len(levels) // 2],
        }  # fmt: skip
        tied: dict[tuple[str, str], frozenset[Result]] = {}
        stored = [result for result in results if result.stored]
        for question, rivals in group(stored, lambda result: result.question).items():
            told = told_metrics(rivals[0])
            parameters |= set(told)
            tied |= {(question, POOLED): first_tier(rivals, told), (question, "rmse"): first_tier(rivals, ["rmse"])}
            lines += [{**line, **head, "method": "bound"} for line in _bounds(rivals[0], told)]
        for result in results:
            for metric in _metrics(result):
                marked = result in tied.get((result.question, metric["metric"]), ())
                lines.append({**line_of(result, metric["metric"]), **metric, **head, "tied": marked})
    return lines


def called(result: Result) -> str:
    """The system, with what disturbs it."""
    return result.system + (f", {result.disturbance}" if result.disturbance else "")


def told_metrics(result: Result) -> tuple[str, ...]:
    """The errors of the quantities that the data tell."""
    return tuple(name + ERROR for name in pooled_quantities(result.model, result.identifiable))


def _bounds(result: Result, told: Sequence[str]) -> Iterator[Line]:
    yield {**line_of(result, POOLED), "bound": root_mean_square(np.array([result.bound(metric) for metric in told]))}
    yield from (line_of(result, metric) for metric in (PARAMETERS, *errors_of(result)))


def _metrics(result: Result) -> Iterator[dict[str, Any]]:
    """The metrics of a result, with the numbers of those that are pooled or of the modes."""
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
    """The noise level, and what is shown of it."""
    return f"{line['snr_db']:g} dB {heading}".strip()


def is_bound(line: Line) -> bool:
    """Whether a line is of the bound."""
    return line["method"] == "bound"


def pooled(line: Line) -> Texts:
    """The pooled excess, the displacement's error and the coverage of all parameters; of the bound its size."""
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
    """A median error with its excess."""
    return with_excess(line["median"], line["excess"])


def order(line: Line) -> tuple[bool, float, str]:
    """The bound first, then methods in the order of their cards."""
    return not is_bound(line), *place_of(line["method"])


def notes(lines: Sequence[Line]) -> Iterator[str]:
    """What sparse models are made of, and what failed."""
    good = [result for result in results_of(lines) if result.n_ok and states_terms(result.label)]
    for name, results in group(good, lambda result: result.title).items():
        found = [
            f"{result.snr_db:g} dB: {terms_found(result.stored, result.scenario)}"
            for result in results
            if result.stored
        ]
        yield f"{name} by the terms it finds. {'; '.join(found)}."
    yield from failures(lines)


def describe(scenario: Scenario) -> str:
    """What is measured, for how long and how finely, and what is told, in a sentence."""
    system, sensors = scenario.make_system(), scenario.measured_dofs
    every = " of every mass" if len(sensors) == system.n_dof else f" of mass {', '.join(str(i + 1) for i in sensors)}"
    measured = f"{scenario.samples} samples over {scenario.duration:g} s{every if system.n_dof > 1 else ''}"
    words = [f"{len(system.names)} parameters", measured]
    if system.linear:
        frequencies = modes(system, scenario.parameters).frequencies
        finest = (scenario.samples - 1) / scenario.duration / frequencies[-1]
        cycles = f"{scenario.duration * frequencies[0]:.3g} periods of the slowest mode"
        words.append(f"{cycles}, {finest:.3g} samples in one of the fastest")
    if scenario.force:
        noisy = "" if scenario.force.noise_db is None else f" (measured with noise, {scenario.force.noise_db:g} dB)"
        held = scenario.force.hold.replace("_", "-")
        words.append(f"known force: {scenario.force.kind}, {held} between its samples{noisy}")
    if scenario.added_mass:
        words.append(f"a second record with {', '.join(f'{m:g}' for m in scenario.added_mass)} kg added")
    return f"{'; '.join(words)}; {scenario.prior.name if scenario.prior else 'no'} prior."


SYSTEMS = TableForm(
    legend=f"""Each panel is one system. Of each noise level: **error**, the pooled excess of the quantities that the
data tell (root mean square over replicates and quantities of error over Cramér-Rao bound); **RMSE**, the median
displacement error (m); **95 %**, the share of the 95 % intervals of all parameters that held the truth. {EXCESS} With a
known force, or a known added mass, the data tell every parameter, there is no prior, and the errors of m, c and k are
true errors; in free vibration the data tell ratios, and the prior (a weighed mass) tells the scale. The row *bound*
gives the bound: pooled in percent, and of the RMSE. {ORACLE} {FIRST_TIER} {DASH} Time: processor time of the median
fit. What a method cannot take is said below its panel. Every quantity and all 95 % intervals are in the CSV.""",
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
            title="The bound, in percent, and the share of its variance that is the prior's:",
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
