"""The certificate of measured records: what one method finds, and all that supports it or contradicts it.

Beside the primary method's answer stand the other methods', the model classes, a prediction of what was held out,
simulated replicas, and what a better record would bring. Nothing is drawn here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import as_completed
from contextlib import suppress
from dataclasses import dataclass, field, replace

from bench.config.schema import Job
from bench.contract.estimate import Estimate, Status
from bench.engine.progress import OnProgress, RunState
from bench.entrants.reference import REFERENCES
from bench.errors import InputError
from bench.isolation.processes import Died
from bench.records.classes import NAME, best_class, class_fit, compare_classes
from bench.records.finding import Finding
from bench.records.identification import assess, identify
from bench.records.intervals import StatedInterval
from bench.records.models import ClassComparison, ModelClass
from bench.records.prediction import HeldOutPrediction, predict_held_out
from bench.records.problem import Measured, spare_factor, with_fewer_samples
from bench.records.replicas import ReplicaCoverage, coverage_on_replicas
from bench.records.request import AUTO, Request
from bench.records.verdict import Reason, Trust
from bench.records.what_if import WhatIf, what_if
from bench.records.workers import Workers

CLASSES_SECONDS = 60.0
"""Time to compare classes; then the certificate lacks them, and system=auto takes sdof."""
OTHERS_SECONDS = 10.0
"""Time limit of each method beside the first."""
OTHERS_SAMPLES = 5000
"""Samples that the methods beside the first get at least of a longer record, decimated: they only check its answer."""
COMPARED = 2
"""Quantities in which methods are compared."""
Say = Callable[[str], None]
Answer = tuple[Finding, HeldOutPrediction | None, tuple[WhatIf, ...]]
"""The primary method's finding, the prediction of what was held out from its fit, and what would help."""


@dataclass(frozen=True, eq=False)
class Certificate:
    """All that is stated of records; the first of ``findings`` is the primary method's.

    ``missing`` says of a part that is not there why it is not.
    """

    measured: Measured
    findings: tuple[Finding, ...]
    classes: tuple[ModelClass, ...] = ()
    prediction: HeldOutPrediction | None = None
    replicas: tuple[ReplicaCoverage, ...] = ()
    what_if: tuple[WhatIf, ...] = ()
    missing: Mapping[str, str] = field(default_factory=dict)

    @property
    def primary(self) -> Finding:
        return self.findings[0]


def certify(
    request: Request,
    measured: Measured,
    replicas: int,
    on_progress: OnProgress = lambda look: None,
    say: Say = lambda sentence: None,
) -> Certificate:
    """Gather the certificate of records; raises InputError.

    Args:
        request: Its first method is the primary one.
        measured: The records.
        replicas: Number of simulated replicas; 0 for none.
        on_progress: Gets the progress.
        say: Gets a sentence before work whose length the user chose.
    """
    missing: dict[str, str] = {}
    with Workers() as workers:
        on_progress(RunState("step", 0, len(request.jobs) + 1, "model classes"))
        comparison = _comparison(measured, workers, missing)
        auto = request.system == AUTO
        measured = best_class(measured, comparison) if auto else replace(measured, comparison=comparison)
        answer, findings = _answers(request, measured, workers, on_progress)
        if answer[0].estimate.status is not Status.OK and comparison is not None and auto:
            with suppress(Died):  # then the answer stays the failed one
                by_class = workers.submit(CLASSES_SECONDS, _of_class, answer[0], comparison.chosen, measured).result()
                answer, findings = (by_class, [answer[0], *findings]) if by_class else (answer, findings)
        primary = with_reasons(answer[0], findings, missing)
        drawn = _replicas(primary, request.job, replicas, workers, on_progress, say, missing)
    _, prediction, changes = answer
    if not changes:
        missing["what_if"] = "the answer is not to be trusted, or the data leave a direction open"
    classes = () if comparison is None else tuple(comparison.classes)
    return Certificate(measured, (primary, *findings), classes, prediction, drawn, changes, missing)


# ------------------------------------------------------------------------------------------------ answers


def _comparison(measured: Measured, workers: Workers, missing: dict[str, str]) -> ClassComparison | None:
    """Compare model classes, or say why they are not."""
    try:
        comparison: ClassComparison | None = workers.submit(CLASSES_SECONDS, compare_classes, measured).result()
    except Died as died:
        missing["classes"] = died.message
        return None
    if comparison is None:
        missing["classes"] = "classes are compared for one degree of freedom"
    return comparison


def _answers(
    request: Request, measured: Measured, workers: Workers, on_progress: OnProgress
) -> tuple[Answer, list[Finding]]:
    """Perform the request's jobs side by side: the primary's answer, and the findings of the others in their order.

    A method that does not take measured records is left out, beside the first.
    """
    first = request.jobs[0]
    jobs = [first, *(job for job in request.jobs[1:] if job.config.method["name"] not in REFERENCES)]
    limits = [first.config.timeout_s, *(min(job.config.timeout_s, OTHERS_SECONDS) for job in jobs[1:])]
    works = [primary_answer, *[other_answer] * len(jobs[1:])]
    futures = {
        workers.submit(limit, work, job, measured, memory_mb=job.config.memory_mb): number
        for number, (job, limit, work) in enumerate(zip(jobs, limits, works, strict=True))
    }
    on_progress(RunState("step", 1, len(jobs) + 1, first.label))
    answers: dict[int, Answer] = {}
    for done, future in enumerate(as_completed(futures), 2):
        number = futures[future]
        try:
            answers[number] = future.result()
        except Died as died:
            estimate = Estimate.failed(measured.problem.system, Status(died.reason), died.message)
            answers[number] = assess(jobs[number].label, measured, estimate, limits[number]), None, ()
        except InputError:
            if number == 0:
                raise
        on_progress(RunState("step", done, len(jobs) + 1, jobs[number].label))
    return answers.pop(0), [finding for _, (finding, _, _) in sorted(answers.items())]


