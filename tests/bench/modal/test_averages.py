"""Averaged frequency responses, compared with closed forms, SciPy and pyFRF; detection of blows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import coherence

from bench.contract.modal import Blows
from bench.modal.averages import averages, decay_needed
from bench.modal.blows import ForcedRecord, blows_of, force_windowed

STEP = 1.0 / 1024.0
OMEGA, RATIOS = 2.0 * np.pi * np.array([23.0, 61.0]), np.array([0.02, 0.015])
RESIDUES = np.array([[1.0, 0.8], [0.6, -0.9]])
TIMES_OF_BLOWS, PEAKS = (1.0, 5.1, 9.3, 13.2, 17.5), (100.0, 60.0, 120.0, 80.0, 90.0)
SECOND = 9.34


def receptance(frequencies: np.ndarray, rate: float = 0.0) -> np.ndarray:
    """Return the response per unit of force (outputs, lines), its impulse response times ``exp(-rate t)``."""
    s = 2j * np.pi * frequencies[:, None] + rate
    return np.asarray(RESIDUES @ (1.0 / (s**2 + 2.0 * RATIOS * OMEGA * s + OMEGA**2)).T)


def response_to(force: np.ndarray) -> np.ndarray:
    """Return the response (outputs, n) to a force without content above the Nyquist frequency, from rest."""
    n = 4 * force.size
    spectrum = np.fft.rfft(force, n) * receptance(np.fft.rfftfreq(n, STEP))
    return np.asarray(np.fft.irfft(spectrum, n)[:, : force.size])


def hammered(seed: int = 0, force_noise: float = 0.0, response_noise: float = 0.0) -> ForcedRecord:
    """Return five blows, the third of them double, with an offset of the force and noise."""
    rng = np.random.default_rng(seed)
    times = np.arange(22.0, step=STEP)[:, None]
    force = np.exp(-0.5 * ((times - (*TIMES_OF_BLOWS, SECOND)) / 0.001) ** 2) @ (*PEAKS, 40.0)
    responses = response_to(force)
    sd = response_noise * np.std(responses, axis=1, keepdims=True)
    noisy = force + 3.0 + force_noise * rng.standard_normal(force.size)
    return ForcedRecord("five.csv", noisy, responses + sd * rng.standard_normal(responses.shape))


def test_a_record_of_five_blows_is_divided_and_a_double_hit_excluded() -> None:
    blows, notes = blows_of([hammered(force_noise=0.5, response_noise=0.01)], STEP, "receptance")
    np.testing.assert_allclose(np.ptp(blows.forces, axis=1), np.delete(PEAKS, 2), rtol=0.05)
    assert 4.0 < blows.forces.shape[1] * STEP < 4.2  # the shortest time between two blows
    assert np.ptp(np.argmax(blows.forces, axis=1)) <= 1
    (double,) = (note for note in notes if "double hit" in note)
    assert double.startswith("five.csv blow 3: double hit after 40 ms")


def test_files_of_one_blow_keep_their_length_and_short_ones_are_excluded() -> None:
    record = hammered()
    files = [ForcedRecord(f"{k}.csv", record.force[a:b], record.responses[:, a:b])
             for k, (a, b) in enumerate([(500, 4500), (4800, 8700), (13000, 14000)])]  # fmt: skip
    blows, notes = blows_of(files, STEP, "receptance")
    assert blows.forces.shape == (2, 3900)
    assert any("less than half as long: 2.csv" in note for note in notes)


def test_a_clipped_force_is_reported() -> None:
    record = hammered(force_noise=0.1)
    _, notes = blows_of([replace(record, force=np.minimum(record.force, 20.0))], STEP, "receptance")
    assert [note.split(":")[0] for note in notes if "limit" in note] == [f"five.csv blow {k}" for k in range(1, 6)]


def test_estimates_without_noise_are_the_closed_form() -> None:
    given = averages(blows_of([hammered()], STEP, "receptance")[0])
    band = given.frequencies < 150.0
    true = receptance(given.frequencies)[:, band]
    assert np.max(np.abs(given.h1[:, band] - true)) < 0.01 * np.max(np.abs(true))


def test_an_exponential_window_shifts_the_poles_by_its_rate() -> None:
    blows = blows_of([hammered()], STEP, "receptance")[0]
    fade = np.exp(-1.5 * STEP * np.arange(blows.forces.shape[1]))
    given = averages(replace(blows, responses=blows.responses * fade, window=1.5), decay=2.5)
    band = given.frequencies < 150.0
    true = receptance(given.frequencies, 4.0)[:, band]
    assert given.window == 4.0
    assert np.max(np.abs(given.h1[:, band] - true)) < 0.01 * np.max(np.abs(true))


def test_a_truncated_record_needs_an_exponential_window() -> None:
    blows, _ = blows_of([hammered()], STEP, "receptance")
    short = Blows(STEP, blows.forces[:, :1000], blows.responses[..., :1000], "receptance")
    assert decay_needed(blows) == 0.0
    assert 1.0 < decay_needed(short) < 4.7 / (1000 * STEP)


def test_bias_and_variance_of_h1_are_as_stated() -> None:
    rows = []
    for seed in range(12):
        given = averages(blows_of([hammered(seed, 1.0, 0.003)], STEP, "receptance")[0])
        band = (given.frequencies > 5.0) & (given.frequencies < 80.0)
        true = receptance(given.frequencies)[:, band]
        squares = np.abs(given.h1[:, band] - true) ** 2 / given.variances[:, band]
        rows.append((np.mean((given.h1[:, band] / true).real) - 1.0, np.mean(given.bias[band]), np.median(squares)))
    bias, stated, square = np.mean(rows, axis=0)
    assert abs(bias - stated) < 3.0 * np.std(rows, axis=0)[0] / np.sqrt(len(rows)) - 0.05 * stated
    assert -0.02 < stated < 0.0
    assert 0.5 < square < 2.5  # F(2, 6) has the median 0.81 and the mean 1.5


def test_a_shakers_record_is_averaged_as_scipy_does() -> None:
    rng = np.random.default_rng(3)
    force = rng.standard_normal(60_000)
    responses = response_to(force)
    responses += 0.3 * np.std(responses, axis=1, keepdims=True) * rng.standard_normal(responses.shape)
    blows, notes = blows_of([ForcedRecord("shaker", force, responses)], STEP, "receptance")
    assert "shaker" in notes[0]
    assert force_windowed(blows) is blows
    given = averages(blows)
    _, expected = coherence(force, responses, 1.0 / STEP, nperseg=force.size // 8)
    np.testing.assert_allclose(given.coherence, expected[:, 1:-1], rtol=1e-6)
    band = given.frequencies < 100.0
    squares = np.abs(given.h1 - receptance(given.frequencies)) ** 2 / given.variances
    assert 0.7 < np.mean(squares[:, band]) < 2.0  # there is leakage at the natural frequencies


def test_estimates_are_those_of_pyfrf() -> None:
    pyfrf = pytest.importorskip("pyFRF")
    blows, _ = blows_of([hammered(2, 0.5, 0.05)], STEP, "receptance")
    given = averages(blows)
    forces = force_windowed(blows).forces
    other = pyfrf.FRF(round(1.0 / STEP), forces[:, None], blows.responses, exc_type="f", resp_type="d")
    lines = slice(1, given.frequencies.size + 1)
    np.testing.assert_allclose(given.h1, other.get_H1()[:, 0, lines], rtol=1e-6)
    np.testing.assert_allclose(given.coherence, other.get_coherence()[:, lines], rtol=1e-6)
