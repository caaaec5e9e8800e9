"""The ranking of what other commands wrote beside the site: the measured track, and the online track."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
import pandas as pd

from bench.entrants.online import online_card
from bench.errors import InputError
from bench.reporting.page.situations import Advice
from bench.reporting.ranking import LOST, Fits, capped, ranked


def elsewhere(folder: Path) -> list[Advice]:
    """Rank the methods of the measured track and of the online track, as far as ``folder`` has their tables."""
    ranked = []
    for name, (rank, columns) in TABLES.items():
        with contextlib.suppress(OSError, ValueError):  # there is no such table, or it has other columns
            ranked.append(rank(pd.read_csv(folder / name, usecols=columns)))
    return [one for one in ranked if one.ranking]


def measured(table: pd.DataFrame) -> Advice:
    """Rank methods on real records, whose truth nobody knows, by what they leave unexplained of samples held out.

    It is divided by the least of all methods on the record. An answer that its own checks withdraw is lost.
    """
    fits = table[table.status.notna() & (table.status != "unsupported")]  # without a status: all records together
    fits = fits.drop_duplicates(["set", "system", "method", "sibling"])
    stands = (fits.status == "ok") & (fits.trust != "do not trust") & fits.held_out.notna()
    unexplained = (100 - fits.held_out).where(stands)
    by_record = unexplained.groupby([fits.set, fits.system, fits.sibling])
    excess = (unexplained / by_record.transform("min")).fillna(1.0)  # of the best that leaves nothing
    fits = fits.assign(loss=np.where(stands, capped(excess), LOST), record=fits.set + fits.system)
    return Advice(
        "A real record of a rig",
        "results/table11.md",
        ranked(_losses(fits)),
        fits.wall_s.where(fits.status == "ok").groupby(fits.method).median().to_dict(),
        basis=f"{by_record.ngroups} records of rigs",
        error="of held-out samples, over the least of any method",
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
        needs="a first guess",
    )


def _losses(fits: pd.DataFrame) -> Fits:
    """Return the losses by method and record."""
    records = fits.record.unique()
    return {
        method: [own.loss[own.record == record].to_numpy() for record in records]
        for method, own in fits.groupby("method")
    }


def _title(label: str) -> str:
    """Return a tracker's name for people, where it is registered."""
    try:
        return online_card(label).title
    except InputError:
        return label.replace("_", " ")


TABLES = {
    "table11.csv": (measured, ("set", "system", "method", "sibling", "status", "trust", "held_out", "wall_s")),
    "table10.csv": (online, ("scenario", "method", "quantity", "excess", "micros_median")),
}
"""By file, what ranks it, and of which columns."""
