"""How far damping and stiffness change with the amplitude, where a record shows that the model leaves something out.

To the fitted model dry friction, quadratic damping and a cubic spring are added, to first order about none of them: a
regression of the residuals on the model's derivatives and on those by the added forces (a score test: C. R. Rao, Proc.
Camb. Phil. Soc. 44:50, 1948). Whichever of them lower the Bayesian information criterion, with the noise as coloured as
it is then, are taken to be there. What they make of damping and stiffness at an amplitude ``A`` is harmonic balance's
equivalent: ``c + 4 mu / (π w A) + 8 c2 w A / (3 π)`` and ``k + 3 k3 A² / 4`` (A. H. Nayfeh, D. T. Mook, Nonlinear
Oscillations, 1979, chapter 3). By their change over the amplitudes in the record another record may differ.

Coloured residuals have two readings: noise of that colour, or forces left out. The forces are chosen once by the
criterion with noise as coloured as is left, and once, where the residuals are coloured, with white noise, which lays
all of the colour on the forces. The first are said to be missing, the second to be suspected; the change is the larger.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations
from typing import ClassVar

import numpy as np

from bench.contract.problem import InitialState
from bench.dynamics.simulate import measurements
from bench.likelihood.autoregression import autoregression, even_times
from bench.records.colour import information_criterion
from bench.records.linearised import Linearised
from bench.systems import Parameter, Quantity, System

SHAPED = {"l", "k3s"}
"""Parameters of a spring that is no straight line already."""
SMALL = 1e-3
"""Size of an added force, over the spring's, in the differences that give its derivative."""
TURNS = 0.05
"""Speed at which the sign of dry friction turns, over the largest speed."""
MOST_SAMPLES = 1000
"""Samples that a longer record is thinned to: the derivatives by the forces are simulated step by step."""
LARGEST = 3.0
"""Of a change of a logarithm."""
STRONG = 6.0
"""Least gain in the criterion that counts (R. E. Kass, A. E. Raftery, J. Am. Stat. Assoc. 90:773, 1995)."""


@dataclass(frozen=True)
class WithForces(System):
    """A system of one DOF and, beside it, ``mu tanh(x'/v_s) + c2 |x'| x' + k3 x³``.

    The sizes stand among the values of the parameters, may have any sign and be many; they are no parameters.
    """

    system: System
    smoothing_velocity: float
    name: ClassVar[str] = "with_forces"
    smooth: ClassVar[bool] = False

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return self.system.parameters

    @property
    def n_hidden(self) -> int:
        return self.system.n_hidden

    @property
    def groups(self) -> tuple[Quantity, ...]:
        return self.system.groups

    def residual(self, p, x, v, a, f, z, ops):  # type: ignore[no-untyped-def]
        own = self.system.residual(p, x, v, a, f, z, ops)
        friction = p["mu+"] * ops.tanh(v[0] / self.smoothing_velocity) + p["c2+"] * ops.abs(v[0]) * v[0]
        return [own[0] + friction + p["k3+"] * x[0] * x[0] * x[0]]

    def hidden_rates(self, p, x, v, f, z, ops):  # type: ignore[no-untyped-def]
        return self.system.hidden_rates(p, x, v, f, z, ops)


@dataclass(frozen=True)
class ModelError:
    """What the model leaves out: names of the forces, and by how much log c and log k change over the record's range.

    ``missing``: what lowers the information criterion, by ``gain``; ``suspected``: what would if the noise were white.
    """

    missing: tuple[str, ...] = ()
    suspected: tuple[str, ...] = ()
    damping: float = 0.0
    stiffness: float = 0.0
    gain: float = 0.0

    def change(self, quantity: Quantity) -> float:
        """The change of a quantity's logarithm."""
        powers = quantity.exponents
        return powers.get("c", 0.0) * self.damping + powers.get("k", 0.0) * self.stiffness


Criterion = Callable[[np.ndarray, int], float]
"""Of residuals, and how many derivatives they were regressed on."""
NOTHING_LACKING = ModelError()
NAMES = {"mu": "dry friction", "c2": "quadratic damping", "k3": "a cubic spring"}


def model_error(at: Linearised) -> ModelError:
    """What the residuals of a fit of one record and one DOF show that its model leaves out."""
    model = at.model
    record = model.problem.records[0]
    names = set(model.system.names)
    if len(model.problem.records) > 1 or model.system.n_dof > 1 or not {"c", "k"} <= names:
        return NOTHING_LACKING
    channel = record.channels[0]
    if len(record.channels) > 1 or channel.measures != "displacement" or not even_times(channel.times):
        return NOTHING_LACKING
    at = _thinned(at)
    p = {name: float(value) for name, value in model.parameters(at.theta).items()}
    rate = np.sqrt(p["k"] / p["m"])
    amplitudes = _amplitudes(at, rate)
    own = [name for name in NAMES if name not in names and not (name == "k3" and names & SHAPED)]
    columns = _columns(at, p, rate, float(amplitudes[0]), own)
    coloured = autoregression(at.residuals, min(at.slopes.shape[1], at.residuals.size - 1)).order > 0
    missing = _chosen(at, columns, information_criterion)
    suspected = _chosen(at, columns, _white_criterion) if coloured else NONE
    changes = [_changes(p, one.logs, one.sizes, rate, amplitudes) for one in (missing, suspected)]
    damping, stiffness = np.max(changes, axis=0)
    named, likely = (tuple(NAMES[name] for name in one.sizes) for one in (missing, suspected))
    return ModelError(named, likely, float(damping), float(stiffness), missing.gain)


