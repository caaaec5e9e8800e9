"""Tables of experiments over several systems: one panel a system, methods down, noise levels across.

They stand for every experiment whose ``table`` has the form ``systems`` (Tables 6 to 9). Systems have parameters of
their own, so what a panel compares is pooled over them: of each replicate the root mean square over the parameters of
error over bound, on those quantities that the data tell.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from tabulate import tabulate

from bench.contract.estimate import Status
from bench.dynamics.modal import agreement, modes
from bench.entrants.reference import REFERENCES
from bench.reporting.rounding import excess_text, number, readable
from bench.reporting.tables.tables import (
    TITLES,
    Entry,
    described_cells,
    errors_of,
    failure_notes,
    latex_table,
    leads,
    told_classes,
)
from bench.reporting.terms import terms_found
from bench.scenario.scenario import Scenario
from bench.scoring.comparison import Comparison, against_best
from bench.scoring.row import Row
from bench.scoring.summary import wilson_interval
from bench.store.cell import Cell
from bench.store.store import Store, StoredCell

COLUMNS = (
    "table", "system", "initial_state", "snr_db", "method", "metric", "mean", "median", "ci_low", "ci_high", "bound",
    "prior_share", "excess", "coverage_95", "n_ok", "n",
)  # fmt: skip
MODAL = {"frequencies_error_pct": "frequency_pct", "damping_ratios_error_pct": "damping_pct", "least_mac": "least_mac"}
"""Metrics that are computed here from the identified parameters, and where they stand in an Agreement."""
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


@dataclass(frozen=True)
class Panel:
    """The cells of one system with one reading of the start, by noise level and method."""

    scenario: Scenario
    entries: tuple[Entry, ...]

    @property
    def levels(self) -> list[float]:
        """Noise levels (dB), as the experiment orders them."""
        return list(dict.fromkeys(e.cell.scenario.snr_db for e in self.entries))

    @property
    def methods(self) -> list[str]:
        """Labels, in the order of :data:`bench.reporting.tables.tables.TITLES`, others last."""
        order = {label: i for i, label in enumerate(TITLES)}
        labels = dict.fromkeys(e.cell.label for e in self.entries)
        return sorted(labels, key=lambda label: order.get(label, len(order)))

    def at(self, method: str, level: float) -> Entry | None:
        """The entry of a method at a noise level."""
        own = (e for e in self.entries if e.cell.label == method and e.cell.scenario.snr_db == level)
        return next(own, None)

    def any_stored(self, level: float | None = None) -> StoredCell | None:
        """Some stored cell, for what all share: bounds and identifiability."""
        own = (e.stored for e in self.entries if e.stored and level in (None, e.cell.scenario.snr_db))
        return next(own, None)


def panels(found: Sequence[Entry]) -> list[Panel]:
    """One a system, disturbance and reading of the start, in order."""
    places = list(dict.fromkeys(_place(e.cell) for e in found))
    own = {place: tuple(e for e in found if _place(e.cell) == place) for place in places}
    return [Panel(entries[0].cell.scenario, entries) for entries in own.values()]


def _place(cell: Cell) -> tuple[str, str, str]:
    return heading(cell.scenario), cell.scenario.told, cell.scenario.system


def heading(scenario: Scenario) -> str:
    """The scenario's name, with what disturbs it."""
    return scenario.label + (f", {scenario.disturbance.kind}" if scenario.disturbance else "")


# ------------------------------------------------------------------------------------------------ what is pooled


def pooled_quantities(scenario: Scenario, identifiable: Mapping[str, bool]) -> list[str]:
    """The quantities that the data tell: all parameters, else the groups; where neither is told, all parameters."""
    system = scenario.make_system()
    groups = [group.name for group in system.groups]
    for names in (list(system.names), groups):
        if all(identifiable.get(name, False) for name in names):
            return names
    return [name for name in groups if identifiable.get(name)] or list(system.names)


