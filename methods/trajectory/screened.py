"""The starts that are worth a fit, of many problems of one layout together, by what shooting and output error share.

The sets of :mod:`methods.starts.candidates` take a few output-error steps each; kept are separate ends that could still
win.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench import SIGMA_FLOOR, Batch, Channel, OutputError, layout
from methods.starts.candidates import candidates, screened
from methods.starts.separate import separate
from methods.trajectory.stepped import Stepped

LONGEST = 300
"""Samples of each channel on which the starts of a nonlinear system are compared; a longer record is solved alone."""


@dataclass(frozen=True)
class Screening:
    """At most so many ``starts`` after ``iterations`` steps, within ``margin`` of the best's profile."""

    starts: int
    iterations: int
    margin: float


@dataclass(frozen=True, eq=False)
class Starts:
    """What is worth a fit: cases and their vectors, and by problem the first start as the data gave it."""

    cases: np.ndarray
    thetas: np.ndarray
    first: np.ndarray


def screened_together(batch: Batch, rules: Screening) -> Starts:
    """The starts that are worth a fit after a few output-error steps."""
    found = [candidates(model, rules.starts + 1) for model in batch.models]
    cases = np.repeat(np.arange(len(found)), [len(own) for own in found])
    vectors = _vectors(batch, cases, [p for own in found for p in own])
    batch = batch.for_screening(cases, vectors)
    vectors = batch.with_starts(cases, vectors) if isinstance(batch, Stepped) else vectors
    start = batch.point(cases, vectors)
    residuals = batch.data[cases] - start.predicted
    good = np.flatnonzero(np.all(np.isfinite(residuals), axis=1))
    cases = cases[good]
    sigma = batch.noise(cases, residuals[good], np.zeros(good.size), SIGMA_FLOOR)
    settled = batch.search(cases, start.at(good), sigma, rules.iterations).point
    values = batch.profile(cases, settled.theta, batch.data[cases] - settled.predicted)
    kept: list[int] = []
    for problem, model in enumerate(batch.models):
        own = np.flatnonzero(cases == problem)
        best = own[separate(model, values[own], settled.theta[own])[: rules.starts]]
        kept += [i for i in best if values[i] <= values[best[0]] + rules.margin]
    # of a problem without a start that of another: it has no fit that would use it
    heads = np.searchsorted(np.repeat(np.arange(len(found)), [len(own) for own in found]), np.arange(len(found)))
    return Starts(cases[kept], settled.theta[kept], vectors[np.minimum(heads, max(len(vectors) - 1, 0))])


def _vectors(batch: Batch, cases: np.ndarray, starts: Sequence[dict[str, float]]) -> np.ndarray:
    """A vector of unknowns of each start, with initial states and offsets where these are found one by one."""
    if not isinstance(batch, Stepped):
        vectors = [batch.models[i].vector(p) for i, p in zip(cases, starts, strict=True)]
        return np.array(vectors).reshape(-1, batch.first.size)
    free, theta = batch.first.free, np.zeros((len(starts), batch.first.size))
    theta[:, : len(free)] = np.log([[p[name] for name in free] for p in starts]).reshape(-1, len(free))
    return theta


@dataclass(frozen=True, eq=False)
class OwnStarts:
    """Of one problem: the vectors that are worth a fit, and its first start as the data gave it."""

    thetas: list[np.ndarray]
    first: np.ndarray


def screened_starts(models: Sequence[OutputError], rules: Screening) -> list[OwnStarts]:
    """The starts of problems, in order: linear systems of one layout together, all others one by one."""
    found: dict[int, OwnStarts] = {}
    groups: dict[object, list[int]] = {}
    for i, model in enumerate(models):
        if model.system.linear:
            groups.setdefault(layout(model.problem), []).append(i)
        else:
            nominal = candidates(head(model), rules.starts + 1)[0]
            first = np.log([nominal[name] for name in model.free])
            found[i] = OwnStarts(screened_alone(model, rules), first)
    for places in groups.values():
        own = screened_together(Batch(tuple(models[i] for i in places)), rules)
        for number, i in enumerate(places):
            found[i] = OwnStarts(list(own.thetas[own.cases == number]), own.first[number])
    return [found[i] for i in range(len(models))]


def screened_alone(model: OutputError, rules: Screening) -> list[np.ndarray]:
    """The starts of one problem of any system that are worth a fit, best first; none where no response is finite."""
    found = screened(head(model), rules.starts, rounds=1, iterations=rules.iterations)
    return [theta for value, theta in found if value <= found[0][0] + rules.margin]


def head(model: OutputError) -> OutputError:
    """The first samples of long records of a nonlinear system, for the screening: ``theta`` means the same for them.

    Its step-by-step simulations would outlast the fit; linear responses are quick at any length.
    """
    if model.system.linear or all(c.n <= LONGEST for _, c in model.channels):
        return model

    def short(c: Channel) -> Channel:
        return replace(c, times=c.times[:LONGEST], values=c.values[:LONGEST])

    records = tuple(replace(r, channels=tuple(short(c) for c in r.channels)) for r in model.problem.records)
    return OutputError(replace(model.problem, records=records))
