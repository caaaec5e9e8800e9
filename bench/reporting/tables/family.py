"""The table of a family of variants (:mod:`bench.reporting.family`): one setting changed at a time around each base."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from bench.entrants.registry import load_method
from bench.reporting.family import PLACE, Family, Place, Section, Variant, family_of, has_choices
from bench.reporting.frame import ERROR, Frame, Line, Result, group
from bench.reporting.labels import cards
from bench.reporting.rounding import answered, excess_text, number, percent
from bench.reporting.tables.pooling import root_mean_square
from bench.reporting.tables.render import MISSING, Columns, Panel, Rows, Texts, failure_notes, files, listing
from bench.scoring.traces import MOMENTS

STIFFNESS, DAMPING = "k_over_m", "c_over_m"
NEAR = 1.1
"""Ratio to the oracle's error up to which a method counts as equally accurate."""
CSV = (
    "section", "base", "row", "method", "settings", "snr_db", "initial_state", "quantity", "value", "n_ok", "n",
)  # fmt: skip
LEGEND = """Each row is one way to train the network on the same data, reference rows and other packages apart.
In a section with a base, its first row, the others differ from it in one setting. {bases} A row may occur in two
sections. Slow rows have fewer data sets; the row below the base gives the base on these data sets alone.

**Accuracy.** n: successful fits, of all, at each noise level if they differ. k/m, c/m, x (displacement): root mean
square error of the successful fits over the Cramér-Rao bound; 1 is the smallest that an unbiased method can reach.
95 %: coverage, the share of the 95 % intervals of k/m that contain the true value, in percent.

**Training** ({place}). Medians over the fits; a failed fit counts as infinite. Times are processor seconds.

- *loss at end / minimum*: the final loss over the lowest known value of the same loss.
- *certificate*: norm of the final gradient over the product of the norms of Jacobian and residual; zero at a minimum.
- *s to within 1 % of the minimum*: time after which the loss stays within 1 % of the minimum; the median over the fits
  that reach it, with their number if some do not.
- *s to {near:g} × oracle*: time after which the root mean square error of k/m stays within {near:g} times that of the
  oracle on the same data, evaluated at {moments} fixed times from {first:g} s to {last:g} s.
- *k/m at minimum*, *c/m at minimum*: the error over the bound if each training had ended at the minimum of its own
  loss, on the data sets that all rows of the section have.
- *whole fit s*: including the search for an initial guess and the intervals. *memory*: growth of the process.

A dash: not computed, or not applicable."""


# ---- columns


@dataclass(frozen=True)
class FamilyColumn:
    """A column of the table.

    Attributes:
        heading: Heading; empty for columns of the CSV alone.
        value: Value of a cell, from its number of data sets (None for all) and the oracle's cell.
        text: Format of the value.
    """

    heading: str
    value: Callable[[Result, int | None, Result | None], float]
    text: Callable[[float], str] = number


def _excess(metric: str, score: str, heading: str) -> FamilyColumn:
    """Return a column with the root mean square of a score over the bound of a metric."""
    return FamilyColumn(
        heading, lambda cell, n, _: root_mean_square(cell.successful(score, n)) / cell.bound(metric), excess_text
    )


def _median(score: str, heading: str, text: Callable[[float], str] = number) -> FamilyColumn:
    return FamilyColumn(heading, lambda cell, n, _: cell.statistic(score, "median"), text)


def finite_median(values: np.ndarray) -> float:
    """Return the median of the finite values; NaN without any."""
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else math.nan


def _coverage(cell: Result, n: int | None, _: Result | None) -> float:
    hits = cell.successful(f"{STIFFNESS}_coverage_95", n)
    return float(np.mean(hits)) if hits.size else math.nan


def _memory(cell: Result, n: int | None, _: Result | None) -> float:
    return finite_median(cell.stored.columns.numbers("peak_memory_mb")) if cell.stored else math.nan


def arrived(cell: Result, n: int | None = None, _: Result | None = None) -> float:
    """Return the share of the fits whose loss stays within 1 % of its minimum; NaN if no minimum is known."""
    return cell.successful("arrival_s").size / cell.n if cell.successful("loss_over_minimum").size else math.nan


