"""The tables of experiments: each in the form that its ``table`` in ``conf/experiment`` names."""

from __future__ import annotations

from collections.abc import Mapping

from bench.reporting.frame import Frame
from bench.reporting.tables.calibration import calibration_table
from bench.reporting.tables.family import family_table
from bench.reporting.tables.leaderboard import leaderboard
from bench.reporting.tables.misspecified import misspecified_table
from bench.reporting.tables.open_split import open_table
from bench.reporting.tables.paper_tables import paper_table
from bench.reporting.tables.robustness import robustness_table
from bench.reporting.tables.systems import system_table
from bench.store.store import Store

FORMS = {
    "paper": paper_table, "calibration": calibration_table, "systems": system_table, "open": open_table,
    "misspecified": misspecified_table, "family": family_table,
}  # fmt: skip


def table_files(frame: Frame, store: Store) -> Mapping[str, str]:
    """The files of an experiment's table by name; none where the store holds no cell of it.

    ``store`` is for what stands beside a table's own cells: the undisturbed ones of a disturbed cell.
    """
    form = str(frame.table.get("form", "paper"))
    ranking = leaderboard(frame) if form == "open" else {}
    return robustness_table(frame, store) if form == "robustness" else {**FORMS[form](frame), **ranking}
