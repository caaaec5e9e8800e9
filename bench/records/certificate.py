"""Certificate of measured records: the estimate of a primary method, and the evidence for or against it.

The evidence consists of other methods, a comparison of model classes, a prediction of held-out samples, the coverage
on simulated replicas, and the gain expected from a better record. The certificate is rendered elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass, field, replace

from bench.config.schema import Job
from bench.contract.estimate import Estimate, Status
from bench.engine.progress import OnProgress, RunState
from bench.entrants.reference import REFERENCES
from bench.errors import InputError
from bench.isolation.processes import Died
from bench.records.classes import best_class, compare_classes
from bench.records.finding import Finding
from bench.records.identification import assess, identify
from bench.records.intervals import StatedInterval
from bench.records.models import ClassComparison, ModelClass
from bench.records.prediction import HeldOutPrediction, predict_held_out
from bench.records.problem import Measured, spare_factor, with_fewer_samples
from bench.records.replicas import LEAST, ReplicaCoverage, coverage_on_replicas
from bench.records.request import AUTO, Request
from bench.records.verdict import Reason, Trust
from bench.records.what_if import WhatIf, what_if
from bench.records.workers import Workers

CLASSES_SECONDS = 60.0
"""Time limit (s) of the comparison of model classes; beyond it the certificate has none, and system=auto is sdof."""
OTHERS_SECONDS = 10.0
"""Time limit (s) of each method other than the primary one."""
OTHERS_SAMPLES = 5000
"""Longer records are decimated to at least this many samples for the other methods, which only check the estimate."""
COMPARED = 2
"""Number of quantities in which methods are compared."""
Say = Callable[[str], None]
Answer = tuple[Finding, HeldOutPrediction | None, tuple[WhatIf, ...]]
"""Result of the primary method, its prediction of the held-out samples, and the gain expected from better records."""


@dataclass(frozen=True, eq=False)
class Certificate:
    """Certificate of measured records.

    Attributes:
        measured: The records.
        findings: Results of the methods, that of the primary method first.
        classes: Compared model classes, the selected one first.
        prediction: Prediction of the held-out samples.
        replicas: Coverage of each quantity on simulated replicas.
        what_if: Errors expected from better records.
        missing: Reason for the absence of a part, by the name of the part.
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
    """Compute the certificate of records.

    Args:
        request: Methods, the primary one first.
        measured: The records.
        replicas: Number of simulated replicas; 0 for none.
        on_progress: Called with the progress.
        say: Called with a sentence that announces the expected time of the replicas.

    Raises:
        InputError: The primary method does not accept the records.
    """
    missing: dict[str, str] = {}
    with Workers() as workers:
        on_progress(RunState("step", 0, len(request.jobs) + 1, "model classes"))
        comparison = _comparison(measured, workers, missing)
        auto = request.system == AUTO
        measured = best_class(measured, comparison) if auto else replace(measured, comparison=comparison)
        answer, findings = _answers(request, measured, workers, on_progress)
        primary = with_reasons(answer[0], findings, missing)
        drawn = _replicas(primary, request.job, replicas, workers, on_progress, say, missing)
    _, prediction, changes = answer
    if not changes:
        missing["what_if"] = "the estimate is not trusted, or the data do not determine all parameters"
    classes = () if comparison is None else tuple(comparison.classes)
    return Certificate(measured, (primary, *findings), classes, prediction, drawn, changes, missing)


# ------------------------------------------------------------------------------------------------ answers


def _comparison(measured: Measured, workers: Workers, missing: dict[str, str]) -> ClassComparison | None:
    """Compare model classes; add the reason to ``missing`` if they cannot be compared."""
    try:
        comparison: ClassComparison | None = workers.submit(CLASSES_SECONDS, compare_classes, measured).result()
    except Died as died:
        missing["classes"] = died.message
        return None
    if comparison is None:
        missing["classes"] = "model classes are compared for one degree of freedom only"
    return comparison


