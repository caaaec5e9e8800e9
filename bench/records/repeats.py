"""Repeats of a test: each record is identified separately, and a random-effects model combines the results.

The logarithm of a quantity in run i is ``y_i = mean + u_i + e_i``. The variance of ``e_i`` is that of the run's
interval, that of ``u_i`` the variance between runs (R. C. Paule, J. Mandel, J. Res. Natl. Bur. Stand. 87:377, 1982),
which is shrunk towards the prior of :mod:`bench.records.intervals` for few runs. The interval of another repeat is the
prediction interval (J. P. T. Higgins, S. G. Thompson, D. J. Spiegelhalter, J. R. Stat. Soc. A 172:137, 2009). A run
with a large deleted residual (W. Viechtbauer, M. W.-L. Cheung, Res. Synth. Methods 1:112, 2010) is excluded.
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
"""Probability of excluding any run although all are repeats of one test."""
ROUNDING = 1e-24
"""Least variance of a logarithm, as the variances of records without noise vanish."""
LEAST_DOF = 3
"""Least degrees of freedom of the variance between runs; the prior supplies those that the runs lack."""


def runs_of(measured: Measured) -> list[Measured]:
    """Split several records into single ones; empty for one record, or with a prior, which would be used repeatedly."""
    problem = measured.problem
    if len(problem.records) < 2 or problem.prior is not None:
        return []
    return [
        replace(measured, recordings=(recording,), problem=replace(problem, records=(record,), name=recording.source))
        for recording, record in zip(measured.recordings, problem.records, strict=True)
    ]


def combined(findings: Sequence[Finding]) -> Finding | None:
    """Combine the results of separate records; None if no record has a trusted estimate."""
    runs = [Run(name, finding, _failure(finding)) for name, finding in zip(_names(findings), findings, strict=True)]
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
    reasons = [Reason(Trust.CAUTION, f"{run.name} is excluded: {run.left_out}") for run in runs if run.left_out]
    if 2 * len(kept) < len(runs):
        reasons.insert(0, Reason(Trust.NO, f"only {len(kept)} of {len(runs)} runs agree and have an estimate"))
    reasons += reasons_of_intervals(spread)
    reasons += [replace(reason, text=f"{middle.name}: {reason.text}") for reason in shown.reasons]
    notes = list(dict.fromkeys(shown.measured.notes))
    if effects:
        scatter = [f"{effect.percent:.2g} % in {readable(name)}" for name, effect in effects.items()][:2]
        notes.append(f"{len(kept)} runs, fitted separately; standard deviation between runs {', '.join(scatter)}")
    return replace(
        shown,
        measured=replace(shown.measured, notes=tuple(notes)),
        stated={**shown.stated, **spread},
        reasons=tuple(reasons),
        runs=tuple(runs),
    )


@dataclass(frozen=True)
class RandomEffects:
    """Random-effects model of a quantity's logarithm.

    Attributes:
        interval: Stated interval.
        mean: Mean of the logarithm.
        error: Variance of the mean.
        between: Variance between runs.
        dof: Degrees of freedom of ``between``.
        percent: Standard deviation between the values (%).
    """

    interval: StatedInterval
    mean: float
    error: float
    between: float
    dof: int
    percent: float


def random_effects(stated: Sequence[StatedInterval], quantity: Quantity, system: System) -> RandomEffects:
    """Fit the random-effects model to the intervals of a quantity in two or more runs."""
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
    repeat, joint = quantile * math.sqrt(between + error), quantile * math.sqrt(error)
    low, high, record_low, record_high, white_low, white_high = (
        math.exp(mean + sign * half) for half in (repeat, joint, white) for sign in (-1.0, 1.0)
    )
    interval = StatedInterval(
        math.exp(mean), low, high, record_low, record_high, white_low, white_high, stated[0].unit, "", uneven
    )
    if repeat > WIDEST:
        interval = replace(interval, low=0.0, limit="at most")
    return RandomEffects(interval, mean, error, between, dof, 100.0 * float(np.std(y, ddof=1)))


def _variance(low: float, high: float) -> float:
    """Return the variance of a logarithm from its 95 % interval, at least ``ROUNDING``."""
    return max((math.log(high / low) / (2.0 * HALF)) ** 2, ROUNDING)


def _stated(runs: Sequence[Run], quantity: Quantity) -> dict[str, StatedInterval]:
    """Return the two-sided intervals of a quantity with positive ends, by name of the run."""
    stated = {run.name: run.finding.intervals.get(quantity.name) for run in runs}
    return {
        name: interval
        for name, interval in stated.items()
        if interval and not interval.limit and min(interval.record_low, interval.white_low) > 0
    }


def _prior_variance(quantity: Quantity, system: System) -> float:
    """Return the prior variance between repeats of a quantity's logarithm."""
    ratios = [(quantity.exponents.get(p.name, 0.0), p.kind) for p in system.parameters if p.name != system.gauge]
    return sum((power * PRIOR_SPREAD[kind]) ** 2 for power, kind in ratios) or PRIOR_SPREAD["mass"] ** 2


def _odd_run(kept: Sequence[Run]) -> Run | None:
    """Return the most deviating run, with the reason to exclude it; None if no deviation is significant."""
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
                values = f"{readable(quantity.name)} {interval.value:.4g}, mean of the others {math.exp(rest.mean):.4g}"
                least, odd = chance, replace(run, left_out=f"inconsistent with the other runs: {values}")
    return odd


def _middle(kept: Sequence[Run]) -> Run:
    """Return the run with the median value among those with the most frequent verdict."""
    trusted = [run for run in kept if run.finding.trust is Trust.TRUST]
    alike = trusted if 2 * len(trusted) > len(kept) else [run for run in kept if run not in trusted]
    return sorted(alike, key=lambda run: next(iter(run.finding.intervals.values())).value)[len(alike) // 2]


def _failure(finding: Finding) -> str:
    """Return the reason to exclude a run without a trusted estimate; empty if it has one."""
    reasons = [reason.text for reason in finding.reasons if reason.verdict is Trust.NO]
    reason = reasons[0] if reasons else finding.estimate.message
    return "" if finding.intervals else f"no trusted estimate: {reason}"


def _names(findings: Sequence[Finding]) -> list[str]:
    """Return the names of the files, with their folders if two names are equal."""
    sources = [finding.measured.recordings[0].source for finding in findings]
    names = [Path(source).name for source in sources]
    return names if len(set(names)) == len(names) else sources
