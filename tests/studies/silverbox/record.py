"""The Silverbox record: its files, its official parts, its equation of motion, and the sign of its constant force.

T. Wigren, J. Schoukens, Three free data sets for development and benchmarking in nonlinear system identification,
European Control Conference 2013, pages 2933-2938. The parts are those of nonlinearbenchmark.org. Input and output are
voltages, so parameters carry their powers: m (s²), c (s), k (1), k3 (1/V²), u0 (V).
"""

from __future__ import annotations

import gzip
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from scipy.interpolate import CubicSpline

from bench import Channel, Dimension, Force, InputError, Parameter, Problem, Quantity, Record, regression_columns
from bench.contract.problem import Hold
from bench.systems import Duffing

RATE = 1e7 / 2**14
"""Sampling rate (Hz)."""
FILES = ("SNLS80mV.csv", "SNLS80mV.csv.gz")
ROWS = 131_072
MULTISINE = slice(40_650, 127_400)
TRAINING = slice(MULTISINE.start, MULTISINE.start + int(0.75 * (MULTISINE.stop - MULTISINE.start)))
TEST_MULTISINE = slice(TRAINING.stop, MULTISINE.stop)
ARROW = slice(100, 40_575)
WITHIN = 32_000
"""Samples of the arrow in which it stays within the range of the training data."""
UNSCORED = 50
"""First samples of a test part, from which its state may be estimated; the score leaves them out."""


@dataclass(frozen=True, eq=False)
class Silverbox:
    """Input and output (V), shape (ROWS,)."""

    u: np.ndarray
    y: np.ndarray

    def record(self, part: slice, hold: Hold, samples: int | None = None) -> Record:
        """A part as a record from time 0: all of its input, and its output, or the first ``samples`` of it."""
        times = np.arange(part.stop - part.start) / RATE
        channel = Channel(times[:samples], self.y[part][:samples], unit="V")
        return Record((channel,), (Force(times, self.u[part], hold),))


def read(folder: Path) -> Silverbox:
    """The record from the folder that holds ``SNLS80mV.csv``, plain or gzipped; raises InputError."""
    path = next((folder / name for name in FILES if (folder / name).is_file()), None)
    if path is None:
        raise InputError("data", folder, f"a folder that holds {' or '.join(FILES)} (nonlinearbenchmark.org)")
    try:
        with gzip.open(path, "rt") if path.suffix == ".gz" else path.open() as file:
            values = np.loadtxt(file, delimiter=",", skiprows=1, usecols=(0, 1))
    except (OSError, ValueError) as error:
        raise InputError("data", path, f"two columns of numbers are needed: {error}") from None
    if len(values) != ROWS:
        raise InputError("data", path, f"{ROWS} rows are needed, {len(values)} were found")
    return Silverbox(values[:, 0], values[:, 1])


@dataclass(frozen=True)
class ConstantForce(Duffing):
    """Duffing oscillator under a constant force too, ``m x'' + c x' + k x + k3 x³ = f(t) + sign u0``, u0 positive."""

    sign: float = 1.0
    name: ClassVar[str] = "silverbox"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (*super().parameters, Parameter("u0", "N", "other", Dimension(1, 1, -2)))

    def residual(self, p, x, v, a, f, z, ops):  # type: ignore[no-untyped-def]
        return [r - self.sign * p["u0"] for r in super().residual(p, x, v, a, f, z, ops)]

    @property
    def groups(self) -> tuple[Quantity, ...]:
        return (*super().groups, Quantity("u0_over_m", "m/s²", {"u0": 1.0, "m": -1.0}))


def signed(data: Silverbox) -> ConstantForce:
    """The system with the sign of its constant force, from the training part alone.

    That of the constant in the regression of the equation of motion on a cubic spline through the output.
    """
    times, system = np.arange(TRAINING.stop - TRAINING.start) / RATE, ConstantForce()
    curve = CubicSpline(times, data.y[TRAINING])
    x, v, a = (np.asarray(curve(times, order)) for order in range(3))
    columns, rest = regression_columns(system, [x], [v], [a], [data.u[TRAINING]])
    sizes = np.linalg.norm(columns, axis=0)
    found = np.linalg.lstsq(columns / sizes, -rest, rcond=None)[0] / sizes
    return ConstantForce(sign=float(np.sign(found[system.names.index("u0")])))


def training_problem(data: Silverbox, system: ConstantForce, hold: Hold, samples: int) -> Problem:
    """The first samples of the training part: start unknown, no prior, noise unknown."""
    part = slice(TRAINING.start, TRAINING.start + samples)
    return Problem(system, (data.record(part, hold),), name="silverbox")
