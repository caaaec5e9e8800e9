"""Verdicts and their reasons, on clean and disturbed records.

Records are simulated by closed forms or by scipy, with fixed seeds, and fitted by output_error.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter, lsim

from bench.commands.main import main
from bench.config.overrides import overrides_of
from bench.contract.problem import Problem
from bench.entrants.registry import make_method
from bench.records.diagnostics import steady_sine
from bench.records.finding import Finding
from bench.records.identification import assess
from bench.records.problem import read_measured
from bench.records.reading import of_arrays
from bench.records.request import request_of
from bench.records.verdict import Reason, Trust, verdict

T = np.linspace(0.0, 10.0, 300)
OMEGA, ZETA = 6.0, 0.04


def free(times: np.ndarray, omega: float = OMEGA, zeta: float = ZETA, size: float = 1.0) -> np.ndarray:
    """Return a solution of ``x'' + 2 zeta omega x' + omega² x = 0`` in closed form."""
    return size * np.exp(-zeta * omega * times) * np.cos(omega * np.sqrt(1.0 - zeta**2) * times + 0.3)


def noisy(x: np.ndarray, db: float, seed: int = 0) -> np.ndarray:
    return x + np.std(x) * 10 ** (-db / 20) * np.random.default_rng(seed).standard_normal(x.size)


