"""The Silverbox benchmark: official parts, the sign of the constant force, one line where the data are absent."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from bench import InputError
from tests.studies.silverbox.__main__ import free_run, main, millivolts
from tests.studies.silverbox.record import (
    ARROW,
    FILES,
    MULTISINE,
    RATE,
    ROWS,
    TEST_MULTISINE,
    TRAINING,
    UNSCORED,
    WITHIN,
    ConstantForce,
    Silverbox,
    read,
    signed,
    training_problem,
)

TRUE = {"m": 5.3e-6, "c": 2.2e-4, "k": 0.98, "k3": 3.9, "u0": 0.0054}
FREQUENCIES = 2 * np.pi * np.array([13.0, 41.0, 67.0, 90.0])


def folder() -> Path | None:
    places = [os.environ.get("BENCH_SHARED_DATA"), Path(__file__).parents[2].parent / "shared" / "data"]
    found = [Path(place) / "silverbox" for place in places if place]
    return next((f for f in found if any((f / name).is_file() for name in FILES)), None)


def made(sign: float) -> Silverbox:
    """An output of four sines, and the input that the equation of motion asks for, in closed form."""
    t = np.arange(ROWS)[:, None] / RATE
    y, v, a = (
        np.sum(0.03 * FREQUENCIES**n * np.sin(FREQUENCIES * t + n * np.pi / 2 + np.arange(4)), axis=1) for n in range(3)
    )
    pull = TRUE["m"] * a + TRUE["c"] * v + TRUE["k"] * y + TRUE["k3"] * y**3
    return Silverbox(pull - sign * TRUE["u0"], y)


def test_the_parts_are_the_official_ones_and_no_test_sample_is_trained_on() -> None:
    """Full multisine [40650:127400], its first 75 % for training; arrow [100:40575] (nonlinearbenchmark.org)."""
    assert (MULTISINE.start, MULTISINE.stop, ARROW.start, ARROW.stop) == (40650, 127400, 100, 40575)
    used = [set(range(part.start, part.stop)) for part in (TRAINING, TEST_MULTISINE, ARROW)]
    assert not used[0] & used[1]
    assert not used[0] & used[2]
    assert used[0] | used[1] == set(range(40650, 127400))
    assert len(used[0]) / 86750 == pytest.approx(0.75, abs=1e-5)
    assert ARROW.start + WITHIN <= ARROW.stop


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_sign_of_the_constant_force_is_found(sign: float) -> None:
    assert signed(made(sign)).sign == sign


def test_the_truth_simulates_to_nothing_but_the_hold() -> None:
    """Root mean square of the output: 42 mV. A spline leaves less than a thousandth, mostly of its cube at 270 Hz."""
    data, system = made(-1.0), ConstantForce(sign=-1.0)
    part = slice(ARROW.start, ARROW.start + 600)
    assert millivolts(free_run(system, TRUE, data, part, "cubic")) < 0.042
    assert free_run(system, TRUE, data, part, "cubic").size == 600 - UNSCORED
    assert millivolts(free_run(system, TRUE, data, part, "linear")) > 0.2


def test_absent_data_are_one_line_and_status_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([f"data={tmp_path}", f"out={tmp_path}"]) == 2
    assert main([]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2
    assert all("data" in line for line in lines)
    (tmp_path / FILES[0]).write_text("V1,V2\n1,2\n3,4\n")
    with pytest.raises(InputError, match="131072 rows"):
        read(tmp_path)


@pytest.mark.skipif(folder() is None, reason="the Silverbox is not here; set BENCH_SHARED_DATA to the folder above it")
def test_shooting_on_a_stretch_is_near_the_fit_to_the_whole_record() -> None:
    """Reference: a fit of the same equation to all training samples gave 68.32 Hz and a damping ratio of 0.0488."""
    pytest.importorskip("casadi")
    from methods.trajectory.shooting import Shooting

    where = folder()
    assert where is not None
    data = read(where)
    system = signed(data)
    estimate = Shooting(starts=1).identify(training_problem(data, system, "cubic", 256), np.random.default_rng(0))
    for name, expected in (("k_over_m", (2 * np.pi * 68.32) ** 2), ("c_over_m", 2 * 0.0488 * 2 * np.pi * 68.32)):
        marginal = estimate.marginal(system.quantity(name))
        assert marginal is not None, estimate.message
        assert marginal.value == pytest.approx(expected, rel=0.02)
    assert system.sign == -1.0
