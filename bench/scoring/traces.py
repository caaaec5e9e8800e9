"""Scores of the way that a fit took, where the traces of an estimate record it; each trace may be absent.

Of a training: ``path_cpu_s`` (n,), processor seconds since the fit began; ``path_parameters`` (n, n_parameters), the
parameters at these moments; ``path_loss`` (n,); ``minimum_loss`` (1,) and ``minimum_parameters`` (n_parameters,), those
of the minimum of that loss. Of a search from several starting points: ``start_objectives`` (n,), minus the log
posterior, up to a constant, where each search ended; ``certificate`` (1,), ``‖Jᵀ r‖ / (‖J‖ ‖r‖)`` of Jacobian and
residual at the answer: the gradient's length over the largest that it could have, zero at a minimum.
"""

from __future__ import annotations

import re

import numpy as np

from bench.contract.estimate import Estimate, Status
from bench.scenario.truth import Truth

MOMENTS = tuple(float(f"{digit}e{power}") for power in range(-2, 3) for digit in (1, 2, 5))
"""Processor seconds at which the error of the answer so far is scored."""
ARRIVED = 1.01
"""A training has arrived once its loss stays within this factor of the minimum's."""
SAME = 0.01
"""Two ends of a search are the same where their log posteriors differ by no more than this. Near a minimum such a
difference is 0.14 standard errors of one parameter: the square root of twice it."""


def trace_scores(estimate: Estimate, truth: Truth) -> dict[str, float]:
    """Return the named scores of a training and of a search; none where the estimate failed.

    ``training_s``: processor seconds to the end of a training; ``loss_over_minimum`` there; ``arrival_s``: when the
    loss came within 1 % of the minimum for good (absent if never); ``<group>_off_pct_at_<t>s``: the error of an
    identifiable group at a moment; ``<group>_off_pct_at_minimum``: that of the loss's own minimum. ``starts``:
    starting points from which a search ended; ``starts_at_best``: those that ended where the best did;
    ``certificate``.
    """
    traces, scores = estimate.traces, dict[str, float]()
    if estimate.status is not Status.OK:
        return scores
    if {"path_cpu_s", "path_parameters"} <= traces.keys():
        seconds = traces["path_cpu_s"]
        scores["training_s"] = float(seconds[-1])
        if "minimum_loss" in traces and "path_loss" in traces:
            losses, least = traces["path_loss"], float(traces["minimum_loss"][0])
            scores["loss_over_minimum"] = float(losses[-1] / max(least, 1e-300))
            away = np.flatnonzero(~(losses <= ARRIVED * least))
            first = int(away[-1]) + 1 if away.size else 0
            scores |= {"arrival_s": float(seconds[first])} if first < seconds.size else {}
        for moment in MOMENTS:
            last = int(np.searchsorted(seconds, moment, "right")) - 1
            if last >= 0:
                scores |= _errors(estimate, truth, traces["path_parameters"][last], f"{moment:g}s")
        if "minimum_parameters" in traces:
            scores |= _errors(estimate, truth, traces["minimum_parameters"], "minimum")
    if "certificate" in traces and traces["certificate"].size:
        scores["certificate"] = float(traces["certificate"][0])
    if "start_objectives" in traces and traces["start_objectives"].size:
        ends = np.asarray(traces["start_objectives"], float)
        scores |= {"starts": float(ends.size), "starts_at_best": float(np.sum(ends <= np.nanmin(ends) + SAME))}
    return scores


def _errors(estimate: Estimate, truth: Truth, values: np.ndarray, when: str) -> dict[str, float]:
    parameters = dict(zip(estimate.system.names, map(float, values), strict=True))
    return {
        f"{group.name}_off_pct_at_{when}": 100.0 * abs(group.value(parameters) / group.value(truth.parameters) - 1.0)
        for group in estimate.system.groups
    }


def of_clock(name: str) -> bool:
    """Return whether a score depends on the speed of the machine: those at moments, and the times themselves."""
    return name in ("training_s", "arrival_s") or bool(re.search(r"_at_[-+.e\d]+s$", name))
