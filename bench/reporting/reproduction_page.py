"""The page of the verdicts on the paper's numbers: what was found, what it rests on, and every number."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
import pandas as pd

from bench.reporting.frame import Line
from bench.reporting.labels import title
from bench.reporting.paper import own_method, paper_value, printed
from bench.reporting.reproduction import ASSUMPTIONS, WIDE_MASS, Place, judged_labels, simple
from bench.reporting.rounding import number
from bench.reporting.tables.estimates import HEADINGS
from bench.reporting.tables.render import MISSING, Columns, Rows, files, listing
from bench.scenario.scenario import Scenario
from bench.scenario.truth import closed_form
from bench.scoring.statistics import LEVEL
from bench.store.cell import Cell

FIRST = next(iter(ASSUMPTIONS))
WEIGHING = 1.96
"""An error of so many standard deviations of the weighing is exceeded in one case of twenty."""
INTRODUCTION = """Each of the paper's 59 numbers (Karkadakattil 2026, doi:10.25082/RIMA.2026.02.002) against the
replicates of the same method here, read as a single run and as a mean of many. *Reproduced*: the number lies where 90
in 100 further runs of ours do, or other means of as many runs (their own sampling error counted). Below that, ours is
worse; above it, ours is better. *Not decidable*: more than half of our mean square error is the prior's.
*Incompatible*: below what the oracle's luck allows. Table 2 prints one estimate, which is read as a single run. *Open*:
the error of k or c may follow from that of the mass, since ours is not better in what it implies of k/m or c/m (below).
The paper's PINN stands beside `{own}` (Levenberg-Marquardt) and, under the first reading, beside the paper's own
training."""
OURS = """What the paper leaves open is filled in by us: records of {duration:g} s, a start that is known, a mass
weighed to {mass:g} %, hardly anything known of damping and stiffness, and decibels of the mean square. It says only
that its prior is mild. So *not decidable* says what our weighing decides; under a far wider prior the errors of m and
k would be larger, and still the prior's. {exceeding} of the {masses} mass errors that it prints exceed {limit:.1f} %,
which a mass weighed to {mass:g} % exceeds in one case of twenty: the paper's prior, if it had one, was wider. So one
reading below has a {wide}. Under it our PINN's median error of m lies between {low:.2g} and {high:.2g} %,
where the paper prints {printed_low:g} to {printed_high:g} %. Still the prior decides them."""
RATIOS = """Its errors of m, c and k are errors of what free vibration does not tell; k/m and c/m it does tell. Table 2
prints an estimate, so these are known but for its last digit, and are read as one run. The other tables print sizes of
errors without signs, so the error of a ratio lies between that of equal and that of opposite signs, rounding included.
*Open*: the two ends have different verdicts."""


def page(data: pd.DataFrame, ratios: pd.DataFrame, base: Mapping[Place, Cell]) -> list[str | Rows]:
    """The parts of the page."""
    first, *others = ASSUMPTIONS
    return [
        "# Reproduction",
        INTRODUCTION.format(own=judged_labels()[own_method()]),
        "## In short",
        _short(data, ratios, first),
        "## What is assumed, and how far it moves the numbers",
        _ours(next(iter(base.values())).scenario, data),
        "The readings were declared before they were run. Each entry is our median error under a reading over that of "
        "the protocol, the median over the numbers of a method, and how many verdicts change.",
        _moves(data, first, others),
        "## What the numbers imply of k/m and c/m",
        RATIOS,
        listing(ratios.to_dict("records"), IMPLIED),
        "## The numbers",
        listing(data.to_dict("records"), NUMBERS),
        "## The paper against itself",
        "Its PINN at 20 dB on the reference system has a mass error of 1.1, 2.6 and 3.9 % and an RMSE of 0.016 and "
        "0.021 m in its Tables 2, 3 and 5: what it calls one value spreads by a factor of three.",
        *_against_itself(base),
        "Regenerate: `python -m bench tables what=reproduction`, after the cells of Tables 2 to 5.",
    ]


def _short(data: pd.DataFrame, ratios: pd.DataFrame, first: str) -> str:
    """How many verdicts of each kind, how many of the decided ones are firm, and how many means differ."""
    counts = data[first].map(simple).value_counts()
    differ = int((data["p (Holm)"] < LEVEL).sum())
    kinds = "\n".join(f"- {n} of {len(data)}: {text}" for text, n in counts.items())
    n_decided, n_firm = int(data.decided.sum()), int(data.firm.sum())
    firm = (
        f"{n_decided} of {len(data)} numbers are decided, and {n_firm} of these verdicts are firm: they hold under all "
        f"{len(ASSUMPTIONS)} readings. Of {len(ratios)} errors of k/m and c/m that the numbers imply, "
        f"{int(ratios.decided.sum())} are decided, {int(ratios.firm.sum())} of them firmly."
    )
    means = (
        f"Read as means of as many replicates, {differ} of {data['p'].count()} differ from ours at 5 % after Holm's "
        "adjustment over all of them (Student's t, the sampling error of both means, under the first reading; those of "
        "m and k say no more than that its prior is another). Read as single runs none can: a hundred replicates do "
        "not resolve a share small enough for so many comparisons."
    )
    return f"{kinds}\n\n{firm}\n\n{means}"


def _ours(scenario: Scenario, data: pd.DataFrame) -> str:
    """What is assumed that the paper does not say, and what its mass errors say of that."""
    assert scenario.prior is not None
    mass = 100.0 * scenario.prior.sd_by_kind["mass"]
    errors = [p.value for p in printed() if p.metric == "m_error_pct"]
    own = data[(data.metric == "m_error_pct") & (data.method == own_method())]
    wide = own[f"{WIDE_MASS}: median"]
    return OURS.format(
        duration=scenario.duration, mass=mass, masses=len(errors), limit=WEIGHING * mass,
        exceeding=sum(error > WEIGHING * mass for error in errors), wide=WIDE_MASS,
        low=float(wide.min()), high=float(wide.max()), printed_low=own.paper.min(), printed_high=own.paper.max(),
    )  # fmt: skip


def _against_itself(base: Mapping[Place, Cell]) -> list[str | Rows]:
    """Whether each displacement error is one that the parameters' errors can give."""
    duration = next(iter(base.values())).scenario.duration
    text = (
        "Errors of m, c and k imply a displacement error, within the range that their unknown signs leave, over "
        f"records of {duration:g} s, a length that is ours. "
    )
    inconsistent = consistency(base)
    if not inconsistent:
        return [text + "Every printed RMSE lies within it: where errors of k and m cancel it can be next to nil."]
    headers = ["where", "errors of m / c / k (%)", "RMSE they imply (m)", "RMSE printed (m)"]
    return [text + "Rows whose printed RMSE lies outside it:", (inconsistent, headers)]