def _thinned(at: Linearised) -> Linearised:
    """Return the likelihood of every so many samples of one record with one channel."""
    kept = slice(None, None, -(-at.residuals.size // MOST_SAMPLES))
    record = at.model.problem.records[0]
    channel = replace(record.channels[0], times=record.channels[0].times[kept], values=record.channels[0].values[kept])
    problem = replace(at.model.problem, records=(replace(record, channels=(channel,)),))
    return Linearised(replace(at.model, problem=problem), at.theta, at.residuals[kept], at.slopes[kept])


@dataclass(frozen=True)
class Chosen:
    """Forces that lower a criterion: their ``sizes``, what they change of the parameters' ``logs``, and by how much."""

    sizes: dict[str, float]
    logs: dict[str, float]
    gain: float


NONE = Chosen({}, {}, 0.0)


def _chosen(at: Linearised, columns: dict[str, np.ndarray], criterion: Criterion) -> Chosen:
    """The added forces that lower a criterion most; none unless by as much as counts."""
    best, first = NONE, criterion(at.residuals, at.theta.size)
    for n in range(1, len(columns) + 1):
        for some in combinations(columns, n):
            rows = np.column_stack([at.slopes, *(columns[name] for name in some)])
            left, solution = _regressed(rows, at.residuals)
            gain = first - criterion(left, rows.shape[1])
            if gain > best.gain:
                sizes = dict(zip(some, map(float, solution[at.theta.size :]), strict=True))
                logs = dict(zip(at.model.free, map(float, solution), strict=False))
                best = Chosen(sizes, logs, gain)
    return best if best.gain >= STRONG else NONE


def _amplitudes(at: Linearised, rate: float) -> np.ndarray:
    """Largest and smallest amplitude of the cycles of the fitted motion, where they can be told: (2,)."""
    channel = at.model.problem.records[0].channels[0]
    fitted = at.model.data - at.residuals
    fitted = fitted - float(np.mean(at.model.offsets(at.theta)))
    if channel.n > 3:  # by displacement and velocity, so that few samples a cycle tell the amplitude too
        fitted = np.hypot(fitted, np.gradient(fitted, channel.times) / rate)
    cycles = np.floor((channel.times - channel.times[0]) * rate / (2 * np.pi)).astype(int)
    whole = [i for i in range(int(cycles[-1]) + 1) if np.count_nonzero(cycles == i) >= 4]
    sizes = [float(np.max(np.abs(fitted[cycles == i]))) for i in whole[: max(len(whole) - 1, 1)]]
    largest = max(sizes, default=float(np.max(np.abs(fitted))))
    return np.array([largest, max(min(sizes, default=largest), 1e-3 * largest)])


def _columns(at: Linearised, p: dict[str, float], rate: float, size: float, own: list[str]) -> dict[str, np.ndarray]:
    """Derivatives (N,) of the prediction by each added force."""
    model, record = at.model, at.model.problem.records[0]
    spring, speed = p["k"] * size, rate * size
    steps = {"mu": SMALL * spring, "c2": SMALL * spring / speed**2, "k3": SMALL * spring / size**3}
    sets = {name: np.full(2 * len(own), value) for name, value in p.items()} | {
        f"{n}+": np.zeros(2 * len(own)) for n in NAMES
    }
    for i, name in enumerate(own):
        sets[f"{name}+"][2 * i : 2 * i + 2] = steps[name], -steps[name]
    start = model.starts(at.theta)[0]
    state = (start.displacement, start.velocity) if isinstance(start, InitialState) else start
    many = [np.repeat(np.asarray(part)[:, None], 2 * len(own), axis=1) for part in state]
    system = WithForces(model.system, TURNS * speed)
    with np.errstate(all="ignore"):
        ends = measurements(system, sets, (many[0], many[1]), record)
    columns = {name: (ends[2 * i] - ends[2 * i + 1]) / (2 * steps[name]) for i, name in enumerate(own)}
    return {name: column for name, column in columns.items() if np.all(np.isfinite(column))}


def _regressed(rows: np.ndarray, residuals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    sizes = np.linalg.norm(rows, axis=0)
    sizes[sizes == 0] = 1.0
    solution = np.linalg.lstsq(rows / sizes, residuals, rcond=1e-10)[0] / sizes
    return residuals - rows @ solution, solution


def _white_criterion(residuals: np.ndarray, unknowns: int) -> float:
    return residuals.size * float(np.log(residuals @ residuals)) + unknowns * float(np.log(residuals.size))


def _changes(
    p: dict[str, float], logs: dict[str, float], sizes: dict[str, float], rate: float, amplitudes: np.ndarray
) -> tuple[float, float]:
    """Changes of log c and log k between the largest and the smallest amplitude."""
    c, k = (p[name] * max(1.0 + logs.get(name, 0.0), 0.0) for name in ("c", "k"))
    speed = rate * amplitudes
    damping = c + 4 * sizes.get("mu", 0.0) / (np.pi * speed) + 8 * sizes.get("c2", 0.0) * speed / (3 * np.pi)
    stiffness = k + 0.75 * sizes.get("k3", 0.0) * amplitudes**2
    return _log_change(damping, p["c"]), _log_change(stiffness, p["k"])


def _log_change(values: np.ndarray, typical: float) -> float:
    least = float(np.exp(-LARGEST)) * typical
    low, high = (max(float(value), least) for value in values)
    return float(np.clip(abs(np.log(high / low)), 0.0, LARGEST))
