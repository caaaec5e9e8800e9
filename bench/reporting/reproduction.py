"""Verdicts on the paper's 59 numbers, what they rest on, and the page that states them.

The paper leaves open how long its records are, whether the start is known, what prior it uses and how it defines the
signal-to-noise ratio. Each number, and what the numbers imply of k/m and c/m, is judged under the reading of the
protocol and under every other one declared here; a verdict that changes is not firm.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
import pandas as pd

from bench.config.experiment import Experiment, sweep
from bench.reporting.frame import Line, Result
from bench.reporting.labels import beside_paper, in_order, title
from bench.reporting.paper import Printed, implied, judged, own_method, paper_value, printed, row_name
from bench.reporting.rounding import number
from bench.reporting.tables.estimates import HEADINGS
from bench.reporting.tables.render import MISSING, Columns, Rows, files, listing
from bench.scenario.scenario import PriorSpec, Scenario
from bench.scenario.truth import closed_form
from bench.scoring.statistics import LEVEL, holm
from bench.scoring.verdict import decided, mean_p_value
from bench.store.cell import Cell


def _prior(name: str) -> PriorSpec:
    cell = sweep({"method": ["prior"], "prior": [name]})[0].cell()
    assert cell.scenario.prior is not None
    return cell.scenario.prior


def _peak(scenario: Scenario) -> Scenario:
    """The noise that the same number of decibels means if it is counted from the largest displacement."""
    clean = scenario.sigmas(0) * 10.0 ** (scenario.snr_db / 20.0)  # root mean square of the clean samples
    peak = float(np.max(np.abs(scenario.initial[0])))
    return replace(scenario, snr_db=scenario.snr_db - 20.0 * math.log10(peak / float(clean[0])))


FIRST, WIDE_MASS = "as in the protocol", "mass known to 10 %"
ASSUMPTIONS: dict[str, Callable[[Scenario], Scenario]] = {
    FIRST: lambda scenario: scenario,
    "records of 5 s": lambda scenario: replace(scenario, duration=5.0),
    "records of 20 s": lambda scenario: replace(scenario, duration=20.0),
    "start unknown": lambda scenario: replace(scenario, initial_state="unknown"),
    "handbook prior": lambda scenario: replace(scenario, prior=_prior("handbook")),
    WIDE_MASS: lambda scenario: replace(scenario, prior=_prior("wide_mass")),
    "SNR from the peak": _peak,
}
"""Readings of what the paper leaves open; the first is the protocol's: 10 s, start known, nominal prior, mean square"""
Place = tuple[int, str, str]
"""Table, row and label of a method."""
Stored = Mapping[str, Mapping[Place, Result]]
"""By reading, the results of its cells."""


# ---- cells and verdicts


@cache
def judged_labels() -> dict[str, str]:
    """By the paper's name of a method, the method of ours that is judged under every reading, in order.

    A variant that has the paper's own training is judged under the first reading only: it has the same minimum to find,
    from the same residuals, at fifty times the cost.
    """
    label = {p.method: beside_paper(p.method)[0] for p in printed()}
    return {name: own for own in in_order(label.values()) for name in label if label[name] == own}


def all_cells() -> dict[str, dict[Place, Cell]]:
    """The cells of every reading; of the first, those of all that stands beside the paper's methods, and the oracle."""
    wanted = {"oracle", *(label for name in judged_labels() for label in beside_paper(name))}
    base = {}
    for table in dict.fromkeys(p.table for p in printed()):
        for cell in Experiment(f"table{table}").cells():
            if cell.scenario.initial_state == "known" and cell.label in wanted:
                base[table, row_name(table, cell.scenario.label, cell.scenario.snr_db), cell.label] = cell
    judged_places = {(p.table, p.row, label) for p in printed() for label in (judged_labels()[p.method], "oracle")}
    varied = {place: cell for place, cell in base.items() if place in judged_places}
    changed = {
        name: {place: replace(cell, scenario=change(cell.scenario)) for place, cell in varied.items()}
        for name, change in ASSUMPTIONS.items()
    }
    return {**changed, FIRST: base}


def verdicts(stored: Stored) -> pd.DataFrame:
    """Return a line a printed number: the verdicts under every reading, whether they agree, and Holm's p of means.

    ``p`` is two-sided, of the paper's number as another mean of as many runs as ours; NaN for Table 2's one estimate.
    """
    lines = []
    for place in printed():
        pair = _own_and_oracle(place, judged_labels()[place.method], stored[FIRST])
        training = _own_and_oracle(place, next(iter(beside_paper(place.method)[1:]), ""), stored[FIRST])
        p = mean_p_value(place.value, pair[0].errors(place.metric)) if pair else 1.0
        where = {"table": place.table, "row": place.row, "method": place.method, "metric": place.metric}
        text = judged(place, *training).text if training else ""
        readings = {"p": math.nan if place.table == 2 else p, **_readings(place, stored), "paper's training": text}
        lines.append({**where, "paper": place.value, **readings})
    data = _with_standing(lines)
    data.insert(7, "p", data.pop("p"))
    means = data["p"].notna()
    data.loc[means, "p (Holm)"] = holm(data["p"][means].tolist())
    return data


