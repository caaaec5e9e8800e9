"""Batches of problems with one *layout*: they differ only in data, initial states and priors.

System, sensors, sample times and forces are equal, so that one call simulates all of them. Forces and added masses are
compared after division by the largest, since they may differ by a unit of mass (:attr:`bench.OutputError.mass_unit`).
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence

import numpy as np

from bench.contract.problem import Problem
from bench.likelihood.output_error import OutputError, mass_scale

DECIMALS = 12
"""Number of decimals to which times, forces and masses of one layout agree, in natural units."""
MOST_AT_ONCE = 1_000_000
"""Largest number of derivatives of predictions in a batch, with one initial guess per problem."""


def layout(problem: Problem) -> Hashable:
    """Return a key that is equal for problems in natural units that can be solved in one batch."""
    mass = mass_scale(problem)

    def rounded(values: np.ndarray | None) -> bytes:
        return b"" if values is None else (np.round(values, DECIMALS) + 0.0).tobytes()

    records = tuple(
        (
            tuple((rounded(c.times), c.measures, c.dof, c.offset) for c in record.channels),
            tuple((rounded(f.times), rounded(f.values / mass), f.hold, f.dof) for f in record.forces),
            record.initial_state is None,
            None if record.added_mass is None else rounded(record.added_mass / mass),
        )
        for record in problem.records
    )
    return problem.system, records, problem.prior is None


def batches(models: Sequence[OutputError], alone: Sequence[bool]) -> Iterator[list[int]]:
    """Group likelihoods of problems in natural units by layout.

    Args:
        models: Likelihoods.
        alone: True for likelihoods that form a batch of their own.

    Yields:
        Indices of the likelihoods of a batch.
    """
    groups: dict[Hashable, list[int]] = {}
    for i, model in enumerate(models):
        groups.setdefault(i if alone[i] else layout(model.problem), []).append(i)
    for places in groups.values():
        first = models[places[0]]
        size = max(1, MOST_AT_ONCE // (first.data.size * first.size))
        yield from (places[i : i + size] for i in range(0, len(places), size))
