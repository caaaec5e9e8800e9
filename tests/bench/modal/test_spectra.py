"""Modes of spectra, compared with closed forms, an independent Fisher information, and simulated blows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.contract.modal import Blows, FrequencyResponses, ModalProblem, Mode
from bench.entrants.modal import make_modal
from bench.modal.scenario import ModalScenario
from bench.modal.spectra import Spectra, modal_parameters

HERTZ, RATIOS = np.array([35.0, 88.0, 150.0]), np.array([0.01, 0.008, 0.012])
POLES = 2.0 * np.pi * HERTZ * (-RATIOS + 1j * np.sqrt(1.0 - RATIOS**2))
RESIDUES = np.array([[0.4, -0.6], [0.5, 0.3], [-0.7, 0.5]]) / (1j * POLES.imag[:, None])
LINES = np.arange(20.0, 220.0, 0.5)


def response(hertz: np.ndarray, order: int, window: float = 0.0) -> np.ndarray:
    """Return the response per unit of force (2, lines), its impulse response times ``exp(-window t)``."""
    s = window + 2j * np.pi * hertz
    parts = RESIDUES[..., None] / (s - POLES[:, None, None]) + RESIDUES.conj()[..., None] / (
        s - POLES.conj()[:, None, None]
    )
    return np.asarray(s**order * np.sum(parts, axis=0))


@pytest.mark.parametrize(
    ("name", "order", "window"), [("receptance", 0, 0.0), ("mobility", 1, 2.0), ("accelerance", 2, 0.0)]
)
def test_frequency_responses_without_noise_give_the_modes_exactly(name: str, order: int, window: float) -> None:
    data = FrequencyResponses(LINES, response(LINES, order, window), name, window=window)
    estimate = make_modal("spectra").identify_modes(ModalProblem(data))
    assert [mode.frequency for mode in estimate.modes] == pytest.approx(HERTZ, rel=1e-9)
    assert [mode.damping_ratio for mode in estimate.modes] == pytest.approx(RATIOS, rel=1e-7)
    assert np.array([mode.shape for mode in estimate.modes]) == pytest.approx(RESIDUES, rel=1e-6)


def test_truncated_blows_give_the_modes_exactly() -> None:
    rate, over, n = 1000.0, 16, 600
    times = np.arange(n * over) / (rate * over)
    force = np.where(np.abs(times - 0.05) < 0.008, np.cos(np.pi * (times - 0.05) / 0.016) ** 6, 0.0)
    spectrum = np.fft.rfft(force, 32 * force.size)
    hertz = np.fft.rfftfreq(32 * force.size, times[1])
    motion = np.fft.irfft(spectrum * response(hertz, 0))[:, : force.size : over]
    assert np.max(np.abs(motion[:, -50:])) > 0.05 * np.max(np.abs(motion))
    data = Blows(1.0 / rate, np.stack([force[::over], 2 * force[::over]]), np.stack([motion, 2 * motion]), "receptance")
    estimate = make_modal("spectra").identify_modes(ModalProblem(data, band=(15.0, 250.0)))
    assert [mode.frequency for mode in estimate.modes] == pytest.approx(HERTZ, rel=1e-5)
    assert [mode.damping_ratio for mode in estimate.modes] == pytest.approx(RATIOS, rel=1e-3)
    assert np.array([mode.shape for mode in estimate.modes]) == pytest.approx(RESIDUES, rel=2e-2, abs=1e-6)


def test_errors_of_frequency_responses_agree_with_standard_errors() -> None:
    rng, clean, scores = np.random.default_rng(5), response(LINES, 0), []
    sigma = 0.01 * np.max(np.abs(clean), axis=1, keepdims=True)
    for _ in range(8):
        noise = rng.standard_normal(clean.shape) + 1j * rng.standard_normal(clean.shape)
        data = FrequencyResponses(LINES, clean + sigma * noise, "receptance")
        for mode in make_modal("spectra").identify_modes(ModalProblem(data, count=1)).modes:
            scores.append((mode.frequency - HERTZ[0]) / mode.frequency_sd)
    assert 0.4 < np.sqrt(np.mean(np.square(scores))) < 1.8


def test_mass_damping_and_stiffness_of_one_degree_of_freedom() -> None:
    m, c, k = 2.0, 3.0, 8000.0
    rate = np.sqrt(k / m)
    ratio = c / (2.0 * m * rate)
    residue = 1.0 / (2j * m * rate * np.sqrt(1.0 - ratio**2))
    mode = Mode(rate / (2 * np.pi), ratio, 0.0, 0.0, np.array([residue, 1j * residue]), np.full(2, 0.01 * abs(residue)))
    parameters = modal_parameters(mode)
    assert (parameters.m, parameters.c, parameters.k) == pytest.approx((m, c, k))
    assert parameters.m_sd == pytest.approx(0.01 * m)
    assert not parameters.note
    assert "90 degrees" in modal_parameters(mode, 1).note


SHORT = ModalScenario("", (40.0,), (0.01,), (1.0,), 1024.0, 512, blows=3, band=(15.0, 120.0))
"""Three blows on one mode, whose motion has decayed to a third at the end of a record."""


def test_standard_errors_of_blows_are_those_of_a_fisher_information_by_finite_differences() -> None:
    """The motion is a sum over the samples of the force, and the noise is white in time."""
    step, n, sigma, low, high = 1e-3, 512, 2e-6, 15.0, 200.0
    times, hertz = step * np.arange(n), np.fft.rfftfreq(n, step)
    since = times - np.array([[0.05], [0.06]])
    forces = np.array([[1.0], [1.6]]) * np.where((since > 0) & (since < 0.012), np.sin(np.pi * since / 0.012) ** 2, 0.0)

    def responses(x: np.ndarray) -> np.ndarray:
        pole = 2.0 * np.pi * x[0] * (-x[1] + 1j * np.sqrt(1.0 - x[1] ** 2))
        parts = [2.0 * ((re + 1j * im) * np.exp(pole * times)).real for re, im in x[2:].reshape(2, 2)]
        return step * np.array([np.convolve(f, part)[:n] for f, part in zip(forces, parts, strict=True)])

    def lines(values: np.ndarray) -> np.ndarray:
        spectra = step * np.fft.rfft(values)[:, (hertz >= low) & (hertz <= high)]
        return np.concatenate([spectra.real, spectra.imag], axis=1).ravel()

    x = np.array([60.0, 0.01, 1e-4, -1.3e-3, 1e-4, -1.3e-3])
    steps = 1e-5 * np.diag(np.abs(x))
    derivatives = [(lines(responses(x + h)) - lines(responses(x - h))) / (2.0 * h.max()) for h in steps]
    s = 2j * np.pi * np.maximum(hertz, low)
    for power, blow in [(power, blow) for power in range(-2, 2) for blow in range(2)]:
        derivatives.append(lines(np.fft.irfft(np.fft.rfft(forces) * s**power, n) * (np.arange(2) == blow)[:, None]))
    columns = np.array(derivatives).T
    scale = np.linalg.norm(columns, axis=0)
    bound = np.sqrt(np.diag(np.linalg.inv((columns / scale).T @ (columns / scale)))) / scale
    bound *= step * sigma * np.sqrt(n / 2.0)
    noise = sigma * np.random.default_rng(4).standard_normal((2, 1, n))
    data = Blows(step, forces, responses(x)[:, None] + noise, "receptance")
    (mode,) = make_modal("spectra").identify_modes(ModalProblem(data, 1, (low, high))).modes
    assert [mode.frequency_sd, mode.damping_ratio_sd] == pytest.approx(bound[:2], rel=0.1)
    assert abs(mode.frequency - x[0]) < 4.0 * bound[0]


@pytest.mark.slow
def test_the_coverage_of_intervals_of_blows_is_95_percent() -> None:
    scores = []
    for replicate in range(100):
        problem, truth = SHORT.draw(11, replicate)
        (mode,) = make_modal("spectra").identify_modes(ModalProblem(problem.data, 1, problem.band)).modes
        errors = mode.frequency - truth.frequencies[0], mode.damping_ratio - truth.damping_ratios[0]
        scores.append([errors[0] / mode.frequency_sd, errors[1] / mode.damping_ratio_sd])
    assert 0.88 < np.mean(np.abs(scores) < 1.96) < 0.99
    assert np.abs(np.mean(scores, axis=0)).max() < 0.4  # four standard errors of the mean


def test_without_the_transient_term_the_damping_of_a_truncated_record_is_biased(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem, truth = replace(SHORT, snr_db=80.0, force_snr_db=80.0).draw(0, 0)
    problem = ModalProblem(problem.data, 1, problem.band)
    (mode,) = make_modal("spectra").identify_modes(problem).modes
    assert mode.damping_ratio == pytest.approx(truth.damping_ratios[0], rel=0.01)
    monkeypatch.setattr(Spectra, "free", lambda self, poles: np.zeros((2, poles.size, self.s.size)))
    (biased,) = make_modal("spectra").identify_modes(problem).modes
    assert biased.damping_ratio > 1.1 * truth.damping_ratios[0]


def test_intervals_of_windowed_frequency_responses_allow_for_the_correlation_of_lines() -> None:
    """White noise in the impulse response, times ``exp(-2 t)``: intervals for independent lines cover 77 %."""
    n, step, window, frequency, ratio, scores = 1024, 1.0 / 512.0, 2.0, 40.0, 0.004, []
    times, hertz = step * np.arange(n), np.fft.rfftfreq(n, step)
    pole, s = 2.0 * np.pi * frequency * (-ratio + 1j * np.sqrt(1.0 - ratio**2)), window + 2j * np.pi * hertz
    clean = -1e-3j / (s - pole) + 1e-3j / (s - pole.conjugate())
    for seed in range(60):
        noise = 2e-5 * np.random.default_rng(seed).standard_normal(n) * np.exp(-window * times)
        values = (clean + step * np.fft.rfft(noise))[None]
        data = FrequencyResponses(hertz, values, "receptance", window=window)
        (mode,) = make_modal("spectra").identify_modes(ModalProblem(data, 1, (15.0, 100.0))).modes
        scores.append((mode.frequency - frequency) / mode.frequency_sd)
        scores.append((mode.damping_ratio - ratio) / mode.damping_ratio_sd)
    assert 0.88 < np.mean(np.abs(scores) < 1.96) < 0.99
