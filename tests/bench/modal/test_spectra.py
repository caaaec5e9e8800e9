"""Modes on spectra against closed forms, an independent Fisher information, and drawn blows."""

from __future__ import annotations

import numpy as np
import pytest

from bench.contract.modal import Blows, FrequencyResponses, ModalProblem, Mode
from bench.entrants.modal import make_modal
from bench.modal.spectra import modal_parameters

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
    data = FrequencyResponses(LINES, response(LINES, order, window), name, window=window)  # type: ignore[arg-type]
    estimate = make_modal("spectra").identify_modes(ModalProblem(data))
    assert [mode.frequency for mode in estimate.modes] == pytest.approx(HERTZ, rel=1e-9)
    assert [mode.damping_ratio for mode in estimate.modes] == pytest.approx(RATIOS, rel=1e-7)
    assert np.array([mode.shape for mode in estimate.modes]) == pytest.approx(RESIDUES, rel=1e-6)


def test_blows_that_end_before_their_motion_give_the_modes_exactly() -> None:
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


def test_intervals_of_frequency_responses_cover_the_truth_as_often_as_stated() -> None:
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
