"""Identify measured records with one method, step by step: fit, residuals, intervals, diagnostics, verdict.

Repeats of a test are answered one by one and combined. Two refits may follow a fit: with errors that expect outliers,
and without the terms of the system that the record does not need.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from bench.config.records import robust_settings
from bench.config.schema import Job
from bench.contract.estimate import Estimate, Status
from bench.records.classes import best_class, compare_classes, needless_terms
from bench.records.diagnostics import OUTLIERS, diagnose, natural_frequency, steady_sine
from bench.records.dominant_frequency import dominant_frequency
from bench.records.finding import Finding
from bench.records.fit import fit
from bench.records.intervals import ENDS, StatedInterval, stated_intervals
from bench.records.linearised_fit import LinearisedFit, linearise
from bench.records.model_error import missing_forces
from bench.records.models import unit_over_mass, without
from bench.records.parts import parts_of
from bench.records.problem import Measured, spare_factor, with_system
from bench.records.repeats import combined, runs_of
from bench.records.request import AUTO, Request
from bench.records.verdict import Reason, Trust
from bench.scoring.combination import combine_with_prior
from bench.systems.sums import Sum


def identify_all(request: Request, measured: Measured) -> list[Finding]:
    """Identify the records with each method of a request, of one class that is chosen first with ``system=auto``.

    Raises:
        InputError: A method cannot take a measured record.
    """
    if request.system == AUTO:
        measured = best_class(measured, compare_classes(measured))
    return [identify(job, measured) for job in request.jobs]


def identify(job: Job, measured: Measured) -> Finding:
    """Identify the records with the job's method, in a process of its own: repeats alone, and then by their spread.

    Repeats that are too short to be answered alone are fitted together.

    Raises:
        InputError: The method cannot take a measured record.
    """
    repeats = combined([_without_needless_terms(job, run) for run in runs_of(measured)])
    if repeats is not None and repeats.intervals:
        return repeats
    together = _without_needless_terms(job, measured)
    return together if together.intervals or repeats is None else repeats


def _without_needless_terms(job: Job, measured: Measured) -> Finding:
    """Identify records with one set of parameters; of a sum that the fit leaves open, without its needless terms."""
    finding, system = _answered(job, measured), measured.problem.system
    if not isinstance(system, Sum) or not _leaves_open(finding):
        return finding
    if not (most := needless_terms(measured)):
        return finding
    finding = _answered(job, with_system(measured, without(system, most)))
    if finding.estimate.status is not Status.OK:
        return finding
    units = {name: unit_over_mass(name) for name in most}
    reasons = [f"{name}/m is 0, at most {limit:.3g} {units[name]}: fitted without it" for name, limit in most.items()]
    zeros = {f"{n}_over_m": StatedInterval(0.0, *(0.0, limit) * 3, units[n], "at most") for n, limit in most.items()}
    return replace(
        finding,
        stated={**finding.stated, **zeros},
        reasons=(*finding.reasons, *(Reason(Trust.CAUTION, reason) for reason in reasons)),
    )


def _leaves_open(finding: Finding) -> bool:
    """Return whether a fit has no answer, or a quantity that has no finite interval above zero."""
    if finding.estimate.status is not Status.OK:
        return finding.estimate.status is Status.DIVERGED
    return not all(interval.low >= 0.0 and math.isfinite(interval.high) for interval in finding.stated.values())


def _answered(job: Job, measured: Measured) -> Finding:
    """Fit and judge; where samples are far off, again with errors that expect outliers if the method has them.

    The second answer is taken where it lies outside of an interval that the first states of this record.
    """
    if sine := steady_sine(measured.problem):
        estimate = Estimate.failed(measured.problem.system, Status.UNSUPPORTED, sine)
        return Finding(job.label, measured, estimate, reasons=(Reason(Trust.NO, sine),))
    finding = assess(job.label, measured, *fit(job, measured.problem))
    settings = robust_settings(job.config.method["name"])
    outliers = any(reason.text.endswith(OUTLIERS) for reason in finding.reasons)
    if not (outliers and settings) or "method.likelihood" in job.explicit:
        return finding
    estimate, wall_s = fit(job, measured.problem, {**job.settings(), **settings})
    note = "samples are far off: fitted with errors of Student's t, which expects outliers"
    robust = assess(job.label, replace(measured, notes=(*measured.notes, note)), estimate, wall_s)
    pairs = [
        (interval, robust.stated[name].value) for name, interval in finding.stated.items() if name in robust.stated
    ]
    return finding if all(interval.record_low <= value <= interval.record_high for interval, value in pairs) else robust


def assess(method: str, measured: Measured, estimate: Estimate, wall_s: float = math.nan) -> Finding:
    """State the intervals that the records support of a method's answer, and the reasons for caution."""
    problem = measured.problem
    if estimate.status is not Status.OK:
        reason = f"no answer ({estimate.status.value}): {estimate.message}{_fewer_samples(measured, estimate.status)}"
        return Finding(method, measured, estimate, wall_s, reasons=(Reason(Trust.NO, reason),))
    scaled = combine_with_prior(estimate, problem.prior)
    with np.errstate(all="ignore"):
        likelihood = linearise(problem, scaled)
        parts = [] if likelihood is None else parts_of(likelihood, _frequency(likelihood))
        missing = () if likelihood is None or measured.comparison is not None else missing_forces(likelihood)
        rate_error = max((recording.rate_error for recording in measured.recordings), default=0.0)
        intervals = stated_intervals(scaled, likelihood, parts, rate_error, measured.comparison)
    intervals |= _with_mass(intervals, measured)
    intervals = {name: replace(interval, unit=measured.unit_of(interval.unit)) for name, interval in intervals.items()}
    reasons, modes = diagnose(likelihood, problem, intervals, missing, estimate.message)
    return Finding(method, measured, estimate, wall_s, intervals, reasons, likelihood, modes)


def _frequency(likelihood: LinearisedFit) -> float:
    channel = likelihood.model.channels[0][1]
    return natural_frequency(likelihood) or dominant_frequency(channel.times, channel.values)


def _fewer_samples(measured: Measured, status: Status) -> str:
    """Return the decimation that would still describe the motion, of a fit that ended at its limits, if any would."""
    factor = spare_factor(measured.problem) if status in (Status.TIMEOUT, Status.OOM) else 1
    return f"; decimate={factor} keeps one sample in {factor}, filtered" if factor > 1 else ""


def _with_mass(intervals: Mapping[str, StatedInterval], measured: Measured) -> dict[str, StatedInterval]:
    """Return intervals of the parameters themselves where their ratios were found and the mass is known."""
    mass, system, scaled = measured.known_mass, measured.problem.system, {}
    for parameter in system.parameters if mass is not None else ():
        ratio = intervals.get(f"{parameter.name}_over_{system.gauge}")
        if ratio is not None:
            ends = {end: mass * getattr(ratio, end) for end in ENDS}
            scaled[parameter.name] = replace(ratio, unit=parameter.unit, **ends)
    return scaled