def arrival(cell: Result, n: int | None = None, _: Result | None = None) -> float:
    """Return the median time (s) to within 1 % of the minimum, of the fits that reach it; infinite if none does."""
    share = arrived(cell)
    return finite_median(cell.successful("arrival_s")) if share else math.inf if share == 0 else math.nan


def oracle_seconds(cell: Result, oracle: Result | None) -> float:
    """Return the time (s) after which the error of k/m stays within 1.1 times the oracle's; infinite if never.

    Both errors are root mean squares over the replicates in which both methods succeeded.
    """
    if oracle is None or not cell.successful("training_s").size:
        return math.nan
    n = min(cell.n, oracle.n)
    both = cell.ok[:n] & oracle.ok[:n]
    limit = NEAR * root_mean_square(oracle.scores(STIFFNESS + ERROR)[:n][both])
    errors = {moment: root_mean_square(cell.scores(moment_score(moment))[:n][both]) for moment in MOMENTS}
    late = [i for i, error in enumerate(errors.values()) if not error <= limit]
    return [*MOMENTS, math.inf][late[-1] + 1 if late else 0]


def moment_score(moment: float) -> str:
    """Return the name of the score with the error at a time (s) of a training."""
    return f"{STIFFNESS}_off_pct_at_{moment:g}s"


def _seconds(value: float) -> str:
    return "never" if math.isinf(value) else number(value)


ACCURACY = {
    "k_over_m_excess": _excess(STIFFNESS + ERROR, STIFFNESS + ERROR, "k/m"),
    "c_over_m_excess": _excess(DAMPING + ERROR, DAMPING + ERROR, "c/m"),
    "displacement_excess": _excess("rmse", "rmse", "x"),
    "k_over_m_coverage_95": FamilyColumn("95 %", _coverage, percent),
}
"""Columns of accuracy, for every method."""
TRAINING = {
    "loss_over_minimum": _median(
        "loss_over_minimum", "loss at end / minimum", lambda loss: f"{loss:.3f}" if loss < 100 else number(loss)
    ),
    "certificate": _median("certificate", "certificate"),
    "training_s": _median("training_s", "training s"),
    "arrival_s": FamilyColumn("s to within 1 % of the minimum", arrival, _seconds),
    "arrived_share": FamilyColumn("", arrived),
    "oracle_s": FamilyColumn(f"s to {NEAR:g} × oracle", lambda cell, n, oracle: oracle_seconds(cell, oracle), _seconds),
    "k_over_m_excess_at_minimum": _excess(STIFFNESS + ERROR, f"{STIFFNESS}_off_pct_at_minimum", "k/m at minimum"),
    "c_over_m_excess_at_minimum": _excess(DAMPING + ERROR, f"{DAMPING}_off_pct_at_minimum", "c/m at minimum"),
    "fit_s": FamilyColumn("whole fit s", lambda cell, n, _: finite_median(cell.cpu_s)),
    "peak_memory_mb": FamilyColumn("memory MB", _memory, lambda size: MISSING if math.isnan(size) else f"{size:.0f}"),
}
"""Columns of a training."""


# ---- the table


def family_table(frame: Frame) -> Mapping[str, str]:
    """Return the files of the table by name; none if no cell of the family is stored."""
    if not any(result.stored and has_choices(result.method) for result in frame):
        return {}
    family = family_of(frame)
    notes = failure_notes(replace(cell, label=v.title) for v in family.variants for cell in v.cells.values())
    parts: list[str | Rows] = [
        f"# {frame.title}",
        _legend(family),
        frame.footer,
        *(part for section in family.sections for part in _section(family, section)),
        *_combinations(family),
        f"## Sources\n\n{_sources(family)}",
        f"## What failed\n\n{notes}" if notes else "",
    ]
    caption = f"({PLACE[0]:g} dB, initial state {PLACE[1]}). Root mean square errors over the Cramér-Rao bound."
    latex = [(f"{_heading(section)} {caption}", _accuracy(section, [PLACE])) for section in family.sections]
    return files(family.method, parts, _lines(family), CSV, 5, latex)


