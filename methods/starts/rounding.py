"""Rounding of a problem to ten digits, for methods that amplify rounding errors of their data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench import InitialState, Problem, Record

DIGITS = 10
"""Digits that are kept of every number in natural units."""


def rounded(problem: Problem) -> Problem:
    """Round every number of a problem (in natural units) to ten digits.

    Thousands of steps of Adam and L-BFGS amplify the last bit of the data to a hundredth of a standard error, and a
    gradient-based sampler amplifies it to other draws. After rounding, a record gives the same bits in any units, and
    hence the same estimate.
    """

    def same(values: np.ndarray) -> np.ndarray:
        return np.round(values, DIGITS)

    records = []
    for record in problem.records:
        start = record.initial_state
        records.append(
            Record(
                tuple(replace(c, times=same(c.times), values=same(c.values)) for c in record.channels),
                tuple(replace(f, times=same(f.times), values=same(f.values)) for f in record.forces),
                InitialState(same(start.displacement), same(start.velocity)) if start is not None else None,
                None if record.added_mass is None else same(record.added_mass),
            )
        )
    prior = problem.prior
    if prior is not None:
        prior = replace(prior, nominal={name: float(f"{v:.{DIGITS}g}") for name, v in prior.nominal.items()})
    return replace(problem, records=tuple(records), prior=prior)
