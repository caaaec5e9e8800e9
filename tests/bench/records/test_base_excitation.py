"""Base excitation, compared with scipy's simulation of the relative motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import lsim

from bench import InputError
from bench.face.identification import identify
from bench.records.base_excitation import with_base_excitation
from bench.records.reading import ReadOptions, read_recording

K, C, G = 60.0, 0.5, 9.80665


@pytest.fixture
def shaken(tmp_path: Path) -> Path:
    """Write 10 s of relative displacement, absolute acceleration and acceleration of the ground, with 2 % of noise."""
    rng, t = np.random.default_rng(11), np.arange(0.0, 10.0, 0.01)
    ground = np.interp(t, t[::8], rng.standard_normal(t[::8].size))
    _, motion, _ = lsim(([[0, 1], [-K, -C]], [[0], [-1]], [[1, 0], [-K, -C]], [[0], [0]]), ground, t)
    columns = [*motion.T, ground / G]
    noisy = [column + 0.02 * np.std(column) * rng.standard_normal(t.size) for column in columns]
    path = tmp_path / "shaken.csv"
    np.savetxt(path, np.column_stack([t, *noisy]), delimiter=",", header="time,rel,abs,ground", comments="")
    return path


@pytest.mark.parametrize(("column", "motion"), [("x:rel", "relative"), ("a:abs", "absolute")])
def test_stiffness_and_damping_over_the_mass_come_from_the_ground_and_either_motion(
    shaken: Path, column: str, motion: str
) -> None:
    units = {"t": "s", column[0]: "m" if column[0] == "x" else "m/s²", "b": "g"}
    result = identify(
        shaken,
        method="output_error",
        columns={"t": 0, column[0]: column[2:]},
        base="ground",
        motion=motion,
        units=units,
    )
    for name, true, within in (("k_over_m", K, 0.01), ("c_over_m", C, 0.1), ("m", 1.0, 0.02)):
        assert result.estimates[name].value == pytest.approx(true, rel=within)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"base": "3"}, "motion=none: base= needs motion=relative"),
        ({"base": "3", "motion": "absolute"}, "motion=absolute: absolute displacement is not supported"),
        ({"motion": "relative"}, "motion=relative: it needs base="),
    ],
)
def test_an_incomplete_base_excitation_is_rejected(shaken: Path, settings: dict[str, Any], message: str) -> None:
    units = {"t": "s", "x": "m"} | ({"b": "g"} if "base" in settings else {})
    with pytest.raises(InputError, match=message):
        identify(shaken, method="ls", columns={"t": 0, "x": 1}, units=units, **settings)


def test_another_force_in_addition_to_base_excitation_is_rejected(shaken: Path) -> None:
    recording = read_recording(shaken, ReadOptions({"t": 0, "x": 1, "b": 3}, {"t": "s", "x": "m", "b": "g"}))
    ground = recording.signals[-1]
    force = replace(ground, role="f", measures="force")
    with pytest.raises(InputError, match="base=b: base excitation is for one mass without other forces"):
        with_base_excitation(replace(recording, signals=(*recording.signals, force)), "relative")
