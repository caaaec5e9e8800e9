"""Rankings of the measured track and of the online track, from their tables."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
import pandas as pd

from bench.entrants.online import online_card
from bench.errors import InputError
from bench.reporting.page.situations import Advice
from bench.reporting.ranking import LOST, Fits, capped, ranked


def track_rankings(folder: Path) -> list[Advice]:
    """Rank the methods of the measured track and of the online track, if ``folder`` contains their tables."""
    rankings = []
    for name, (rank, columns) in TABLES.items():
        with contextlib.suppress(OSError, ValueError):  # there is no such table, or it has other columns
            rankings.append(rank(pd.read_csv(folder / name, usecols=columns)))
    return [advice for advice in rankings if advice.ranking]


def measured(table: pd.DataFrame) -> Advice:
    """Rank methods on measured records, whose true values are unknown, by their prediction of held-out samples.

    The unexplained part is divided by the smallest of all methods on the record. An estimate that is rejected by its
    checks counts as an outlier fit.
    """
    fits = table[table.status.notna() & (table.status != "unsupported")]  # lines over all records have no status
    fits = fits.drop_duplicates(["set", "system", "method", "sibling"])
    usable = (fits.status == "ok") & (fits.trust != "do not trust") & fits.held_out.notna()
    unexplained = (100 - fits.held_out).where(usable)
    by_record = unexplained.groupby([fits.set, fits.system, fits.sibling])
    excess = (unexplained / by_record.transform("min")).fillna(1.0)  # 0/0 where the best leaves nothing unexplained
    fits = fits.assign(loss=np.where(usable, capped(excess), LOST), record=fits.set + fits.system)
    return Advice(
        "A measured record",
        "results/table11.md",
        ranked(_losses(fits)),
        fits.wall_s.where(fits.status == "ok").groupby(fits.method).median().to_dict(),
        basis=f"{by_record.ngroups} measured records",
        error="held-out samples, relative to the best method",
    )


def online(table: pd.DataFrame) -> Advice:
    """Rank trackers by their error over the bound along the path."""
    lines = table[table.quantity.notna() & (table.method != "bound")]
    lines = lines.assign(
        loss=capped(lines.excess.fillna(np.inf)), record=lines.scenario, method=lines.method.map(_title)
    )
    return Advice(
        "Parameters that change while the data arrive",
        "results/table10.md",
        ranked(_losses(lines)),
        (lines.micros_median / 1e6).groupby(lines.method).median().to_dict(),
        basis=f"{lines.scenario.nunique()} scenarios",
        needs="an initial guess",
    )


def _losses(fits: pd.DataFrame) -> Fits:
    """Return the losses by method and record."""
    records = fits.record.unique()
    return {
        method: [lines.loss[lines.record == record].to_numpy() for record in records]
        for method, lines in fits.groupby("method")
    }


def _title(label: str) -> str:
    """Return the title of a tracker, or its label if it is not registered."""
    try:
        return online_card(label).title
    except InputError:
        return label.replace("_", " ")


TABLES = {
    "table11.csv": (measured, ("set", "system", "method", "sibling", "status", "trust", "held_out", "wall_s")),
    "table10.csv": (online, ("scenario", "method", "quantity", "excess", "micros_median")),
}
"""Functions that rank the methods of a table, and the columns they read, by file."""
