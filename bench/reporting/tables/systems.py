"""The table of experiments over several systems: a panel a system, methods down, noise levels across.

Systems have parameters of their own, so what a panel compares is pooled over them: of each replicate the root mean
square over the parameters of error over bound, on those quantities that the data tell.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from bench.dynamics.modal import modes
from bench.reporting.frame import ERROR, Frame, Line, Result, group, quantity
from bench.reporting.labels import place_of, states_terms
from bench.reporting.ranking import FIRST_TIER, first_tier
from bench.reporting.rounding import excess_text, number, percent, readable, with_excess
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
from bench.reporting.tables.render import MISSING, Rows, TableForm, Texts, bold, named, panel
from bench.reporting.tables.tidy import errors_of, line
from bench.reporting.terms import terms_found
from bench.scenario.scenario import Scenario

MANY = 8
"""Parameters beyond which a panel of single parameters would not be read."""
SHOWN_AT = 20.0
"""The noise level (dB) at which single parameters are shown; the middle one where an experiment has not this."""
POOLED, PARAMETERS = "told_pooled", "parameters_pooled"
"""Metrics that are pooled over the quantities that the data tell, and over all parameters."""
SHOWN = {POOLED: "error", PARAMETERS: "95 %", "rmse": "RMSE (m)"}
MODAL_NAMES = dict(zip(MODAL, ("frequencies %", "damping ratios %", "MAC"), strict=True))
MODES = """As modes (median over the replicates of the root mean square error over the modes, and of the lowest modal
assurance criterion):"""


def system_lines(frame: Frame) -> list[Line]:
    """One line a cell and metric: every score, the pooled ones, those of the modes; and the bounds of each panel."""
    lines: list[Line] = []
    for (name, start, _), own in group(frame, lambda one: (called(one), one.initial_state, one.kind)).items():
        section = f"{name}, initial state {start}\n\n{describe(own[0].scenario)}"
        head = {"table": frame.number or frame.experiment, "section": section}
        tied: dict[tuple[str, str], frozenset[Result]] = {}
        for question, results in group([one for one in own if one.stored], lambda one: one.question).items():
            metrics = {POOLED: told_metrics(results[0]), "rmse": ("rmse",)}
            tied |= {(question, metric): first_tier(results, pooled) for metric, pooled in metrics.items()}
            lines += [{**head, **one, "method": "bound", "tied": False} for one in _bounds(results[0])]
        for result in own:
            found = [{**line(result, "", COLUMNS), **one, **head, "system": called(result)} for one in _lines(result)]
            lines += [{**one, "tied": result in tied.get((result.question, one["metric"]), ())} for one in found]
    return lines


def called(result: Result) -> str:
    """The system, with what disturbs it."""
    return result.system + (f", {result.disturbance}" if result.disturbance else "")


def told_metrics(result: Result) -> tuple[str, ...]:
    """The errors of the quantities that the data tell."""
    return tuple(name + ERROR for name in pooled_quantities(result.model, result.identifiable))


def _bounds(result: Result) -> Iterator[Line]:
    pooled = [result.bound(metric) for metric in told_metrics(result)]
    yield {**line(result, POOLED), "bound": root_mean_square(np.array(pooled))}
    yield from (line(result, metric) for metric in (PARAMETERS, *errors_of(result)))


def _lines(result: Result) -> Iterator[Line]:
    if result.stored is None:
        yield {"metric": "not run"}
        return
    model = result.scenario.make_system()
    groups = tuple(group.name for group in model.groups)
    pools = {POOLED: pooled_quantities(model, result.identifiable), PARAMETERS: model.names, "groups_pooled": groups}
    for name, names in pools.items():
        excess = pooled_excess(result, tuple(name + ERROR for name in names))
        yield {"metric": name, "excess": excess, "coverage_95": pooled_coverage(result, names)}
    yield from (line(result, metric, COLUMNS) for metric in errors_of(result))
    for metric, values in modal_scores(result).items():
        yield {"metric": metric, "median": lower_median(values)}


# ---- what is shown


def entry(one: Line) -> Texts:
    """The pooled excess, the displacement's error and the coverage of all parameters; of the bound its size."""
    level, metric, result = f"{one['snr_db']:g} dB", one["metric"], one["result"]
    pooled = f"×{excess_text(one['excess'])}" if math.isfinite(one["excess"]) else MISSING
    texts = {POOLED: pooled, "rmse": _median(one)}
    if one["method"] == "bound":
        texts = {POOLED: f"{number(one['bound'])} %", "rmse": number(one["bound"])}
    elif not result.n_ok:
        texts, metric = {POOLED: result.status.value if result.stored else "not run"}, metric.replace("not run", POOLED)
    texts = {name: bold(text, one["tied"]) for name, text in texts.items()} | {PARAMETERS: percent(one["coverage_95"])}
    return {f"{level} {SHOWN[metric]}": texts[metric]} if metric in SHOWN and metric in texts else {}


