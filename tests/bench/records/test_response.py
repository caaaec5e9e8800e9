"""Measured and fitted response for display, compared with a closed form."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench.records.finding import Finding
from bench.records.identification import identify_all
from bench.records.problem import read_measured
from bench.records.reading import of_arrays
from bench.records.request import request_of
from bench.records.response import best_of, response_of
from bench.records.verdict import Trust

NOISE = 0.02
GAP = (3.0, 5.0)


def decay(times: np.ndarray) -> np.ndarray:
    """Return a decay of 2 Hz with a damping ratio of about 2 % and an offset."""
    return np.asarray(np.exp(-0.25 * times) * np.cos(4 * np.pi * times) + 0.1)


@pytest.fixture(scope="module")
def findings() -> list[Finding]:
    """Return the results of a poor and a good method on 4.3 samples per cycle with a gap."""
    times = np.arange(0.0, 8.0, 0.1163)
    times = times[(times < GAP[0]) | (times > GAP[1])]
    values = decay(times) + NOISE * np.random.default_rng(5).standard_normal(times.size)
    request = request_of({"data": ["arrays"], "method": ["ls", "shooting"]})
    return identify_all(request, read_measured(request, (of_arrays(times, values),)))


def test_the_curve_runs_between_the_samples_and_through_a_gap(findings: list[Finding]) -> None:
    """For five unknowns and 52 samples the error is about a third of the noise (root mean square).

    Linear interpolation of the samples has an error of the size of the motion in the gap.
    """
    response = response_of(findings[1])
    assert response.frequency == pytest.approx(2.0, abs=0.1)
    fit = response.fit
    assert fit is not None
    assert (fit.times[0], fit.times[-1]) == (response.times[0], response.times[-1])
    assert np.max(np.diff(fit.times)) < 0.5 / 16  # of a cycle, 16 points at least
    assert rms(fit.values - decay(fit.times)) < NOISE
    assert rms(np.interp(fit.times, response.times, response.values) - decay(fit.times)) > 5 * NOISE


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_the_residuals_are_the_noise(findings: list[Finding]) -> None:
    fit = response_of(findings[1]).fit
    assert fit is not None
    residuals = fit.residuals
    assert residuals.rms == pytest.approx(NOISE, rel=0.35)
    assert residuals.part_of_signal == pytest.approx(residuals.rms / np.std(response_of(findings[1]).values), rel=1e-6)


def test_a_response_has_the_unit_of_the_file(tmp_path: Path) -> None:
    times = np.arange(0.0, 8.0, 0.1)
    path = tmp_path / "decay.csv"
    values = 1e3 * (decay(times) + NOISE * np.random.default_rng(5).standard_normal(times.size))
    np.savetxt(path, np.column_stack([times, values]), delimiter=",", header="t (s),x (mm)", comments="")
    request = request_of({"data": [str(path)], "method": ["shooting"]})
    response = response_of(identify_all(request, read_measured(request))[0])
    assert (response.unit, response.measures) == ("mm", "displacement")
    np.testing.assert_allclose(response.values, values)
    assert response.fit is not None
    assert rms(response.fit.values - 1e3 * decay(response.fit.times)) < 1e3 * NOISE
    assert response.fit.residuals.unit == "mm"
    assert response.fit.residuals.rms == pytest.approx(1e3 * NOISE, rel=0.35)
    assert response.fit.residuals.offset == pytest.approx(100.0, abs=10.0)


def test_units_of_rotations() -> None:
    times = np.arange(0.0, 5.0, 0.05)
    request = request_of({"data": ["arrays"], "method": ["shooting"]})
    measured = read_measured(request, (of_arrays(times, decay(times)),))
    units = {"m/s²": "rad/s²", "1/(m²·s²)": "1/(rad²·s²)", "N·s/m": "N·m·s/rad", "kg": "kg·m²", "Hz": "Hz"}
    channel = replace(measured.problem.records[0].channels[0], unit="rad")
    record = replace(measured.problem.records[0], channels=(channel,))
    turned = replace(measured, problem=replace(measured.problem, records=(record,)))
    assert {unit: turned.unit_of(unit) for unit in units} == units
    assert {unit: measured.unit_of(unit) for unit in units} == {unit: unit for unit in units}


def test_the_best_finding_has_the_best_verdict_and_the_smallest_residuals(findings: list[Finding]) -> None:
    poor, good = findings
    assert (poor.trust, good.trust) == (Trust.NO, Trust.TRUST)
    assert best_of([poor, good]) is good
    assert best_of([good, poor]) is good


def test_a_response_without_a_fit_has_the_samples_only() -> None:
    times = np.arange(0.0, 5.0, 0.05)
    request = request_of({"data": ["arrays"], "method": ["shooting"]})
    (finding,) = identify_all(request, read_measured(request, (of_arrays(times, np.ones(times.size)),)))
    response = response_of(finding)
    assert response.fit is None
    assert best_of([finding]) is finding
    assert np.array_equal(response.values, np.ones(times.size))
