"""Identification of measured records with one method: fit, residuals, intervals, diagnostics, verdict.

A method runs in a separate process, with limits of time and memory.

Repeats of a test are identified separately and combined. A fit may be repeated with a likelihood that is robust to
outliers, and without terms of the system that the record does not require.
"""

from __future__ import annotations

import math
import multiprocessing
import pickle
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from bench.config.records import robust_settings
from bench.config.schema import Job
from bench.contract.estimate import Estimate, Status
from bench.contract.method import Identifier
from bench.contract.problem import Problem
from bench.engine import method_process
from bench.engine.pool import Limits
from bench.engine.wire import unpack
from bench.entrants.reference import REFERENCES
from bench.entrants.registry import make_method, missing_package
from bench.errors import InputError
from bench.isolation.processes import Children, Died
from bench.records.classes import best_class, compare_classes, needless_terms
from bench.records.diagnostics import diagnose, natural_frequency, outliers, steady_sine
from bench.records.dominant_frequency import dominant_frequency
from bench.records.finding import Finding
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
    """Identify records with each method of a request.

    With ``system=auto`` the model class is selected first, and is the same for all methods.

    Raises:
        InputError: A method does not accept measured records.
    """
    if request.system == AUTO:
        measured = best_class(measured, compare_classes(measured))
    return [identify(job, measured) for job in request.jobs]


def identify(job: Job, measured: Measured) -> Finding:
    """Identify records with the method of a job, in a separate process.

    Repeats are identified separately and combined; if that fails, they are fitted jointly.

    Raises:
        InputError: The method does not accept measured records.
    """
    repeats = combined([_without_needless_terms(job, run) for run in runs_of(measured)])
    if repeats is not None and repeats.intervals:
        return repeats
    joint = _without_needless_terms(job, measured)
    return joint if joint.intervals or repeats is None else repeats


def _without_needless_terms(job: Job, measured: Measured) -> Finding:
    """Identify records jointly; drop terms of a sum that they do not require if a quantity is not determined."""
    finding, system = _robust_if_needed(job, measured), measured.problem.system
    if not isinstance(system, Sum) or not _is_undetermined(finding):
        return finding
    if not (most := needless_terms(measured)):
        return finding
    finding = _robust_if_needed(job, with_system(measured, without(system, most)))
    if finding.estimate.status is not Status.OK:
        return finding
    units = {name: unit_over_mass(name) for name in most}
    reasons = [f"{n}/m is zero, at most {limit:.3g} {units[n]}: fitted without this term" for n, limit in most.items()]
    zeros = {f"{n}_over_m": StatedInterval(0.0, *(0.0, limit) * 3, units[n], "at most") for n, limit in most.items()}
    return replace(
        finding,
        stated={**finding.stated, **zeros},
        reasons=(*finding.reasons, *(Reason(Trust.CAUTION, reason) for reason in reasons)),
    )


def _is_undetermined(finding: Finding) -> bool:
    """Return whether a fit diverged, or has a quantity without a finite interval above zero."""
    if finding.estimate.status is not Status.OK:
        return finding.estimate.status is Status.DIVERGED
    return not all(interval.low >= 0.0 and math.isfinite(interval.high) for interval in finding.stated.values())


def _robust_if_needed(job: Job, measured: Measured) -> Finding:
    """Fit and assess records; repeat a fit with outliers under Student's t distribution if the method supports it.

    The robust result replaces the first one if one of its values is outside of the first one's interval.
    """
    if sine := steady_sine(measured.problem):
        estimate = Estimate.failed(measured.problem.system, Status.UNSUPPORTED, sine)
        return Finding(job.label, measured, estimate, reasons=(Reason(Trust.NO, sine),))
    finding = assess(job.label, measured, *fit(job, measured.problem))
    settings = robust_settings(job.config.method["name"])
    if not settings or finding.fit is None or not outliers(finding.fit) or "method.likelihood" in job.explicit:
        return finding
    estimate, wall_s = fit(job, measured.problem, {**job.settings(), **settings})
    note = "outliers: fitted with errors of Student's t distribution, which is robust to them"
    robust = assess(job.label, replace(measured, notes=(*measured.notes, note)), estimate, wall_s)
    pairs = [
        (interval, robust.stated[name].value) for name, interval in finding.stated.items() if name in robust.stated
    ]
    return finding if all(interval.record_low <= value <= interval.record_high for interval, value in pairs) else robust


