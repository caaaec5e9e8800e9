"""The initial guesses that are worth a fit, of a batch of problems, by the rules that shooting and output error share.

The parameter sets of :mod:`methods.starts.candidates` take a few output-error steps each; kept are separate ends that
could still win.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench import OutputError
from methods.starts.candidates import candidates, head, screened
from methods.starts.evidence import basins, most_probable
from methods.starts.reach import is_unresolved
from methods.starts.separate import separate

NONLINEAR_STEPS = 5
"""Gauss-Newton steps of the initial states and offsets that fit the data of a nonlinear system best."""


@dataclass(frozen=True)
class Screening:
    """At most so many ``starts`` after ``iterations`` steps, within ``margin`` of the best's profile."""

    starts: int
    iterations: int
    margin: float


@dataclass(frozen=True, eq=False)
class Guesses:
    """Initial guesses that are worth a fit: problem numbers and vectors, and each problem's first one before any step.

    ``cases`` (n,), ``thetas`` (n, size), ``first`` (problems, size).
    """

    cases: np.ndarray
    thetas: np.ndarray
    first: np.ndarray


def screen(models: Sequence[OutputError], batch: OutputError, rules: Screening) -> Guesses:
    """Choose the guesses for each of the models of a batch."""
    sets = [candidates(model, rules.starts + 1) for model in models]
    cases = np.repeat(np.arange(len(sets)), [len(guesses) for guesses in sets])
    heads = np.concatenate([[0], np.cumsum([len(guesses) for guesses in sets])[:-1]])
    thetas = np.zeros((cases.size, batch.size))
    thetas[:, : len(batch.free)] = np.log([[p[name] for name in batch.free] for guesses in sets for p in guesses])
    batch = batch.for_screening(cases, thetas)
    thetas = batch[cases].with_initial_states(thetas, 1 if batch.system.linear else NONLINEAR_STEPS)
    first = thetas[heads]
    point = batch[cases].point(thetas)
    finite = np.flatnonzero(np.all(np.isfinite(point.predicted), axis=1))
    cases, point = cases[finite], point[finite]
    chosen = batch[cases]
    sigma = chosen.noise(chosen.data - point.predicted, 0.0)
    settled, _ = chosen.search(point, sigma, rules.iterations)
    values = chosen.profile_of(settled.theta, chosen.data - settled.predicted)
    kept = list[list[int]]()
    for number, model in enumerate(models):
        places = np.flatnonzero(cases == number)
        best = places[separate(model, values[places], settled.theta[places])[: rules.starts]]
        kept.append(list(best))
    # beyond half the sampling rate the best fit may be a narrow basin, and the most probable one another
    ambiguous = [i for i, own in enumerate(kept) if len(own) > 1 and is_unresolved(models[i].problem)]
    ends = basins([models[i] for i in ambiguous], [settled.theta[kept[i]] for i in ambiguous])
    for i, end in zip(ambiguous, ends, strict=True):
        if end.evidence.size and (place := end.first(models[i])):  # else the best fit stands first anyway
            kept[i] = kept[i][:1]
            settled.theta[kept[i][0]] = end.thetas[place]
    worth = [i for own in kept for i in own if values[i] <= values[own[0]] + rules.margin]
    return Guesses(cases[worth], settled.theta[worth], first)


def screened_alone(model: OutputError, rules: Screening) -> list[np.ndarray]:
    """Choose the guesses for one problem of any system, best first; none where no response is finite."""
    guesses = screened(head(model), rules.starts, rounds=1, iterations=rules.iterations)
    starts = [theta for value, theta in guesses if value <= guesses[0][0] + rules.margin]
    return most_probable(head(model), starts) if len(starts) > 1 and is_unresolved(model.problem) else starts
