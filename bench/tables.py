"""``python -m bench.tables``: the tables of all experiments as Markdown, CSV and LaTeX, from stored rows alone.

A table is what its experiment in ``conf`` describes; a cell that the store lacks is a row that says so. Tables 2 to 5
are made here; an experiment whose ``table`` names another form has it made there (see :func:`table_files`).
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from tabulate import tabulate

from bench.cell import Cell
from bench.cli import read_fields
from bench.compare import Comparison, against_best
from bench.config import choices, expand, jobs_to_cells
from bench.errors import InputError
from bench.plan import State, plan
from bench.reference import REFERENCES
from bench.registry import load_method
from bench.rounding import excess_text, number
from bench.statistics import RESAMPLES
from bench.store import Store, StoredCell
from bench.store_archive.opening import DEFAULT_STORE, open_store
from bench.terminal import command
from bench.verdict import Verdict, judge

USAGE = f"usage: python -m bench.tables [store={DEFAULT_STORE}] [archive=<folder>|none] [out=results]"
COLUMNS = (
    "table", "row", "system", "initial_state", "snr_db", "method", "metric", "mean", "median", "ci_low", "ci_high",
    "bound", "prior_share", "excess", "n_ok", "n", "paper", "verdict",
)  # fmt: skip
PRIMARY = ("k_over_m_error_pct", "c_over_m_error_pct", "rmse")
"""The metrics that methods are ranked on: what the data tell."""
GROSS = 2.0
"""A method whose excess is this many times the best's is not marked as tied: it fails grossly now and then."""
METRICS = ("k_over_m_error_pct", "c_over_m_error_pct", "rmse", "m_error_pct", "c_error_pct", "k_error_pct")
HEADINGS = ("k/m error %", "c/m error %", "RMSE (m)", "m error %", "c error %", "k error %")
TITLES = {
    "prior": "prior (no data)", "oracle": "oracle", "bound": "bound", "shooting": "Multiple shooting",
    "mcmc": "Bayesian MCMC", "nuts": "Bayesian NUTS", "pinn": "PINN", "pinn_adam": "PINN (paper's training)",
    "pinn_ensemble": "PINN, ensemble (paper's way)", "collocation": "Spline collocation",
    "collocation_bootstrap": "Spline collocation, bootstrap", "output_error": "Output error, one cold start",
    "matrix_pencil": "Matrix pencil", "log_decrement": "Logarithmic decrement", "ls": "LS, finite differences",
    "ls_spline": "LS, smoothing spline", "rls": "RLS", "sindy": "SINDy", "ddnn": "DDNN",
    "ekf": "Extended Kalman filter", "ukf": "Unscented Kalman filter", "era": "Eigensystem realisation",
}  # fmt: skip
PAPER_METHODS = {"ls": "ls", "rls": "rls", "ddnn": "ddnn", "pinn_adam": "pinn", "pinn": "pinn"}
"""Which of the paper's methods a method of ours is compared with."""
LEGEND = """Each entry: median over the replicates, and after × the excess: root mean square error over the bound, 1
being the best that an unbiased method can do. The row *bound* gives the Cramér-Rao bound on the root mean square (a
median lies below a root mean square: about 0.67 of it for a normal error), and below it how much of its variance is
the prior's: 0 % is told by the data, 100 % by the prior alone (`python -m bench.identifiability` says more). *oracle*
is maximum a posteriori started at the truth, *prior* the nominal values without any data. Free vibration tells k/m
and c/m only: m, and what follows from it, is decided by the prior. All 95 % intervals are in the CSV. A failed
replicate counts as an infinite error in medians; the excess is over the successful ones, and ×>1e6 where some ran
away. Bold: the method of least median error, and all that cannot be told from it on the same data (Wilcoxon's
signed-rank test, Holm's adjustment, 5 %) or are less than 2 % from it, unless gross errors now and then double its
excess. Told: what a method uses beyond the data; *start* where it is known, *prior* natively, or *after*, by one step
that all such methods share."""


@dataclass(frozen=True)
class Entry:
    """One cell of a table: where it stands, and what the store holds of it."""

    row: str
    cell: Cell
    stored: StoredCell | None


