"""What the methods share that read k/m and c/m of one mass off its free decay: logarithmic decrement, matrix pencil.

A method brings one function, from displacements to (k/m, c/m) of many data sets at once. The rest is here: which
problems are a free decay, the parametric bootstrap and the answer. The start is not used even where it is told: that is
what these methods are like.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from bench import Estimate, NoEstimate, Problem, Serves
from methods.regression.bootstrap import bootstrap_covariance
from methods.regression.equation import Regression, Values, answer, layout_objection, responses

Reader = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Times (n,) and displacements (sets, n) to k/m and c/m, shape (sets, 2); NaN where a set does not tell them."""

SERVES = Serves(offsets=True, forced=False, nonlinear=False, max_dof=1)
GROWS = "the vibration grows: c/m came out negative; take a record with more decay above its noise"


def decay_objection(problem: Problem) -> str | None:
    """Why the problem is not the free decay of one mass with k/m and c/m to find, in a sentence; None where it is."""
    kinds = {p.name: p.kind for p in problem.system.parameters}
    if sorted(kinds.values()) != ["damping", "mass", "stiffness"]:
        return "it needs one mass, one damping and one stiffness"
    return layout_objection(problem)


def has_offset(problem: Problem) -> bool:
    """Whether the one sensor adds an unknown constant."""
    return problem.records[0].channels[0].offset


def decay_estimate(
    problem: Problem, read: Reader, unreadable: str, rng: np.random.Generator, bootstrap: int
) -> Estimate:
    """Estimate the groups of a free decay with the covariance of ``bootstrap`` synthetic records (none where it is 0).

    ``unreadable`` is the sentence for a record that ``read`` makes nothing of. An unstable estimate (c/m negative) is
    given as it is, with a sentence: dropping it would drop the unlucky half of the noise.
    """
    regression = Regression.of(untold(problem))
    times, order = regression.times[0], _order(regression)

    def fitter(values: Values) -> np.ndarray:
        return np.asarray(read(times, values[0][0])[:, order])

    unknowns = fitter(regression.values)[0]
    if not np.all(np.isfinite(unknowns)):
        raise NoEstimate(unreadable)
    world = _world(regression, unknowns)
    covariance = bootstrap_covariance(world, fitter, rng, bootstrap) if world is not None and bootstrap else None
    damping = unknowns[order][1]
    # the resting level is found too, and costs a degree of freedom
    found = np.append(unknowns, np.zeros(int(has_offset(problem))))
    return answer(regression, found, covariance, GROWS if damping <= 0 else "")


def untold(problem: Problem) -> Problem:
    """Leave out the start, told or not."""
    return replace(problem, records=tuple(replace(record, initial_state=None) for record in problem.records))


def _order(regression: Regression) -> list[int]:
    """Where k/m and c/m stand in the system's own order of its groups; its own inverse, being of two."""
    stiffness = next(p.name for p in regression.system.parameters if p.kind == "stiffness")
    first = regression.system.groups[0].exponents
    return [0, 1] if stiffness in first else [1, 0]


@dataclass(frozen=True, eq=False)
class _Decay:
    """The simulated response (1, n) and the standard deviation (1,) of the data about it."""

    centres: tuple[np.ndarray, ...]
    noise: tuple[np.ndarray, ...]


def _world(regression: Regression, unknowns: np.ndarray) -> _Decay | None:
    """The response of the estimate from its best start, and the noise with N - 4 degrees of freedom (N - 5 with an
    offset); None where it overflows.
    """
    y = regression.values[0]
    response = responses(
        regression.system, regression.parameters(unknowns[None]), regression.records[0], y, np.zeros(2)
    )
    if not np.all(np.isfinite(response)):
        return None
    misfit = np.sum((response - y) ** 2, axis=-1)[:, 0]
    spent = 4 + int(regression.records[0].channels[0].offset)
    return _Decay((response[:, 0],), (np.sqrt(misfit / max(y.shape[-1] - spent, 1)),))
