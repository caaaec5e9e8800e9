"""Scores of the way that a training took, where an estimate's traces tell of it.

These traces are looked for (each may be absent): ``path_cpu_s`` (n,), processor seconds since the fit began;
``path_parameters`` (n, n_parameters), the parameters at these moments; ``path_loss`` (n,); ``minimum_loss`` (1,) and
``minimum_parameters`` (n_parameters,), those of the minimum of that loss.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from bench.contract.estimate import Estimate, Status
from bench.scenario.truth import Truth

MOMENTS = tuple(float(f"{digit}e{power}") for power in range(-2, 3) for digit in (1, 2, 5))
"""Processor seconds at which the error of the answer so far is scored."""
ARRIVED = 1.01
"""A training has arrived once its loss stays within this factor of the minimum's."""


def path_scores(estimate: Estimate, truth: Truth) -> dict[str, float]:
    """Named scores of a training; none without its traces, or where the estimate failed.

    ``training_s``: processor seconds to its end; ``loss_over_minimum`` at its end; ``arrival_s``: when
    the loss came within 1 % of the minimum for good (absent if never); ``<group>_off_pct_at_<t>s``: the error of an
    identifiable group at a moment; ``<group>_off_pct_at_minimum``: that of the loss's own minimum.
    """
    traces = estimate.traces
    if estimate.status is not Status.OK or "path_cpu_s" not in traces or "path_parameters" not in traces:
        return {}
    seconds = traces["path_cpu_s"]
    scores = {"training_s": float(seconds[-1])}
    if "minimum_loss" in traces and "path_loss" in traces:
        scores |= _arrival(seconds, traces["path_loss"], float(traces["minimum_loss"][0]))
    for moment in MOMENTS:
        at = int(np.searchsorted(seconds, moment, "right")) - 1
        if at >= 0:
            scores |= _errors(estimate, truth, traces["path_parameters"][at], f"{moment:g}s")
    if "minimum_parameters" in traces:
        scores |= _errors(estimate, truth, traces["minimum_parameters"], "minimum")
    return scores


def of_clock(name: str) -> bool:
    """Whether a score hangs on how fast the machine is: at the moments of a path, and the times themselves."""
    return name in ("training_s", "arrival_s") or bool(re.search(r"_at_[-+.e\d]+s$", name))


def _arrival(seconds: np.ndarray, losses: np.ndarray, least: float) -> dict[str, float]:
    scores = {"loss_over_minimum": float(losses[-1] / max(least, 1e-300))}
    away = np.flatnonzero(~(losses <= ARRIVED * least))
    first = int(away[-1]) + 1 if away.size else 0
    return scores | ({"arrival_s": float(seconds[first])} if first < seconds.size else {})


def _errors(estimate: Estimate, truth: Truth, values: np.ndarray, when: str) -> dict[str, float]:
    names = estimate.system.names
    parameters: Mapping[str, float] = dict(zip(names, map(float, values), strict=True))
    return {
        f"{group.name}_off_pct_at_{when}": 100.0 * abs(group.value(parameters) / group.value(truth.parameters) - 1.0)
        for group in estimate.system.groups
    }