@cache
def paper_numbers() -> pd.DataFrame:
    """The paper's Tables 2 to 5, with the source in the file's first lines."""
    with as_file(files("bench").joinpath("data", "paper_tables.csv")) as path:
        return pd.read_csv(path, comment="#")


def paper_value(table: int, row: str, method: str, metric: str) -> float:
    """The paper's number for a table's row, method and metric; NaN where it has none."""
    numbers = paper_numbers()
    column = "displacement_rmse" if metric == "rmse" else metric
    if column not in numbers or method not in PAPER_METHODS:
        return math.nan
    theirs = numbers[(numbers.table == table) & (numbers.method == PAPER_METHODS[method])]
    if table in (4, 5):
        theirs = theirs[theirs.row == row]
    return float(theirs[column].iloc[0]) if len(theirs) else math.nan


def _row_name(table: int, cell: Cell) -> str:
    if table == 4:
        return cell.scenario.label.rpartition("_")[2]
    return {2: "identified", 3: "comparison"}.get(table, f"{cell.scenario.snr_db:g}")


def table_experiments() -> list[str]:
    """The experiments that describe a table."""
    from bench.config import _experiment

    return [name for name in choices("experiment") if _experiment(name).get("table")]


def described_cells(experiment: str) -> tuple[str, list[Cell]]:
    """Title of an experiment's table, and its cells in order."""
    from bench.config import _experiment

    cells = jobs_to_cells(expand([f"experiment={experiment}"], multirun=True))
    return str(_experiment(experiment)["table"]["title"]), cells


def entries(experiment: str, store: Store) -> tuple[int, str, list[Entry]]:
    """Number and title of an experiment's table, and its cells in order with what the store holds of each."""
    from bench.config import _experiment

    number_ = int(_experiment(experiment)["table"]["number"])
    title, cells = described_cells(experiment)
    return number_, title, [Entry(_row_name(number_, cell), cell, store.load(cell.identity)) for cell in cells]


def tidy(table: int, found: Sequence[Entry]) -> pd.DataFrame:
    """The table as one line a metric: every method, the bound, and the paper's number with its verdict."""
    oracles = {_place(e): e.stored for e in found if e.cell.method == "oracle" and e.stored}
    lines: list[dict[str, Any]] = []
    bounded: set[tuple[str, str]] = set()
    for entry in found:
        if entry.stored is not None and _place(entry) not in bounded:
            bounded.add(_place(entry))
            lines += _bound_lines(table, entry, entry.stored)
        lines += _lines(table, entry, oracles.get(_place(entry)))
    return pd.DataFrame(lines, columns=list(COLUMNS))


def _place(entry: Entry) -> tuple[str, str]:
    return entry.row, entry.cell.scenario.told


def _head(table: int, entry: Entry) -> dict[str, Any]:
    scenario = entry.cell.scenario
    return {
        "table": table, "row": entry.row, "system": scenario.label, "initial_state": scenario.told,
        "snr_db": scenario.snr_db, "method": entry.cell.label,
    }  # fmt: skip


def _bound_lines(table: int, entry: Entry, stored: StoredCell) -> Iterable[dict[str, Any]]:
    for metric, summary in stored.summary.items():
        if math.isfinite(summary["bound"]):
            share = stored.prior_share.get(metric.removesuffix("_error_pct"), math.nan)
            line = {"method": "bound", "metric": metric, "bound": summary["bound"], "prior_share": share}
            yield {**_head(table, entry), **line}


def _lines(table: int, entry: Entry, oracle: StoredCell | None) -> Iterable[dict[str, Any]]:
    if entry.stored is None:
        for metric in METRICS:
            yield {**_head(table, entry), "metric": metric, "n_ok": 0, "n": 0, "verdict": "not run"}
        return
    for metric, summary in entry.stored.summary.items():
        if metric == "realised_snr_db":
            continue
        paper = paper_value(table, entry.row, entry.cell.label, metric)
        yield {
            **_head(table, entry),
            "metric": metric,
            **{key: summary[key] for key in ("mean", "median", "ci_low", "ci_high", "bound", "excess")},
            "n_ok": entry.stored.n_ok,
            "n": len(entry.stored.rows),
            "paper": paper,
            "verdict": _verdict(paper, entry.stored, oracle, metric),
        }


