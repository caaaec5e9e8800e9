"""Rounding of a problem to ten decimals, for methods that amplify rounding errors of their data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench import InitialState, Problem, Record

DIGITS = 10
"""Decimals that are kept in natural units."""


def rounded(problem: Problem) -> Problem:
    """Round times, samples, forces, initial states and nominal values of a problem in natural units to ten decimals.

    Thousands of steps of Adam and L-BFGS amplify the last bit of the data to a hundredth of a standard error, and a
    gradient-based sampler amplifies it to other draws. After rounding, a record gives the same bits in any units, and
    hence the same estimate, except where a value lies on the boundary between two decimals.
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