def fit(job: Job, problem: Problem, settings: dict[str, Any] | None = None) -> tuple[Estimate, float]:
    """Fit a problem with the method of a job.

    Args:
        job: Method, settings, seed and limits.
        problem: The records.
        settings: Settings that replace those of the job.

    Returns:
        The estimate, failed if the method has no result, and the computing time (s), NaN if the fit did not finish.

    Raises:
        InputError: The method is a reference that needs the true values.
    """
    name = job.config.method["name"]
    if name in REFERENCES:
        raise InputError("method", name, "it needs the true values, which are unknown for a record; choose a method")
    if lacking := missing_package(name):
        return Estimate.failed(problem.system, Status.MISSING_DEPENDENCY, lacking), math.nan
    limits = Limits(1, job.config.timeout_s, job.config.memory_mb)
    return fit_alone(make_method(name, settings or job.settings()), problem, limits, job.config.seed)


def fit_alone(method: Identifier, problem: Problem, limits: Limits, seed: int = 0) -> tuple[Estimate, float]:
    """Fit a problem within the limits.

    Returns:
        The estimate, with responses at the samples of the first channel, and the computing time (s), as :func:`fit`.
    """
    times = problem.records[0].channels[0].times
    rng, work = np.random.default_rng(seed), pickle.dumps(method.identify_many)
    task = method_process.FitTask(work, (0,), (problem,), (rng,), (times,), limits.timeout_s)
    started = time.perf_counter()
    try:
        if multiprocessing.current_process().daemon:  # a worker has limits already and may not start children
            packed = method_process.perform(task)
            assert packed is not None  # a task of a single replicate always returns its result
            (result,) = unpack(packed)
        else:
            with Children() as children:
                process = method_process.ready(children, None, method.requires, limits.memory_mb)
                result = method_process.solve(process, task, limits.memory_mb)
    except Died as died:
        seconds = time.perf_counter() - started
        return Estimate.failed(problem.system, Status(died.reason), died.message), seconds
    if "answer" not in result:
        return Estimate.failed(problem.system, Status(result["status"]), result["message"]), math.nan
    return replace(result["answer"], system=problem.system).checked(), result["wall_s"]


def assess(method: str, measured: Measured, estimate: Estimate, wall_s: float = math.nan) -> Finding:
    """Assess an estimate of records: state its intervals and the reasons for caution.

    Args:
        method: Name of the method.
        measured: The records.
        estimate: The method's estimate.
        wall_s: Computing time of the fit (s).
    """
    problem = measured.problem
    if estimate.status is not Status.OK:
        reason = f"no estimate ({estimate.status.value}): {estimate.message}{_fewer_samples(measured, estimate.status)}"
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
    """Return the advice to decimate, for a fit that exceeded a limit and a record with samples to spare."""
    factor = spare_factor(measured.problem) if status in (Status.TIMEOUT, Status.OOM) else 1
    return f"; try decimate={factor}, which keeps every {factor}th sample after a low-pass filter" if factor > 1 else ""


def _with_mass(intervals: Mapping[str, StatedInterval], measured: Measured) -> dict[str, StatedInterval]:
    """Return intervals of the parameters, from those of their ratios to the mass, if the mass is known."""
    mass, system, scaled = measured.known_mass, measured.problem.system, {}
    for parameter in system.parameters if mass is not None else ():
        ratio = intervals.get(f"{parameter.name}_over_{system.gauge}")
        if ratio is not None:
            ends = {end: mass * getattr(ratio, end) for end in ENDS}
            scaled[parameter.name] = replace(ratio, unit=parameter.unit, **ends)
    return scaled
