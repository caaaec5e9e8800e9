"""Repeats of a test: combination of separate results, and exclusion of inconsistent runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

import bench
from bench.contract.estimate import Estimate
from bench.contract.problem import Channel, Problem, Record
from bench.records.finding import Finding
from bench.records.intervals import PRIOR_SPREAD, StatedInterval
from bench.records.problem import Measured
from bench.records.reading import Recording
from bench.records.repeats import combined, runs_of
from bench.records.verdict import Reason, Trust
from bench.systems.linear import SDOF

RECORD = Record((Channel(np.arange(20.0), np.cos(np.arange(20.0))),))


def several(n: int) -> Measured:
    recordings = tuple(Recording((), (), f"folder/run{i + 1}.csv", "") for i in range(n))
    return Measured(recordings, Problem(SDOF(), (RECORD,) * n), ())


def stated(value: float, error: float, unit: str) -> StatedInterval:
    low, high = value * np.exp(-1.96 * error), value * np.exp(1.96 * error)
    return StatedInterval(value, low, high, low, high, low, high, unit)


def answers(measured: Measured, k: Sequence[float], c: Sequence[float], error: float = 1e-4) -> list[Finding]:
    """Return a result for each run, with equal relative errors; a failed one where k/m is 0."""
    findings = []
    for run, stiffness, damping in zip(runs_of(measured), k, c, strict=True):
        estimate = Estimate(SDOF())
        if stiffness == 0:
            findings.append(Finding("ls", run, estimate, reasons=(Reason(Trust.NO, "no vibration detected"),)))
            continue
        intervals = {
            "k_over_m": stated(stiffness, error, "1/s²"),
            "c_over_m": stated(damping, 10 * error, "1/s"),
            "natural_frequency": stated(np.sqrt(stiffness) / 2 / np.pi, error / 2, "Hz"),
        }
        findings.append(Finding("ls", run, estimate, stated=intervals))
    return findings


@pytest.mark.parametrize("n", [2, 3, 5])
def test_the_interval_of_a_repeat_is_the_prediction_interval_of_the_random_effects_model(n: int) -> None:
    k = np.array([100.0, 101.0, 99.0, 102.0, 100.4])[:n]
    measured = several(n)
    finding = combined(answers(measured, k, [1.0] * n))
    assert finding is not None
    y, more = np.log(k), max(4 - n, 0)
    tau2 = ((n - 1) * (np.var(y, ddof=1) - 1e-8) + more * PRIOR_SPREAD["stiffness"] ** 2) / (n - 1 + more)
    half = stats.t(n - 1 + more).ppf(0.975) * np.sqrt((tau2 + 1e-8) / n + tau2)
    interval = finding.intervals["k_over_m"]
    assert interval.value == pytest.approx(np.exp(np.mean(y)))
    assert np.log(interval.high / interval.value) == pytest.approx(half, rel=1e-3)
    assert interval.low < interval.record_low < interval.value < interval.record_high < interval.high


def test_the_frequency_is_half_as_wide_as_the_stiffness_and_agrees_with_it() -> None:
    measured = several(3)
    finding = combined(answers(measured, [50.0, 50.4, 49.9], [1.0, 1.2, 0.9]))
    assert finding is not None
    k, f = finding.intervals["k_over_m"], finding.intervals["natural_frequency"]
    assert f.value == pytest.approx(np.sqrt(k.value) / 2 / np.pi)
    assert np.log(f.high / f.low) == pytest.approx(np.log(k.high / k.low) / 2)


@pytest.mark.parametrize("n", [3, 4, 6])
def test_an_inconsistent_run_is_excluded_by_name(n: int) -> None:
    measured, k = several(n), [100.0 * (1 + 0.001 * (-1) ** i) for i in range(n)]
    k[1] = 118.0
    finding = combined(answers(measured, k, [1.0] * n))
    assert finding is not None
    assert [run.name for run in finding.runs if run.left_out] == ["run2.csv"]
    assert finding.trust is Trust.CAUTION
    assert finding.reasons[0].text.startswith("run2.csv is excluded: inconsistent with the other runs: k/m 118")
    assert finding.intervals["k_over_m"].high < 105


def test_scattered_repeats_are_kept_and_reported() -> None:
    measured = several(5)
    finding = combined(answers(measured, [100, 110, 93, 104, 88], [1.0] * 5))
    assert finding is not None
    assert not any(run.left_out for run in finding.runs)
    assert "differs by up to" in finding.reasons[0].text
    assert finding.intervals["k_over_m"].low < 93 < 110 < finding.intervals["k_over_m"].high


def test_failed_repeats_are_excluded_and_two_of_five_are_too_few() -> None:
    measured = several(5)
    finding = combined(answers(measured, [100, 0, 100.2, 0, 0], [1.0] * 5))
    assert finding is not None
    assert finding.trust is Trust.NO
    assert finding.reasons[0].text == "only 2 of 5 runs agree and have an estimate"
    assert not finding.intervals
    assert combined(answers(measured, [0, 0, 0, 0, 0], [1.0] * 5)) is None


def test_the_only_successful_run_of_two_is_returned_with_caution() -> None:
    measured = several(2)
    separate = answers(measured, [100, 0], [1.0] * 2)
    finding = combined(separate)
    assert finding is not None
    assert finding.trust is Trust.CAUTION
    assert dict(finding.intervals) == dict(separate[0].intervals)


def test_a_run_that_does_not_determine_the_damping_is_kept_without_affecting_it() -> None:
    measured = several(4)
    separate = answers(measured, [100, 101, 99, 100], [1.0, 1.1, 0.9, 5.0])
    damping = replace(separate[3].intervals["c_over_m"], low=0.0, record_low=0.0, limit="at most")
    separate[3] = replace(separate[3], stated={**separate[3].intervals, "c_over_m": damping})
    finding = combined(separate)
    assert finding is not None
    assert finding.intervals["c_over_m"].value == pytest.approx(np.cbrt(1.0 * 1.1 * 0.9), rel=1e-3)


def test_inconsistent_damping_has_a_limit_in_place_of_an_interval() -> None:
    measured = several(3)
    finding = combined(answers(measured, [100, 101, 99], [0.2, 1.0, 4.0]))
    assert finding is not None
    assert (finding.intervals["c_over_m"].limit, finding.intervals["k_over_m"].limit) == ("at most", "")
    assert finding.intervals["c_over_m"].high > 4.0


def test_a_single_record_has_no_runs() -> None:
    assert runs_of(several(1)) == []


@pytest.mark.slow
def test_five_files_are_combined_and_each_is_reported(tmp_path: Path) -> None:
    rng, times, names = np.random.default_rng(3), np.arange(0, 8, 0.02), []
    for i, factor in enumerate((1.0, 1.002, 0.997, 1.2, 1.001)):
        pole = complex(-0.2, 9.0 * np.sqrt(factor))
        x = np.real((1 + i / 10) * np.exp(pole * times)) + 0.01 * rng.standard_normal(times.size)
        names.append(tmp_path / f"run{i + 1}.csv")
        np.savetxt(names[-1], np.c_[times, x], delimiter=",", header="t [s],x [m]", comments="")
    answer = bench.identify(names, method="output_error")
    assert [name for name, run in answer.runs.items() if run.left_out] == ["run4.csv"]
    assert answer.samples == 5 * times.size
    low, high = answer.intervals["k_over_m"]
    assert low < 81.04 < high
    assert high / low < 1.05
    assert answer.as_dict()["runs"]["run1.csv"]["estimates"]["k_over_m"]["value"] == pytest.approx(81.04, rel=0.01)
    page = repr(answer)
    assert "Single run" in page
    assert "left out" in page
