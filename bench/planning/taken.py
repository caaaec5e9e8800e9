"""A record of a free decay as it is planned from: what a method found in it, and how well the record supports that."""

from __future__ import annotations

import math

import numpy as np

from bench.errors import InputError
from bench.planning.free_decay import QUANTITIES, Oscillator
from bench.planning.extension import Taken, start_of
from bench.records.finding import Finding
from bench.records.identification import identify
from bench.records.intervals import HALF
from bench.records.problem import read_measured
from bench.records.request import Overrides, request_of
from bench.records.verdict import Trust


def taken(overrides: Overrides) -> Taken:
    """Read and fit a record; raises InputError where it is none of a free decay, or its answer not to be trusted."""
    request = request_of(overrides)
    measured = read_measured(request)
    record = measured.problem.records[0]
    if len(measured.problem.records) > 1 or len(record.channels) > 1 or record.forces:
        raise InputError("given", request.files[0], "one record of one displacement, without a force")
    finding = identify(request.job, measured)
    if finding.trust is Trust.NO or not set(QUANTITIES) <= set(finding.intervals):
        why = "; ".join(reason.text for reason in finding.reasons) or finding.estimate.message
        raise InputError("given", request.files[0], f"a record whose answer can be trusted ({why})")
    return _taken(finding)


def _taken(finding: Finding) -> Taken:
    channel = finding.problem.records[0].channels[0]
    found = {name: finding.intervals[name] for name in QUANTITIES}
    oscillator = Oscillator(found["natural_frequency"].value, found["damping_ratio"].value)
    times = channel.times - channel.times[0]
    start = start_of(oscillator, times, channel.values)
    assert finding.fit is not None
    own = finding.fit.channels[0]
    sigma = finding.channel_size * float(np.sqrt(np.mean(finding.fit.residuals[own] ** 2)))
    supported = {name: math.log(one.high / one.low) / (2.0 * HALF) for name, one in found.items()}
    return Taken(times, oscillator, start, sigma, supported)