def implied_rmse(scenario: Scenario, errors: Sequence[float]) -> tuple[float, float]:
    """The least and the largest displacement RMSE (m) that errors of m, c and k (%) of either sign imply."""
    true, t = dict(scenario.parameters), scenario.dense_times
    x0, v0 = scenario.initial[0][0], scenario.initial[1][0]
    right = closed_form(true, x0, v0, t)
    found = []
    for signs in itertools.product((-1.0, 1.0), repeat=3):
        changed = zip("mck", errors, signs, strict=True)
        p = {name: true[name] * (1.0 + sign * error / 100.0) for name, error, sign in changed}
        found.append(float(np.sqrt(np.mean((closed_form(p, x0, v0, t) - right) ** 2))))
    return min(found), max(found)


def consistency(base: Mapping[Place, Cell]) -> list[list[str]]:
    """Rows whose displacement RMSE no signs of its own parameter errors can give."""
    rows, labels = [], set(judged_labels().values())
    for (table, row, label), cell in base.items():
        values = [paper_value(table, row, label, m) for m in ("m_error_pct", "c_error_pct", "k_error_pct", "rmse")]
        if label not in labels or not np.all(np.isfinite(values)):
            continue
        low, high = implied_rmse(cell.scenario, values[:3])
        if not low <= values[3] <= high:
            place = f"Table {table}, {row}, {title(label)}"
            rows.append([place, " / ".join(f"{v:g}" for v in values[:3]), f"{low:.3f} to {high:.3f}", f"{values[3]:g}"])
    return rows


def _moves(data: pd.DataFrame, first: str, others: Sequence[str]) -> Rows:
    def moved(label: str, name: str) -> str:
        own = data[data.method == label]
        ratio = float(np.nanmedian(own[f"{name}: median"] / own[f"{first}: median"]))
        return f"×{ratio:.2f}, {int((own[name].map(simple) != own[first].map(simple)).sum())} of {len(own)}"

    return listing(
        others, {"reading": str, **{title(own): partial(moved, label) for label, own in judged_labels().items()}}
    )


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
NUMBERS: Columns[Line] = {
    **NAMED,
    "paper": lambda line: number(line["paper"]),
    "ours, median": lambda line: number(line[f"{FIRST}: median"]),
    "verdict": lambda line: line[FIRST],
    "paper's training": lambda line: line["paper's training"] or MISSING,
    "firm": _firm,
    "p (Holm)": lambda line: MISSING if math.isnan(line["p (Holm)"]) else f"{line['p (Holm)']:.2g}",
}
IMPLIED: Columns[Line] = {
    **NAMED,
    "paper implies": lambda line: line["text"],
    "ours, median": lambda line: number(line[f"{FIRST}: median"]),
    "verdict": lambda line: line[FIRST],
    "firm": _firm,
}


def written(data: pd.DataFrame, ratios: pd.DataFrame, base: Mapping[Place, Cell]) -> dict[str, str]:
    """The page and its numbers, by name."""
    return files("reproduction", page(data, ratios, base), data.to_dict("records"), digits=5)
