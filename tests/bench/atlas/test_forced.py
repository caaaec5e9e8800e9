"""Tests with a measured force: the scenario has the force that the numbers say, and its atlas is one of its own."""

import math
from dataclasses import replace

import numpy as np
import pytest

from bench.atlas.forced_test import KINDS, Forced
from bench.commands.main import main
from bench.config.atlas import SAMPLED, atlas_blocks, atlas_methods

POINT = Forced(100, 10.0, 0.05, 30.0, 2.0, 20.0, "multisine")


def spectrum(point: Forced) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies over the natural frequency, and the amplitude of the clean force's transform, finely spaced."""
    made = point.scenario()
    force = made.force.draw(made.duration, np.random.default_rng(1))
    natural = math.sqrt(made.parameters["k"] / made.parameters["m"]) / (2.0 * math.pi)
    step = force.times[1] - force.times[0]
    size = 2**17
    return np.fft.rfftfreq(size, step) / natural, np.abs(np.fft.rfft(force.values, size))


def test_the_scenario_is_the_test_that_the_numbers_say() -> None:
    made = POINT.scenario()
    m, c, k = (made.parameters[name] for name in ("m", "c", "k"))
    assert c / (2 * math.sqrt(k * m)) == pytest.approx(0.05)
    assert math.sqrt(k / m) * made.duration / (2 * math.pi) == pytest.approx(10.0)
    problem, _ = made.maker(0)(0)
    (record,) = problem.records
    assert not np.any(record.initial_state.displacement)


@pytest.mark.parametrize("kind", KINDS)
def test_the_force_is_told_with_its_noise(kind) -> None:
    point = replace(POINT, force=kind, force_snr_db=20.0, bandwidth=3.0, cycles=40.0)
    made = point.scenario()
    told = made.maker(0)(0)[0].records[0].forces[0].values
    other = made.maker(0)(1)[0].records[0].forces[0].values
    # two replicates differ by two draws of the noise: variance 2 sigma², with sigma² a hundredth of the mean square
    power = np.mean(told * other)
    assert np.var(told - other) / 2.0 == pytest.approx(0.01 * power, rel=0.25)


def test_a_periodic_force_ends_at_its_bandwidth() -> None:
    for kind in ("multisine", "band_limited_noise", "swept_sine"):
        ratios, sizes = spectrum(replace(POINT, force=kind, cycles=40.0))
        power = np.cumsum(sizes**2) / np.sum(sizes**2)
        assert power[np.searchsorted(ratios, 2.1)] > 0.98
        assert power[np.searchsorted(ratios, 1.5)] < 0.9


def test_a_pulse_falls_to_half_at_its_bandwidth() -> None:
    ratios, sizes = spectrum(replace(POINT, force="impulse"))
    assert np.interp(2.0, ratios, sizes) / sizes[0] == pytest.approx(0.5, abs=0.02)


@pytest.mark.slow
def test_its_methods_can_be_made_and_the_command_writes_it(tmp_path, capsys) -> None:
    assert {task.label for task in atlas_blocks(SAMPLED, test="forced")} == set(atlas_methods("forced"))
    given = [f"store={tmp_path / 'store'}", f"out={tmp_path / 'out'}", "test=forced", "part=points", "points=2"]
    assert main(["-m", "experiment=atlas", *given, "method=frequency"]) == 0
    page = (tmp_path / "out" / "atlas_forced.md").read_text()
    assert "2 points" in page
    assert "## m, the mass" in page
    assert main(["-m", "experiment=atlas", "test=force"]) == 2
    assert "did you mean forced" in capsys.readouterr().err