def pooled_errors(stored: StoredCell, names: Sequence[str]) -> np.ndarray:
    """By replicate, the root mean square over the quantities of error over bound; infinite where it failed."""
    bounds = np.array([stored.summary.get(f"{name}_error_pct", {}).get("bound", math.nan) for name in names])
    errors = np.stack([errors_of(stored, f"{name}_error_pct") for name in names], axis=1)
    usable = np.isfinite(bounds) & (bounds > 0)
    if not usable.any():
        return np.full(len(stored.rows), np.inf)
    with np.errstate(over="ignore"):
        ratios = errors[:, usable] / bounds[usable]
        return np.asarray(np.sqrt(np.mean(ratios**2, axis=1)))


def pooled_excess(stored: StoredCell, names: Sequence[str]) -> float:
    """Root mean square of the pooled errors over the successful replicates; NaN without any."""
    errors = pooled_errors(stored, names)
    good = errors[np.isfinite(errors) & np.array([row.status is Status.OK for row in stored.rows])]
    return float(np.sqrt(np.mean(good**2))) if good.size else math.nan


def pooled_coverage(stored: StoredCell, names: Sequence[str], level: int = 95) -> tuple[float, float, float]:
    """Share of the intervals of these quantities that held the truth, with Wilson's interval over the replicates.

    Intervals of one replicate are not independent of each other: the interval counts replicates, not intervals.
    """
    hits = [
        [row.scores[f"{name}_coverage_{level}"] for name in names if f"{name}_coverage_{level}" in row.scores]
        for row in stored.rows
        if row.status is Status.OK
    ]
    shares = [float(np.mean(own)) for own in hits if own]
    if not shares:
        return math.nan, math.nan, math.nan
    low, high = wilson_interval(round(sum(shares)), len(shares))
    return float(np.mean(shares)), low, high


def identified(row: Row, scenario: Scenario) -> dict[str, float] | None:
    """The parameters of a replicate; over the gauge mass where its method gives groups only. None where it failed."""
    system = scenario.make_system()
    if row.status is not Status.OK:
        return None
    ratios = {name: row.scores.get(f"{name}_ratio", math.nan) for name in system.names}
    if all(map(math.isfinite, ratios.values())):
        return {name: scenario.parameters[name] * ratio for name, ratio in ratios.items()}
    found = {system.gauge: 1.0}
    for group in system.groups:
        name = next(n for n, power in group.exponents.items() if power > 0)
        found[name] = row.scores.get(f"{group.name}_ratio", math.nan) * float(group.value(scenario.parameters))
    return found if all(name in found for name in system.names) else None


def modal_scores(stored: StoredCell, scenario: Scenario) -> dict[str, np.ndarray]:
    """By metric and replicate, how the identified modes agree with the true ones; nothing for other systems."""
    system = scenario.make_system()
    if not system.linear or system.n_dof < 2:
        return {}
    true = modes(system, scenario.parameters)
    failed = {"frequency_pct": math.inf, "damping_pct": math.inf, "least_mac": 0.0}
    found = []
    for row in stored.rows:
        p = identified(row, scenario)
        found.append(failed if p is None else vars(agreement(modes(system, p), true)))
    return {metric: np.array([one[key] for one in found]) for metric, key in MODAL.items()}


# ------------------------------------------------------------------------------------------------ the tidy table


def tidy(table: str, found: Sequence[Entry]) -> pd.DataFrame:
    """One line a cell and metric: every score, the pooled ones, those of the modes, and the bound."""
    lines: list[dict[str, Any]] = []
    for panel in panels(found):
        for entry in panel.entries:
            lines += _lines(table, entry)
    return pd.DataFrame(lines, columns=list(COLUMNS))


