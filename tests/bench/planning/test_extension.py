"""A record that was taken: what more of it would tell, against simulated records and a hand-made case."""

import math

import numpy as np
import pytest

import bench
from bench.commands.main import main
from bench.planning.extension import MeasuredDecay, initial_state
from bench.planning.free_decay import Oscillator, motion

OSCILLATOR, SIGMA, START = Oscillator(2.0, 0.03), 1e-3, (0.02, 0.1)
TIMES = np.arange(40) * 0.05


def record(times: np.ndarray, seed: int) -> np.ndarray:
    noise = np.random.default_rng(seed).standard_normal(times.size)
    return np.asarray(motion(OSCILLATOR, times, START)[0] + SIGMA * noise + 0.004)


def taken() -> MeasuredDecay:
    plain = MeasuredDecay(TIMES, OSCILLATOR, START, SIGMA, {})
    return MeasuredDecay(TIMES, OSCILLATOR, START, SIGMA, plain.bounds(TIMES))


@pytest.mark.slow
def test_a_longer_record_is_as_good_as_simulated_ones_are() -> None:
    times = taken().extended(2.0)
    errors = [
        math.log(bench.identify(times, record(times, seed), method="output_error").values["damping_ratio"] / 0.03)
        for seed in range(40)
    ]
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(taken().expected(2.0)["damping_ratio"], rel=0.3)


def test_the_start_is_found_under_an_offset() -> None:
    found = initial_state(OSCILLATOR, TIMES, motion(OSCILLATOR, TIMES, START)[0] + 0.3)
    np.testing.assert_allclose(found, START, rtol=1e-9)


def test_the_factor_is_the_least_that_reaches_the_error() -> None:
    own = taken()
    wanted = 0.6 * own.supported["c_over_m"]
    factor = own.factor_for("c_over_m", wanted)
    assert own.expected(factor)["c_over_m"] <= wanted < own.expected(factor - 0.1)["c_over_m"]
    assert own.factor_for("c_over_m", 1e-6) is None  # the motion dies away
    assert own.factor_for("c_over_m", own.supported["c_over_m"]) == 1.0
    assert own.number_for("c_over_m", own.supported["c_over_m"] / 2) == 4


def test_the_command_reads_a_record_and_refuses_what_is_none(tmp_path, capsys) -> None:
    path = tmp_path / "record.csv"
    np.savetxt(path, np.c_[TIMES, record(TIMES, 1)], delimiter=",", header="t (s),x (m)", comments="")
    assert main(["design", f"given={path}", "want=damping_ratio:5%"]) == 0
    said = capsys.readouterr().out
    assert "s more reduce the error of damping ratio" in said
    assert "2 times as long" in said
    rng = np.random.default_rng(0)
    np.savetxt(path, np.c_[TIMES, rng.standard_normal(40)], delimiter=",", header="t (s),x (m)", comments="")
    assert main(["design", f"given={path}"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert main(["design", "given=nowhere.csv"]) == 2