def _median(one: Line) -> str:
    return with_excess(one["median"], one["excess"])


def beside(lines: Sequence[Line]) -> Iterator[str | Rows]:
    """Single parameters, bounds, modes, terms and failures; what there is of them."""
    result = next((one["result"] for one in lines if one["result"].stored), None)
    if result:
        names, levels = result.model.names, list(group(lines, lambda one: one["snr_db"]))
        level = SHOWN_AT if SHOWN_AT in levels else levels[len(levels) // 2]
        single = {*told_metrics(result), *(name + ERROR for name in names)}
        own = [one for one in lines if one["metric"] in single]
        if len(names) <= MANY:
            yield f"Errors at {level:g} dB, in percent (median ×excess):"
            here = [one for one in own if one["snr_db"] == level and one["method"] != "bound" and one["n_ok"]]
            yield panel(sorted(here, key=order), named, lambda one: {readable(quantity(one["metric"])): _median(one)})
        yield "The bound, in percent, and the share of its variance that is the prior's:"
        bounds = [one for one in own if one["method"] == "bound"]
        yield panel(
            bounds, lambda one: {"": readable(one["quantity"])}, lambda one: {f"{one['snr_db']:g} dB": bounded(one)}
        )
    modal = [one for one in lines if one["metric"] in MODAL and one["n_ok"]]
    if modal:
        yield MODES
        yield panel(
            sorted(modal, key=order),
            named,
            lambda one: {f"{one['snr_db']:g} dB {MODAL_NAMES[one['metric']]}": number(one["median"])},
        )
    yield from terms(results_of(lines))
    yield from failures(lines)


def terms(results: Sequence[Result]) -> Iterator[str]:
    """What sparse models are made of: how often a method found exactly the terms of the equation of motion."""
    good = [result for result in results if result.n_ok and states_terms(result.label)]
    for own in group(good, lambda result: result.title).values():
        found = [f"{one.snr_db:g} dB: {terms_found(one.stored, one.scenario)}" for one in own if one.stored]
        yield f"{own[0].title} by the terms it finds. {'; '.join(found)}."


def order(one: Line) -> tuple[bool, float, str]:
    """The bound first, then methods in the order of their cards."""
    return one["method"] != "bound", *place_of(one["method"])


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


COLUMNS = (
    "table", "system", "initial_state", "snr_db", "method", "metric", "mean", "median", "ci_low", "ci_high", "bound",
    "prior_share", "excess", "coverage_95", "n_ok", "n",
)  # fmt: skip
SYSTEMS = TableForm(
    legend=f"""Each panel is one system. Of each noise level: **error**, the pooled excess of the quantities that the
data tell (root mean square over replicates and quantities of error over Cramér-Rao bound); **RMSE**, the median
displacement error (m); **95 %**, the share of the 95 % intervals of all parameters that held the truth. {EXCESS} With a
known force, or a known added mass, the data tell every parameter, there is no prior, and the errors of m, c and k are
true errors; in free vibration the data tell ratios, and the prior (a weighed mass) tells the scale. The row *bound*
gives the bound: pooled in percent, and of the RMSE. {ORACLE} {FIRST_TIER} {DASH} Time: processor time of the median
fit. What a method cannot take is said below its panel. Every quantity and all 95 % intervals are in the CSV.""",
    columns=COLUMNS, lines=system_lines, section=lambda one: one["section"], entry=entry, last=fits, order=order,
    beside=beside, in_csv=lambda one: one["method"] != "bound", latex=True,
)  # fmt: skip
