"""The certificate of measured records: what one method finds, and all that speaks for or against it.

Beside the primary method's answer stand the other methods', the model classes, a prediction of what was held out, twins
(simulated records like this one) and what a better record would bring. Nothing is drawn here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from bench.contract.estimate import Status
from bench.dynamics.simulate import simulate
from bench.entrants.registry import registered
from bench.errors import InputError
from bench.isolation.processes import Died
from bench.records.classes import ModelClass, best_class, ranked_classes, simplest
from bench.records.continued import NAME, continued_fit
from bench.records.find import find
from bench.records.finding import Finding, judged
from bench.records.fit import within_time
from bench.records.held_out import early_fit
from bench.records.intervals import StatedInterval
from bench.records.linearised import Linearised
from bench.records.record import Measured
from bench.records.request import AUTO, Request
from bench.records.verdict import Reason, Trust
from bench.systems import LENGTH, MEASURED

Say = Callable[[str, int, int], None]
"""What is being done, and of how many steps how many are done."""
CLASSES_SECONDS, AUTO_SECONDS = 60.0, 180.0
"""Time to compare classes, and where system=auto needs them; then the certificate lacks them, and auto takes sdof."""
OTHERS_SECONDS, AT_ONCE = 10.0, 2
"""Limit of each method beside the first, and how many run side by side."""
TWIN_SECONDS = 10.0
"""Time that the fits to twins may take, by what each method took for the record; then methods are left out."""
LEAST_TWINS, MOST_TWINNED = 20, 5
COMPARED = 2
"""Quantities in which methods are compared."""
DENSE = 1500


@dataclass(frozen=True, eq=False)
class FittedMotion:
    """The fitted motion on a dense grid, in the channel's units."""

    times: np.ndarray
    displacement: np.ndarray
    velocity: np.ndarray


@dataclass(frozen=True, eq=False)
class Prediction:
    """The last part of the first channel as a fit of the part before ``split`` (s) has it; ``fit`` in percent."""

    split: float
    predicted: np.ndarray
    fit: float


@dataclass(frozen=True)
class MethodComparison:
    """One method's value of one quantity beside the primary's: ``agrees``, ``level`` or ``off``.

    It agrees inside the primary's interval, and is level with it where its own interval holds the primary's value.
    """

    method: str
    quantity: str
    interval: StatedInterval
    standing: str


@dataclass(frozen=True, eq=False)
class Certificate:
    """All that is stated of records; the first of ``findings`` is the primary method's.

    ``missing`` says of a part that is not there why it is not.
    """

    request: Request
    findings: tuple[Finding, ...]
    compared: tuple[MethodComparison, ...]
    classes: tuple[ModelClass, ...] = ()
    motion: FittedMotion | None = None
    prediction: Prediction | None = None
    twins: Any = None
    what_if: tuple[Any, ...] = ()
    missing: Mapping[str, str] = field(default_factory=dict)

    @property
    def primary(self) -> Finding:
        return self.findings[0]

    @property
    def names(self) -> tuple[str, ...]:
        """The quantities in which methods are compared."""
        return compared_quantities(self.findings)

    @property
    def shown(self) -> Mapping[str, StatedInterval]:
        """The primary method's intervals, or what it said before they were withdrawn."""
        return self.primary.intervals or self.primary.withdrawn


def certify(request: Request, measured: Measured, twins: int, say: Say = lambda what, done, of: None) -> Certificate:
    """Gather the certificate of records; raises InputError.

    Args:
        request: Whose first method is the primary one.
        measured: The records.
        twins: Simulated records; 0 for none.
        say: Told of every step.
    """
    steps = len(request.jobs) + 3
    missing: dict[str, str] = {}
    say("model classes", 0, steps)
    classes = tuple(_ranked(measured, missing, AUTO_SECONDS if request.system == AUTO else CLASSES_SECONDS))
    if request.system == AUTO:
        measured = best_class(measured, classes)
    kept = _all_found(request, measured, lambda label, done: say(label, 1 + done, steps))
    kept = (*_instead(kept[0], classes, measured, request), *kept)
    primary = kept[0]
    motion = motion_of(primary)
    prediction = None if primary.at is None else prediction_of(primary.at)
    say("what would help", steps - 2, steps)
    hopes = _what_if(primary, missing)

    def progress(done: int, of: int) -> None:
        say(f"twins {100 * done // max(of, 1)} %", steps - 1, steps)

    progress(0, 1)
    drawn = _twins(kept, twins, request, progress, missing)
    say("done", steps, steps)
    return Certificate(request, kept, comparisons(kept), classes, motion, prediction, drawn, hopes, missing)


def _all_found(request: Request, measured: Measured, say: Callable[[str, int], None]) -> tuple[Finding, ...]:
    """The findings of a request's jobs in their order, some at once: each fit is a process of its own."""
    pool, found = ThreadPoolExecutor(AT_ONCE), []
    waiting = [pool.submit(_found, job, measured, i == 0) for i, job in enumerate(request.jobs)]
    try:
        for i, (job, future) in enumerate(zip(request.jobs, waiting, strict=True)):
            say(job.label, i)
            found.append(future.result())
    finally:
        pool.shutdown(cancel_futures=True)  # of a run that is interrupted, no further method starts
    return tuple(one for one in found if one is not None)


def _instead(
    primary: Finding, classes: Sequence[ModelClass], measured: Measured, request: Request
) -> tuple[Finding, ...]:
    """Where the primary method has no answer for the class that was chosen: what the class's own fit says."""
    alone = len(measured.problem.records) == 1 and request.system == AUTO
    if primary.outcome.status is Status.OK or not classes or not alone:
        return ()
    outcome = continued_fit(simplest(classes), measured.problem)
    if outcome is None:
        return ()
    found = judged(NAME, measured, outcome)
    said = f"{primary.method} found no answer: {primary.outcome.message}; this is the class's own fit"
    return (replace(found, reasons=(*found.reasons, Reason(Trust.CAUTION, said))),)


