"""The trajectories about which the first maps are taken: the scan and screening that multiple shooting has, too.

Candidates come from the data alone (:mod:`methods.starts.candidates`); each is given a few output-error steps, and the
best that are apart are kept.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench import NoEstimate, OutputError
from methods.starts.candidates import candidates, head, screening
from methods.starts.evidence import most_probable
from methods.starts.reach import is_unresolved
from methods.starts.separate import separate

STARTS = 3
"""Separate starts at most."""
SCREENING = 5
"""Output-error steps that each candidate is given before the best are taken."""
MARGIN = 15.0
"""A start is kept if minus twice its log-posterior is within this of the best."""
ROUNDS = 4
"""Gauss-Newton steps for the initial states of a candidate."""


def first_candidate(model: OutputError) -> dict[str, float]:
    """The first of the parameter sets that the data suggest, moved by no search."""
    return candidates(head(model), STARTS + 1)[0]


def screened_starts(model: OutputError) -> np.ndarray:
    """The model's vectors (B, size) of the starts to be followed, best first.

    Raises NoEstimate where no candidate gives a finite response.
    """
    short = head(model)
    quick = screening(short)
    thetas = quick.settle(_vectors(quick, candidates(short, STARTS + 1)), 1, SCREENING)
    with np.errstate(all="ignore"):
        residuals = quick.data - quick.predict(thetas)
    values = np.array([quick.profile_of(theta, left) for theta, left in zip(thetas, residuals, strict=True)])
    best = separate(short, values, thetas)[:STARTS]
    if not best:
        raise NoEstimate("no start gave a finite response; give a prior nearer to the system")
    kept = [thetas[i] for i in best if values[i] <= values[best[0]] + MARGIN]
    if is_unresolved(short.problem):  # a few steps do not yet order the basins of several degrees of freedom
        kept = most_probable(short, list(thetas[np.isfinite(values)]) if short.system.n_dof > 1 else kept)
    return np.stack(kept)


def _vectors(quick: OutputError, found: Sequence[dict[str, float]]) -> np.ndarray:
    """Theta at the candidates, with the initial states and offsets that fit best there; all simulated together."""
    k = len(quick.free)
    if quick.system.linear or quick.size == k:
        return np.stack([quick.vector(p) for p in found])
    thetas = np.zeros((len(found), quick.size))
    thetas[:, :k] = np.log([[p[name] for name in quick.free] for p in found])
    for _ in range(ROUNDS):
        predicted, slopes = quick.jacobian(thetas)
        for theta, values, columns in zip(thetas, predicted, slopes[..., k:], strict=True):
            if np.all(np.isfinite(values)) and np.all(np.isfinite(columns)):
                theta[k:] += np.linalg.lstsq(columns, quick.data - values, rcond=1e-12)[0]
    return thetas
