"""Scores of a search from several starts, where an estimate's traces tell of it.

These traces are looked for (each may be absent): ``start_objectives`` (n,), minus the log posterior, up to a constant,
where the search from each start ended; ``certificate`` (1,), ``‖Jᵀ r‖ / (‖J‖ ‖r‖)`` of Jacobian and residual at the
answer: the gradient's length over the largest that it could have, zero at a minimum.
"""

from __future__ import annotations

import numpy as np

from bench.contract.estimate import Estimate, Status

SAME = 0.01
"""Two ends of a search are the same where their log posteriors differ by no more than this. Near a minimum such a
difference is 0.14 standard errors of one parameter: the square root of twice it."""


def search_scores(estimate: Estimate) -> dict[str, float]:
    """Named scores of a search; none without its traces, or where the estimate failed.

    ``starts``: those from which a search came to an end; ``starts_at_best``: those that ended where the best did;
    ``certificate``.
    """
    traces = estimate.traces
    if estimate.status is not Status.OK:
        return {}
    scores: dict[str, float] = {}
    if "certificate" in traces and traces["certificate"].size:
        scores["certificate"] = float(traces["certificate"][0])
    if "start_objectives" in traces and traces["start_objectives"].size:
        ends = np.asarray(traces["start_objectives"], float)
        scores |= {"starts": float(ends.size), "starts_at_best": float(np.sum(ends <= np.nanmin(ends) + SAME))}
    return scores
