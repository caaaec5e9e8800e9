"""The certificate of measured records: what one method finds, and all that supports it or contradicts it.

Beside the primary method's answer stand the other methods', the model classes, a prediction of what was held out,
simulated replicas, and what a better record would bring. Nothing is drawn here.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from bench.config.schema import Job
from bench.contract.estimate import Status
from bench.engine.progress import RunState
from bench.entrants.reference import REFERENCES
from bench.errors import InputError
from bench.isolation.processes import Died
from bench.records.classes import NAME, best_class, class_fit, compare_classes
from bench.records.find import find
from bench.records.finding import Finding, judged
from bench.records.fit import Outcome
from bench.records.held_out import early_fit
from bench.records.intervals import StatedInterval
from bench.records.linearised import Linearised
from bench.records.models import ClassComparison, ModelClass
from bench.records.problem import Measured, spare_factor, with_fewer_samples
from bench.records.replicas import ReplicaCoverage, coverage_on_replicas
from bench.records.request import AUTO, Request
from bench.records.verdict import Reason, Trust
from bench.records.what_if import WhatIf, what_if
from bench.records.workers import Call, Workers

CLASSES_SECONDS = 60.0
"""Time to compare classes; then the certificate lacks them, and system=auto takes sdof."""
OTHERS_SECONDS = 10.0
"""Time limit of each method beside the first."""
OTHERS_SAMPLES = 5000
"""Samples that the methods beside the first get at least of a longer record, decimated: they only check its answer."""
COMPARED = 2
"""Quantities in which methods are compared."""
OnLook = Callable[[RunState], None]


@dataclass(frozen=True, eq=False)
class Prediction:
    """The first channel as predicted by a fit of the part before ``split`` (s); ``fit`` in percent."""

    split: float
    predicted: np.ndarray
    fit: float


@dataclass(frozen=True)
class MethodComparison:
    """One method's value of one quantity beside the primary's: ``agrees``, ``tied`` or ``off``.

    It agrees inside the primary's interval, and is tied with it where its own interval covers the primary's value.
    """

    method: str
    quantity: str
    interval: StatedInterval
    agreement: str


@dataclass(frozen=True, eq=False)
class Certificate:
    """All that is stated of records; the first of ``findings`` is the primary method's.

    ``missing`` says of a part that is not there why it is not.
    """

    request: Request
    measured: Measured
    findings: tuple[Finding, ...]
    compared: tuple[MethodComparison, ...]
    classes: tuple[ModelClass, ...] = ()
    prediction: Prediction | None = None
    replicas: tuple[ReplicaCoverage, ...] = ()
    what_if: tuple[WhatIf, ...] = ()
    missing: Mapping[str, str] = field(default_factory=dict)

    @property
    def primary(self) -> Finding:
        return self.findings[0]

    @property
    def names(self) -> tuple[str, ...]:
        """The quantities in which methods are compared."""
        return compared_quantities(self.findings)


def certify(
    request: Request,
    measured: Measured,
    replicas: int,
    on_look: OnLook = lambda look: None,
    say: Callable[[str], None] = lambda sentence: None,
) -> Certificate:
    """Gather the certificate of records; raises InputError.

    Args:
        request: Its first method is the primary one.
        measured: The records.
        replicas: Number of simulated replicas; 0 for none.
        on_look: Gets the progress.
        say: Gets a sentence before work whose length the user chose.
    """
    missing: dict[str, str] = {}
    with Workers() as workers:
        on_look(RunState("step", 0, len(request.jobs) + 1, "model classes"))
        comparison = _comparison(measured, workers, missing)
        classes = () if comparison is None else tuple(comparison.classes)
        auto = request.system == AUTO
        measured = best_class(measured, comparison) if auto else replace(measured, comparison=comparison)
        answer, others = _answers(request, measured, workers, on_look)
        if answer.finding.outcome.status is not Status.OK and classes and auto:
            by_class = workers.one(Call(_of_class, (answer.finding, classes, measured), CLASSES_SECONDS))
            answer, others = (by_class, [answer.finding, *others]) if by_class else (answer, others)
        compared = comparisons([answer.finding, *others])
        primary = with_reasons(answer.finding, compared, missing)
        drawn = _replicas(primary, request.job, replicas, workers, on_look, say, missing)
    if not answer.what_if:
        missing["what_if"] = "the answer is not to be trusted, or the data leave a direction open"
    findings = (primary, *others)
    return Certificate(
        request, measured, findings, compared, classes, answer.prediction, drawn, answer.what_if, missing
    )


# ------------------------------------------------------------------------------------------------ methods


@dataclass(frozen=True, eq=False)
class PrimaryAnswer:
    """The primary method's finding, and what follows from its fit."""

    finding: Finding
    prediction: Prediction | None = None
    what_if: tuple[WhatIf, ...] = ()


