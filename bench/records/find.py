"""Identify measured records: by the method asked for, again without needless terms, and by one robust to outliers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache

from bench.config.records import coloured_settings, robust_method
from bench.config.schema import Job
from bench.contract.estimate import Status
from bench.entrants.registry import missing_package
from bench.errors import InputError
from bench.isolation.processes import Died
from bench.records.classes import best_class, compare_classes, needless_terms
from bench.records.diagnostics import OUTLIERS, steady_sine
from bench.records.finding import Finding, judged
from bench.records.fit import Outcome, fit, within_time
from bench.records.intervals import StatedInterval
from bench.records.models import unit_over_mass, without
from bench.records.problem import Measured, spare_factor, with_fewer_samples, with_system
from bench.records.repeats import combined, runs_of
from bench.records.request import AUTO, Request
from bench.records.verdict import Reason, Trust
from bench.systems.sums import Sum


def find_all(request: Request, measured: Measured) -> list[Finding]:
    """Identify the records with each method of a request, of one class that is chosen first with ``system=auto``.

    Raises:
        InputError: A method cannot take a measured record.
    """
    if request.system == AUTO:
        measured = best_class(measured, compare_classes(measured))
    return [find(job, measured) for job in request.jobs]


def find(job: Job, measured: Measured) -> Finding:
    """Identify the records with the job's method, in a process of its own: repeats alone, and then by their spread.

    Repeats that are too short to be answered alone are fitted together.

    Raises:
        InputError: The method cannot take a measured record.
    """
    repeats = combined([_found(job, run) for run in runs_of(measured)])
    if repeats is not None and repeats.intervals:
        return repeats
    together = _found(job, measured)
    return together if together.intervals or repeats is None else repeats


def _found(job: Job, measured: Measured) -> Finding:
    """Identify records with one set of parameters.

    Where a search fails on many samples a cycle it is tried again on fewer, filtered; where a parameter is left open,
    without the terms of a sum that the record does not need.
    """
    found = _with_fewer_samples(_answer(job, measured), job)
    if not _leaves_open(found):
        return found
    system = measured.problem.system
    if not isinstance(system, Sum):
        return found
    most = _needless(measured, job.config.timeout_s)
    if not most:
        return found
    return _with_zeros(_answer(job, with_system(found.measured, without(system, most))), system, most)


def _answer(job: Job, measured: Measured) -> Finding:
    """Judge the method's answer, with the colour of the noise where it can be given and outliers looked into."""
    if sine := steady_sine(measured.problem):
        return Finding(job.label, measured, Outcome(None, Status.UNSUPPORTED, sine), reasons=(Reason(Trust.NO, sine),))
    return _with_robust(_coloured(judged(job.label, measured, fit(job, measured.problem)), job), job)


def _coloured(finding: Finding, job: Job) -> Finding:
    """Where the residuals are coloured, what the method finds when it is told so, if it can be."""
    more = coloured_settings(job.config.method["name"])
    noises = () if finding.fit is None else finding.fit.noises
    coloured = any(noise is not None and noise.order for noise in noises)
    if not (more and coloured) or "method.likelihood" in job.explicit:
        return finding
    outcome = fit(job, finding.problem, settings={**job.settings(), **more})
    return finding if outcome.status is not Status.OK else judged(job.label, finding.measured, outcome, finding)


def _with_fewer_samples(finding: Finding, job: Job) -> Finding:
    """Where the method found no answer: what it finds in the decimated record, where that describes the motion too.

    Misfits of the phase have the more minima the longer the record and the denser its samples; and the fit is quicker.
    """
    factor = spare_factor(finding.problem)
    if finding.outcome.status is not Status.DIVERGED or factor == 1:
        return finding
    try:
        measured = with_fewer_samples(finding.measured, factor, job)
    except InputError:
        return finding
    said = f"{finding.method} found no answer in all samples: {finding.outcome.message}"
    return _answer(job, replace(measured, notes=(*measured.notes, said)))


def _leaves_open(found: Finding) -> bool:
    """Whether the method ended without an answer, or with a quantity that has no finite interval above zero."""
    if found.outcome.status is Status.DIVERGED:
        return True
    stated = {**found.withdrawn, **found.intervals}.values()
    return found.outcome.status is Status.OK and not all(own.low >= 0.0 and math.isfinite(own.high) for own in stated)


@lru_cache(maxsize=4)
def _needless(measured: Measured, limit_s: float) -> Mapping[str, float]:
    """The parameters of terms that the records do not need, and the most that they allow of each, over the mass."""
    try:
        return within_time(needless_terms, measured, limit_s)
    except Died:
        return {}


def _with_zeros(finding: Finding, system: Sum, most: Mapping[str, float]) -> Finding:
    """A finding with the parameters of a system at zero that it was made without."""
    if finding.outcome.status is not Status.OK:
        return finding
    units = {name: unit_over_mass(system, name) for name in most}
    said = [f"{name}/m is 0, at most {limit:.3g} {units[name]}: fitted without it" for name, limit in most.items()]
    reasons = (*finding.reasons, *(Reason(Trust.CAUTION, sentence) for sentence in said))
    if not finding.intervals:
        return replace(finding, reasons=reasons)
    zeros = {f"{n}_over_m": StatedInterval(0.0, *(0.0, limit) * 3, units[n], "at most") for n, limit in most.items()}
    return replace(finding, reasons=reasons, intervals={**finding.intervals, **zeros})


def _with_robust(finding: Finding, job: Job) -> Finding:
    """Where samples are far off, the same and what a fit that expects outliers finds (errors with Student's t)."""
    far = any(reason.text.endswith(OUTLIERS) for reason in finding.reasons)
    robust_name, settings = robust_method()
    already = settings.items() <= job.settings().items()
    if not far or already or missing_package(robust_name):
        return finding
    robust = fit(job, finding.problem, robust_name, settings)
    own, system = finding.intervals or finding.withdrawn, finding.problem.system
    name = next(iter(own), "")
    marginal = None if robust.estimate is None or not name else robust.estimate.marginal(system.quantity(name))
    if marginal is None:
        reason = f"a fit that expects outliers gave no answer: {robust.message}"
        return replace(finding, reasons=(*finding.reasons, Reason(Trust.CAUTION, reason)))
    inside = own[name].low <= marginal.value <= own[name].high
    reason = f"a fit that expects outliers (Student's t) gives {name.replace('_over_', '/')} = {marginal.value:.6g}"
    if not inside:
        reason += ", outside of this interval: believe that one"
    reasons = (*finding.reasons, Reason(Trust.CAUTION if inside else Trust.NO, reason))
    if inside:
        return replace(finding, reasons=reasons)
    return replace(finding, reasons=reasons, intervals={}, withdrawn=own)