def _lines(table: str, entry: Entry) -> Iterable[dict[str, Any]]:
    scenario, stored = entry.cell.scenario, entry.stored
    head = {
        "table": table, "system": heading(scenario), "initial_state": scenario.told, "snr_db": scenario.snr_db,
        "method": entry.cell.label,
    }  # fmt: skip
    if stored is None:
        yield {**head, "metric": "not run", "n_ok": 0, "n": 0}
        return
    count = {"n_ok": stored.n_ok, "n": len(stored.rows)}
    for name, quantities in _pools(scenario, stored).items():
        covered = pooled_coverage(stored, quantities)[0]
        yield {**head, "metric": name, "excess": pooled_excess(stored, quantities), "coverage_95": covered, **count}
    for metric, summary in stored.summary.items():
        if not metric.endswith("_error_pct") and not metric.startswith("rmse"):
            continue
        name = metric.removesuffix("_error_pct")
        yield {
            **head, "metric": metric, **{k: summary[k] for k in ("mean", "median", "ci_low", "ci_high", "bound")},
            "excess": summary["excess"], "prior_share": stored.prior_share.get(name, math.nan),
            "coverage_95": stored.summary.get(f"{name}_coverage_95", {}).get("mean", math.nan), **count,
        }  # fmt: skip
    for metric, values in modal_scores(stored, scenario).items():
        yield {**head, "metric": metric, "median": _median(values), **count}


def _pools(scenario: Scenario, stored: StoredCell) -> dict[str, list[str]]:
    system = scenario.make_system()
    return {
        "told_pooled": pooled_quantities(scenario, stored.identifiable),
        "parameters_pooled": list(system.names),
        "groups_pooled": [group.name for group in system.groups],
    }


