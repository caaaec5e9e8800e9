"""Scores of the online track, against paths whose scores follow by hand."""

import math

import numpy as np
import pytest

from bench.online.course import Course
from bench.online.follow import Followed
from bench.online.forces import HeldForce
from bench.online.scenario import OnlineScenario
from bench.online.score import AFTER, LEVELS, Z95, Score, score, score_bound, scored
from bench.reporting.tables.online_table import BOUND, CONSTANT, STEP, in_order, table, tracked


def stepping(samples: int = 200) -> OnlineScenario:
    return OnlineScenario(
        "x", "sdof", {"m": 1.0, "c": 0.5, "k": 9.0}, 10.0, samples, forces=(HeldForce(),),
        varying={"k": Course("step", change=-0.2)},
    )  # fmt: skip


def path(stream, off: np.ndarray, sd: float) -> Followed:
    """A tracker that is ``off`` in the logarithm of every quantity, and says so much uncertainty."""
    true = np.stack([np.log(q.value(stream.truth.parameters)) for q in stream.layout.quantities], axis=1)
    n, q = true.shape
    return Followed(true + off[:, None], np.full((n, q), sd), np.full(n, np.nan), np.full(n, "ok"), np.ones(n), 8)


def test_an_error_of_twice_the_bound_has_an_excess_of_two_and_no_interval_that_holds() -> None:
    made = stepping()
    stream = made.stream(0, 0)
    bound = {"k_over_m": np.full(200, 0.01**2)}
    found = score(made, [scored(stream, path(stream, np.full(200, 0.02), 0.01), bound, "k_over_m")])
    assert found.excess == pytest.approx(2.0)
    assert found.rms == pytest.approx(2.0)
    assert found.coverage == 0.0


def test_delay_is_counted_from_the_step_to_the_first_interval_without_the_old_value() -> None:
    made = stepping()
    stream = made.stream(0, 0)
    late = np.where((np.arange(200) >= 100) & (np.arange(200) < 117), -math.log(0.8), 0.0)  # finds out 17 samples on
    found = score(made, [scored(stream, path(stream, late, 0.01), {"k_over_m": np.full(200, 1e-4)}, "k_over_m")])
    assert found.delay == 17


def test_the_delay_of_the_bound_is_when_its_variance_first_excludes_the_old_value() -> None:
    made = stepping()
    stream = made.stream(0, 0)
    change = abs(math.log(0.8))
    bound = np.where(np.arange(200) < 130, 1.01 * change / Z95, 0.99 * change / Z95) ** 2
    of = next(q for q in stream.layout.quantities if q.name == "k_over_m")
    found = score_bound(made, [stream], [bound], of)
    assert found.delay == 30
    assert found.excess == 1.0


def test_methods_stand_in_the_order_of_their_worse_quantity() -> None:
    lines = [
        {"method": name, "ok": 1, "excess": excess}
        for name, *own in (("near in k", 1.1, 5.0), ("even", 2.0, 2.0), (BOUND, 1.0, 1.0))
        for excess in own
    ]
    assert list(dict.fromkeys(line["method"] for line in in_order(lines))) == [BOUND, "even", "near in k"]


def test_false_alarms_stand_beside_delays_of_the_same_half_width() -> None:
    """Of a record that is constant the alarms, of one with a step the delay; one that is never seen says so."""
    curve = tuple((0.25 * i, math.inf if i else 12.0) for i in range(len(LEVELS)))
    scores = Score(1.5, 2.0, 1.0, 0.95, (math.nan,) * len(AFTER), 12.0, curve, 1)
    what = {"method": "m", "title": "M", "micros_median": 1.0, "micros_99": 2.0}
    lines = [line for name in (CONSTANT, STEP) for line in tracked({**what, "scenario": name}, {"k": scores})]
    page = table(lines, {CONSTANT: "Nothing changes.", STEP: "A step."}, "again")["table10.md"]
    row = page[page.index("## Delay against") :].splitlines()[-3]
    assert [text.strip() for text in row.split("|")[1:4]] == ["M", "0 / 12", "0.25 / never"]
