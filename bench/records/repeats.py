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
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bench.contract.belief import standard_quantile
from bench.records.finding import Finding, Run
from bench.records.intervals import HALF, PRIOR_SPREAD, UPPER, WIDEST, StatedInterval, paule_mandel
from bench.records.record import Measured
from bench.records.verdict import Reason, Trust
from bench.systems import Quantity, System

LEVEL = 1e-3
"""Probability that any run of repeats of one rig is taken for one of another rig."""
LEAST_DOF = 3
"""Degrees of freedom of the variance between runs; where these are too few for it, the prior makes up for the rest."""
LEAST_OTHERS = 2
"""Runs that have to agree before another one can be left out."""
UNALIKE = 5.0
"""Standard deviation between runs over the prior's beyond which they may be of different rigs."""


def runs_of(measured: Measured) -> list[Measured]:
    """Return each of several records alone; none for a single record, or where a prior would count once for each."""
    problem = measured.problem
    if len(problem.records) < 2 or problem.prior is not None:
        return []
    return [
        replace(
            measured, recordings=(recording,), problem=replace(problem, records=(record,), name=_name(recording.source))
        )
        for recording, record in zip(measured.recordings, problem.records, strict=True)
    ]


def combined(alone: Sequence[Finding]) -> Finding | None:
    """Combine what each of several records says alone; None where none of them has an answer that stands."""
    runs = [Run(_name_of(finding), finding) for finding in alone]
    runs = [run if run.finding.intervals else replace(run, left_out=_failed(run)) for run in runs]
    while (odd := _odd_run(_kept(runs))) is not None:
        runs = [replace(run, left_out=odd[1]) if run is odd[0] else run for run in runs]
    kept = _kept(runs)
    if not kept:
        return None
    system = kept[0].finding.problem.system
    spreads = {name: spread for q in system.quantities if (spread := _spread(kept, q, system)) for name in (q.name,)}
    shown = _representative(kept, spreads)
    intervals = {name: spreads[name].interval if name in spreads else own for name, own in shown.intervals.items()}
    said = f"{len(runs)} runs, each answered alone; {_differences(spreads) or f'{len(kept)} of them stands'}"
    reasons = (*_reasons(runs, spreads), *(Reason(r.verdict, f"{_name_of(shown)}: {r.text}") for r in shown.reasons))
    stands = all(reason.verdict is not Trust.NO for reason in reasons)
    return replace(
        shown,
        measured=replace(shown.measured, notes=(*dict.fromkeys(shown.measured.notes), said)),
        intervals=intervals if stands else {},
        withdrawn={} if stands else intervals,
        reasons=reasons,
        runs=tuple(runs),
    )


@dataclass(frozen=True)
class RandomEffects:
    """The random-effects model of a quantity: its interval, and the standard deviation of its logarithm."""

    interval: StatedInterval
    deviation: float
    unevenness: float


def _spread(kept: Sequence[Run], quantity: Quantity, system: System) -> RandomEffects | None:
    """Fit the random-effects model to the runs that determine a quantity; None for fewer than two of them."""
    stated = list(_determining(kept, quantity.name).values())
    if len(stated) < 2:
        return None
    y, v = _logs(stated)
    prior = _prior_variance(quantity, system)
    variance, dof = _variance(y, v, prior)
    mean, error = _mean(y, v + variance)
    value, quantile = math.exp(mean), float(standard_quantile(UPPER, dof))
    white = HALF / math.sqrt(sum((2 * HALF / math.log(own.white_high / own.white_low)) ** 2 for own in stated))
    repeat, own = quantile * math.sqrt(variance + error), quantile * math.sqrt(error)
    low, high, record_low, record_high, white_low, white_high = (
        value * math.exp(sign * half) for half in (repeat, own, white) for sign in (-1.0, 1.0)
    )
    uneven = math.sqrt(paule_mandel(y, v) / prior)
    interval = StatedInterval(
        value, low, high, record_low, record_high, white_low, white_high, quantity.unit, unevenness=uneven
    )
    if repeat > WIDEST:
        interval = replace(interval, low=0.0, limit="at most")
    return RandomEffects(interval, float(np.std(y, ddof=1)), uneven)


def _determining(runs: Sequence[Run], name: str) -> dict[Run, StatedInterval]:
    """Return the intervals of a quantity that have two ends, and a logarithm, by run."""
    stated = {run: run.finding.intervals[name] for run in runs if name in run.finding.intervals}
    return {run: own for run, own in stated.items() if not own.limit and min(own.record_low, own.white_low) > 0}


def _logs(stated: Sequence[StatedInterval]) -> tuple[np.ndarray, np.ndarray]:
    """Return logarithms (n,) and their variances (n,) by the runs' own intervals."""
    errors = [math.log(own.record_high / own.record_low) / (2 * HALF) for own in stated]
    return np.array([math.log(own.value) for own in stated]), np.array(errors) ** 2


