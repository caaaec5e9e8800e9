"""Repeats of a test: every record is answered alone, and their spread is the interval of another repeat.

The logarithm of a quantity in run i is ``y_i = mean + u_i + e_i``: the error ``e_i`` has the variance that the interval
of the run states, ``u_i`` that between runs (R. C. Paule, J. Mandel, J. Res. Natl. Bur. Stand. 87:377, 1982); of two or
three runs it is drawn towards the prior spread of :mod:`bench.records.intervals`. Another repeat lies in the prediction
interval of the model (J. P. T. Higgins, S. G. Thompson, D. J. Spiegelhalter, J. R. Stat. Soc. A 172:137, 2009). A run
whose deleted residual is too large (W. Viechtbauer, M. W.-L. Cheung, Res. Synth. Methods 1:112, 2010) is of another
rig, and left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bench.contract.distribution import standard_quantile
from bench.records.diagnostics import readable, reasons_of_intervals
from bench.records.finding import Finding, Run
from bench.records.intervals import CHANCE, HALF, PRIOR_SPREAD, UPPER, WIDEST, StatedInterval, paule_mandel
from bench.records.problem import Measured
from bench.records.verdict import Reason, Trust
from bench.systems import Quantity, System

LEVEL = 1e-3
"""Probability that any run of repeats of one rig is taken for one of another rig."""
ROUNDING = 1e-24
"""Least variance of a logarithm: of a record without noise the variances would otherwise vanish."""
LEAST_DOF = 3
"""Degrees of freedom of the variance between runs; where these are too few for it, the prior makes up for the rest."""


def runs_of(measured: Measured) -> list[Measured]:
    """Return each of several records alone; none for a single record, or where a prior would count once for each."""
    problem = measured.problem
    if len(problem.records) < 2 or problem.prior is not None:
        return []
    return [
        replace(measured, recordings=(recording,), problem=replace(problem, records=(record,), name=recording.source))
        for recording, record in zip(measured.recordings, problem.records, strict=True)
    ]


def combined(alone: Sequence[Finding]) -> Finding | None:
    """Combine what each of several records says alone; None where none of them has an answer that stands."""
    runs = [Run(name, finding, _failure(finding)) for name, finding in zip(_names(alone), alone, strict=True)]
    while (odd := _odd_run([run for run in runs if not run.left_out])) is not None:
        runs = [odd if run.name == odd.name else run for run in runs]
    kept = [run for run in runs if not run.left_out]
    if not kept:
        return None
    middle = _middle(kept)
    shown, system = middle.finding, middle.finding.problem.system
    effects = {
        quantity.name: random_effects(list(stated.values()), quantity, system)
        for quantity in system.quantities
        if len(stated := _stated(kept, quantity)) > 1
    }
    spread = {name: effect.interval for name, effect in effects.items()}
    reasons = [Reason(Trust.CAUTION, f"{run.name} is left out: {run.left_out}") for run in runs if run.left_out]
    if 2 * len(kept) < len(runs):
        reasons.insert(0, Reason(Trust.NO, f"only {len(kept)} of {len(runs)} runs agree and can be answered"))
    reasons += reasons_of_intervals(spread)
    reasons += [replace(reason, text=f"{middle.name}: {reason.text}") for reason in shown.reasons]
    notes = list(dict.fromkeys(shown.measured.notes))
    if effects:
        scatter = [f"{readable(name)} by {effect.percent:.2g} %" for name, effect in effects.items()][:2]
        differ = f"differ in {' and in '.join(scatter)} (standard deviation)"
        notes.append(f"{len(kept)} runs, each answered alone, {differ}")
    return replace(
        shown,
        measured=replace(shown.measured, notes=tuple(notes)),
        stated={**shown.stated, **spread},
        reasons=tuple(reasons),
        runs=tuple(runs),
    )


@dataclass(frozen=True)
class RandomEffects:
    """The random-effects model of a quantity's logarithm.

    ``mean`` with its variance ``error``; the variance ``between`` runs with its degrees of freedom; ``percent``: the
    standard deviation between the values.
    """

    interval: StatedInterval
    mean: float
    error: float
    between: float
    dof: int
    percent: float


def random_effects(stated: Sequence[StatedInterval], quantity: Quantity, system: System) -> RandomEffects:
    """Fit the model to intervals of two runs or more."""
    y = np.log([interval.value for interval in stated])
    v = np.array([_variance(interval.record_low, interval.record_high) for interval in stated])
    prior, of_runs = _prior_variance(quantity, system), paule_mandel(y, v)
    more = max(LEAST_DOF - (y.size - 1), 0)
    dof = y.size - 1 + more
    between = ((y.size - 1) * of_runs.variance + more * prior) / dof
    weights = 1.0 / (v + between)
    mean, error = float(np.sum(weights * y) / np.sum(weights)), float(1.0 / np.sum(weights))
    white = HALF / math.sqrt(sum(1.0 / _variance(interval.white_low, interval.white_high) for interval in stated))
    quantile = float(standard_quantile(UPPER, dof))
    uneven = math.sqrt(of_runs.variance / prior) if of_runs.chance < CHANCE else 1.0
    repeat, together = quantile * math.sqrt(between + error), quantile * math.sqrt(error)
    low, high, record_low, record_high, white_low, white_high = (
        math.exp(mean + sign * half) for half in (repeat, together, white) for sign in (-1.0, 1.0)
    )
    interval = StatedInterval(
        math.exp(mean), low, high, record_low, record_high, white_low, white_high, stated[0].unit, "", uneven
    )
    if repeat > WIDEST:
        interval = replace(interval, low=0.0, limit="at most")
    return RandomEffects(interval, mean, error, between, dof, 100.0 * float(np.std(y, ddof=1)))


def _variance(low: float, high: float) -> float:
    """Return the variance of a logarithm whose 95 % interval ends there, at least that of rounding."""
    return max((math.log(high / low) / (2.0 * HALF)) ** 2, ROUNDING)


def _stated(runs: Sequence[Run], quantity: Quantity) -> dict[str, StatedInterval]:
    """Return the intervals of a quantity that have two ends, and a logarithm, by the run's name."""
    stated = {run.name: run.finding.intervals.get(quantity.name) for run in runs}
    return {
        name: interval
        for name, interval in stated.items()
        if interval and not interval.limit and min(interval.record_low, interval.white_low) > 0
    }