def forced(times: np.ndarray, seed: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """Return a random force, interpolated linearly, and the response of a mass of 1 kg from rest."""
    force = 0.5 * np.cumsum(np.random.default_rng(seed).standard_normal(times.size))
    force -= np.mean(force)
    return force, lsim(([1.0], [1.0, 2 * ZETA * OMEGA, OMEGA**2]), force, times)[1]


def judge(times: np.ndarray, x: np.ndarray, force: np.ndarray | None = None, **fields: Any) -> Finding:
    request = request_of(overrides_of({"method": "output_error", "data": "arrays", **fields}))
    measured = read_measured(request, (of_arrays(times, x, force),))
    method = make_method("output_error", request.job.settings())
    estimate = method.identify(measured.problem, np.random.default_rng(0))
    return assess("output_error", measured, estimate)


def reasons(finding: Finding) -> str:
    return "; ".join(reason.text for reason in finding.reasons)


# clean records


def clean(omega: float, zeta: float, seconds: float, samples: int, db: float, seed: int) -> Finding:
    times = np.linspace(0.0, seconds, samples)
    return judge(times, noisy(free(times, omega, zeta), db, seed))


CLEAN = [(6.0, 0.04, 10.0, 300), (6.0, 0.02, 5.0, 150), (40.0, 0.01, 2.0, 400), (0.5, 0.1, 50.0, 100)]
"""Angular frequency, damping ratio, seconds and samples of records of 4 to 13 cycles."""


@pytest.mark.parametrize("db", [20.0, 30.0, 40.0])
@pytest.mark.parametrize("case", CLEAN)
def test_a_clean_record_is_never_rejected_and_its_error_is_within_four_standard_errors(
    case: tuple[float, float, float, int], db: float
) -> None:
    finding = clean(*case, db=db, seed=100)
    assert finding.trust is not Trust.NO
    interval = finding.intervals["natural_frequency"]
    truth = case[0] / (2 * np.pi)
    assert abs(np.log(interval.value / truth)) < 4 * np.log(interval.white_high / interval.white_low) / 2 / 1.96


@pytest.mark.slow
def test_clean_records_are_trusted() -> None:
    """Each of a dozen checks may raise a false alarm in one of a hundred records: 9 of 10 have none."""
    findings = [clean(*case, db=db, seed=seed) for case in CLEAN for db in (20.0, 30.0, 40.0) for seed in range(8)]
    trusted = [finding.trust is Trust.TRUST for finding in findings]
    assert np.mean(trusted) >= 0.9, [reasons(finding) for finding in findings if finding.reasons]
    assert all(not finding.reasons for finding, good in zip(findings, trusted, strict=True) if good)


def test_a_clean_forced_record_is_trusted_and_determines_the_mass() -> None:
    force, x = forced(T)
    finding = judge(T, noisy(x, 30.0, 1), force)
    assert finding.trust is Trust.TRUST, reasons(finding)
    assert finding.intervals["m"].value == pytest.approx(1.0, rel=0.02)


def test_an_undamped_vibration_is_not_rejected() -> None:
    """Its frequency is well determined."""
    finding = judge(T, noisy(np.cos(OMEGA * T), 30.0))
    assert finding.trust is not Trust.NO, reasons(finding)
    assert finding.intervals["k_over_m"].value == pytest.approx(OMEGA**2, rel=1e-3)


def test_strong_white_noise_is_reported_but_not_rejected() -> None:
    finding = judge(T, noisy(free(T), 6.0))
    assert finding.trust is Trust.CAUTION
    assert "strong noise" in reasons(finding)


# noise alone


@pytest.mark.parametrize("samples", [50, 100, 300, 1000])
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_noise_is_no_vibration(samples: int, seed: int) -> None:
    finding = judge(np.linspace(0.0, 10.0, samples), np.random.default_rng(seed).standard_normal(samples))
    assert finding.trust is Trust.NO
    assert "no vibration detected" in reasons(finding)
    assert not finding.intervals


# disturbed records: none is trusted, and the reason is stated

CAUTION_AT_LEAST = (Trust.CAUTION, Trust.NO)
REFUSED = (Trust.NO,)


def outlier() -> np.ndarray:
    x = noisy(free(T), 30.0)
    x[120] += 3.0
    return x


def pushed() -> np.ndarray:
    """Return a motion that is pushed during the first second."""
    x = noisy(free(T), 30.0)
    x[:30] += 2.0 * np.sin(np.linspace(0.0, 9.0, 30)) ** 2
    return x


def fewer_than_two_a_cycle() -> np.ndarray:
    """Return a vibration at 0.63 of the sampling rate, whose alias is at 0.37 of it."""
    return noisy(free(T, 2 * np.pi * 0.63 * 29.9, 0.004), 30.0)


def wandering() -> np.ndarray:
    return noisy(free(T), 30.0) + 0.02 * np.cumsum(np.random.default_rng(3).standard_normal(T.size))


def chirp() -> np.ndarray:
    return noisy(np.cos(4.0 * T + 0.3 * T**2) * np.exp(-0.1 * T), 30.0)


def coloured() -> np.ndarray:
    rng = np.random.default_rng(4)
    return free(T) + 0.2 * lfilter([0.6], [1.0, -0.8], rng.standard_normal(T.size))


DISTURBED: dict[str, tuple[Callable[[], np.ndarray], tuple[Trust, ...], str]] = {
    "an outlier": (outlier, CAUTION_AT_LEAST, "outlier"),
    "a weak second mode": (
        lambda: noisy(free(T) + free(T, 15.0, 0.02, 0.1), 30.0),
        CAUTION_AT_LEAST,
        "2.5 times the natural frequency|2.51 times|2.50 times|2.52 times",
    ),
    "two modes": (lambda: noisy(free(T) + free(T, 15.0, 0.02, 1.0), 30.0), REFUSED, "a second mode"),
    "motion that grows fast": (lambda: noisy(free(T, zeta=-0.1), 30.0), REFUSED, "the motion grows"),
    "a push at first": (pushed, CAUTION_AT_LEAST, "exclude a start-up with from="),
    "fewer than two samples a cycle": (fewer_than_two_a_cycle, REFUSED, "fit the samples equally well"),
    "a frequency that changes": (chirp, REFUSED, "not white: the model does not describe the record"),
    "coloured noise": (coloured, CAUTION_AT_LEAST, "not white"),
    "a sensor that wanders": (wandering, CAUTION_AT_LEAST, "not white"),
}  # fmt: skip


@pytest.mark.parametrize("case", DISTURBED)
def test_the_disturbance_of_a_record_is_reported(case: str) -> None:
    record, verdicts, part = DISTURBED[case]
    finding = judge(T, record())
    assert finding.trust in verdicts, reasons(finding)
    assert any(text in reasons(finding) for text in part.split("|")), reasons(finding)


def test_a_wandering_sensor_is_not_reported_as_a_second_mode() -> None:
    """A line at the lowest frequency of the record, a tenth of the natural one, is no mode and no harmonic."""
    text = reasons(judge(T, wandering()))
    assert "a second mode" not in text
    assert "drift" in text


@pytest.mark.parametrize(
    ("cycles", "verdicts"), [(0.4, REFUSED), (0.6, REFUSED), (1.0, CAUTION_AT_LEAST), (1.3, CAUTION_AT_LEAST)]
)
def test_too_few_cycles_are_counted(cycles: float, verdicts: tuple[Trust, ...]) -> None:
    times = np.linspace(0.0, cycles * 2 * np.pi / OMEGA, 100)
    finding = judge(times, noisy(free(times), 30.0))
    assert finding.trust in verdicts
    assert "cycles" in reasons(finding)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_the_wrong_sign_of_the_force_is_reported_and_force_gain_corrects_it(seed: int) -> None:
    force, x = forced(T, 5 + seed)
    wrong = judge(T, noisy(x, 30.0, seed), -force)
    assert wrong.trust is Trust.NO
    assert "the sign of the force is wrong: reversed, it fits far better; add force_gain=-1" in reasons(wrong)
    corrected = judge(T, noisy(x, 30.0, seed), -force, force_gain=-1)
    assert corrected.intervals["m"].value == pytest.approx(1.0, rel=0.02)
    assert "sign of the force" not in reasons(corrected)


def test_the_sign_of_a_right_force_is_not_questioned_if_the_model_is_wrong() -> None:
    """Half of the motion is that of a second mass: residuals are large, but reversing the force does not help."""
    force, x = forced(T)
    other = lsim(([1.0], [1.0, 1.2, 400.0]), force, T)[1]
    finding = judge(T, noisy(x + np.std(x) / np.std(other) * other, 30.0), force)
    assert "sign of the force" not in reasons(finding)


def sine_response(transient: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return force and response for a sine at 0.7 times the natural frequency, with the transient or long after."""
    times = np.linspace(0.0, 60.0, 1800)
    force = np.cos(0.7 * OMEGA * times)
    x = lsim(([1.0], [1.0, 2 * ZETA * OMEGA, OMEGA**2]), force, times)[1]
    part = slice(0, 900) if transient else slice(900, 1800)
    return force[part], x[part]


def of_forced(times: np.ndarray, x: np.ndarray, force: np.ndarray) -> Problem:
    request = request_of(overrides_of({"method": "output_error", "data": "arrays"}))
    return read_measured(request, (of_arrays(times, x, force),)).problem


def test_a_steady_state_response_to_a_sine_does_not_determine_mass_damping_and_stiffness() -> None:
    force, x = sine_response(transient=False)
    times = np.linspace(0.0, 30.0, 900)
    assert "steady-state response to a sine of 0.668" in steady_sine(of_forced(times, noisy(x, 40.0), force))
    finding = judge(times, noisy(x, 40.0), force)
    assert finding.trust is Trust.NO
    assert "steady-state response to a sine of 0.668" in reasons(finding)
    assert not finding.intervals


@pytest.mark.slow
def test_the_transient_response_to_a_sine_determines_them() -> None:
    force, x = sine_response(transient=True)
    times = np.linspace(0.0, 30.0, 900)
    assert not steady_sine(of_forced(times, noisy(x, 40.0), force))
    finding = judge(times, noisy(x, 40.0), force)
    assert "steady-state" not in reasons(finding)
    assert finding.intervals["m"].value == pytest.approx(1.0, rel=0.05)


def test_a_force_without_effect_is_rejected() -> None:
    finding = judge(T, np.random.default_rng(1).standard_normal(T.size), forced(T)[0])
    assert finding.trust is Trust.NO
    assert not finding.intervals


def test_clipping_with_later_noise_is_a_harmonic() -> None:
    x = np.clip(free(T, zeta=0.02), -0.4, 0.4)
    finding = judge(T, x + 1e-2 * np.random.default_rng(2).standard_normal(T.size))
    assert finding.trust is Trust.NO
    assert "a clipped sensor or a strongly nonlinear spring" in reasons(finding)
    assert not finding.modes


def test_the_colour_of_rounding_errors_is_ignored() -> None:
    assert "white" not in reasons(judge(T, np.round(free(T), 7)))


@pytest.mark.slow
def test_a_vibration_and_its_alias_are_reported() -> None:
    finding = judge(T, fewer_than_two_a_cycle())
    apparent, alias = finding.modes
    assert alias.frequency == pytest.approx(0.63 * 29.9, rel=1e-3)
    assert apparent.frequency + alias.frequency == pytest.approx(29.9, rel=1e-3)
    assert alias.alias


# verdict and exit status


def test_the_verdict_is_that_of_the_worst_reason() -> None:
    caution, no = Reason(Trust.CAUTION, "a"), Reason(Trust.NO, "b")
    assert verdict(()) is Trust.TRUST
    assert verdict((caution,)) is Trust.CAUTION
    assert verdict((caution, no, caution)) is Trust.NO


def test_values_that_are_not_trusted_are_withdrawn_but_kept() -> None:
    finding = judge(T, noisy(free(T) + free(T, 15.0, 0.02, 1.0), 30.0))
    assert finding.trust is Trust.NO
    assert finding.intervals == {}
    assert finding.withdrawn["k_over_m"].value == pytest.approx(OMEGA**2, rel=0.2)
    frequencies = [mode.frequency for mode in finding.modes]
    assert sorted(frequencies) == pytest.approx([OMEGA / 2 / np.pi, 15 / 2 / np.pi], rel=3e-3)
    assert "has modes at" in reasons(finding)


def written(folder: Path, head: str, x: np.ndarray, times: np.ndarray = T) -> str:
    path = folder / "record.csv"
    np.savetxt(path, np.column_stack([times, x]), delimiter=",", header=head, comments="")
    return f"data={path}"


STATUS = {
    "trust": (lambda: noisy(free(T), 30.0, 100), 0),
    "use with caution": (outlier, 0),
    "do not trust": (lambda: np.random.default_rng(3).standard_normal(300), 1),
}


@pytest.mark.parametrize("trust", STATUS)
def test_the_exit_status_is_1_if_no_estimate_is_trusted(
    trust: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record, status = STATUS[trust]
    assert main(["method=output_error", written(tmp_path, "t [s],x [m]", record())]) == status
    out = capsys.readouterr().out
    assert f": {trust}\n" in out
    assert ("Rejected value" in out) == (status == 1)
