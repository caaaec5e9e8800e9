"""Which ends of a search are kept."""

from __future__ import annotations

import numpy as np

from bench import Channel, OutputError, Problem, Record
from bench.systems import SDOF
from methods.starts.distinct_minima import distinct_minima

TIMES = np.linspace(0.0, 1.0, 21)
"""Twenty intervals: half the sampling rate is ten cycles."""


def ends(*cycles: float) -> tuple[OutputError, np.ndarray]:
    """A model of a free decay, and vectors ``log(c/m), log(k/m), start`` of these frequencies."""
    model = OutputError(Problem(SDOF(), (Record((Channel(TIMES, np.cos(20.0 * TIMES)),)),)))
    names = model.free
    rows = []
    for f in cycles:
        logs = {"c": 0.0, "k": 2 * np.log(2 * np.pi * f)}
        rows.append([*(logs[name] for name in names), 1.0, 0.0])
    return model, np.array(rows)


def test_ends_are_apart_finite_and_best_first() -> None:
    model, thetas = ends(3.0, 3.001, 5.0, 7.0)
    assert distinct_minima(model, np.array([4.0, 3.0, 1.0, np.inf]), thetas) == [2, 0]


def test_an_alias_is_kept_only_where_it_is_far_more_probable() -> None:
    """14 cycles look like 6 at 20 samples a unit of time; odds of 20 to 1 are 6 in twice the log-posterior."""
    model, thetas = ends(14.0, 6.0)
    assert distinct_minima(model, np.array([0.0, 5.0]), thetas) == [1]
    assert distinct_minima(model, np.array([0.0, 7.0]), thetas) == [0, 1]
    assert distinct_minima(model, np.array([0.0]), thetas[:1]) == [0]