def primary_answer(job: Job, measured: Measured) -> PrimaryAnswer:
    """Find the primary method's answer; raises InputError."""
    return _with_consequences(find(job, measured))


def _with_consequences(finding: Finding) -> PrimaryAnswer:
    prediction = None if finding.fit is None else prediction_of(finding.fit)
    changes = () if finding.trust is Trust.NO else what_if(finding)
    return PrimaryAnswer(finding, prediction, changes)


def other_answer(job: Job, measured: Measured) -> Finding | None:
    """Find the answer of a method beside the first; None where it does not take measured records."""
    factor = min(spare_factor(measured.problem), measured.problem.n // OTHERS_SAMPLES)
    try:
        return find(job, with_fewer_samples(measured, factor, job) if factor > 1 else measured)
    except InputError:
        return None


def _answers(
    request: Request, measured: Measured, workers: Workers, on_look: OnLook
) -> tuple[PrimaryAnswer, list[Finding]]:
    """Perform the request's jobs side by side: the primary's answer, and the findings of the others in their order."""
    first, jobs = request.jobs[0], [job for job in request.jobs if job.config.method["name"] not in REFERENCES]
    jobs = [first, *(job for job in jobs if job is not first)]
    limits = [job.config.timeout_s if job is first else min(job.config.timeout_s, OTHERS_SECONDS) for job in jobs]
    tasks = [
        Call(primary_answer if job is first else other_answer, (job, measured), limit, job.config.memory_mb)
        for job, limit in zip(jobs, limits, strict=True)
    ]
    results: dict[int, PrimaryAnswer | Finding] = {}
    on_look(RunState("step", 1, len(jobs) + 1, first.label))
    for number, result in workers.perform(tasks):
        if isinstance(result, Died):
            outcome = Outcome(None, Status(result.reason), result.message, limits[number])
            stopped = judged(jobs[number].label, measured, outcome)
            result = stopped if number else PrimaryAnswer(stopped)
        results[number] = result
        on_look(RunState("step", 1 + len(results), len(jobs) + 1, jobs[number].label))
    answer = results.pop(0)
    assert isinstance(answer, PrimaryAnswer)
    return answer, [finding for _, finding in sorted(results.items()) if isinstance(finding, Finding)]


def _of_class(failed: Finding, classes: Sequence[ModelClass], measured: Measured) -> PrimaryAnswer | None:
    """Where the primary method has no answer for the class that was chosen: what the class's own fit says."""
    outcome = class_fit(classes[0], measured.problem) if len(measured.problem.records) == 1 else None
    if outcome is None:
        return None
    finding = judged(NAME, measured, outcome)
    said = f"{failed.method} found no answer: {failed.outcome.message}; this is the class's own fit"
    return _with_consequences(replace(finding, reasons=(*finding.reasons, Reason(Trust.CAUTION, said))))


def _comparison(measured: Measured, workers: Workers, missing: dict[str, str]) -> ClassComparison | None:
    """Compare model classes, or say why they are not."""
    try:
        comparison: ClassComparison | None = workers.one(Call(compare_classes, (measured,), CLASSES_SECONDS))
    except Died as died:
        missing["classes"] = died.message
        return None
    if comparison is None:
        missing["classes"] = "classes are compared for one degree of freedom"
    return comparison


def compared_quantities(findings: Sequence[Finding]) -> tuple[str, ...]:
    """Return k/m and c/m, or the first two groups of the system that any method determines."""
    stated = {name for one in findings for name in (one.intervals or one.withdrawn)}
    groups = [q.name for q in findings[0].problem.system.groups if q.name in stated]
    first = [name for name in ("k_over_m", "c_over_m") if name in groups]
    return tuple([*first, *(name for name in groups if name not in first)][:COMPARED])


def comparisons(findings: Sequence[Finding]) -> tuple[MethodComparison, ...]:
    """Compare each method's values with the primary's, whose own come first."""
    rows = []
    for name in compared_quantities(findings):
        reference = findings[0].intervals.get(name)
        for finding in findings:
            interval = finding.intervals.get(name)
            if interval is not None:
                agreement = "primary" if finding is findings[0] else agreement_of(interval, reference)
                rows.append(MethodComparison(finding.method, name, interval, agreement))
    return tuple(rows)


def agreement_of(other: StatedInterval, reference: StatedInterval | None) -> str:
    """Return ``agrees``, ``tied`` or ``off``; ``-`` where there is no reference."""
    if reference is None:
        return "-"
    if reference.low <= other.value <= reference.high:
        return "agrees"
    return "tied" if other.low <= reference.value <= other.high else "off"


def with_reasons(
    primary: Finding, compared: Sequence[MethodComparison], missing: Mapping[str, str] = MappingProxyType({})
) -> Finding:
    """Add the reasons for caution that methods give whose own answers are sound, and the comparison of classes."""
    off: dict[str, list[str]] = {}
    for one in compared:
        if one.agreement == "off":
            off.setdefault(one.quantity, []).append(one.method)
    said = [f"{', '.join(methods)} disagree{'s' if len(methods) == 1 else ''} in {name.replace('_over_', '/')}"
            for name, methods in off.items()]  # fmt: skip
    said += _reasons_of_classes(primary, missing)
    return replace(primary, reasons=(*primary.reasons, *(Reason(Trust.CAUTION, reason) for reason in said)))


def _reasons_of_classes(primary: Finding, missing: Mapping[str, str]) -> list[str]:
    comparison, terms = primary.measured.comparison, set(getattr(primary.problem.system, "terms", ()))
    if comparison is None:
        return [f"model classes were not compared: {missing['classes']}"] if "classes" in missing else []
    good = [comparison.chosen, *comparison.tied]
    if terms and all(set(one.system.terms) != terms for one in good):
        return [f"the class {comparison.chosen.name} describes the record better: system=auto takes it"]
    others = [one.name for one in good if set(one.system.terms) != terms]
    return [f"the record does not distinguish these classes from the one taken: {', '.join(others)}"] if others else []


# ------------------------------------------------------------------------------------------------ consequences


def prediction_of(at: Linearised) -> Prediction | None:
    """Predict the last 40 % of the first channel by a fit of the first 60 %; None where that fit is not possible."""
    early, samples = early_fit(at), at.channels[0]
    if early is None or not np.all(np.isfinite(early.predicted[samples])):
        return None
    fit = early.fit_percent(at.model.data, samples)
    return None if math.isnan(fit) else Prediction(early.split, early.predicted[samples], fit)


def _replicas(
    primary: Finding,
    job: Job,
    n: int,
    workers: Workers,
    on_look: OnLook,
    say: Callable[[str], None],
    missing: dict[str, str],
) -> tuple[ReplicaCoverage, ...]:
    primary = next((run.finding for run in primary.runs if run.finding.fit is primary.fit), primary)
    if n == 0:
        missing["replicas"] = "none were asked for (twins=0)"
    elif primary.trust is Trust.NO or primary.fit is None:
        missing["replicas"] = "the answer is not to be trusted, so no replicas of it are simulated"
    elif primary.method != job.label:
        missing["replicas"] = f"replicas are fitted by a method, and this answer is the {primary.method}"
    if "replicas" in missing:
        return ()
    started = time.monotonic()

    def on_replicas(done: int, seconds_left: float) -> None:
        nonlocal started
        if started and done < n:
            say(f"{n} simulated replicas: about {seconds_left:.0f} s more (twins=0 leaves them out)")
        started = 0.0
        on_look(RunState("replica", done, n, "", seconds_left, at_least=False))

    coverages = coverage_on_replicas(primary, job, n, workers, on_replicas)
    if not coverages:
        missing["replicas"] = f"of {n} replicas fewer than 20 were answered"
    return coverages