def _lines(family: Family) -> Iterator[Line]:
    """Yield one line per row, cell and quantity; a missing cell has n = 0 and the quantities of accuracy alone."""
    sections = [*family.sections, family.combinations]
    rows = [(section, row, place) for section in sections for row in section.rows for place in family.places]
    for section, row, place in rows:
        cell, oracle, n = row.stored_cell(place), _oracle(family, place), section.common(place)
        head = {
            "section": section.heading, "base": section.base, "row": row.title, "method": row.method,
            "settings": json.dumps(dict(row.settings), sort_keys=True), "snr_db": place[0], "initial_state": place[1],
            "n_ok": cell.n_ok if cell else 0, "n": cell.n if cell else 0,
        }  # fmt: skip
        for name, quantity in ACCURACY.items():
            yield {**head, "quantity": name, "value": quantity.value(cell, None, None) if cell else math.nan}
        for name, quantity in TRAINING.items() if cell else ():
            if not math.isnan(value := quantity.value(cell, n, oracle)):  # type: ignore[arg-type]
                yield {**head, "quantity": name, "value": value}


def _oracle(family: Family, place: Place) -> Result | None:
    return next((variant.stored_cell(place) for variant in family.variants if variant.method == "oracle"), None)


def _legend(family: Family) -> str:
    usual = {setting: family.names.usual[setting] for setting in family.names.card.choices}
    bases = (
        f"*{name.capitalize()}*: {family.names.joined({**usual, **settings})}."
        for name, settings in family.bases.items()
    )
    ends = {"moments": len(MOMENTS), "first": MOMENTS[0], "last": MOMENTS[-1]}
    scenario = f"{PLACE[0]:g} dB, initial state {PLACE[1]}"
    return LEGEND.format(bases=" ".join(bases), place=scenario, near=NEAR, **ends)


def _heading(section: Section) -> str:
    return section.heading + (f", {section.base}" if section.base else "")


def _title(row: Variant) -> str:
    return f"{row.title} (base)" if row.base else row.title


def _section(family: Family, section: Section) -> Iterator[str | Rows]:
    """Yield the accuracy with a known and with an unknown initial state, and the training."""
    yield f"## {_heading(section)}"
    for initial_state, places in group(family.places, lambda place: place[1]).items():
        yield f"*Accuracy, initial state {initial_state}*"
        yield _accuracy(section, places)
    yield f"*Training ({PLACE[0]:g} dB, initial state {PLACE[1]})*"
    oracle, n = _oracle(family, PLACE), section.common(PLACE)
    columns: Columns[Variant] = {
        quantity.heading: partial(_training, quantity, n, oracle) for quantity in TRAINING.values() if quantity.heading
    }
    yield listing(section.rows, {"row": _title, "n": partial(_counts, [PLACE]), **columns})


def _training(quantity: FamilyColumn, n: int, oracle: Result | None, row: Variant) -> str:
    cell = row.stored_cell(PLACE)
    if cell is None:
        return MISSING
    some = quantity is TRAINING["arrival_s"] and 0 < arrived(cell) < 1
    return quantity.text(quantity.value(cell, n, oracle)) + (
        f" ({round(arrived(cell) * cell.n)}/{cell.n})" if some else ""
    )


def _counts(places: Sequence[Place], row: Variant) -> str:
    """Return the successful fits, of all, once if they are the same at every computed noise level."""
    counts = [answered(cell.n_ok, cell.n) if (cell := row.stored_cell(place)) else MISSING for place in places]
    computed = set(counts) - {MISSING}
    return ", ".join(counts) if len(computed) > 1 else next(iter(computed), MISSING)


def _accuracy(section: Section, places: Sequence[Place]) -> Rows:
    """Return the rows of a section with all noise levels side by side; below the base, the base on fewer data sets."""
    base = section.rows[0]
    pairs = [(row.stored_cell(place), base.stored_cell(place)) for row in section.rows[1:] for place in places]
    fewer = {cell.n for cell, other in pairs if cell and other and cell.n < other.n} if base.base else set()
    rows: list[tuple[Variant, int | None]] = [(row, None) for row in section.rows]
    rows[1:1] = [(base, n) for n in sorted(fewer, reverse=True)]
    columns: Columns[tuple[Variant, int | None]] = {
        f"{place[0]:g} dB {quantity.heading}": partial(_entry, place, quantity)
        for place in places
        for quantity in ACCURACY.values()
    }
    first: Columns[tuple[Variant, int | None]] = {
        "row": lambda row: _title(row[0]) if row[1] is None else f"the base on {row[1]} data sets",
        "n": lambda row: _counts(places, row[0]) if row[1] is None else str(row[1]),
    }
    return listing(rows, {**first, **columns})


