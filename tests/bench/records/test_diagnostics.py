"""Verdicts: what must not be trusted is not, for the reason that it is so; what is clean is trusted.

Every record is simulated here, by closed forms or by scipy, at fixed seeds; the fit is that of output_error in this
process.
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
    """``x'' + 2 zeta omega x' + omega² x = 0``, in closed form."""
    return size * np.exp(-zeta * omega * times) * np.cos(omega * np.sqrt(1.0 - zeta**2) * times + 0.3)


def noisy(x: np.ndarray, db: float, seed: int = 0) -> np.ndarray:
    return x + np.std(x) * 10 ** (-db / 20) * np.random.default_rng(seed).standard_normal(x.size)


def forced(times: np.ndarray, seed: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """A wandering force, joined by straight lines, and the response to it from rest of a mass of 1 kg."""
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


# what is clean


def clean(omega: float, zeta: float, seconds: float, samples: int, db: float, seed: int) -> Finding:
    times = np.linspace(0.0, seconds, samples)
    return judge(times, noisy(free(times, omega, zeta), db, seed))


CLEAN = [(6.0, 0.04, 10.0, 300), (6.0, 0.02, 5.0, 150), (40.0, 0.01, 2.0, 400), (0.5, 0.1, 50.0, 100)]
"""Angular frequency, damping ratio, seconds and samples of records of 4 to 13 cycles."""


@pytest.mark.parametrize("db", [20.0, 30.0, 40.0])
@pytest.mark.parametrize("what", CLEAN)
def test_a_clean_record_is_never_refused_and_its_interval_holds_the_truth(
    what: tuple[float, float, float, int], db: float
) -> None:
    finding = clean(*what, db=db, seed=100)
    assert finding.trust is not Trust.NO
    found = finding.intervals["natural_frequency"]
    truth = what[0] / (2 * np.pi)
    assert abs(np.log(found.value / truth)) < 4 * np.log(found.white_high / found.white_low) / 2 / 1.96


@pytest.mark.slow
def test_clean_records_are_trusted() -> None:
    """Each of a dozen checks may raise a false alarm in one of a hundred records: 9 of 10 have none."""
    found = [clean(*what, db=db, seed=seed) for what in CLEAN for db in (20.0, 30.0, 40.0) for seed in range(8)]
    trusted = [finding.trust is Trust.TRUST for finding in found]
    assert np.mean(trusted) >= 0.9, [reasons(one) for one in found if one.reasons]
    assert all(not finding.reasons for finding, good in zip(found, trusted, strict=True) if good)


def test_a_clean_forced_record_is_trusted_and_tells_the_mass() -> None:
    force, x = forced(T)
    finding = judge(T, noisy(x, 30.0, 1), force)
    assert finding.trust is Trust.TRUST, reasons(finding)
    assert finding.intervals["m"].value == pytest.approx(1.0, rel=0.02)


def test_a_vibration_whose_damping_cannot_be_told_from_none_is_not_refused() -> None:
    """Undamped to the eye: of such a record the frequency is known well."""
    finding = judge(T, noisy(np.cos(OMEGA * T), 30.0))
    assert finding.trust is not Trust.NO, reasons(finding)
    assert finding.intervals["k_over_m"].value == pytest.approx(OMEGA**2, rel=1e-3)


def test_more_noise_is_said_but_what_is_white_is_not_refused() -> None:
    finding = judge(T, noisy(free(T), 6.0))
    assert finding.trust is Trust.CAUTION
    assert "much noise" in reasons(finding)


# noise alone


@pytest.mark.parametrize("samples", [50, 100, 300, 1000])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_noise_is_no_vibration(samples: int, seed: int) -> None:
    finding = judge(np.linspace(0.0, 10.0, samples), np.random.default_rng(seed).standard_normal(samples))
    assert finding.trust is Trust.NO
    assert not finding.intervals


def test_noise_is_refused_as_noise() -> None:
    """Not as a response that is not finite, also where the fit ends at no damping."""
    for seed, samples in [(0, 50), (1, 50), (2, 50), (0, 300)]:
        said = reasons(judge(np.linspace(0.0, 10.0, samples), np.random.default_rng(seed).standard_normal(samples)))
        assert "no vibration found" in said


@pytest.mark.slow
def test_noise_passes_for_a_vibration_hardly_ever() -> None:
    """At most 1 of 100; the check promises 1 in 1000."""
    passed = 0
    for seed in range(100):
        rng = np.random.default_rng(1000 + seed)
        samples = int(rng.integers(50, 400))
        passed += judge(np.linspace(0.0, 10.0, samples), rng.standard_normal(samples)).trust is not Trust.NO
    assert passed <= 1


# what spoils a record: nothing of it is trusted, and the reason is named

CARE_AT_LEAST = (Trust.CAUTION, Trust.NO)
REFUSED = (Trust.NO,)


def outlier() -> np.ndarray:
    x = noisy(free(T), 30.0)
    x[120] += 3.0
    return x


def huge_outlier() -> np.ndarray:
    x = noisy(free(T), 30.0)
    x[120] += 30.0
    return x


def pushed() -> np.ndarray:
    """A hand on it for the first second."""
    x = noisy(free(T), 30.0)
    x[:30] += 2.0 * np.sin(np.linspace(0.0, 9.0, 30)) ** 2
    return x


def fewer_than_two_a_cycle() -> np.ndarray:
    """At 0.63 of the sampling rate, so it seems to be at 0.37 of it."""
    return noisy(free(T, 2 * np.pi * 0.63 * 29.9, 0.004), 30.0)


def beyond_nyquist() -> np.ndarray:
    """At 0.55 of the sampling rate, so it seems to be at 0.45 of it."""
    return noisy(free(T, 2 * np.pi * 0.55 * 29.9, 0.004), 30.0)


def wandering() -> np.ndarray:
    return noisy(free(T), 30.0) + 0.02 * np.cumsum(np.random.default_rng(3).standard_normal(T.size))


def chirp() -> np.ndarray:
    return noisy(np.cos(4.0 * T + 0.3 * T**2) * np.exp(-0.1 * T), 30.0)


def coloured() -> np.ndarray:
    rng = np.random.default_rng(4)
    return free(T) + 0.2 * lfilter([0.6], [1.0, -0.8], rng.standard_normal(T.size))


SPOILT: dict[str, tuple[Callable[[], np.ndarray], tuple[Trust, ...], str]] = {
    "an outlier": (outlier, CARE_AT_LEAST, "samples are far off"),
    "a huge outlier": (huge_outlier, CARE_AT_LEAST, "samples are far off"),
    "a weak second mode": (
        lambda: noisy(free(T) + free(T, 15.0, 0.02, 0.1), 30.0),
        CARE_AT_LEAST,
        "2.5 times the natural frequency|2.51 times|2.50 times|2.52 times",
    ),
    "two modes": (lambda: noisy(free(T) + free(T, 15.0, 0.02, 1.0), 30.0), REFUSED, "a second mode"),
    "growing motion": (lambda: noisy(free(T, zeta=-0.02), 30.0), REFUSED, "the motion grows"),
    "motion that grows fast": (lambda: noisy(free(T, zeta=-0.1), 30.0), REFUSED, "the motion grows"),
    "a push at first": (pushed, CARE_AT_LEAST, "leave a start-up out by from="),
    "a vibration beyond Nyquist": (beyond_nyquist, REFUSED, "fit the samples alike"),
    "fewer than two samples a cycle": (fewer_than_two_a_cycle, REFUSED, "fit the samples alike"),
    "a frequency that changes": (chirp, REFUSED, "not white: the model does not describe this record"),
    "coloured noise": (coloured, CARE_AT_LEAST, "not white"),
    "a sensor that wanders": (wandering, CARE_AT_LEAST, "not white"),
}  # fmt: skip


@pytest.mark.parametrize("what", SPOILT)
def test_what_spoils_a_record_is_named(what: str) -> None:
    record, verdicts, part = SPOILT[what]
    finding = judge(T, record())
    assert finding.trust in verdicts, reasons(finding)
    assert any(one in reasons(finding) for one in part.split("|")), reasons(finding)


def test_a_wandering_sensor_is_not_called_a_second_mode() -> None:
    """A line at the lowest frequency of the record, a tenth of the natural one, is no mode and no harmonic."""
    said = reasons(judge(T, wandering()))
    assert "a second mode" not in said
    assert "drift" in said


@pytest.mark.parametrize(
    ("cycles", "verdicts"), [(0.4, REFUSED), (0.6, REFUSED), (1.0, CARE_AT_LEAST), (1.3, CARE_AT_LEAST)]
)
def test_too_few_cycles_are_counted(cycles: float, verdicts: tuple[Trust, ...]) -> None:
    times = np.linspace(0.0, cycles * 2 * np.pi / OMEGA, 100)
    finding = judge(times, noisy(free(times), 30.0))
    assert finding.trust in verdicts
    assert "cycles" in reasons(finding)


@pytest.mark.parametrize("seed", [0, 1])
def test_the_wrong_sign_of_the_force_is_named_and_force_gain_mends_it(seed: int) -> None:
    force, x = forced(T, 5 + seed)
    wrong = judge(T, noisy(x, 30.0, seed), -force)
    assert wrong.trust is Trust.NO
    assert "its sign is wrong; say force_gain=-1" in reasons(wrong)
    mended = judge(T, noisy(x, 30.0, seed), -force, force_gain=-1)
    assert mended.intervals["m"].value == pytest.approx(1.0, rel=0.02)
    assert "sign is wrong" not in reasons(mended)


def test_a_right_force_is_not_called_wrong_where_the_model_is() -> None:
    """Half of the motion is of a second body: the residuals are large, but turning the force would not help."""
    force, x = forced(T)
    other = lsim(([1.0], [1.0, 1.2, 400.0]), force, T)[1]
    finding = judge(T, noisy(x + np.std(x) / np.std(other) * other, 30.0), force)
    assert "sign is wrong" not in reasons(finding)


def sine_response(start: bool) -> tuple[np.ndarray, np.ndarray]:
    """Force and response to a sine at 0.7 times the natural frequency; with its ``start`` from rest, or long after."""
    times = np.linspace(0.0, 60.0, 1800)
    force = np.cos(0.7 * OMEGA * times)
    x = lsim(([1.0], [1.0, 2 * ZETA * OMEGA, OMEGA**2]), force, times)[1]
    part = slice(0, 900) if start else slice(900, 1800)
    return force[part], x[part]


def of_forced(times: np.ndarray, x: np.ndarray, force: np.ndarray) -> Problem:
    request = request_of(overrides_of({"method": "output_error", "data": "arrays"}))
    return read_measured(request, (of_arrays(times, x, force),)).problem


def test_one_steady_sine_does_not_determine_mass_damping_and_stiffness() -> None:
    force, x = sine_response(start=False)
    times = np.linspace(0.0, 30.0, 900)
    assert "one steady sine at 0.668" in steady_sine(of_forced(times, noisy(x, 40.0), force))
    finding = judge(times, noisy(x, 40.0), force)
    assert finding.trust is Trust.NO
    assert "one steady sine at 0.668" in reasons(finding)
    assert not finding.intervals


def test_the_start_of_a_sine_does() -> None:
    force, x = sine_response(start=True)
    times = np.linspace(0.0, 30.0, 900)
    assert not steady_sine(of_forced(times, noisy(x, 40.0), force))
    finding = judge(times, noisy(x, 40.0), force)
    assert "steady sine" not in reasons(finding)
    assert finding.intervals["m"].value == pytest.approx(1.0, rel=0.05)


def test_a_force_without_any_effect_explains_nothing() -> None:
    finding = judge(T, np.random.default_rng(1).standard_normal(T.size), forced(T)[0])
    assert finding.trust is Trust.NO
    assert not finding.intervals


def test_both_modes_are_offered_where_the_system_has_one() -> None:
    finding = judge(T, noisy(free(T) + free(T, 15.0, 0.02, 1.0), 30.0))
    assert sorted(mode.frequency for mode in finding.modes) == pytest.approx(
        [OMEGA / 2 / np.pi, 15 / 2 / np.pi], rel=3e-3
    )
    assert "holds modes at" in reasons(finding)


def test_tops_cut_off_and_noise_behind_them_are_a_harmonic() -> None:
    x = np.clip(free(T, zeta=0.02), -0.4, 0.4)
    finding = judge(T, x + 1e-2 * np.random.default_rng(2).standard_normal(T.size))
    assert finding.trust is Trust.NO
    assert "a clipped sensor, or a spring that is far from linear" in reasons(finding)
    assert not finding.modes


def test_the_rounding_of_a_file_has_no_colour() -> None:
    assert "white" not in reasons(judge(T, np.round(free(T), 7)))


def test_vibration_and_alias_are_offered_where_both_fit_alike() -> None:
    finding = judge(T, fewer_than_two_a_cycle())
    apparent, alias = finding.modes
    assert alias.frequency == pytest.approx(0.63 * 29.9, rel=1e-3)
    assert apparent.frequency + alias.frequency == pytest.approx(29.9, rel=1e-3)
    assert alias.alias


# the verdict, and what the command makes of it


def test_the_worst_reason_is_the_verdict() -> None:
    care, no = Reason(Trust.CAUTION, "a"), Reason(Trust.NO, "b")
    assert verdict(()) is Trust.TRUST
    assert verdict((care,)) is Trust.CAUTION
    assert verdict((care, no, care)) is Trust.NO


def test_what_is_not_to_be_trusted_is_withdrawn_but_kept() -> None:
    finding = judge(T, noisy(free(T) + free(T, 15.0, 0.02, 1.0), 30.0))
    assert finding.trust is Trust.NO
    assert finding.intervals == {}
    assert finding.withdrawn["k_over_m"].value == pytest.approx(OMEGA**2, rel=0.2)


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
def test_the_exit_status_is_1_where_nothing_is_to_be_trusted(
    trust: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record, status = STATUS[trust]
    assert main(["method=output_error", written(tmp_path, "t [s],x [m]", record())]) == status
    out = capsys.readouterr().out
    assert f": {trust}\n" in out
    assert ("Rejected value" in out) == (status == 1)


@pytest.mark.parametrize(
    ("head", "part"),
    [
        ("t [furlongs],x [m]", "furlongs"),
        ("t [s],displacement [m/s²]", "displacement [m/s²]"),
        ("t [s],position [g]", "position [g]"),
        ("t [m],x [m]", "several columns measure displacement"),
    ],
)
def test_a_wrong_unit_is_refused_in_one_line(
    head: str, part: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["method=output_error", written(tmp_path, head, noisy(free(T), 30.0))]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert len(err.splitlines()) == 1
    assert part in err
