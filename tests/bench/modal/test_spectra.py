"""Modes on spectra against closed forms, an independent Fisher information, and drawn blows."""

from __future__ import annotations

import numpy as np
import pytest

from bench.contract.modal import FrequencyResponses, ModalProblem
from bench.entrants.modal import make_modal

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
