"""Tables of experiments over several systems: one panel a system, methods down, noise levels across.

They stand for every experiment whose ``table`` has the form ``systems`` (Tables 6 to 9). Systems have parameters of
their own, so what a panel compares is pooled over them: of each replicate the root mean square over the parameters of
error over bound, on those quantities that the data tell.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from bench.dynamics.modal import modes
from bench.reporting.frame import ERROR, Frame, Result, group
from bench.reporting.labels import in_order, states_terms, title, told
from bench.reporting.rounding import excess_text, number, readable
from bench.reporting.tables.pooling import (
    MODAL,
    lower_median,
    modal_scores,
    pooled_bound,
    pooled_coverage,
    pooled_errors,
    pooled_excess,
    pooled_quantities,
)
from bench.reporting.tables.render import Rows, bold, csv, failure_notes, latex_tables, markdown_table
from bench.reporting.terms import terms_found
from bench.scenario.scenario import Scenario
from bench.scoring.comparison import ScenarioRanking, standing

COLUMNS = (
    "table", "system", "initial_state", "snr_db", "method", "metric", "mean", "median", "ci_low", "ci_high", "bound",
    "prior_share", "excess", "coverage_95", "n_ok", "n",
)  # fmt: skip
MANY = 8
"""Parameters beyond which a panel of single parameters would not be read."""
UNTOLD = 1.0
"""A relative standard deviation at the bound beyond which a quantity is practically not identifiable."""
LEGEND = """Each panel is one system. Of each noise level: **error**, the pooled excess of the quantities that the
data tell (root mean square over replicates and quantities of error over Cramér-Rao bound: 1 is the best that an
unbiased method can do); **RMSE**, the median displacement error (m) and after × its excess; **95 %**, the share of
the 95 % intervals of all parameters that held the truth. With a known force, or a known added mass, the data tell
every parameter, there is no prior, and the errors of m, c and k are true errors; in free vibration the data tell
ratios, and the prior (a weighed mass) tells the scale. The row *bound* gives the bound: pooled in percent, and of
the RMSE. *oracle* is maximum a posteriori (without a prior: maximum likelihood) started at the truth. Excesses are
over the successful replicates, *ok* of n; a failed one counts as an infinite error in medians and ranks. Bold: the
method of least median error, and all that cannot be told from it on the same data (Wilcoxon's signed-rank test,
Holm's adjustment, 5 %) or are less than 2 % from it, unless gross errors double its excess. A dash for a share:
the method states no interval. ×>1e6: some estimates ran away, and how far says nothing. Time: processor time of the
median fit. A dash for an error: the experiment does not ask for it. What a method cannot take is said below
its panel."""


class SystemPanel:
    """The results of one system with one reading of the start, by noise level and method."""

    def __init__(self, results: Sequence[Result]) -> None:
        self.results, self.scenario = results, results[0].scenario
        self.model, self.heading = self.scenario.make_system(), heading(results[0])
        self.levels = list(dict.fromkeys(result.snr_db for result in results))
        """Noise levels (dB), as the experiment orders them."""
        self.methods = in_order(result.label for result in results)
        self._at = {(result.label, result.snr_db): result for result in reversed(results)}

    def at(self, method: str, level: float) -> Result | None:
        """The result of a method at a noise level."""
        return self._at.get((method, level))

    def succeeded(self, method: str, level: float) -> Result | None:
        """The same, where any replicate succeeded."""
        result = self.at(method, level)
        return result if result and result.n_ok else None

    def any_stored(self, level: float) -> Result | None:
        """Some stored result of a noise level, for what all share: bounds and identifiability."""
        return next((result for result in self.results if result.stored and result.snr_db == level), None)

    def told_quantities(self, result: Result) -> tuple[str, ...]:
        """The quantities that the data tell, by what a result says of them."""
        return pooled_quantities(self.scenario, result.identifiable)

    @cached_property
    def middle(self) -> float:
        """20 dB where the experiment has it, else its middle level."""
        return 20.0 if 20.0 in self.levels else self.levels[len(self.levels) // 2]

    @cached_property
    def excesses(self) -> dict[tuple[str, float], tuple[float, float]]:
        """By method and noise level, the excess of the pooled quantities and that of the displacement."""
        found = {}
        for level, own in group(self.results, lambda result: result.snr_db).items():
            good = [result for result in own if result.n_ok]
            for result in good:
                pooled = pooled_excess(result, self.told_quantities(good[0]))
                found[result.label, level] = pooled, result.summary["rmse"]["excess"]
        return found

    @cached_property
    def standings(self) -> dict[tuple[float, int], ScenarioRanking | None]:
        """By noise level, where methods stand by the pooled errors (0) and the displacement's (1).

        Reference rows, and methods without any successful replicate, are left out.
        """
        found: dict[tuple[float, int], ScenarioRanking | None] = {}
        for level, own in group(self.results, lambda result: result.snr_db).items():
            good = [result for result in own if result.n_ok]
            ranked = [result for result in good if not result.is_reference]
            if not ranked:
                continue
            names = self.told_quantities(good[0])
            errors = {result.label: (pooled_errors(result, names), result.errors("rmse")) for result in ranked}
            for i in (0, 1):
                values = {label: both[i] for label, both in errors.items()}
                bound = ranked[0].bound("rmse") if i else 1.0  # pooled errors are over their bounds
                excess = {label: self.excesses[label, level][i] for label in errors}
                found[level, i] = standing(values, excess, bound)
        return found

    # ---- the main table of a panel

    @cached_property
    def table(self) -> Rows:
        """Rows and headers, which Markdown and LaTeX share."""
        rows = [self._bound_row(), *(self._row(method) for method in self.methods)]
        headers = [f"{level:g} dB {what}" for level in self.levels for what in ("error", "RMSE (m)", "95 %")]
        return rows, ["method", *headers, "time (s)", "uses", "ok"]

    def _bound_row(self) -> list[str]:
        cells = []
        for level in self.levels:
            result = self.any_stored(level)
            if result is None:
                cells += ["-", "-", ""]
                continue
            pooled = pooled_bound(result, self.told_quantities(result))
            cells += [f"{number(pooled)} %", number(result.bound("rmse")), ""]
        return ["bound", *cells, "", "", ""]

    def _row(self, method: str) -> list[str]:
        cells, oks, times, reference, of = [], [], [], False, ""
        for level in self.levels:
            result = self.at(method, level)
            if result is None or result.stored is None or not result.n_ok:
                why = "-" if result is None else result.stored.status.value if result.stored else "not run"
                cells += [why, "", ""]
                oks.append(f"0/{result.n}" if result and result.stored else "-")
                continue
            cells += self._entry(result)
            oks.append(f"{result.n_ok}/{result.n}")
            times.append(lower_median(result.cpu_s[result.ok]))
            reference, of = result.is_reference, result.method
        time = f"{np.median(times):.2g}" if times and not reference else ""
        uses = _uses(told(of), self.scenario) if times else ""
        return [title(method), *cells, time, uses, oks[0] if len(set(oks)) == 1 else ", ".join(oks)]

    def _entry(self, result: Result) -> list[str]:
        pooled, rmse = self.excesses[result.label, result.snr_db]
        covered, _, _ = pooled_coverage(result, self.model.names)
        texts = (
            f"×{excess_text(pooled)}" if math.isfinite(pooled) else "-",
            f"{number(result.summary['rmse']['median'])} ×{excess_text(rmse)}",
        )
        ranked = [self.standings.get((result.snr_db, i)) for i in (0, 1)]
        cells = [
            bold(text, one is not None and result.label in one.level) for text, one in zip(texts, ranked, strict=True)
        ]  # fmt: skip
        return [*cells, "-" if math.isnan(covered) else f"{100 * covered:.0f}"]

    # ---- what stands below it

    def notes(self) -> list[str]:
        """Single parameters, modes, terms, what cannot be told, and failures; what there is of them."""
        parts = (self._parameters(), self._modes(), self._terms(), self._untold(), failure_notes(self.results))
        return [part for part in parts if part]

    def _parameters(self) -> str:
        """The single parameters and groups at one noise level: median error in percent and excess."""
        stored = self.any_stored(self.middle)
        if stored is None or len(self.model.names) > MANY:
            return ""
        names = list(dict.fromkeys([*self.model.names, *self.told_quantities(stored)]))
        rows = [["bound", *(number(stored.bound(name + ERROR)) for name in names)]]
        for method in self.methods:
            result = self.succeeded(method, self.middle)
            if result is not None:
                rows.append([title(method), *(_median_and_excess(result, name + ERROR) for name in names)])
        table = markdown_table(rows, ["method", *map(readable, names)])
        return f"Errors at {self.middle:g} dB, in percent (median ×excess):\n\n{table}"

    def _modes(self) -> str:
        """Natural frequencies, damping ratios and mode shapes: medians over the replicates, at every noise level."""
        rows = []
        for method in self.methods:
            cells = []
            for level in self.levels:
                result = self.succeeded(method, level)
                scores = modal_scores(result) if result else {}
                cells += [number(lower_median(scores[metric])) if scores else "-" for metric in MODAL]
            if any(cell != "-" for cell in cells):
                rows.append([title(method), *cells])
        if not rows:
            return ""
        headers = [
            f"{level:g} dB {what}" for level in self.levels for what in ("frequencies %", "damping ratios %", "MAC")
        ]
        what = (
            "As modes (median over the replicates of the root mean square error over the modes, and of the lowest "
            "modal assurance criterion):"
        )
        return f"{what}\n\n{markdown_table(rows, ['method', *headers])}"

    def _terms(self) -> str:
        """What sparse models are made of: how often a method found exactly the terms of the equation of motion."""
        parts = []
        for method in self.methods:
            found = [self.succeeded(method, level) for level in self.levels] if states_terms(method) else []
            sentences = [
                f"{one.snr_db:g} dB: {terms_found(one.stored, self.scenario)}" for one in found if one and one.stored
            ]
            if sentences:
                parts.append(f"{title(method)} by the terms it finds. " + "; ".join(sentences) + ".")
        return "\n\n".join(parts)

    def _untold(self) -> str:
        """What cannot be identified, at each noise level where it is so."""
        sentences = []
        for level in self.levels:
            result = self.any_stored(level)
            if result is None:
                continue
            own = [quantity.name for quantity in self.model.quantities]
            never = [name for name in own if not result.identifiable.get(name, True)]
            bounds = {name: result.summary.get(name + ERROR, {}).get("bound", 0.0) for name in own if name not in never}
            weak = [f"{n} (bound {number(b)} %)" for n, b in bounds.items() if 100 * UNTOLD < b < math.inf]
            if level == self.levels[0] and never:
                what = "decided by the prior" if self.scenario.prior else "not identifiable"
                sentences.append(f"Not told by the data at any noise, {what}: {', '.join(map(readable, never))}.")
            if weak:
                sentences.append(f"At {level:g} dB practically not identifiable: {', '.join(map(readable, weak))}.")
        return " ".join(sentences)


def heading(result: Result) -> str:
    """The scenario's name, with what disturbs it."""
    return result.system + (f", {result.disturbance}" if result.disturbance else "")


def panels(results: Iterable[Result]) -> list[SystemPanel]:
    """One a system, disturbance and reading of the start, in order."""
    places = group(results, lambda result: (heading(result), result.initial_state, result.kind))
    return [SystemPanel(own) for own in places.values()]


def _uses(classes: str, scenario: Scenario) -> str:
    """What a method was told beyond the data, of what there was to tell here."""
    there = {"start": scenario.initial_state == "known", "prior": scenario.prior is not None}
    return ", ".join(word for word in classes.split(", ") if there.get(word.split()[0] if word else "", True))


def _median_and_excess(result: Result, metric: str) -> str:
    if metric not in result.summary:
        return "-"
    excess = result.excess(metric)
    return number(result.statistic(metric, "median")) + (f" ×{excess_text(excess)}" if math.isfinite(excess) else "")


# ------------------------------------------------------------------------------------------------ the tidy table


def tidy(table: str, shown: Sequence[SystemPanel]) -> list[dict[str, Any]]:
    """One line a cell and metric: every score, the pooled ones, those of the modes, and the bound."""
    return [line for panel in shown for result in panel.results for line in _lines(table, panel, result)]


def _lines(table: str, panel: SystemPanel, result: Result) -> Iterable[dict[str, Any]]:
    head = {
        "table": table, "system": panel.heading, "initial_state": result.initial_state, "snr_db": result.snr_db,
        "method": result.label,
    }  # fmt: skip
    if result.stored is None:
        yield {**head, "metric": "not run", "n_ok": 0, "n": 0}
        return
    count = {"n_ok": result.n_ok, "n": result.n}
    for name, quantities in _pools(panel, result).items():
        covered = pooled_coverage(result, quantities)[0]
        yield {**head, "metric": name, "excess": pooled_excess(result, quantities), "coverage_95": covered, **count}
    for metric, summary in result.summary.items():
        if not metric.endswith(ERROR) and not metric.startswith("rmse"):
            continue
        name = metric.removesuffix(ERROR)
        statistics = ("mean", "median", "ci_low", "ci_high", "bound", "excess")
        yield {
            **head, "metric": metric, **{key: summary[key] for key in statistics},
            "prior_share": result.prior_share.get(name, math.nan), "coverage_95": result.covered(name), **count,
        }  # fmt: skip
    for metric, values in modal_scores(result).items():
        yield {**head, "metric": metric, "median": lower_median(values), **count}


def _pools(panel: SystemPanel, result: Result) -> Mapping[str, tuple[str, ...]]:
    return {
        "told_pooled": panel.told_quantities(result),
        "parameters_pooled": panel.model.names,
        "groups_pooled": tuple(group.name for group in panel.model.groups),
    }


# ------------------------------------------------------------------------------------------------ for reading


def markdown(heading_: str, shown: Sequence[SystemPanel], command: str) -> str:
    """The table for reading."""
    parts = [f"# {heading_}", LEGEND]
    for panel in shown:
        parts += [f"## {panel.heading}", describe(panel.scenario), markdown_table(*panel.table), *panel.notes()]
    parts.append(f"Every single quantity and all 95 % intervals of medians are in the CSV. Regenerate: `{command}`")
    return "\n\n".join(parts) + "\n"


def describe(scenario: Scenario) -> str:
    """What is measured, for how long and how finely, and what is told, in a sentence."""
    system = scenario.make_system()
    n, sensors = system.n_dof, scenario.measured_dofs
    places = (
        ""
        if n == 1
        else " of every mass"
        if len(sensors) == n
        else f" of mass {', '.join(str(i + 1) for i in sensors)}"
    )
    words = [f"{len(system.names)} parameters", f"{scenario.samples} samples over {scenario.duration:g} s{places}"]
    if system.linear:
        frequencies = modes(system, scenario.parameters).frequencies
        step = scenario.duration / (scenario.samples - 1)
        cycles, finest = scenario.duration * frequencies[0], 1.0 / (frequencies[-1] * step)
        words.append(f"{cycles:.3g} periods of the slowest mode, {finest:.3g} samples in one of the fastest")
    if scenario.force:
        noisy = "" if scenario.force.noise_db is None else f" (measured with noise, {scenario.force.noise_db:g} dB)"
        words.append(
            f"known force: {scenario.force.kind}, {scenario.force.hold.replace('_', '-')} between its samples{noisy}"
        )
    if scenario.added_mass:
        words.append(f"a second record with {', '.join(f'{m:g}' for m in scenario.added_mass)} kg added")
    prior = "no prior" if scenario.prior is None else f"{scenario.prior.name} prior"
    return f"{'; '.join(words)}. Initial state {scenario.initial_state}, {prior}."


def system_table(frame: Frame) -> Mapping[str, str]:
    """The files of the table by name; none where the store holds no cell of it."""
    if not frame.any_stored:
        return {}
    name = f"table{frame.number}" if frame.number else frame.experiment
    title_ = f"Table {frame.number}. {frame.title}" if frame.number else frame.title
    shown = panels(frame)
    captions = [f"{frame.title}: {panel.heading}. {describe(panel.scenario)}" for panel in shown]
    return {
        f"{name}.md": markdown(title_, shown, frame.command),
        f"{name}.csv": csv(tidy(str(frame.number or frame.experiment), shown), columns=COLUMNS),
        f"{name}.tex": latex_tables(zip(captions, (panel.table for panel in shown), strict=True)),
    }
