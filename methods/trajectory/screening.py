"""Screening of initial guesses for shooting and output error, for a batch of problems.

The candidates of :mod:`methods.starts.candidates` are improved by a few output-error iterations each; distinct ends
within a margin of the best are kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench import FIRST_DAMPING, OutputError
from methods.starts.candidates import candidates, head, screening
from methods.starts.distinct_minima import aliased, distinct_minima
from methods.starts.evidence import basins
from methods.starts.search_range import is_unresolved


@dataclass(frozen=True)
class Rules:
    """Settings of the screening and of convergence, named as those of the methods.

    At most ``starts`` guesses are kept after ``screen_iterations`` steps, within ``margin`` of the best in minus twice
    the log-posterior. Fit and noise alternate at most ``sigma_rounds`` times, until the noise changes by less than
    ``sigma_tolerance``; a fit takes at most ``iterations`` steps with the initial ``damping``.
    """

    starts: int
    screen_iterations: int
    margin: float
    sigma_rounds: int
    sigma_tolerance: float
    iterations: int
    damping: float = FIRST_DAMPING


@dataclass(frozen=True, eq=False)
class Guesses:
    """Screened initial guesses, best first: problem indices ``cases`` (n,) and vectors ``thetas`` (n, size).

    ``first`` (problems, size): first candidate of each problem. ``sigma`` (n, channels): initial noise, that of the
    residuals where None.
    """

    cases: np.ndarray
    thetas: np.ndarray
    first: np.ndarray
    sigma: np.ndarray | None = None

    @staticmethod
    def of_one(thetas: Sequence[np.ndarray]) -> Guesses:
        """Return guesses for a single problem."""
        return Guesses(np.zeros(len(thetas), int), np.stack(thetas), thetas[0][None])


def screen(models: Sequence[OutputError], batch: OutputError, rules: Rules) -> Guesses:
    """Screen the candidates of each model of a batch."""
    sets = [candidates(model, rules.starts + 1) for model in models]
    cases = np.repeat(np.arange(len(sets)), [len(guesses) for guesses in sets])
    thetas = np.zeros((cases.size, batch.size))
    thetas[:, : len(batch.free)] = np.log([[p[name] for name in batch.free] for guesses in sets for p in guesses])
    batch = batch.for_screening(cases, thetas)
    thetas = batch[cases].with_initial_states(thetas)
    first = thetas[np.searchsorted(cases, np.arange(len(sets)))]
    point = batch[cases].point(thetas)
    finite = np.flatnonzero(np.all(np.isfinite(point.predicted), axis=1))
    cases, point = cases[finite], point[finite]
    chosen = batch[cases]
    sigma = chosen.noise(chosen.data - point.predicted, 0.0)
    settled, _ = chosen.search(point, sigma, rules.screen_iterations)
    values = chosen.profile_of(settled.theta, chosen.data - settled.predicted)
    kept, aliases, finite = list[list[int]](), np.zeros(values.size, bool), np.isfinite(values)
    aliases[finite] = aliased(models[0], settled.theta[finite])
    for number, model in enumerate(models):
        places = np.flatnonzero(cases == number)
        best = distinct_minima(model, values[places], settled.theta[places], aliases[places])
        kept.append(list(places[best[: rules.starts]]))
    # above half the sampling rate the best fit may lie in a narrow, less probable basin, and a few iterations do not
    # order the basins of several degrees of freedom
    compared = {
        i: np.flatnonzero(cases == i) if model.system.n_dof > 1 else np.array(kept[i])
        for i, model in enumerate(models)
        if len(kept[i]) > 1 and is_unresolved(model.problem)
    }
    ends = basins([models[i] for i in compared], [settled.theta[places] for places in compared.values()])
    for (i, considered), end in zip(compared.items(), ends, strict=True):
        if not end.evidence.size:  # no basin has a covariance
            continue
        place = end.first(models[i])
        if place or len(considered) > len(kept[i]):  # otherwise the best fit is first already
            kept[i] = kept[i][:1]
            settled.theta[kept[i][0]] = end.thetas[place]
    worth = [i for places in kept for i in places if values[i] <= values[places[0]] + rules.margin]
    return Guesses(cases[worth], settled.theta[worth], first)


def screen_alone(model: OutputError, rules: Rules) -> Guesses:
    """Screen the candidates of one problem, on the first samples of a nonlinear system with coarse integration."""
    short = head(model)
    return screen([short], OutputError.batch([screening(short)]), rules)