def _variance(y: np.ndarray, v: np.ndarray, prior: float) -> tuple[float, int]:
    """Return the variance between runs of logarithms (n,) with variances (n,), and its degrees of freedom."""
    own = y.size - 1
    more = max(LEAST_DOF - own, 0)
    return (own * paule_mandel(y, v) + more * prior) / (own + more), own + more


def _mean(y: np.ndarray, variances: np.ndarray) -> tuple[float, float]:
    """Return the weighted mean and its variance."""
    weights = 1.0 / variances
    return float(np.sum(weights * y) / np.sum(weights)), float(1.0 / np.sum(weights))


def _prior_variance(quantity: Quantity, system: System) -> float:
    """Return the variance between repeats expected before the data, ratios to the mass being independent."""
    kinds = {parameter.name: parameter.kind for parameter in system.parameters}
    powers = {name: power for name, power in quantity.exponents.items() if name != system.gauge}
    mass = quantity.exponents.get(system.gauge, 0.0) + sum(
        power * float(system.dimensions[name].mass) for name, power in powers.items()
    )
    return (
        sum((power * PRIOR_SPREAD[kinds[name]]) ** 2 for name, power in powers.items())
        + (mass * PRIOR_SPREAD["mass"]) ** 2
    )


def _odd_run(kept: Sequence[Run]) -> tuple[Run, str] | None:
    """Return the run that is least like the others, and in what, if chance does not explain it."""
    if len(kept) <= LEAST_OTHERS:
        return None
    system = kept[0].finding.problem.system
    worst: tuple[float, Run, str] | None = None
    groups = [q for q in system.groups if len(_determining(kept, q.name)) > LEAST_OTHERS]
    for quantity in groups:
        stated = _determining(kept, quantity.name)
        y, v = _logs(list(stated.values()))
        for i, (run, own) in enumerate(stated.items()):
            others = np.arange(y.size) != i
            variance, dof = _variance(y[others], v[others], _prior_variance(quantity, system))
            mean, error = _mean(y[others], v[others] + variance)
            chance = _two_sided((y[i] - mean) / math.sqrt(v[i] + variance + error), dof)
            if chance * y.size * len(groups) < LEVEL and (worst is None or chance < worst[0]):
                name = quantity.name.replace("_over_", "/")
                said = f"not a repeat of the others: {name} = {own.value:.4g}, theirs {math.exp(mean):.4g}"
                worst = (chance, run, said)
    return None if worst is None else worst[1:]


def _two_sided(statistic: float, dof: float) -> float:
    from scipy.stats import t

    return 2.0 * float(t.sf(abs(statistic), dof))


def _reasons(runs: Sequence[Run], spreads: dict[str, RandomEffects]) -> list[Reason]:
    """Return a reason for each run that is left out, and for runs that are hardly of one rig."""
    reasons = [Reason(Trust.CAUTION, f"{run.name} is left out: {run.left_out}") for run in runs if run.left_out]
    if 2 * len(_kept(runs)) < len(runs):
        reasons.insert(0, Reason(Trust.NO, f"only {len(_kept(runs))} of {len(runs)} runs agree and can be answered"))
    name, most = max(spreads.items(), key=lambda item: item[1].unevenness, default=("", None))
    if most is not None and most.unevenness > UNALIKE:
        said = f"the runs differ by {100 * most.deviation:.2g} % in {name.replace('_over_', '/')}"
        reasons.append(Reason(Trust.CAUTION, f"{said}, more than repeats of one rig do: is each of them of it?"))
    return reasons


def _representative(kept: Sequence[Run], spreads: dict[str, RandomEffects]) -> Finding:
    """Return the run in the middle, of those with the commonest verdict."""
    counts = Counter(run.finding.trust for run in kept)
    common = Trust.TRUST if 2 * counts[Trust.TRUST] > len(kept) else Trust.CAUTION
    name = next(iter(spreads), "")
    middle = spreads[name].interval.value if name else 0.0
    of_it = [run.finding for run in kept if run.finding.trust is common] or [run.finding for run in kept]
    return min(of_it, key=lambda f: abs(f.intervals[name].value - middle) if name else 0.0)


def _differences(spreads: dict[str, RandomEffects]) -> str:
    """Return the standard deviations between the runs, of two quantities, in words."""
    shown = [f"{name.replace('_over_', '/')} differs by {100 * s.deviation:.2g} %" for name, s in spreads.items()]
    return f"between them {' and '.join(shown[:2])} (standard deviation)" if shown else ""


def _failed(run: Run) -> str:
    reasons = [reason.text for reason in run.finding.reasons if reason.verdict is Trust.NO]
    return f"alone it has no answer to trust: {reasons[0] if reasons else run.finding.outcome.message}"


def _kept(runs: Sequence[Run]) -> list[Run]:
    return [run for run in runs if not run.left_out]


def _name(source: str) -> str:
    return Path(source).name


def _name_of(finding: Finding) -> str:
    return _name(finding.measured.recordings[0].source)
