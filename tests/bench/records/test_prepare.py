"""What is done to measured signals before a fit, on records whose truth is simulated here."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import bench


def written(path: Path, heading: str, *columns: np.ndarray) -> Path:
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=heading, comments="", fmt="%.7g")
    return path


@pytest.mark.parametrize(("heading", "power"), [("v [m/s]", 1), ("a [m/s^2]", 2)])
def test_the_offset_of_a_sensor_is_estimated(tmp_path: Path, heading: str, power: int) -> None:
    """Ten times the motion, as gravity in an accelerometer."""
    times = np.arange(0.0, 15.0, 0.05)
    pole = complex(-0.1, np.sqrt(19.36 - 0.01))
    motion = np.real(pole**power * np.exp(pole * times))
    noise = 0.02 * np.std(motion) * np.random.default_rng(power).standard_normal(times.size)
    path = written(tmp_path / "record.csv", f"t [s],{heading}", times, motion + noise - 10 * np.std(motion))
    answer = bench.identify(path, method="output_error")
    assert answer.values["k_over_m"] == pytest.approx(19.36, rel=0.003)
    assert answer.values["c_over_m"] == pytest.approx(0.2, rel=0.05)
    assert answer.trust == "trust"
