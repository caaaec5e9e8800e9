"""The verdict under a cell's table: of summaries that are made to be good, biased, overconfident or silent."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy import stats

from bench import Estimate, Normal, Status
from bench.information.fisher import compute_bound
from bench.reporting.verdict import good, verdict
from bench.scenario.scenario import Scenario
from bench.scoring.row import Row
from bench.scoring.score import score
from bench.scoring.summary import summarise
from bench.store.stored import StoredCell


def cell(excess: dict[str, float], cover: dict[str, float], ok: int = 100, silent: int = 0) -> StoredCell:
    rows = [Row(i, Status.OK if i < ok else Status.DIVERGED) for i in range(ok + silent)]
    summary: dict[str, Any] = {f"{name}_error_pct": {"excess": value} for name, value in excess.items()}
    summary |= {f"{name}_coverage_95": {"mean": value} for name, value in cover.items()}
    return StoredCell("0" * 20, {}, rows, summary, {}, {"m": False}, 0.0)


GOOD = {"k_over_m": 1.05, "c_over_m": 0.98}
COVER = {"k_over_m": 0.95, "c_over_m": 0.93}


@pytest.mark.parametrize(
    ("excess", "cover", "said"),
    [
        (GOOD, COVER, "on the bound; intervals hold"),
        # 100 errors: a root mean square is within about 14 % of its own, so 1.3 may be chance and 1.5 may not
        ({**GOOD, "k_over_m": 1.3}, COVER, "on the bound; intervals hold"),
        ({**GOOD, "k_over_m": 1.5}, COVER, "1.50 times the bound in k/m, on it in others; intervals hold"),
        ({"k_over_m": 9.0, "c_over_m": 2.0}, COVER, "9.00 times the bound in k/m; intervals hold"),
        # of 100 intervals at 95 % fewer than 90 hold in less than one case of 40
        (GOOD, {**COVER, "c_over_m": 0.90}, "on the bound; intervals hold"),
        (GOOD, {**COVER, "c_over_m": 0.89}, "on the bound; 95 % intervals of c/m hold in 89 %"),
        (GOOD, {}, "on the bound; no intervals are told"),
        # what the prior alone tells is not the method's
        ({**GOOD, "m": 30.0}, {**COVER, "m": 0.1}, "on the bound; intervals hold"),
    ],
)
def test_it_says_what_the_numbers_say(excess: dict[str, float], cover: dict[str, float], said: str) -> None:
    assert verdict(cell(excess, cover)) == said


@pytest.mark.parametrize("n", [10, 100])
def test_errors_too_small_to_be_chance_are_never_called_good(n: int) -> None:
    """Chi-square of n at a probability of a millionth: 0.197 and 0.680 of the bound (tables of the gamma function)."""
    least = math.sqrt(stats.gamma.ppf(1e-6, n / 2, scale=2.0) / n)
    # the last: the bound is of a linearisation that does not hold so far
    for factor, bound, said in ((0.99, 3.0, "below the bound by more"), (1.01, 3.0, "on the"), (0.99, 80.0, "on the")):
        stored = cell({"k_over_m": factor * least, "c_over_m": 1.0}, COVER, n)
        for summary in (stored.summary["k_over_m_error_pct"], stored.summary["c_over_m_error_pct"]):
            summary["bound"] = bound
        assert verdict(stored).startswith(said)
        assert good(verdict(stored)) == (said == "on the")


def test_a_method_that_has_the_truth_is_flagged_and_one_at_the_bound_is_not(reference: Scenario) -> None:
    """Summaries of real scores: 20 fits that scatter by the bound, and 20 that were given the truth to 5e-11 %."""
    (problem, truth), bound = reference.replicates(0, 1)[0], compute_bound(reference)
    rng = np.random.default_rng(1)
    for width, said in ((1.0, "on the bound"), (1e-9, "below the bound by more than chance allows (k/m, c/m")):
        sds = np.array([width * bound.relative_sd[name] for name in ("k_over_m", "c_over_m")])
        groups = truth.parameters["k"] / truth.parameters["m"], truth.parameters["c"] / truth.parameters["m"]
        means = np.array(groups) * (1.0 + sds * rng.standard_normal((20, 2)))
        rows = []
        for i, mean in enumerate(means):
            distribution = Normal(("k_over_m", "c_over_m"), mean, np.diag((sds * groups) ** 2), log=False)
            rows.append(Row(i, Status.OK, scores=score(Estimate(problem.system, groups=distribution), problem, truth)))
        summary = summarise(rows, bound)
        assert verdict(StoredCell("0" * 20, {}, rows, summary, {}, bound.identifiable, 0.0)).startswith(said)


def test_fits_without_an_answer_are_counted_and_few_give_no_verdict() -> None:
    assert verdict(cell(GOOD, COVER, 95, 5)).endswith("5 of 100 fits have no answer")
    assert not good(verdict(cell(GOOD, COVER, 95, 5)))
    assert good(verdict(cell(GOOD, COVER)))
    assert verdict(cell(GOOD, COVER, 4, 96)).startswith("no verdict: 4 of 100")
    assert verdict(cell({"k_over_m": math.nan}, {})).startswith("no verdict: nothing")