def _prior_variance(quantity: Quantity, system: System) -> float:
    """Return the variance between repeats expected before the data, which is stated of ratios to the mass."""
    ratios = [(quantity.exponents.get(p.name, 0.0), p.kind) for p in system.parameters if p.name != system.gauge]
    return sum((power * PRIOR_SPREAD[kind]) ** 2 for power, kind in ratios) or PRIOR_SPREAD["mass"] ** 2


def _odd_run(kept: Sequence[Run]) -> Run | None:
    """Return the run that is least like the others, with the reason to leave it out, if chance does not explain it."""
    from scipy.stats import t

    system, odd, least = kept[0].finding.problem.system if kept else None, None, LEVEL
    groups = [(q, stated) for q in (system.groups if system else ()) if len(stated := _stated(kept, q)) > 2]
    for quantity, stated in groups:
        for run in (run for run in kept if run.name in stated):
            interval, others = stated[run.name], [other for name, other in stated.items() if name != run.name]
            rest = random_effects(others, quantity, run.finding.problem.system)
            error = math.sqrt(_variance(interval.record_low, interval.record_high) + rest.between + rest.error)
            chance = 2.0 * float(t.sf(abs(math.log(interval.value) - rest.mean) / error, rest.dof))
            chance *= len(stated) * len(groups)
            if chance < least:
                values = f"{readable(quantity.name)} = {interval.value:.4g}, theirs {math.exp(rest.mean):.4g}"
                least, odd = chance, replace(run, left_out=f"not a repeat of the others: {values}")
    return odd


def _middle(kept: Sequence[Run]) -> Run:
    """Return the run with the median value, of those with the commonest verdict."""
    trusted = [run for run in kept if run.finding.trust is Trust.TRUST]
    alike = trusted if 2 * len(trusted) > len(kept) else [run for run in kept if run not in trusted]
    return sorted(alike, key=lambda run: next(iter(run.finding.intervals.values())).value)[len(alike) // 2]


def _failure(finding: Finding) -> str:
    """Return why a run is left out that has no answer alone, or nothing."""
    reasons = [reason.text for reason in finding.reasons if reason.verdict is Trust.NO]
    because = reasons[0] if reasons else finding.estimate.message
    return "" if finding.intervals else f"alone it has no answer to trust: {because}"


def _names(alone: Sequence[Finding]) -> list[str]:
    """Return the names of the files, with their folders where two of them are alike."""
    sources = [finding.measured.recordings[0].source for finding in alone]
    names = [Path(source).name for source in sources]
    return names if len(set(names)) == len(names) else sources
