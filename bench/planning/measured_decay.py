"""Identification of a measured free decay, as the basis for planning a longer record."""

from __future__ import annotations

import math

import numpy as np

from bench.errors import InputError
from bench.planning.extension import MeasuredDecay, initial_state
from bench.planning.free_decay import QUANTITIES, Oscillator
from bench.records.finding import Finding
from bench.records.identification import identify
from bench.records.intervals import HALF
from bench.records.problem import read_measured
from bench.records.request import Overrides, request_of
from bench.records.verdict import Trust


def measured_decay(overrides: Overrides) -> MeasuredDecay:
    """Read and fit a record; raises InputError if it is not a single free decay, or its estimate is unreliable."""
    request = request_of(overrides)
    measured = read_measured(request)
    record = measured.problem.records[0]
    if len(measured.problem.records) > 1 or len(record.channels) > 1 or record.forces:
        raise InputError("given", request.files[0], "must be a single record of one displacement without a force")
    finding = identify(request.job, measured)
    if finding.trust is Trust.NO or not set(QUANTITIES) <= set(finding.intervals):
        why = "; ".join(reason.text for reason in finding.reasons) or finding.estimate.message
        raise InputError("given", request.files[0], f"its estimate is not reliable ({why})")
    return _decay(finding)


def _decay(finding: Finding) -> MeasuredDecay:
    channel = finding.problem.records[0].channels[0]
    intervals = {name: finding.intervals[name] for name in QUANTITIES}
    oscillator = Oscillator(intervals["natural_frequency"].value, intervals["damping_ratio"].value)
    times = channel.times - channel.times[0]
    start = initial_state(oscillator, times, channel.values)
    assert finding.fit is not None
    residuals = finding.fit.residuals[finding.fit.channels[0]]
    sigma = finding.channel_size * float(np.sqrt(np.mean(residuals**2)))
    supported = {name: math.log(i.high / i.low) / (2.0 * HALF) for name, i in intervals.items()}
    return MeasuredDecay(times, oscillator, start, sigma, supported)
