"""Scores of the convergence of a fit, from the traces of its estimate. Any trace may be absent.

Traces of a training: ``path_cpu_s`` (n,), processor time since the fit began (s); ``path_parameters`` (n, n_parameters)
and ``path_loss`` (n,) at these times; ``minimum_loss`` (1,) and ``minimum_parameters`` (n_parameters,) at the minimum
of the loss. Traces of a search from several starting points: ``start_objectives`` (n,), the final negative log
posterior of each search, up to a constant; ``certificate`` (1,), the normalised gradient ``‖Jᵀ r‖ / (‖J‖ ‖r‖)`` of
Jacobian and residual at the estimate, which is zero at a minimum.
"""

from __future__ import annotations

import re

import numpy as np

from bench.contract.estimate import Estimate, Status
from bench.scenario.truth import Truth

MOMENTS = tuple(float(f"{digit}e{power}") for power in range(-2, 3) for digit in (1, 2, 5))
"""Processor times (s) at which the error of the current parameters is scored."""
ARRIVED = 1.01
"""A training has converged once its loss stays within this factor of the minimum."""
SAME = 0.01
"""Two searches end in the same minimum if their log posteriors differ by no more than this: by 0.14 standard errors of
one parameter, the square root of twice the difference."""


def trace_scores(estimate: Estimate, truth: Truth) -> dict[str, float]:
    """Return the convergence scores of an estimate by name; none if it failed.

    ``training_s``: processor time of the training (s); ``loss_over_minimum``: final loss over its minimum;
    ``arrival_s``: time after which the loss stays within 1 % of the minimum (absent if it never does);
    ``<group>_off_pct_at_<t>s``: error of an identifiable group at time t (%); ``<group>_off_pct_at_minimum``: its error
    at the minimum of the loss (%); ``starts``: number of searches; ``starts_at_best``: number of searches that ended in
    the best minimum; ``certificate``: normalised gradient.
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
            above = np.flatnonzero(~(losses <= ARRIVED * least))
            first = int(above[-1]) + 1 if above.size else 0
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
        objectives = np.asarray(traces["start_objectives"], float)
        scores |= {
            "starts": float(objectives.size),
            "starts_at_best": float(np.sum(objectives <= np.nanmin(objectives) + SAME)),
        }
    return scores


def _errors(estimate: Estimate, truth: Truth, values: np.ndarray, when: str) -> dict[str, float]:
    parameters = dict(zip(estimate.system.names, map(float, values), strict=True))
    return {
        f"{group.name}_off_pct_at_{when}": 100.0 * abs(group.value(parameters) / group.value(truth.parameters) - 1.0)
        for group in estimate.system.groups
    }


def depends_on_clock(name: str) -> bool:
    """Return whether a score depends on the speed of the machine: times, and errors at a given time."""
    return name in ("training_s", "arrival_s") or bool(re.search(r"_at_[-+.e\d]+s$", name))
