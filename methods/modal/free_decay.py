"""What the methods share that read k/m and c/m of one mass off its free decay: logarithmic decrement, matrix pencil.

A method brings one function, from displacements to (k/m, c/m) of many data sets at once. The rest is here: which
problems are a free decay, the parametric bootstrap and the answer, of all problems of one layout at once. The start is
not used even where it is told: that is what these methods are like.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bench import Estimate, NoEstimate, Problem, Serves
from methods.modal.overdamped import real_decays
from methods.regression.bootstrap import bootstrap_covariances
from methods.regression.company import Finish, answers_together
from methods.regression.equation import Regression, Values, answer, layout_objection, responses

Reader = Callable[[np.ndarray, np.ndarray, bool], np.ndarray]
"""Times (n,), displacements (sets, n) and whether an unknown constant is in them to k/m and c/m, shape (sets, 2).

NaN where a set does not tell them.
"""
Spread = Callable[["Decays"], np.ndarray]
"""Covariances (sets, 2, 2) of k/m and c/m; NaN where the bootstrap is to find them."""

SERVES = Serves(offsets=True, forced=False, nonlinear=False, max_dof=1)
GROWS = "the vibration grows: c/m came out negative; take a record with more decay above its noise"
UNTOLD = (
    "most synthetic records of this noise could not be read, so there is no uncertainty: do not trust the value; "
    "take a longer record or less noise"
)


@dataclass(frozen=True)
class Reading:
    """How a method reads free decays: ``unreadable`` is the sentence for a record that ``read`` makes nothing of.

    The covariance is that of ``bootstrap`` synthetic records (none where it is 0), or of ``spread`` where it has one.
    """

    read: Reader
    unreadable: str
    bootstrap: int
    spread: Spread | None = None
    by_poles: bool = True
    """Whether ``read`` finds poles: where these are not a damped mass's, two real decays may be."""

    def groups(self, times: np.ndarray, sets: np.ndarray, offset: bool) -> np.ndarray:
        """k/m and c/m (sets, 2) of displacements (sets, n)."""
        found = self.read(times, sets, offset)
        lost = ~np.all(np.isfinite(found), axis=1)
        if self.by_poles and np.any(lost):
            found[lost] = real_decays(times, sets[lost], offset)
        return found


@dataclass(frozen=True, eq=False)
class Decays:
    """Free decays as they were read: ``groups`` (sets, 2), k/m and c/m, at times (n,), whether about an ``offset``.

    ``centres`` (sets, n) are their responses from the best start, NaN where they overflow; ``noise`` (sets,) is the
    standard deviation of the data about them with N - 4 degrees of freedom (N - 5 with an offset).
    """

    times: np.ndarray
    groups: np.ndarray
    centres: np.ndarray
    noise: np.ndarray
    offset: bool


def decay_objection(problem: Problem) -> str | None:
    """Why the problem is not the free decay of one mass with k/m and c/m to find, in a sentence; None where it is."""
    kinds = {p.name: p.kind for p in problem.system.parameters}
    if sorted(kinds.values()) != ["damping", "mass", "stiffness"]:
        return "it needs one mass, one damping and one stiffness"
    return layout_objection(problem)


def has_offset(problem: Problem) -> bool:
    """Whether the one sensor adds an unknown constant."""
    return problem.records[0].channels[0].offset


def decay_estimates(
    problems: Sequence[Problem], rngs: Sequence[np.random.Generator], reading: Reading
) -> list[Estimate]:
    """Estimate the groups of free decays.

    An unstable estimate (c/m negative) is given as it is, with a sentence: dropping it would drop the unlucky half of
    the noise.
    """
    own = [untold(problem) for problem in problems]
    return answers_together(own, rngs, partial(_decays, reading), max(1, reading.bootstrap))


def _decays(
    reading: Reading, regressions: Sequence[Regression], rngs: Sequence[np.random.Generator]
) -> Sequence[Finish]:
    first = regressions[0]
    times, order, offset = first.times[0], _order(first), first.records[0].channels[0].offset
    y = np.concatenate([regression.values[0] for regression in regressions], axis=1)
    groups = reading.groups(times, y[0], offset)
    decays = _world(first, Decays(times, groups, y[0], np.zeros(len(groups)), offset), order)
    covariances = _covariances(reading, decays, rngs)
    return [
        partial(_estimate, regression, reading, own[order], None if cov is None else cov[np.ix_(order, order)])
        for regression, own, cov in zip(regressions, groups, covariances, strict=True)
    ]


def _estimate(
    regression: Regression, reading: Reading, unknowns: np.ndarray, covariance: np.ndarray | None
) -> Estimate:
    if not np.all(np.isfinite(unknowns)):
        raise NoEstimate(reading.unreadable)
    # the resting level is found too, and costs a degree of freedom
    found = np.append(unknowns, np.zeros(int(regression.records[0].channels[0].offset)))
    damping = unknowns[_order(regression)][1]
    said = [GROWS] * bool(damping <= 0) + [UNTOLD] * (covariance is None and reading.bootstrap > 0)
    return answer(regression, found, covariance, "; ".join(said))


def untold(problem: Problem) -> Problem:
    """Leave out the start, told or not."""
    return replace(problem, records=tuple(replace(record, initial_state=None) for record in problem.records))


def _order(regression: Regression) -> list[int]:
    """Where k/m and c/m stand in the system's own order of its groups; its own inverse, being of two."""
    stiffness = next(p.name for p in regression.system.parameters if p.kind == "stiffness")
    first = regression.system.groups[0].exponents
    return [0, 1] if stiffness in first else [1, 0]


def _covariances(reading: Reading, decays: Decays, rngs: Sequence[np.random.Generator]) -> list[np.ndarray | None]:
    """Covariances of k/m and c/m; None where there is none."""
    found: list[np.ndarray | None] = [None] * len(rngs)
    if not reading.bootstrap:
        return found
    if reading.spread is not None:
        found = [cov if np.all(np.isfinite(cov)) else None for cov in reading.spread(decays)]
    worlds = np.all(np.isfinite(decays.centres), axis=1)
    left = [i for i, cov in enumerate(found) if cov is None and worlds[i]]

    def fitter(values: Values) -> np.ndarray:
        return reading.groups(decays.times, values[0][0], decays.offset)

    drawn = bootstrap_covariances(
        [_Decay((decays.centres[i : i + 1],), (decays.noise[i : i + 1],)) for i in left],
        fitter,
        [rngs[i] for i in left],
        reading.bootstrap,
    )
    for i, cov in zip(left, drawn, strict=True):
        found[i] = cov
    return found


@dataclass(frozen=True, eq=False)
class _Decay:
    """The simulated response (1, n) and the standard deviation (1,) of the data about it."""

    centres: tuple[np.ndarray, ...]
    noise: tuple[np.ndarray, ...]


def _world(regression: Regression, decays: Decays, order: list[int]) -> Decays:
    """The decays with the responses from their best starts and the noise about them, in place of data and zeros."""
    y, parameters = decays.centres, regression.parameters(decays.groups[:, order])
    centres = responses(regression.system, parameters, regression.records[0], y[None], np.zeros(2))[0]
    left = max(y.shape[1] - 4 - int(decays.offset), 1)
    return replace(decays, centres=centres, noise=np.sqrt(np.sum((centres - y) ** 2, axis=1) / left))
