"""What a method found in measured records: values, stated intervals, residuals, and how far to trust them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from bench.contract.estimate import Estimate, Status
from bench.contract.problem import Problem, Units
from bench.likelihood.autoregression import Whitened
from bench.records.diagnostics import diagnose, natural_frequency
from bench.records.fit import Outcome
from bench.records.intervals import ENDS, StatedInterval, stated_intervals
from bench.records.linearised import Linearised, at_theta, linearised
from bench.records.model_error import missing_forces
from bench.records.modes import Mode
from bench.records.parts import parts_of
from bench.records.problem import Measured, spare_factor
from bench.records.strongest import strongest_frequency
from bench.records.verdict import Reason, Trust, verdict
from bench.scoring.combination import combine_with_prior
from bench.systems import MEASURED


@dataclass(frozen=True, eq=False)
class Run:
    """One of several records: its file's name, what it says alone, and why it is left out of the joint answer."""

    name: str
    finding: Finding
    left_out: str = ""


@dataclass(frozen=True, eq=False)
class Finding:
    """The answer of one method to measured records.

    ``intervals`` hold what the data tell, by name of the quantity; none where the answer is withdrawn or failed.
    ``withdrawn`` keeps what the method itself says of an answer that is not to be trusted. ``fit`` is the likelihood
    there, in the problem's natural units. Of repeats that were answered alone ``runs`` hold each of them, and all but
    the intervals is that of the run in the middle.
    """

    method: str
    measured: Measured
    outcome: Outcome
    intervals: Mapping[str, StatedInterval] = field(default_factory=dict)
    withdrawn: Mapping[str, StatedInterval] = field(default_factory=dict)
    reasons: tuple[Reason, ...] = ()
    fit: Linearised | None = None
    modes: tuple[Mode, ...] = ()
    runs: tuple[Run, ...] = ()

    @property
    def trust(self) -> Trust:
        """The verdict."""
        return verdict(self.reasons)

    @property
    def problem(self) -> Problem:
        return self.measured.problem

    @property
    def units(self) -> Units:
        """The natural units in which ``fit`` is, in the user's."""
        return self.problem.natural_units()

    @property
    def channel_size(self) -> float:
        """How much one unit of the first channel in ``fit`` is in the channel's own unit."""
        return self.units.of(MEASURED[self.problem.records[0].channels[0].measures])


def judged(method: str, measured: Measured, outcome: Outcome, white: Finding | None = None) -> Finding:
    """A method's outcome with the intervals that the records support, and the verdict.

    ``white``: where the outcome takes account of the noise's colour, the method's finding that takes it for white.
    """
    if outcome.estimate is None or outcome.status is not Status.OK:
        reason = f"no answer ({outcome.status.value}): {outcome.message}{_fewer_samples(measured, outcome)}"
        return Finding(method, measured, outcome, reasons=(Reason(Trust.NO, reason),))
    estimate = combine_with_prior(outcome.estimate, measured.problem.prior)
    with np.errstate(all="ignore"):
        at = linearised(measured.problem, estimate)
        parts = parts_of(at, _frequency(at)) if at is not None else []
        missing = () if at is None or measured.comparison is not None else missing_forces(at)
        noise = at if white is None or at is None else _whitened(at)
        rate_error = max((recording.rate_error for recording in measured.recordings), default=0.0)
        intervals = stated_intervals(estimate, noise, parts, rate_error, measured.comparison)
        intervals = _beside_white(intervals, white)
        intervals = _with_mass(intervals, estimate, measured)
    diagnosis = diagnose(at, measured.problem, intervals, missing, outcome.message)
    finding = Finding(method, measured, outcome, intervals, {}, diagnosis.reasons, at, diagnosis.modes)
    if finding.trust is Trust.NO:
        return replace(finding, intervals={}, withdrawn=intervals)
    return finding


def _fewer_samples(measured: Measured, outcome: Outcome) -> str:
    """Of a fit that ended at its limits: which decimation would still describe the motion, where one would."""
    factor = spare_factor(measured.problem) if outcome.status in (Status.TIMEOUT, Status.OOM) else 1
    return f"; decimate={factor} keeps one sample in {factor}, filtered" if factor > 1 else ""


def _frequency(at: Linearised) -> float:
    channel = at.model.channels[0][1]
    return natural_frequency(at) or strongest_frequency(channel.times, channel.values)


def _whitened(at: Linearised) -> Linearised | None:
    """The likelihood with the colour of its own residuals taken account of."""
    return at_theta(Whitened(at.model.problem, at.model.gauge, model=at.model, noises=at.noises), at.theta)


def _beside_white(intervals: dict[str, StatedInterval], white: Finding | None) -> dict[str, StatedInterval]:
    """Intervals of coloured noise, beside those of the same method that take it for white."""
    if white is None:
        return intervals
    found = {}
    for name, one in intervals.items():
        own = white.intervals.get(name) or white.withdrawn.get(name, one)
        found[name] = replace(one, white_low=own.white_low, white_high=own.white_high)
    return found


def _with_mass(
    intervals: dict[str, StatedInterval], estimate: Estimate, measured: Measured
) -> dict[str, StatedInterval]:
    """The parameters themselves too, where their ratios were found and the mass is told."""
    mass, system = measured.told_mass, estimate.system
    if mass is None:
        return intervals
    found = dict(intervals)
    for parameter in system.parameters:
        ratio = intervals.get(f"{parameter.name}_over_{system.gauge}")
        if ratio is not None:
            ends = {end: mass * getattr(ratio, end) for end in ENDS}
            found[parameter.name] = replace(ratio, unit=parameter.unit, **ends)
    return found