def errors_of(stored: StoredCell, metric: str) -> np.ndarray:
    """A metric's errors, replicate by replicate; infinite where a replicate failed."""
    return np.array([row.scores.get(metric, math.inf) for row in stored.rows])


def _verdict(paper: float, stored: StoredCell, oracle: StoredCell | None, metric: str) -> str:
    if math.isnan(paper):
        return ""
    return judged(paper, stored, oracle, metric).text if oracle else "no oracle stored"


def judged(paper: float, stored: StoredCell, oracle: StoredCell, metric: str) -> Verdict:
    """The verdict of a cell on a printed number."""
    # the prior's part of this method's own mean square error: a method that is far off is so for other reasons
    excess = stored.summary[metric]["excess"]
    share = stored.prior_share.get(metric.removesuffix("_error_pct"), 0.0) / max(excess**2, 1.0)
    return judge(paper, errors_of(stored, metric), errors_of(oracle, metric), share)


def markdown(table: int, title: str, data: pd.DataFrame, found: Sequence[Entry]) -> str:
    """The table for reading: a panel for each reading of the initial state, then the paper's numbers with verdicts."""
    parts = [f"# Table {table}. {title}", LEGEND]
    for told in dict.fromkeys(data.initial_state):
        parts.append(f"## Initial state {told}")
        comparisons = ranked(found, told)
        panel = _panel(table, data[data.initial_state == told], comparisons, told_classes(found))
        parts.append(tabulate(*panel, tablefmt="github", disable_numparse=True))
        parts.append(_resolved(comparisons))
    parts.append("## The paper's numbers")
    parts.append(
        "A verdict says where the paper's number falls among our replicates (known start): between their 5 % and 95 % "
        f"quantiles as a single run, and likewise among means of as many ({RESAMPLES} resamples)."
    )
    parts.append(_paper_panel(data))
    notes = failure_notes(found)
    parts += [f"## What failed\n\n{notes}"] if notes else []
    command = f"python -m bench -m experiment=table{table} && python -m bench.tables"
    parts.append(f"Regenerate: `{command}`")
    return "\n\n".join(parts) + "\n"


Ranking = Mapping[tuple[str, str], tuple[str, list[Comparison]]]
"""By row and metric: the best method, and the others compared with it."""


def ranked(found: Sequence[Entry], told: str) -> Ranking:
    """The methods of each row of one panel compared on the metrics they are ranked on; reference rows apart."""
    ranking = {}
    own = [e for e in found if e.cell.scenario.told == told and e.stored and e.cell.method not in REFERENCES]
    for row in dict.fromkeys(entry.row for entry in own):
        stored = {e.cell.label: e.stored for e in own if e.row == row and e.stored}
        for metric in PRIMARY:
            values = {label: errors_of(cell, metric) for label, cell in stored.items()}
            if len(values) > 1:
                ranking[row, metric] = against_best(values)
    return ranking


def _resolved(ranking: Ranking) -> str:
    """What these replicates could tell apart."""
    pairs = [c for _, found in ranking.values() for c in found if math.isfinite(c.resolved)]
    if not pairs:
        return ""
    low, high = min(pairs, key=lambda c: c.resolved), max(pairs, key=lambda c: c.resolved)
    names = [TITLES.get(c.a, c.a) for c in (low, high)]
    return (
        "The smallest ratio of errors to the best method's that these replicates would tell from 1 with 80 % "
        f"probability: from {low.resolved:.3f} ({names[0]}) to {high.resolved:.2f} ({names[1]})."
    )


def told_classes(found: Sequence[Entry]) -> dict[str, str]:
    """By label, what a method was told beyond the data: the start where it is known, and the prior.

    ``prior after``: it returns the identifiable groups only, and the shared step combines them with the prior.
    """
    classes = {"oracle": "truth as start", "prior": "prior only"}
    for entry in found:
        if entry.cell.method not in REFERENCES:
            card = load_method(entry.cell.method).card
            start = "start, " if card.start == "used when known" else ""
            classes[entry.cell.label] = start + ("prior" if card.scale == "native" else "prior after")
    return classes


