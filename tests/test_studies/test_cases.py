"""The study of records with a known truth: every kind can be drawn, and an answer is judged by what it states."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bench.records.intervals import StatedInterval
from tests.studies.cases.__main__ import judged
from tests.studies.cases.kinds import KINDS, Case


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_a_kind_is_drawn_by_its_seed_with_a_truth(kind: str, tmp_path: Path) -> None:
    case, again = (KINDS[kind](np.random.default_rng(5), tmp_path) for _ in range(2))
    assert case.truth == again.truth
    assert all(true is None or 0 < true < np.inf for true in case.truth.values())
    for path in [case.data] if isinstance(case.data, Path) else case.data if isinstance(case.data, list) else []:
        assert path.stat().st_size > 500


def answer(
    value: float, low: float, high: float, trust: str = "trust", said: str = "", limit: str = ""
) -> SimpleNamespace:
    own = StatedInterval(value, low, high, low, high, low, high, "1/s²", limit)
    return SimpleNamespace(estimates={"k_over_m": own}, trust=trust, notes=(said,), reasons=(), message="")


CASE = Case(None, {"k_over_m": 100.0})


@pytest.mark.parametrize(
    ("case", "found", "outcome"),
    [
        (CASE, answer(101, 99, 103), "right"),
        (CASE, answer(102, 100.5, 103.5), "missed"),
        (CASE, answer(104, 103.5, 104.5), "WRONG AND TRUSTED"),
        (CASE, answer(104, 103.5, 104.5, "use with caution"), "wrong"),
        (CASE, answer(104, 20, 450), "wide"),
        (CASE, answer(130, 90, 170), "wide"),
        (CASE, answer(102, 0, 140, limit="at most"), "right"),
        (CASE, answer(20, 0, 30, limit="at most"), "WRONG AND TRUSTED"),
        (CASE, answer(100, 99, 101, "do not trust"), "refused"),
        (CASE, "data=x.csv: refused", "refused"),
        (CASE, ValueError("broken"), "crashed"),
        (Case(None, {"k_over_m": 100.0}, says="twice"), answer(100, 99, 101), "unsaid"),
        (Case(None, {"k_over_m": 100.0}, says="twice"), answer(100, 99, 101, said="pasted twice"), "right"),
        (Case(None, {"k_over_m": 100.0}, says="twice", refusal=True), "data=x.csv: pasted twice", "honest"),
        (Case(None, {"k_over_m": 100.0}, refusal=True, never=True), answer(100, 99, 101), "WRONG AND TRUSTED"),
        (Case(None, {}, never=True, frequencies=(2.0, 7.0)), answer(1, 0.9, 1.1, "use with caution"), "wrong"),
        (
            Case(None, {}, never=True, frequencies=(2.0, 7.0)),
            answer(1, 0.9, 1.1, "use with caution", "modes at 2.01 Hz and 6.99 Hz"),
            "honest",
        ),
    ],
)  # fmt: skip
def test_an_answer_is_judged_by_its_intervals_and_what_it_says(case: Case, found: object, outcome: str) -> None:
    assert judged(case, found).outcome == outcome