def _median(values: np.ndarray) -> float:
    """The median where values may be infinite: the lower of the middle two."""
    return float(np.sort(values)[(values.size - 1) // 2])


# ------------------------------------------------------------------------------------------------ for reading


Table = tuple[list[list[str]], list[str]]
"""Rows and headers."""


def tables_of(found: Sequence[Entry]) -> list[tuple[Panel, Table]]:
    """Every panel with its table, which Markdown and LaTeX share."""
    classes = told_classes(found)
    return [(panel, _panel(panel, classes)) for panel in panels(found)]


def markdown(title: str, shown: Sequence[tuple[Panel, Table]], command: str) -> str:
    """The table for reading."""
    parts = [f"# {title}", LEGEND]
    for panel, table in shown:
        parts += [f"## {heading(panel.scenario)}", describe(panel.scenario)]
        parts.append(tabulate(*table, tablefmt="github", disable_numparse=True))
        parts += [part for part in (_parameters(panel), _modes(panel), _terms(panel), _untold(panel)) if part]
        notes = failure_notes(panel.entries)
        parts += [notes] if notes else []
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
    return f"{'; '.join(words)}. Initial state {scenario.told}, {prior}."


@dataclass(frozen=True)
class Contest:
    """One column at one noise level: excesses by label, and the best of the methods compared with the others."""

    excess: Mapping[str, float]
    ranking: tuple[str, list[Comparison]] | None


def _contests(panel: Panel) -> dict[tuple[float, str], Contest]:
    """By noise level and column; reference rows have an excess, and stand outside the ranking."""
    found = {}
    for level in panel.levels:
        own = [e for e in panel.entries if e.cell.scenario.snr_db == level]
        stored = {e.cell.label: e.stored for e in own if e.stored and e.stored.n_ok}
        if not stored:
            continue
        names = pooled_quantities(panel.scenario, next(iter(stored.values())).identifiable)
        ranked = [e.cell.label for e in own if e.cell.label in stored and e.cell.method not in REFERENCES]
        columns = {
            "told": {label: (pooled_errors(s, names), pooled_excess(s, names)) for label, s in stored.items()},
            "rmse": {label: (errors_of(s, "rmse"), s.summary["rmse"]["excess"]) for label, s in stored.items()},
        }
        for column, both in columns.items():
            ranking = against_best({label: both[label][0] for label in ranked}) if len(ranked) > 1 else None
            found[level, column] = Contest({label: excess for label, (_, excess) in both.items()}, ranking)
    return found


def _panel(panel: Panel, classes: Mapping[str, str]) -> Table:
    """The panel's rows and headers."""
    contests, rows = _contests(panel), [_bound_row(panel)]
    for method in panel.methods:
        cells, oks, times = [], [], []
        for level in panel.levels:
            entry = panel.at(method, level)
            stored = entry.stored if entry else None
            if stored is None or not stored.n_ok:
                cells += [stored.status.value if stored else "not run" if entry else "-", "", ""]
                oks.append(f"0/{len(stored.rows)}" if stored else "-")
                continue
            cells += _entry(panel, stored, method, level, contests)
            oks.append(f"{stored.n_ok}/{len(stored.rows)}")
            times.append(_median(np.array([row.cpu_s for row in stored.rows if row.status is Status.OK])))
        time = f"{np.median(times):.2g}" if times and method not in REFERENCES else ""
        uses = _uses(classes.get(method, ""), panel.scenario) if times else ""
        rows.append([TITLES.get(method, method), *cells, time, uses, _joined(oks)])
    headers = [f"{level:g} dB {what}" for level in panel.levels for what in ("error", "RMSE (m)", "95 %")]
    return rows, ["method", *headers, "time (s)", "uses", "ok"]


def _uses(classes: str, scenario: Scenario) -> str:
    """What a method was told beyond the data, of what there was to tell here."""
    there = {"start": scenario.told == "known", "prior": scenario.prior is not None}
    return ", ".join(word for word in classes.split(", ") if there.get(word.split()[0] if word else "", True))


def _joined(oks: Sequence[str]) -> str:
    return oks[0] if len(set(oks)) == 1 else ", ".join(oks)


def _bound_row(panel: Panel) -> list[str]:
    cells = []
    for level in panel.levels:
        stored = panel.any_stored(level)
        if stored is None:
            cells += ["-", "-", ""]
            continue
        names = pooled_quantities(panel.scenario, stored.identifiable)
        bounds = [stored.summary.get(f"{name}_error_pct", {}).get("bound", math.nan) for name in names]
        pooled = math.sqrt(float(np.mean(np.square(bounds)))) if bounds else math.nan
        cells += [f"{number(pooled)} %", number(stored.summary["rmse"]["bound"]), ""]
    return ["bound", *cells, "", "", ""]


def _entry(panel: Panel, stored: StoredCell, method: str, level: float, contests: Mapping[Any, Contest]) -> list[str]:
    told, rmse = (contests[level, column].excess[method] for column in ("told", "rmse"))
    covered, _, _ = pooled_coverage(stored, panel.scenario.make_system().names)
    texts = {
        "told": f"×{excess_text(told)}" if math.isfinite(told) else "-",
        "rmse": f"{number(stored.summary['rmse']['median'])} ×{excess_text(rmse)}",
    }
    cells = []
    for column, text in texts.items():
        contest = contests[level, column]
        cells.append(f"**{text}**" if leads(contest.ranking, method, contest.excess) else text)
    return [*cells, "-" if math.isnan(covered) else f"{100 * covered:.0f}"]


def _middle(panel: Panel) -> float:
    """20 dB where the experiment has it, else its middle level."""
    levels = panel.levels
    return 20.0 if 20.0 in levels else levels[len(levels) // 2]


def _parameters(panel: Panel) -> str:
    """The single parameters and groups at one noise level: median error in percent and excess."""
    level = _middle(panel)
    stored = panel.any_stored(level)
    system = panel.scenario.make_system()
    if stored is None or len(system.names) > MANY:
        return ""
    names = [
        *system.names,
        *(n for n in pooled_quantities(panel.scenario, stored.identifiable) if n not in system.names),
    ]
    bounds = [stored.summary.get(f"{name}_error_pct", {}).get("bound", math.nan) for name in names]
    rows = [["bound", *map(number, bounds)]]
    for method in panel.methods:
        entry = panel.at(method, level)
        if entry is None or entry.stored is None or not entry.stored.n_ok:
            continue
        summaries = [entry.stored.summary.get(f"{name}_error_pct") for name in names]
        texts = [
            f"{number(s['median'])} ×{excess_text(s['excess'])}" if s and math.isfinite(s["excess"]) else
            number(s["median"]) if s else "-"
            for s in summaries
        ]  # fmt: skip
        rows.append([TITLES.get(method, method), *texts])
    table = tabulate(rows, ["method", *map(readable, names)], "github", disable_numparse=True)
    return f"Errors at {level:g} dB, in percent (median ×excess):\n\n{table}"


def _modes(panel: Panel) -> str:
    """Natural frequencies, damping ratios and mode shapes: medians over the replicates, at every noise level."""
    rows = []
    for method in panel.methods:
        cells = []
        for level in panel.levels:
            entry = panel.at(method, level)
            scores = modal_scores(entry.stored, panel.scenario) if entry and entry.stored and entry.stored.n_ok else {}
            cells += [number(_median(scores[metric])) if scores else "-" for metric in MODAL]
        if any(cell != "-" for cell in cells):
            rows.append([TITLES.get(method, method), *cells])
    if not rows:
        return ""
    headers = [
        f"{level:g} dB {what}" for level in panel.levels for what in ("frequencies %", "damping ratios %", "MAC")
    ]
    table = tabulate(rows, ["method", *headers], tablefmt="github", disable_numparse=True)
    what = (
        "As modes (median over the replicates of the root mean square error over the modes, and of the lowest modal "
        "assurance criterion):"
    )
    return f"{what}\n\n{table}"


def _terms(panel: Panel) -> str:
    """What SINDy's sparse model is made of: how often it found exactly the terms of the equation of motion."""
    sentences = []
    for level in panel.levels:
        entry = panel.at("sindy", level)
        if entry and entry.stored and entry.stored.n_ok:
            sentences.append(f"{level:g} dB: {terms_found(entry.stored, panel.scenario)}")
    return "SINDy by the terms it finds. " + "; ".join(sentences) + "." if sentences else ""


def _untold(panel: Panel) -> str:
    """What cannot be identified, at each noise level where it is so."""
    sentences = []
    for level in panel.levels:
        stored = panel.any_stored(level)
        if stored is None:
            continue
        own = [q.name for q in panel.scenario.make_system().quantities]
        never = [n for n in own if not stored.identifiable.get(n, True)]
        weak = [
            f"{n} (bound {number(b)} %)"
            for n in own
            if n not in never
            and (b := stored.summary.get(f"{n}_error_pct", {}).get("bound", 0.0)) > 100 * UNTOLD
            and math.isfinite(b)
        ]
        if level == panel.levels[0] and never:
            what = "decided by the prior" if panel.scenario.prior else "not identifiable"
            sentences.append(f"Not told by the data at any noise, {what}: {', '.join(readable(n) for n in never)}.")
        if weak:
            sentences.append(f"At {level:g} dB practically not identifiable: {', '.join(map(readable, weak))}.")
    return " ".join(sentences)


def latex(title: str, shown: Sequence[tuple[Panel, Table]]) -> str:
    """The panels as LaTeX (booktabs), for an article."""
    parts = [
        latex_table(f"{title}: {heading(panel.scenario)}. {describe(panel.scenario)}", *table) for panel, table in shown
    ]
    return f"% needs the package booktabs\n% regenerate: python -m bench.tables\n{''.join(parts)}"


def system_table(experiment: str, store: Store) -> dict[str, str]:
    """The files of the table by name; none where the store holds no cell of it."""
    from bench.config.config import _experiment

    title, cells = described_cells(experiment)
    found = [Entry("", cell, store.load(cell.identity)) for cell in cells]
    if all(entry.stored is None for entry in found):
        return {}
    number_ = _experiment(experiment)["table"].get("number")
    name = f"table{number_}" if number_ else experiment
    heading_ = f"Table {number_}. {title}" if number_ else title
    command = f"python -m bench -m experiment={experiment} && python -m bench.tables"
    shown = tables_of(found)
    return {
        f"{name}.md": markdown(heading_, shown, command),
        f"{name}.csv": tidy(str(number_ or experiment), found).to_csv(index=False, float_format="%.6g"),
        f"{name}.tex": latex(title, shown),
    }