def _panel(
    table: int, data: pd.DataFrame, ranking: Ranking, classes: Mapping[str, str]
) -> tuple[list[list[str]], list[str]]:
    first = {4: "set", 5: "SNR (dB)"}.get(table)
    rows: list[list[str]] = []
    for (row, method), lines in data.groupby(["row", "method"], sort=False):
        by_metric = lines.set_index("metric")
        cells = [_entry(by_metric, metric, method == "bound") for metric in METRICS]
        excess = {metric: _excesses(data, row, metric) for metric in PRIMARY}
        cells = [
            f"**{cell}**" if leads(ranking.get((str(row), metric)), str(method), excess.get(metric, {})) else cell
            for cell, metric in zip(cells, METRICS, strict=True)
        ]
        n = by_metric.n.iloc[0]
        ok = "" if method == "bound" else f"{by_metric.n_ok.iloc[0]:.0f}/{n:.0f}" if n else "not run"
        head = [str(row)] if first else []
        rows.append([*head, TITLES.get(str(method), str(method)), *cells, classes.get(str(method), ""), ok])
        if method == "bound":
            shares = [f"{100 * by_metric.prior_share.get(metric, math.nan):.0f} %" for metric in METRICS]
            rows.append([*head, "of it from the prior", *("-" if s == "nan %" else s for s in shares), "", ""])
    return rows, [*([first] if first else []), "method", *HEADINGS, "told", "ok"]


def _excesses(data: pd.DataFrame, row: Any, metric: str) -> dict[str, float]:
    own = data[(data.row == row) & (data.metric == metric)]
    return dict(zip(own.method, own.excess, strict=True))


def leads(ranking: tuple[str, list[Comparison]] | None, method: str, excess: Mapping[str, float]) -> bool:
    """Whether a method is the best of its row, or tied with it and free of the gross errors that ranks do not see."""
    if ranking is None:
        return False
    best, others = ranking
    gross = excess.get(method, math.nan) > GROSS * excess.get(best, math.nan)
    return method == best or (not gross and any(c.a == method and c.tie for c in others))


def _entry(by_metric: pd.DataFrame, metric: str, is_bound: bool) -> str:
    if metric not in by_metric.index:
        return "-"
    line = by_metric.loc[metric]
    if is_bound:
        return number(line.bound)
    text = number(line["median"])
    if math.isfinite(line.excess):
        text += f" ×{excess_text(line.excess)}"
    # the paper's own reading is the known start; its numbers stand beside that panel only
    beside = math.isfinite(line.paper) and line.initial_state == "known"
    return f"{text} (paper {number(line.paper)})" if beside else text


def _paper_panel(data: pd.DataFrame) -> str:
    lines = data[data.paper.notna() & (data.initial_state == "known")]
    rows = [
        [
            line["row"],
            TITLES.get(line.method, line.method),
            HEADINGS[METRICS.index(line.metric)],
            number(line.paper),
            f"{number(line['median'])} ({number(line.ci_low)} to {number(line.ci_high)})",
            number(line.bound),
            line.verdict,
        ]
        for _, line in lines.iterrows()
    ]
    headers = ["row", "method", "metric", "paper", "ours, median (95 %)", "bound", "verdict"]
    return tabulate(rows, headers=headers, tablefmt="github", disable_numparse=True)


def failure_notes(found: Sequence[Entry]) -> str:
    """What failed, how often and with what sentence, as a list; empty where nothing did."""
    notes: dict[str, int] = {}
    for entry in found:
        for row in entry.stored.rows if entry.stored else ():
            if row.status.value != "ok":
                text = f"{TITLES.get(entry.cell.label, entry.cell.label)}: {row.status.value}, {row.message}"
                notes[text] = notes.get(text, 0) + 1
    missing = sum(entry.stored is None for entry in found)
    lines = [f"- {n} × {text}" for text, n in notes.items()]
    lines += [f"- {missing} cells were not run"] if missing else []
    return "\n".join(lines)