def ratio_verdicts(stored: Stored) -> pd.DataFrame:
    """Return a line a ratio that the paper implies: the verdicts under every reading, and whether they agree."""
    return _with_standing([{**vars(place), **_readings(place, stored)} for place in implied()])


def _readings(place: Printed, stored: Stored) -> dict[str, Any]:
    """Return the verdict under every reading, and our median error."""
    line: dict[str, Any] = {}
    for name in ASSUMPTIONS:
        pair = _own_and_oracle(place, judged_labels()[place.method], stored[name])
        line[name] = judged(place, *pair).text if pair else "not run"
        line[f"{name}: median"] = float(np.median(pair[0].errors(place.metric))) if pair else math.nan
    return line


def _own_and_oracle(place: Printed, label: str, stored: Mapping[Place, Result]) -> tuple[Result, Result] | None:
    own, oracle = (stored.get((place.table, place.row, name)) for name in (label, "oracle"))
    return (own, oracle) if own and oracle and own.stored and oracle.stored else None


def _with_standing(lines: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Add whether a verdict decides anything under the first reading, and if so, whether it is the same under all."""
    data = pd.DataFrame(lines)
    readings = data[list(ASSUMPTIONS)]
    data["decided"] = readings[FIRST].map(decided) & ~readings.eq("not run").any(axis=1)
    data["firm"] = data["decided"] & (readings.map(simple).nunique(axis=1) == 1)
    return data


def simple(text: str) -> str:
    """A verdict without its percentage."""
    return text.partition(" (")[0] if text.startswith("not decidable") else text


# ---- the page

PAGE = """# Reproduction

Each of the paper's 59 numbers (Karkadakattil 2026, doi:10.25082/RIMA.2026.02.002) against the
replicates of the same method here, read as a single run and as a mean of many. *Reproduced*: the number lies where 90
in 100 further runs of ours do, or other means of as many runs (their own sampling error counted). Below that, ours is
worse; above it, ours is better. *Not decidable*: more than half of our mean square error is the prior's.
*Incompatible*: below what the oracle's luck allows. Table 2 prints one estimate, which is read as a single run. *Open*:
the error of k or c may follow from that of the mass, since ours is not better in what it implies of k/m or c/m (below).
The paper's PINN stands beside `{own}` (Levenberg-Marquardt) and, under the first reading, beside the paper's own
training.

## In short

{counts}

{decided} of {numbers} numbers are decided, and {firm} of these verdicts are firm: they hold under all {readings}
readings. Of {ratios} errors of k/m and c/m that the numbers imply, {ratios_decided} are decided, {ratios_firm} of them
firmly.

Read as means of as many replicates, {differ} of {means} differ from ours at 5 % after Holm's adjustment over all of
them (Student's t, the sampling error of both means, under the first reading; those of m and k say no more than that its
prior is another). Read as single runs none can: a hundred replicates do not resolve a share small enough for so many
comparisons.

## What is assumed, and how far it moves the numbers

What the paper leaves open is filled in by us: records of {duration:g} s, a start that is known, a mass weighed to
{mass:g} %, hardly anything known of damping and stiffness, and decibels of the mean square. It says only that its prior
is mild. So *not decidable* says what our weighing decides; under a far wider prior the errors of m and k would be
larger, and still the prior's. {exceeding} of the {masses} mass errors that it prints exceed {limit:.1f} %, which a mass
weighed to {mass:g} % exceeds in one case of twenty: the paper's prior, if it had one, was wider. So one reading below
has a {wide}. Under it our PINN's median error of m lies between {low:.2g} and {high:.2g} %, where the paper prints
{printed_low:g} to {printed_high:g} %. Still the prior decides them.

The readings were declared before they were run. Each entry is our median error under a reading over that of the
protocol, the median over the numbers of a method, and how many verdicts change."""
RATIOS = """## What the numbers imply of k/m and c/m

Its errors of m, c and k are errors of what free vibration does not tell; k/m and c/m it does tell. Table 2
prints an estimate, so these are known but for its last digit, and are read as one run. The other tables print sizes of
errors without signs, so the error of a ratio lies between that of equal and that of opposite signs, rounding included.
*Open*: the two ends have different verdicts."""
AGAINST_ITSELF = """## The paper against itself

Its PINN at 20 dB on the reference system has a mass error of 1.1, 2.6 and 3.9 % and an RMSE of 0.016 and 0.021 m in its
Tables 2, 3 and 5: what it calls one value spreads by a factor of three.

Errors of m, c and k imply a displacement error, within the range that their unknown signs leave, over records of
{duration:g} s, a length that is ours. {within} of {rows} printed RMSE lie within it: where errors of k and m cancel it
can be next to nil."""
WEIGHING = 1.96
"""An error of so many standard deviations of the weighing is exceeded in one case of twenty."""


def written(data: pd.DataFrame, ratios: pd.DataFrame, base: Mapping[Place, Cell]) -> dict[str, str]:
    """The page and its numbers, by name."""
    scenario, consistent = next(iter(base.values())).scenario, consistency(base)
    parts: list[str | Rows] = [
        PAGE.format(**_page_numbers(data, ratios, scenario)),
        _moves(data),
        RATIOS,
        listing(ratios.to_dict("records"), {**NAMED, "paper implies": lambda line: line["text"], **OURS}),
        "## The numbers",
        listing(data.to_dict("records"), {**NAMED, "paper": lambda line: number(line["paper"]), **OURS, **MORE}),
        AGAINST_ITSELF.format(duration=scenario.duration, within=sum(consistent), rows=len(consistent)),
        "Regenerate: `python -m bench tables what=reproduction`, after the cells of Tables 2 to 5.",
    ]
    return files("reproduction", parts, data.to_dict("records"), digits=5)


def _page_numbers(data: pd.DataFrame, ratios: pd.DataFrame, scenario: Scenario) -> dict[str, Any]:
    """The numbers of the page by name."""
    assert scenario.prior is not None
    mass = 100.0 * scenario.prior.sd_by_kind["mass"]
    errors = data[data.metric == "m_error_pct"]
    own = errors[errors.method == own_method()]
    wide = own[f"{WIDE_MASS}: median"]
    counts = data[FIRST].map(simple).value_counts().items()
    return {
        "own": judged_labels()[own_method()], "decided": data.decided.sum(),
        "counts": "\n".join(f"- {n} of {len(data)}: {text}" for text, n in counts),
        "numbers": len(data), "firm": data.firm.sum(), "readings": len(ASSUMPTIONS),
        "ratios": len(ratios), "ratios_decided": ratios.decided.sum(), "ratios_firm": ratios.firm.sum(),
        "differ": (data["p (Holm)"] < LEVEL).sum(), "means": data["p"].count(),
        "duration": scenario.duration, "mass": mass, "masses": len(errors), "limit": WEIGHING * mass,
        "exceeding": (errors.paper > WEIGHING * mass).sum(), "wide": WIDE_MASS, "low": wide.min(), "high": wide.max(),
        "printed_low": own.paper.min(), "printed_high": own.paper.max(),
    }  # fmt: skip


def _moves(data: pd.DataFrame) -> Rows:
    def moved(label: str, name: str) -> str:
        own = data[data.method == label]
        ratio = float(np.nanmedian(own[f"{name}: median"] / own[f"{FIRST}: median"]))
        return f"×{ratio:.2f}, {int((own[name].map(simple) != own[FIRST].map(simple)).sum())} of {len(own)}"

    columns = {title(own): partial(moved, label) for label, own in judged_labels().items()}
    return listing(list(ASSUMPTIONS)[1:], {"reading": str, **columns})


def _firm(line: Line) -> str:
    """Yes, or the readings under which the verdict is another; a dash where nothing is decided."""
    changes = [name for name in ASSUMPTIONS if simple(line[name]) != simple(line[FIRST])]
    return "yes" if line["firm"] else "no: " + ", ".join(changes) if line["decided"] else MISSING


NAMED: Columns[Line] = {
    "table": lambda line: str(line["table"]),
    "row": lambda line: line["row"],
    "method": lambda line: title(judged_labels()[line["method"]]),
    "metric": lambda line: HEADINGS[line["metric"]],
}
OURS: Columns[Line] = {
    "ours, median": lambda line: number(line[f"{FIRST}: median"]),
    "verdict": lambda line: line[FIRST],
    "firm": _firm,
}
MORE: Columns[Line] = {
    "paper's training": lambda line: line["paper's training"] or MISSING,
    "p (Holm)": lambda line: MISSING if math.isnan(line["p (Holm)"]) else f"{line['p (Holm)']:.2g}",
}


def implied_rmse(scenario: Scenario, errors: Sequence[float]) -> tuple[float, float]:
    """The least and the largest displacement RMSE (m) that errors of m, c and k (%) of either sign imply."""
    true, t = dict(scenario.parameters), scenario.dense_times
    x0, v0 = scenario.initial[0][0], scenario.initial[1][0]
    right = closed_form(true, x0, v0, t)
    sizes = []
    for signs in itertools.product((-1.0, 1.0), repeat=3):
        changed = zip("mck", errors, signs, strict=True)
        p = {name: true[name] * (1.0 + sign * error / 100.0) for name, error, sign in changed}
        sizes.append(float(np.sqrt(np.mean((closed_form(p, x0, v0, t) - right) ** 2))))
    return min(sizes), max(sizes)


def consistency(base: Mapping[Place, Cell]) -> list[bool]:
    """By row of the paper, whether its displacement RMSE is one that some signs of its parameter errors give."""
    consistent = []
    for (table, row, label), cell in base.items():
        errors = [paper_value(table, row, label, f"{name}_error_pct") for name in "mck"]
        rmse = paper_value(table, row, label, "rmse")
        if label in judged_labels().values() and np.all(np.isfinite([*errors, rmse])):
            low, high = implied_rmse(cell.scenario, errors)
            consistent.append(low <= rmse <= high)
    return consistent
