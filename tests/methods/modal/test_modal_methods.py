"""Matrix pencil, ERA and sdypy-EMA for several modes: closed forms, the likelihood's answer and its bound."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.special import stdtrit

from bench import Blows, FreeDecays, FrequencyResponses, ModalEstimate, ModalProblem
from bench.entrants.modal import make_modal
from bench.modal.waves import Waves
from methods.rivals.ema import averaged

REALISATIONS = ["matrix_pencil", "era"]
FREQUENCIES, RATIOS = np.array([3.1, 7.4, 9.9]), np.array([0.02, 0.01, 0.015])
RATES = 2 * np.pi * FREQUENCIES
POLES = RATES * (-RATIOS + 1j * np.sqrt(1 - RATIOS**2))
SHAPES = np.array([[1.0, 0.7j, 0.04], [-0.5, 0.6 + 0.2j, 0.05]])
"""The third mode is weak."""


def decays(
    noise: float = 0.0, step: float = 0.02, samples: int = 500, seed: int = 1, colour: float = 0.0
) -> FreeDecays:
    """Two channels with a constant each; noise an autoregression of order 1."""
    times = 3.0 + step * np.arange(samples)
    motion = np.einsum("cm,mt->ct", SHAPES, np.exp(POLES[:, None] * (times - times[0]))).real
    white = np.random.default_rng(seed).standard_normal((2, samples + 100))
    for j in range(1, samples + 100):
        white[:, j] += colour * white[:, j - 1]
    return FreeDecays(times, motion + np.array([[2.0], [-1.0]]) + noise * white[:, 100:])


def modes(name: str, data: FreeDecays | FrequencyResponses | Blows, count: int | None = None) -> ModalEstimate:
    problem = ModalProblem(data, count)
    method = make_modal(name)
    assert method.objection(problem) is None
    return method.identify_modes(problem)


@pytest.mark.parametrize("name", REALISATIONS)
@pytest.mark.parametrize(("step", "samples"), [(0.02, 500), (0.0004, 25_000)], ids=["short", "thinned"])
def test_exact_samples_give_every_mode_and_shape(name: str, step: float, samples: int) -> None:
    answer = modes(name, decays(step=step, samples=samples), count=3)
    assert [mode.frequency for mode in answer.modes] == pytest.approx(FREQUENCIES, rel=1e-7)
    assert [mode.damping_ratio for mode in answer.modes] == pytest.approx(RATIOS, rel=1e-5)
    np.testing.assert_allclose(np.transpose([mode.shape for mode in answer.modes]), SHAPES, atol=1e-6)


@pytest.mark.parametrize("name", REALISATIONS)
def test_little_noise_gives_the_answer_of_the_likelihood_and_its_standard_errors(name: str) -> None:
    data = decays(noise=2e-3)
    answer, best = modes(name, data), Waves().identify_modes(ModalProblem(data))
    assert len(answer.modes) == len(best.modes) == 3
    for mode, other in zip(answer.modes, best.modes, strict=True):
        assert abs(mode.frequency - other.frequency) < 1.5 * other.frequency_sd
        assert mode.frequency_sd == pytest.approx(other.frequency_sd, rel=0.25)
        assert mode.damping_ratio_sd == pytest.approx(other.damping_ratio_sd, rel=0.25)
        np.testing.assert_allclose(mode.shape_sd, other.shape_sd, rtol=0.3)
        assert mode.share == pytest.approx(other.share, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("name", REALISATIONS)
@pytest.mark.parametrize("colour", [0.0, 0.8])
def test_intervals_hold_at_white_and_at_coloured_noise(name: str, colour: float) -> None:
    covered, records = np.zeros(2), 12
    for seed in range(records):
        answer = modes(name, decays(0.005, seed=seed, colour=colour), count=3)
        reach = stdtrit(answer.degrees, 0.975)
        for mode, frequency, ratio in zip(answer.modes, FREQUENCIES, RATIOS, strict=True):
            covered += [
                abs(mode.frequency - frequency) < reach * mode.frequency_sd,
                abs(mode.damping_ratio - ratio) < reach * mode.damping_ratio_sd,
            ]
    # of 36 draws at 95 %, 28 or fewer are a chance of 1 in 3000
    assert np.all(covered > 28)


@pytest.mark.parametrize("name", REALISATIONS)
def test_the_number_is_found_and_noise_alone_has_none(name: str) -> None:
    counts = [len(modes(name, decays(0.01, seed=seed)).modes) for seed in range(5)]
    assert counts.count(3) >= 4
    noise = np.random.default_rng(2).standard_normal((2, 500))
    assert not modes(name, FreeDecays(0.02 * np.arange(500), noise)).modes


@pytest.mark.parametrize("name", REALISATIONS)
def test_a_record_at_uneven_steps_is_refused(name: str) -> None:
    data = decays()
    uneven = dataclasses.replace(data, times=data.times + 0.009 * np.sin(np.arange(500)))
    assert "even steps" in str(make_modal(name).objection(ModalProblem(uneven)))


# ---------------------------------------------------------------------------------------------------- sdypy-EMA


def response(lines: np.ndarray, derivative: int) -> np.ndarray:
    s = 2j * np.pi * lines[:, None]
    parts = SHAPES[:, None] / (s - POLES) + SHAPES[:, None].conj() / (s - POLES.conj())
    return np.asarray(np.sum(parts * s**derivative, axis=2))


@pytest.mark.parametrize("kind", ["receptance", "mobility", "accelerance"])
def test_ema_finds_poles_and_residues_of_a_closed_form(kind: str) -> None:
    pytest.importorskip("sdypy.EMA")
    lines = 0.02 * np.arange(1001)
    values = response(lines, ["receptance", "mobility", "accelerance"].index(kind))
    answer = modes("ema", FrequencyResponses(lines, values, kind, window=0.0))
    assert [mode.frequency for mode in answer.modes] == pytest.approx(FREQUENCIES, rel=1e-4)
    assert [mode.damping_ratio for mode in answer.modes] == pytest.approx(RATIOS, rel=1e-2)
    np.testing.assert_allclose(np.transpose([mode.shape for mode in answer.modes]), SHAPES, atol=0.01)
    assert np.isnan(answer.modes[0].frequency_sd)


def test_ema_takes_the_damping_of_its_exponential_window_off_and_refuses_free_decays() -> None:
    pytest.importorskip("sdypy.EMA")
    pytest.importorskip("pyFRF")
    step, times = 0.01, 0.01 * np.arange(600)
    force = np.where(np.arange(600) == 2, 1.0, 0.0)
    kernel = 2.0 * np.einsum("cm,mt->ct", SHAPES, np.exp(POLES[:, None] * times)).real
    moved = np.array([np.convolve(force, row)[: times.size] * step for row in kernel])
    blows = Blows(step, force[None], moved[None], "receptance")
    assert averaged(blows).window > 0.5
    answer = modes("ema", blows)
    assert [mode.frequency for mode in answer.modes] == pytest.approx(FREQUENCIES, rel=1e-3)
    assert [mode.damping_ratio for mode in answer.modes] == pytest.approx(RATIOS, rel=0.05)
    assert "free decays" in str(make_modal("ema").objection(ModalProblem(decays())))