def latex(table: int, title: str, data: pd.DataFrame, found: Sequence[Entry]) -> str:
    """Both panels as LaTeX (booktabs), for an article."""
    parts = []
    for told in dict.fromkeys(data.initial_state):
        panel = _panel(table, data[data.initial_state == told], ranked(found, told), told_classes(found))
        caption = f"{title} (initial state {told}). Median, and root mean square error over the Cramér-Rao bound."
        parts.append(latex_table(caption, *panel))
    return f"% needs the package booktabs\n% regenerate: python -m bench.tables\n{''.join(parts)}"


def latex_table(caption: str, rows: Sequence[Sequence[str]], headers: Sequence[str]) -> str:
    """One table of Markdown's cells as LaTeX."""
    body = tabulate(rows, headers, tablefmt="latex_booktabs", disable_numparse=True)
    body = re.sub(r"\*\*(.+?)\*\*", r"\\textbf{\1}", body.replace("×", r"$\times$").replace("é", r"\'e"))
    for plain, escaped in (("é", r"\'e"), ("%", r"\%"), ("_", r"\_")):
        caption = caption.replace(plain, escaped)
    return f"\\begin{{table}}\n\\centering\n\\small\n\\caption{{{caption}}}\n{body}\n\\end{{table}}\n"


def paper_table(experiment: str, store: Store) -> dict[str, str]:
    """The files of a table of the paper by name; none where the store holds no cell of it."""
    number_, title, found = entries(experiment, store)
    if all(entry.stored is None for entry in found):
        return {}
    data = tidy(number_, found)
    return {
        f"table{number_}.md": markdown(number_, title, data, found),
        f"table{number_}.csv": data.to_csv(index=False, float_format="%.6g"),
        f"table{number_}.tex": latex(number_, title, data, found),
    }


def table_files(experiment: str, store: Store) -> dict[str, str]:
    """The files of an experiment's table by name, made by the form that its ``table`` names; none without cells."""
    from bench.calibration import calibration_table
    from bench.config import _experiment
    from bench.robustness import robustness_table  # here, since these build on this module
    from bench.system_tables import system_table

    forms = {
        "paper": paper_table,
        "robustness": robustness_table,
        "calibration": calibration_table,
        "systems": system_table,
    }
    return forms[_experiment(experiment)["table"].get("form", "paper")](experiment, store)


def write_tables(store: Store, out: Path, experiments: Sequence[str]) -> list[Path]:
    """Write the tables that have any stored cell; returns the paths written."""
    written = []
    for experiment in experiments:
        contents = table_files(experiment, store)
        if not contents:
            print(f"{experiment}: no cells stored; run python -m bench -m experiment={experiment}", file=sys.stderr)
            continue
        _say_stale(experiment, store)
        for name, content in contents.items():
            path = out / name
            path.write_text(content, encoding="utf-8")
            written.append(path)
    return written


def _say_stale(experiment: str, store: Store) -> None:
    """A line on the error stream where a table rests on cells that other code or packages computed."""
    planned = plan(described_cells(experiment)[1], store)
    stale = [one for one in planned if one.state is State.STALE]
    if stale:
        said = f"{len(stale)} of {len(planned)} cells are stale ({stale[0].why[:100]})"
        print(f"{experiment}: {said}; python -m bench -m experiment={experiment} computes them again", file=sys.stderr)


def main(argv: Sequence[str] | None = None) -> int:
    """``python -m bench.tables [store=...] [archive=...] [out=results]``; exit status 2 for bad input."""
    return command("bench.tables", f"{USAGE}\n\n{__doc__}", argv, _main)


def _main(arguments: Sequence[str]) -> int:
    from bench.leaderboard import leaderboard  # here, since it builds on this module

    fields = read_fields(arguments, {"store": DEFAULT_STORE, "archive": "", "out": "results"})
    store, out = open_store(fields["store"], fields["archive"]), Path(fields["out"])
    if not store.there():
        raise InputError("store", store.folder, "there is no such folder; run some cells first")
    Store(out).prepare()
    for path in write_tables(store, out, table_experiments()):
        print(path)
    for name, content in leaderboard(store).items():
        (out / name).write_text(content, encoding="utf-8")
        print(out / name)
    return 0


if __name__ == "__main__":
    sys.exit(main())