def _found(job: Any, measured: Measured, first: bool) -> Finding | None:
    """The finding of a job, those beside the first within a limit; of a reference row, which needs the truth, none."""
    limit = job.config.timeout_s if first else min(job.config.timeout_s, OTHERS_SECONDS)
    config = replace(job.config, timeout_s=limit)
    try:
        return find(replace(job, config=config), measured)
    except InputError:
        if first:
            raise
        return None


def _ranked(measured: Measured, missing: dict[str, str], limit_s: float) -> list[ModelClass]:
    """The ranked classes, or why there are none: a fit of friction to pure noise may take minutes."""
    try:
        found = within_time(ranked_classes, measured, limit_s)
    except Died as died:
        missing["classes"] = died.message
        return []
    if not found:
        missing["classes"] = "classes are compared for one displacement of one degree of freedom"
    return found


def compared_quantities(findings: Sequence[Finding]) -> tuple[str, ...]:
    """k/m and c/m, or the first two groups of the system that any method tells."""
    told = {name for one in findings for name in (one.intervals or one.withdrawn)}
    groups = [q.name for q in findings[0].problem.system.groups if q.name in told]
    first = [name for name in ("k_over_m", "c_over_m") if name in groups]
    return tuple([*first, *(name for name in groups if name not in first)][:COMPARED])


def comparisons(findings: Sequence[Finding]) -> tuple[MethodComparison, ...]:
    """Each method's values beside the primary's, the primary's own first."""
    found = []
    for name in compared_quantities(findings):
        own = findings[0].intervals.get(name)
        for one in findings:
            other = one.intervals.get(name)
            if other is not None:
                standing = "primary" if one is findings[0] else standing_of(other, own)
                found.append(MethodComparison(one.method, name, other, standing))
    return tuple(found)


def standing_of(other: StatedInterval, own: StatedInterval | None) -> str:
    """How a value stands to the primary's: ``agrees``, ``level``, ``off``; ``-`` where there is none."""
    if own is None:
        return "-"
    if own.low <= other.value <= own.high:
        return "agrees"
    return "level" if other.low <= own.value <= other.high else "off"


def motion_of(finding: Finding) -> FittedMotion | None:
    """The fitted motion of the first channel's degree of freedom; None where it is not finite."""
    at = finding.at
    if at is None:
        return None
    model, record, units = at.model, at.model.problem.records[0], finding.units
    mine = model.channels[0][1]
    p = {name: float(value) for name, value in model.parameters(at.theta).items()}
    times = np.linspace(0.0, float(mine.times[-1]), DENSE)
    with np.errstate(all="ignore"):
        path = simulate(record.rig(model.system), p, model.starts(at.theta)[0], times, record.forces)
    x, v = path.displacement[mine.dof], path.velocity[mine.dof]
    if not (np.all(np.isfinite(x)) and np.all(np.isfinite(v))):
        return None
    return FittedMotion(units.time * times, units.of(LENGTH) * x, units.of(MEASURED["velocity"]) * v)


def prediction_of(at: Linearised) -> Prediction | None:
    """The last 40 % of the first channel by a fit of the first 60 %; None where that fit is not possible."""
    found, own = early_fit(at), at.channels[0]
    if found is None or not np.all(np.isfinite(found.predicted[own])):
        return None
    fit = found.fit_percent(at.model.data, own)
    return None if math.isnan(fit) else Prediction(found.split, found.predicted[own], fit)


def _what_if(primary: Finding, missing: dict[str, str]) -> tuple[Any, ...]:
    if primary.trust is Trust.NO or primary.at is None:
        missing["what_if"] = "the answer is not to be trusted, so nothing is said of what a better record would bring"
        return ()
    from bench.records.what_if import what_if

    return tuple(what_if(primary))


def affordable(findings: Sequence[Finding], n: int) -> tuple[list[str], int]:
    """The methods that twins are fitted with, the primary first, and how many twins: as the time allows."""
    took = {
        one.method: one.outcome.wall_s
        for one in findings
        if one.intervals and math.isfinite(one.outcome.wall_s) and one.method in registered()
    }
    primary = findings[0].method
    own = max(took.pop(primary, 0.0), 1e-4)
    number = n if n * own <= TWIN_SECONDS else max(min(n, LEAST_TWINS), int(TWIN_SECONDS / own))
    left, chosen = TWIN_SECONDS - number * own, [primary]
    for method, wall_s in sorted(took.items(), key=lambda item: item[1]):
        left -= number * wall_s
        if left < 0 or len(chosen) == MOST_TWINNED:
            break
        chosen.append(method)
    return chosen, number


def _twins(
    findings: Sequence[Finding], n: int, request: Request, progress: Callable[[int, int], None], missing: dict[str, str]
) -> Any:
    if n == 0:
        missing["twins"] = "none was asked for (twins=0)"
        return None
    if findings[0].trust is Trust.NO or findings[0].at is None:
        missing["twins"] = "the answer is not to be trusted, so no twins are made of it"
        return None
    if findings[0].method not in registered():
        said = "twins are fitted by registered methods with their own settings"
        missing["twins"] = f"{said}, and this answer is of {findings[0].method}"
        return None
    from bench.records.twins import twins_of

    methods, number = affordable(findings, n)
    return twins_of(findings[0], methods, number, int(request.job.config.seed), progress)