def _entry(place: Place, quantity: FamilyColumn, row: tuple[Variant, int | None]) -> str:
    cell, n = row[0].stored_cell(place), row[1]
    shown = cell is not None and (n is None or cell.n > n)
    return quantity.text(quantity.value(cell, n, None)) if cell and shown else MISSING


def _combinations(family: Family) -> list[str | Rows]:
    """Return the errors of combinations of settings on the same data, one column per value of the second setting."""
    settings, names = family.combinations.settings, family.names
    if len(settings) < 2:
        return []

    def values(variant: Variant) -> dict[str, Any]:
        return {name: variant.settings.get(name, names.usual[name]) for name in settings}

    def order(variant: Variant) -> list[float]:
        value = values(variant)
        return [names.order(name, value[name]) for name in (*settings[:1], *settings[2:], *settings[1:2])]

    def row(variant: Variant) -> Texts:
        return {_words(name): names.of(name, value) for name, value in values(variant).items() if name != settings[1]}

    def entry(variant: Variant) -> Texts:
        cell, text = variant.stored_cell(PLACE), MISSING
        if cell:
            errors = (ACCURACY[f"{name}_excess"] for name in (STIFFNESS, DAMPING))
            both = ", ".join(error.text(error.value(cell, n, None)) for error in errors)
            text = f"{both} ({number(finite_median(cell.cpu_s))} s)"
        return {names.of(settings[1], values(variant)[settings[1]]): text}

    combined = [item for variant in family.combinations.rows for item in values(variant).items()]
    members = [v for v in family.variants if v.method == family.method and set(v.settings) <= set(settings)]
    shown = [variant for variant in members if all(item in combined for item in values(variant).items())]
    n = min((cell.n for variant in shown if (cell := variant.stored_cell(PLACE))), default=0)
    explanation = (
        f"Errors of k/m and c/m over the bound on the first {n} data sets ({PLACE[0]:g} dB, initial state {PLACE[1]}), "
        "and processor seconds of a whole fit."
    )
    heading = f"## Combinations of {', '.join(map(_words, settings))}"
    return [heading, explanation, Panel(entry, row, order=order).rows(shown)] if shown else []


def _words(setting: str) -> str:
    return setting.replace("_", " ")


# ---- sources


def _sources(family: Family) -> str:
    """List the source of every choice in the table, then other packages, with the versions that were used."""
    members = [variant for variant in family.variants if variant.method == family.method]
    lines = []
    for setting, values in cards()[family.method].choices.items():
        for value in values:  # loads a choice of another package only if a row uses it
            users = [v for v in members if v.settings.get(setting, family.names.usual[setting]) == value]
            if users:
                choice = values[value]
                package = f" ({_versions(choice.package, users)})" if choice.package else ""
                lines.append(f"{choice.title}: {choice.source}{package}")
    others = next((section.rows for section in family.sections if section.heading == "Other packages"), ())
    for variant in others:
        method = load_method(variant.method)
        packages = ", ".join(_versions(name, [variant]) for name in method.requires)
        lines.append(f"{variant.title}: {method.card.settings_source}" + (f" ({packages})" if packages else ""))
    return "\n".join(f"- {line}" for line in dict.fromkeys(lines))


def _versions(package: str, users: Iterable[Variant]) -> str:
    """Return a package with the version that computed the stored cells, if they state one."""
    stored = [cell.stored.provenance.get("packages", {}) for v in users for cell in v.cells.values() if cell.stored]
    names = (package, package.replace("-", "_"))
    versions = {str(packages[name]).partition("+")[0] for packages in stored for name in names if name in packages}
    return f"{package} {', '.join(sorted(versions))}".strip()
