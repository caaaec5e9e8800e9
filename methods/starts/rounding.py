"""A problem to ten digits, for methods that magnify the last bit of their data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench import InitialState, Problem, Record

DIGITS = 10
"""Digits that are kept of every number in natural units."""


def rounded(problem: Problem) -> Problem:
    """Round every number of a problem (in natural units) to ten digits.

    Thousands of steps of Adam and L-BFGS magnify the last bit of the data to a hundredth of a standard error, and a
    gradient sampler's path magnifies it to other draws. Rounded like this, a record in other units is the same record
    to the last bit, and so is the answer.
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
