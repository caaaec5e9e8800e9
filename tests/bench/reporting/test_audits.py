"""The page of audits: the claims of ``claims/``, the paper's numbers as printed, and what is published of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bench.audit.evidence import audit
from bench.commands.audit import read
from bench.reporting.audits import PAPER, audit_files, paper_verdicts
from bench.reporting.paper import printed

REPOSITORY = Path(__file__).parents[3]
CLAIMS = sorted((REPOSITORY / "claims").glob("*.yaml"))
FORMS = {"rmse": ("x", "rmse"), **{f"{q}_error_pct": (q, "percent error") for q in "mck"}}


def test_the_papers_claim_has_its_numbers() -> None:
    """Those of its tables, in their order, at their noise."""
    stated = read(REPOSITORY / "claims" / f"{PAPER}.yaml")
    rows = [(f"Table {p.table}", *FORMS[p.metric], p.value) for p in printed()]
    assert [(r.place, r.quantity, r.form, r.value) for r in stated.claim.reported] == rows
    noise = [stated.situations[r.case, ""].setting.noise.value[0] for r in stated.claim.reported]
    assert noise == [p.snr_db for p in printed()]


def test_the_papers_bounds_are_those_of_its_tables() -> None:
    """The displacement's bound of Table 5, which the scenarios give by a computation of their own."""
    published = pd.read_csv(REPOSITORY / "results" / "table5.csv", low_memory=False).query("method == 'bound'")
    ours = pd.read_csv(REPOSITORY / "results" / "audits.csv").query("claim == @PAPER and quantity == 'x'")
    for state, reading in (("known", ours.reading.isna()), ("unknown", ours.reading == "initial state unknown")):
        wanted = published[(published.initial_state == state) & (published.metric == "rmse")].set_index("row").bound
        for db in (40, 30, 10, 5):
            bound = ours[reading & (ours.case == f"{db} dB")].bound.item()
            assert bound == pytest.approx(wanted[db], rel=0.005)  # other times at which it is scored


def test_the_page_says_what_the_claims_give() -> None:
    """Three claims anew, one of them with data that are not those of its equation."""
    names = ("hungtrannam2025", "moseley2022", "rao2023")
    files = audit_files([audit(read(REPOSITORY / "claims" / f"{name}.yaml")) for name in names], REPOSITORY / "results")
    page = (REPOSITORY / "results" / "audits.md").read_text()
    for section in files["audits.md"].split("\n## ")[1:]:
        for line in section.split("\n\nRegenerate")[0].splitlines():
            assert line in page
    published = pd.read_csv(REPOSITORY / "results" / "audits.csv")
    assert set(published.claim) == {path.stem for path in CLAIMS}
    assert "data and equation differ" in next(
        line for line in page.splitlines() if line.startswith("| [hungtrannam2025]")
    )
    ours = published[published.claim == PAPER]
    assert ours.replicates.dropna().tolist() == paper_verdicts(REPOSITORY / "results")
    assert np.sum(ours.reading.isna()) == 59
