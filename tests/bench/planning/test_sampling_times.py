"""Optimal sampling times: against every subset of a small grid, random ones, and simulated tests."""

import itertools

import numpy as np
import pytest

from bench.commands.main import main
from bench.entrants.registry import make_method
from bench.planning import sampling_times
from bench.planning.free_decay import Decay
from bench.planning.sampling_times import VOLUME, best_times, evaluate_times
from bench.planning.search import Likely
from bench.planning.verify import simulate_decays

LIKELY, DECAY = Likely(2.0, 0.02), Decay(40, 8.0, 20.0)


@pytest.mark.parametrize("quantity", ["c_over_m", "k_over_m", "damping_ratio"])
def test_no_subset_of_a_small_grid_is_much_better(quantity: str, monkeypatch) -> None:
    monkeypatch.setattr(sampling_times, "FINE", 3)
    decay = Decay(5, 1.3, 20.0)
    found = best_times(LIKELY, decay, quantity).median[quantity]
    grid = np.linspace(0.0, decay.duration, 13)
    every = [
        evaluate_times(LIKELY, grid[list(own)], 20.0).median[quantity] for own in itertools.combinations(range(13), 5)
    ]
    assert min(every) <= found * (1 + 1e-9)
    assert found < 1.1 * min(every)


@pytest.mark.slow
@pytest.mark.parametrize("likely", [LIKELY, Likely(2.0, 0.02, 0.05, 0.3)])
def test_the_best_times_are_better_than_even_and_than_random_ones(likely: Likely) -> None:
    rng = np.random.default_rng(0)
    for quantity in ("c_over_m", "k_over_m"):
        best = best_times(likely, DECAY, quantity)
        assert best.times.size == DECAY.samples == np.unique(best.times).size
        assert best.median[quantity] < 0.85 * evaluate_times(likely, DECAY.times, 20.0).median[quantity]
        drawn = [np.sort(rng.uniform(0.0, 8.0, 40)) for _ in range(20)]
        assert best.median[quantity] < min(evaluate_times(likely, times, 20.0).median[quantity] for times in drawn)


def test_the_ellipse_is_smaller_than_for_either_quantity_alone() -> None:
    volume = best_times(LIKELY, DECAY, VOLUME).median
    for quantity, other in (("c_over_m", "k_over_m"), ("k_over_m", "c_over_m")):
        alone = best_times(LIKELY, DECAY, quantity).median
        assert alone[quantity] <= volume[quantity]
        assert alone[other] >= volume[other]


def test_a_real_method_gains_what_the_bound_promises() -> None:
    best, method = best_times(LIKELY, DECAY, "c_over_m"), make_method("output_error", {})
    errors = simulate_decays(LIKELY, DECAY, "c_over_m", method, 60, lambda: None, best.times)
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(best.median["c_over_m"], rel=0.3)


def test_the_command_says_when_to_sample(tmp_path, capsys) -> None:
    given = ["want=c_over_m:5%", "frequency=2", "damping=0.02", "noise=0.5mm", "times=optimal", "duration=8"]
    path = tmp_path / "times.csv"
    assert main(["design", *given, "samples=40", "amplitude=1cm", f"out={path}"]) == 0
    assert "best for c/m" in capsys.readouterr().out
    assert len(path.read_text().splitlines()) == 41
    for wrong in (["samples=40"], ["amplitude=1cm"], ["samples=40", "amplitude=1cm", "times=soon"]):
        assert main(["design", *given, *wrong]) == 2
        assert capsys.readouterr().err.count("\n") == 1
