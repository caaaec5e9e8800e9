"""Tables of experiments, by the form that ``table`` in ``conf/experiment`` names."""

from __future__ import annotations

from collections.abc import Mapping

from bench.reporting.frame import Frame
from bench.reporting.tables.estimates import CALIBRATION, MISSPECIFIED, OPEN, PAPER, ROBUSTNESS
from bench.reporting.tables.family import family_table
from bench.reporting.tables.leaderboard import leaderboard
from bench.reporting.tables.systems import SYSTEMS

FORMS = {
    "paper": PAPER.files, "calibration": CALIBRATION.files, "systems": SYSTEMS.files, "robustness": ROBUSTNESS.files,
    "misspecified": MISSPECIFIED.files, "family": family_table,
    "open": lambda frame: {**OPEN.files(frame), **leaderboard(frame)},
}  # fmt: skip


def table_files(frame: Frame) -> Mapping[str, str]:
    """Return the files of an experiment's table by name; none if nothing is stored."""
    return FORMS[frame.form](frame)