def _answers(
    request: Request, measured: Measured, workers: Workers, on_progress: OnProgress
) -> tuple[Answer, list[Finding]]:
    """Run the jobs of a request in parallel; return the primary answer and the results of the other methods in order.

    Other methods that do not accept measured records are skipped.
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
    """Identify the records with the primary method; raises InputError."""
    finding = identify(job, measured)
    prediction = None if finding.fit is None else predict_held_out(finding.fit)
    return finding, prediction, () if finding.trust is Trust.NO else what_if(finding)


def other_answer(job: Job, measured: Measured) -> Answer:
    """Identify the records, decimated if long, with a method that checks the primary one; raises InputError."""
    factor = min(spare_factor(measured.problem), measured.problem.n // OTHERS_SAMPLES)
    return identify(job, with_fewer_samples(measured, factor, job) if factor > 1 else measured), None, ()


# ------------------------------------------------------------------------------------------------ agreement


def compared_quantities(findings: Sequence[Finding]) -> tuple[str, ...]:
    """Return k/m and c/m, or else the first two groups of the system that any method determines."""
    stated = {name for finding in findings for name in (finding.intervals or finding.withdrawn)}
    groups = [q.name for q in findings[0].problem.system.groups if q.name in stated]
    return tuple(sorted(groups, key=lambda name: name not in ("k_over_m", "c_over_m"))[:COMPARED])


def agreements(finding: Finding, primary: Finding, names: Sequence[str]) -> dict[str, str]:
    """Compare the values of a method with those of the primary method.

    Args:
        finding: Result of the method.
        primary: Result of the primary method.
        names: Quantities to compare.

    Returns:
        By quantity ``agrees`` (the value is inside the primary interval), ``tied`` (only the method's interval covers
        the primary value) or ``off``; ``primary`` for the primary method itself.
    """
    stated = {name: finding.intervals[name] for name in names if name in finding.intervals}
    if finding.method == primary.method:
        return dict.fromkeys(stated, "primary")
    return {name: agreement_of(interval, primary.intervals.get(name)) for name, interval in stated.items()}


def agreement_of(other: StatedInterval, reference: StatedInterval | None) -> str:
    """Return ``agrees``, ``tied`` or ``off`` as in :func:`agreements`; ``-`` without a reference."""
    if reference is None:
        return "-"
    if reference.low <= other.value <= reference.high:
        return "agrees"
    return "tied" if other.low <= reference.value <= other.high else "off"


def with_reasons(primary: Finding, others: Sequence[Finding], missing: Mapping[str, str]) -> Finding:
    """Add the reasons for caution that follow from the other methods and from the comparison of classes."""
    names = compared_quantities([primary, *others])
    agreement = {other.method: agreements(other, primary, names) for other in others}
    texts = []
    for name in names:
        off = [method for method, by_quantity in agreement.items() if by_quantity.get(name) == "off"]
        if off:
            texts.append(f"{', '.join(off)} disagree{'s' if len(off) == 1 else ''} in {name.replace('_over_', '/')}")
    texts += _class_reasons(primary, missing)
    return replace(primary, reasons=(*primary.reasons, *(Reason(Trust.CAUTION, text) for text in texts)))


def _class_reasons(primary: Finding, missing: Mapping[str, str]) -> list[str]:
    comparison, terms = primary.measured.comparison, set(getattr(primary.problem.system, "terms", ()))
    if comparison is None:
        return [f"model classes were not compared: {missing['classes']}"] if "classes" in missing else []
    good = [comparison.chosen, *comparison.tied]
    if terms and all(set(model.system.terms) != terms for model in good):
        return [f"model class {comparison.chosen.name} describes the record better; system=auto selects it"]
    tied = [model.name for model in good if set(model.system.terms) != terms]
    return [f"the record does not distinguish the fitted model class from {', '.join(tied)}"] if tied else []


# ------------------------------------------------------------------------------------------------ replicas


def _replicas(
    primary: Finding, job: Job, n: int, workers: Workers, on_progress: OnProgress, say: Say, missing: dict[str, str]
) -> tuple[ReplicaCoverage, ...]:
    """Compute the coverage on ``n`` replicas; add the reason to ``missing`` if there are none."""
    primary = next((run.finding for run in primary.runs if run.finding.fit is primary.fit), primary)
    if n == 0:
        missing["replicas"] = "not requested (twins=0)"
    elif primary.trust is Trust.NO or primary.fit is None:
        missing["replicas"] = "the estimate is not trusted"
    if "replicas" in missing:
        return ()
    announced = False

    def on_replicas(done: int, seconds_left: float) -> None:
        nonlocal announced
        if not announced and math.isfinite(seconds_left):
            announced = True
            say(f"{n} simulated replicas: about {seconds_left:.0f} s more (twins=0 skips them)")
        on_progress(RunState("replica", done, n, "", seconds_left, at_least=False))

    coverages = coverage_on_replicas(primary, job, n, workers, on_replicas)
    if not coverages:
        missing["replicas"] = f"fewer than {LEAST} of {n} replicas have an estimate"
    return coverages