def primary_answer(job: Job, measured: Measured) -> Answer:
    """Find the primary method's answer; raises InputError."""
    return _with_consequences(identify(job, measured))


def _with_consequences(finding: Finding) -> Answer:
    early = None if finding.fit is None else predict_held_out(finding.fit)
    return finding, early, () if finding.trust is Trust.NO else what_if(finding)


def other_answer(job: Job, measured: Measured) -> Answer:
    """Find the answer of a method beside the first, which only checks it; raises InputError."""
    factor = min(spare_factor(measured.problem), measured.problem.n // OTHERS_SAMPLES)
    return identify(job, with_fewer_samples(measured, factor, job) if factor > 1 else measured), None, ()


def _of_class(failed: Finding, chosen: ModelClass, measured: Measured) -> Answer | None:
    """Where the primary method has no answer for the class that was chosen: what the class's own fit says."""
    estimate = class_fit(chosen, measured.problem) if len(measured.problem.records) == 1 else None
    if estimate is None:
        return None
    finding = assess(NAME, measured, estimate)
    said = f"{failed.method} found no answer: {failed.estimate.message}; this is the class's own fit"
    return _with_consequences(replace(finding, reasons=(*finding.reasons, Reason(Trust.CAUTION, said))))


# ------------------------------------------------------------------------------------------------ agreement


def compared_quantities(findings: Sequence[Finding]) -> tuple[str, ...]:
    """Return k/m and c/m, or the first two groups of the system that any method determines."""
    stated = {name for finding in findings for name in (finding.intervals or finding.withdrawn)}
    groups = [q.name for q in findings[0].problem.system.groups if q.name in stated]
    return tuple(sorted(groups, key=lambda name: name not in ("k_over_m", "c_over_m"))[:COMPARED])


def agreements(finding: Finding, primary: Finding, names: Sequence[str]) -> dict[str, str]:
    """Compare a method's values with the primary's: ``agrees``, ``tied`` or ``off``, by quantity.

    It agrees inside the primary's interval, and is tied with it where its own interval covers the primary's value.
    """
    stated = {name: finding.intervals[name] for name in names if name in finding.intervals}
    if finding.method == primary.method:
        return dict.fromkeys(stated, "primary")
    return {name: agreement_of(interval, primary.intervals.get(name)) for name, interval in stated.items()}


def agreement_of(other: StatedInterval, reference: StatedInterval | None) -> str:
    """Return ``agrees``, ``tied`` or ``off``; ``-`` where there is no reference."""
    if reference is None:
        return "-"
    if reference.low <= other.value <= reference.high:
        return "agrees"
    return "tied" if other.low <= reference.value <= other.high else "off"


def with_reasons(primary: Finding, others: Sequence[Finding], missing: Mapping[str, str]) -> Finding:
    """Add the reasons for caution that methods give whose own answers are sound, and the comparison of classes."""
    names = compared_quantities([primary, *others])
    found = {other.method: agreements(other, primary, names) for other in others}
    said = []
    for name in names:
        off = [method for method, agreement in found.items() if agreement.get(name) == "off"]
        if off:
            said.append(f"{', '.join(off)} disagree{'s' if len(off) == 1 else ''} in {name.replace('_over_', '/')}")
    said += _reasons_of_classes(primary, missing)
    return replace(primary, reasons=(*primary.reasons, *(Reason(Trust.CAUTION, reason) for reason in said)))


def _reasons_of_classes(primary: Finding, missing: Mapping[str, str]) -> list[str]:
    comparison, terms = primary.measured.comparison, set(getattr(primary.problem.system, "terms", ()))
    if comparison is None:
        return [f"model classes were not compared: {missing['classes']}"] if "classes" in missing else []
    good = [comparison.chosen, *comparison.tied]
    if terms and all(set(model.system.terms) != terms for model in good):
        return [f"the class {comparison.chosen.name} describes the record better: system=auto takes it"]
    tied = [model.name for model in good if set(model.system.terms) != terms]
    return [f"the record does not distinguish these classes from the one taken: {', '.join(tied)}"] if tied else []


# ------------------------------------------------------------------------------------------------ replicas


def _replicas(
    primary: Finding, job: Job, n: int, workers: Workers, on_progress: OnProgress, say: Say, missing: dict[str, str]
) -> tuple[ReplicaCoverage, ...]:
    """Judge the intervals on ``n`` replicas, whose time is said before, or say why there are none."""
    primary = next((run.finding for run in primary.runs if run.finding.fit is primary.fit), primary)
    if n == 0:
        missing["replicas"] = "none were asked for (twins=0)"
    elif primary.trust is Trust.NO or primary.fit is None:
        missing["replicas"] = "the answer is not to be trusted, so no replicas of it are simulated"
    elif primary.method != job.label:
        missing["replicas"] = f"replicas are fitted by a method, and this answer is the {primary.method}"
    if "replicas" in missing:
        return ()
    said = False

    def on_replicas(done: int, seconds_left: float) -> None:
        nonlocal said
        if not said and math.isfinite(seconds_left):
            said = True
            say(f"{n} simulated replicas: about {seconds_left:.0f} s more (twins=0 leaves them out)")
        on_progress(RunState("replica", done, n, "", seconds_left, at_least=False))

    coverages = coverage_on_replicas(primary, job, n, workers, on_replicas)
    if not coverages:
        missing["replicas"] = f"of {n} replicas fewer than 20 were answered"
    return coverages
