"""Equation of motion with the terms of all model classes, fitted to a record for all classes at once.

``x'' = f/m - (c/m) x' - (k/m) x - (k/m) l sin(x/l) - (k3/m) x³ - (c2/m) |x'| x' - (mu/m) sgn(x') - b/m``: a class is
a set of free coefficients, and the others are zero. All classes are simulated together, with derivatives, by one
compiled function. Units are such that the dominant angular frequency and half of the range of the record are 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.contract.distribution import standard_quantile
from bench.contract.problem import Channel, Record
from bench.likelihood.autoregression import MOST_ORDER, SAMPLES_PER_ORDER, Autoregression, autoregression
from bench.likelihood.least_squares import SETTLED, Linearisation, covariances, minimise
from bench.records.dominant_frequency import dominant_frequency
from bench.records.law_simulation import STEP, STILL, simulator

COEFFICIENTS = ("1/m", "c", "k", "pendulum", "k3", "c2", "mu", "b", "1/l")
"""Coefficients divided by the mass (except the first and the last), in the order of the unknowns."""
FIRST = np.array([0.5, 0.04, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0])
"""Initial guess of the free coefficients."""
FURTHER = np.array([False, False, False, False, False, True, True, False, False])
"""Coefficients that are freed after the others have been fitted, as friction is not smooth before there is a motion."""
LITTLE = 1e-3
"""Initial guess of these coefficients."""
POSITIVE = np.array([False, True, False, False, False, True, True, False, False])
"""Damping coefficients, which are removed from a class if their estimate is negative."""
LEAST_STEPS = 3000
"""Least number of steps of a forced record, which may have no dominant frequency."""
MOST_CYCLES = 40.0
"""Cycles that are fitted; of a longer record in three windows at its start, middle and end."""
SAMPLES_PER_CYCLE = 24.0
"""Samples per cycle; denser samples are averaged, which reduces the amplitude of a sine by 0.3 %."""
DIED_OUT = 0.05
"""A free record is cut where its amplitude falls below this fraction of the largest, as smoothed friction cannot
stick."""
FIRST_CYCLES, GROWTH = 1.5, 2.5
"""Length of the first fit, and growth of the length: on a whole record, errors of the phase cause many local minima."""
ITERATIONS, LAST_ITERATIONS, COLOURED_ITERATIONS = 8, 15, 4
TOLERANCE = 1e-4
"""A search ends when a step would lower the sum of squares by less than this fraction of the initial mean square."""
NOISE_FLOOR = 1e-4
"""Least ratio of noise to signal, due to integration and rounding."""
ONE_SIDED = float(standard_quantile(0.95, None))

UNIT = {"c": (1, 0), "k": (2, 0), "pendulum": (2, 0), "k3": (2, -2), "c2": (0, -1), "mu": (2, 1), "b": (2, 1)}
"""Powers of the units of rate and size in a coefficient divided by the mass."""
ORDER = {"displacement": 0, "velocity": 1, "acceleration": 2}
Searched = tuple[np.ndarray, np.ndarray]
Noises = Sequence[Sequence[Autoregression]]
"""Noise model of each class and row."""


@dataclass(frozen=True, eq=False)
class Excerpt:
    """Samples of a record that are fitted: R rows, each a channel in a window, of N samples and J integration steps.

    Attributes:
        values: Samples, shape (R, N).
        weight: 1 for samples and 0 for padding, shape (R, N).
        places: Times of the samples from the start of the window, shape (R, N).
        force: Force at the samples, shape (R, N).
        push: Mean force during each step, shape (R, J).
        order: Derivative of the displacement that a row measures, shape (R,).
        window: Number of the window of a row, shape (R,).
        channel: Number of the channel of a row, shape (R,).
        offsets: Channels with an unknown offset.
        rate: Unit of angular frequency (rad/s).
        strongest: Dominant angular frequency in this unit.
        size: Unit of displacement.
        force_size: Unit of force.
    """

    values: np.ndarray
    weight: np.ndarray
    places: np.ndarray
    force: np.ndarray
    push: np.ndarray
    order: np.ndarray
    window: np.ndarray
    channel: np.ndarray
    offsets: tuple[int, ...]
    rate: float
    strongest: float
    size: float
    force_size: float

    @property
    def still(self) -> float:
        """Speed amplitude for smoothing friction; ``STILL`` in free records, which use the current amplitude."""
        return self.strongest / np.sqrt(2.0) if np.any(self.push) else STILL


def excerpt(record: Record) -> Excerpt:
    """Cut the fitted samples out of a record; array sizes are rounded up so that compiled functions are reused."""
    first = record.channels[0]
    strongest = rate = 2 * np.pi * dominant_frequency(first.times, first.values)
    if record.forces:
        rate = max(rate, LEAST_STEPS * STEP / record.duration)
    size = (float(np.ptp(first.values)) / 2.0 or 1.0) / strongest ** ORDER[first.measures]
    force_size = max((float(np.std(f.values)) for f in record.forces), default=0.0) or 1.0

    def forced(times: np.ndarray) -> np.ndarray:
        return np.asarray(record.force(times.ravel(), 1)[0].reshape(times.shape) / force_size)

    windows = _windows(record, strongest)
    rows = [
        (w, low, i, ORDER[channel.measures], *_averaged(channel, low, high, rate))
        for w, (low, high) in enumerate(windows)
        for i, channel in enumerate(record.channels)
    ]
    rows = [row for row in rows if row[4].size > 2]
    n, steps = _rounded(max(row[4].size for row in rows), 512), _rounded(rate * np.ptp(windows[0]) / STEP + 2, 2048)
    values, weight, places, force = np.zeros((4, len(rows), n))
    push = np.zeros((len(rows), steps))
    for r, (_, low, _, order, times, means) in enumerate(rows):
        used = times.size
        values[r, :used], weight[r, :used] = means / (size * rate**order), 1.0
        places[r, :used] = rate * (times - low)
        if record.forces:
            force[r, :used] = forced(times)
            nodes = (np.arange(steps)[:, None] + np.array([0.125, 0.375, 0.625, 0.875])) * STEP / rate
            push[r] = np.mean(forced(low + nodes), axis=1)
    window, _, channel, kind = (np.array(column) for column in list(zip(*rows, strict=True))[:4])
    offsets = tuple(i for i, c in enumerate(record.channels) if c.offset)
    units = rate, strongest / rate, size, force_size
    return Excerpt(values, weight, places, force, push, kind, window, channel, offsets, *units)


def _rounded(size: float, least: int) -> int:
    return max(least, 1 << int(np.ceil(np.log2(size))))


def _windows(record: Record, rate: float) -> list[tuple[float, float]]:
    """Return start and end (s) of the fitted windows; a free motion is cut where it has died out."""
    period, first = 2 * np.pi / rate, record.channels[0]
    end = record.duration
    if not record.forces:
        cycle = ((first.times - first.times[0]) / period).astype(int)
        spread = np.array(
            [np.std(first.values[cycle == i]) if np.any(cycle == i) else 0.0 for i in range(cycle[-1] + 1)]
        )
        alive = int(np.flatnonzero(spread >= DIED_OUT * np.max(spread))[-1]) + 1
        end = min(end, float(first.times[0]) + max(alive, 3) * period)
    longest = MOST_CYCLES * period
    if end <= longest:
        return [(0.0, min(end, longest))]
    return [(low, low + longest / 3.0) for low in np.linspace(0.0, end - longest / 3.0, 3)]


def _averaged(channel: Channel, low: float, high: float, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Average the samples of a channel within a window in blocks; return times and means."""
    inside = (channel.times >= low) & (channel.times <= high * (1.0 + 1e-12))
    times, values = channel.times[inside], channel.values[inside]
    per_cycle = (times.size - 1) / max(float(np.ptp(times)), 1e-300) * 2 * np.pi / rate
    by = max(int(per_cycle / SAMPLES_PER_CYCLE), 1)
    whole = times.size // by * by
    return times[:whole].reshape(-1, by).mean(axis=1), values[:whole].reshape(-1, by).mean(axis=1)


@dataclass(frozen=True, eq=False)
class ClassFits:
    """Fits of C classes to a record, in units of the excerpt.

    Attributes:
        excerpt: The fitted samples.
        free: Mask of the coefficients that remain in each class, shape (C, 9).
        coefficients: Estimates, shape (C, 9).
        starts: Displacement and velocity at time 0, shape (C, 2).
        residuals: Residuals over the standard deviation of the samples, shape (C, n).
        log_likelihoods: Log-likelihoods of the samples with coloured noise, without the first ones; shape (C, n').
        unknowns: Number of estimated parameters including those of the noise, shape (C,).
        independent: Effective number of independent samples, shape (C,).
        limits: One-sided 95 % limit of each damping coefficient, infinite if not determined; shape (C, 9).
    """

    excerpt: Excerpt
    free: np.ndarray
    coefficients: np.ndarray
    starts: np.ndarray
    residuals: np.ndarray
    log_likelihoods: np.ndarray
    unknowns: np.ndarray
    independent: np.ndarray
    limits: np.ndarray

    def in_si(self, coefficients: np.ndarray) -> dict[str, float]:
        """Convert coefficients (9,) to SI units, divided by the mass; return also mass ``m`` and length ``l``."""
        e, by_name = self.excerpt, dict(zip(COEFFICIENTS, coefficients.tolist(), strict=True))
        values = {name: by_name[name] * e.rate**rate * e.size**size for name, (rate, size) in UNIT.items()}
        mass = e.force_size / (e.size * e.rate**2 * by_name["1/m"]) if by_name["1/m"] else 1.0
        return {**values, "m": mass, "l": e.size / by_name["1/l"]}

    def limits_in_si(self, case: int) -> dict[str, float]:
        """Return the limits of the damping coefficients of a class in SI units, divided by the mass."""
        values = self.in_si(np.where(POSITIVE, self.limits[case], 1.0))
        return {name: values[name] for name, positive in zip(COEFFICIENTS, POSITIVE, strict=True) if positive}


class LawFitter:
    """Least-squares fit of several classes at once.

    Args:
        excerpt: The samples.
        free: Mask of the coefficients of each class, shape (C, 9).
        turn: Value of 1/l in the excerpt's units, or its initial guess.
    """

    def __init__(self, excerpt: Excerpt, free: np.ndarray, turn: float) -> None:
        self.excerpt, self.free, self.turn = excerpt, free.copy(), turn
        self.law, self.states = len(COEFFICIENTS), 2 * (int(np.max(excerpt.window)) + 1)
        self.size = self.law + self.states + len(excerpt.offsets)
        self.whole = float(np.max(excerpt.places * excerpt.weight))
        self.counts = np.sum(excerpt.weight, axis=1).astype(int)

    @property
    def open(self) -> np.ndarray:
        """Mask of the unknowns of each class (C, size): coefficients, initial states of the windows, offsets."""
        pulled = self.free[:, 2] | self.free[:, 3] | self.free[:, 4]
        states = np.ones((len(self.free), self.states), bool)
        offsets = np.repeat(pulled[:, None], len(self.excerpt.offsets), axis=1)
        return np.concatenate([self.free, states, offsets], axis=1)

    def evaluate(self, theta: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
        """Simulate all classes.

        Args:
            theta: Unknowns, shape (C, size).
            length: Time from the start of each window up to which motions are simulated.

        Returns:
            Residuals (predicted minus measured), shape (C, R, N), and derivatives, shape (C, R, N, size).
        """
        e, law = self.excerpt, self.law
        places = law + 2 * e.window[:, None] + np.arange(2)  # of each row's initial state
        q = np.concatenate([np.repeat(theta[:, None, :law], len(places), axis=1), theta[:, places]], axis=2)
        steps = min(int(length / STEP) + 2, e.push.shape[1])
        predicted, by_q = simulator()(q, steps, e.push, e.places, e.force, e.order, e.still)
        left, by_q = np.asarray(predicted) - e.values, np.asarray(by_q)
        slopes = np.zeros((*left.shape, self.size))
        slopes[..., :law] = by_q[..., :law]
        for row, place in enumerate(places):
            slopes[:, row, :, place[0] : place[1] + 1] = by_q[:, row, :, law:]
        for column, channel in enumerate(e.offsets, start=law + self.states):
            slopes[:, e.channel == channel, :, column] = 1.0
            left += theta[:, column, None, None] * slopes[..., column]
        return left, slopes

    def search(self, theta: np.ndarray, iterations: int, weight: np.ndarray, noises: Noises | None = None) -> Searched:
        """Minimise the weighted sum of squares of all classes.

        Args:
            theta: Initial guess, shape (C, size).
            iterations: Largest number of iterations.
            weight: Weights of the samples, shape (R, N).
            noises: Noise models by which residuals are whitened; without them the noise is white.

        Returns:
            The unknowns (C, size) and the sums of squares (C,).
        """
        trial, free, scale = theta.copy(), self.open, np.ones(len(theta))
        length = float(np.max(self.excerpt.places * (weight > 0)))

        def evaluate(cases: np.ndarray, unknowns: np.ndarray) -> Linearisation:
            trial[cases] = unknowns
            with np.errstate(all="ignore"):
                left, slopes = self.evaluate(trial, length)
            left, slopes = left * weight, slopes * (weight[..., None] * free[:, None, None, :])
            if noises is not None:
                left, slopes = self.whitened(noises, left, slopes)
            left, slopes, n = left[cases], slopes[cases], cases.size
            left, slopes = left.reshape(n, -1) * scale[cases, None], slopes.reshape(n, -1, self.size)
            return Linearisation.of(unknowns, left, slopes * scale[cases, None, None])

        start = evaluate(np.arange(len(theta)), theta)
        cost = np.where(np.isfinite(start.cost) & (start.cost > 0), start.cost, 1.0)
        scale = np.sqrt(SETTLED / TOLERANCE * np.sum(weight > 0) / cost)
        start = Linearisation.of(theta, start.residuals * scale[:, None], start.slopes * scale[:, None, None])
        reached = minimise(evaluate, start, iterations).point
        return reached.unknowns, reached.cost / scale**2

    def whitened(self, noises: Noises, left: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Whiten residuals (C, R, N) and derivatives (C, R, N, size) of each class by its noise models."""
        white, turned = np.zeros_like(left), np.zeros_like(slopes)
        for case, noises_of_case in enumerate(noises):
            for row, (noise, n) in enumerate(zip(noises_of_case, self.counts, strict=True)):
                white[case, row, :n] = noise.whiten(left[case, row, :n])
                turned[case, row, :n] = noise.whiten(slopes[case, row, :n].T).T
        return white, turned

    def fitted(self) -> ClassFits:
        """Fit the classes: on growing windows without ``FURTHER`` damping, then with it, then with coloured noise."""
        e, wanted = self.excerpt, self.free.copy()
        theta = np.zeros((len(wanted), self.size))
        theta[:, : self.law] = np.where(wanted, FIRST, 0.0)
        theta[:, 2:4] *= e.strongest**2
        theta[:, self.law - 1] = self.turn
        self.free = wanted & ~FURTHER
        length = 2 * np.pi * FIRST_CYCLES / e.strongest
        while length < self.whole:
            theta, _ = self.search(theta, ITERATIONS, e.weight * (e.places <= length))
            length *= GROWTH
        theta, _ = self.search(theta, LAST_ITERATIONS, e.weight)
        self.free = wanted
        theta[:, : self.law] += LITTLE * (self.free & FURTHER)
        while True:
            theta, cost = self.search(theta, LAST_ITERATIONS, e.weight)
            for case in range(len(theta)):  # a class must fit no worse than a class nested in it
                inside = [i for i in range(len(theta)) if np.all(self.free[i] <= self.free[case])]
                theta[case] = theta[min(inside, key=lambda i: cost[i])]
            negative = (theta[:, : self.law] < 0) & self.free & POSITIVE
            if not np.any(negative):
                return self.coloured(theta)
            self.free = self.free & ~negative
            theta[:, : self.law] = np.where(negative, 0.0, theta[:, : self.law])

    def coloured(self, theta: np.ndarray) -> ClassFits:
        """Repeat the fit from ``theta`` with noise coloured as the residuals of each class."""
        weight = self.excerpt.weight
        noises = self.noises(self.evaluate(theta, self.whole)[0])
        theta, _ = self.search(theta, COLOURED_ITERATIONS, weight, noises)
        theta[:, : self.law] = np.where(POSITIVE, np.maximum(theta[:, : self.law], 0.0), theta[:, : self.law])
        left, slopes = self.evaluate(theta, self.whole)
        noises = self.noises(left)
        logs, independent = [], []
        for residuals, row in zip(left, noises, strict=True):
            each = list(zip(row, residuals, self.counts, strict=True))
            logs.append(np.concatenate([_log_likelihoods(noise, r[:n], self._floor) for noise, r, n in each]))
            independent.append(sum(_independent(noise, n) for noise, _, n in each))
        return ClassFits(
            self.excerpt,
            self.free,
            theta[:, : self.law],
            theta[:, self.law : self.law + 2],
            np.nan_to_num(left[:, weight > 0], nan=np.inf) / self._signal,
            np.array(logs),
            self.open.sum(axis=1) + np.array([sum(noise.order for noise in row) for row in noises]),
            np.array(independent),
            self._limits(theta, noises, left, slopes),
        )

    def noises(self, left: np.ndarray) -> Noises:
        """Estimate the noise model of each class and row from its residuals."""
        left = np.nan_to_num(left, nan=1e6, posinf=1e6, neginf=-1e6)
        used = self.open.sum(axis=1) / len(self.counts)
        floor = Autoregression(np.zeros(0), self._floor**2)
        noises = [
            [autoregression(r[:n], min(spent, n - 1)) for r, n in zip(residuals, self.counts, strict=True)]
            for residuals, spent in zip(left, used, strict=True)
        ]
        return [[noise if noise.variance > floor.variance else floor for noise in row] for row in noises]

    @property
    def _signal(self) -> float:
        return float(np.std(self.excerpt.values[self.excerpt.weight > 0])) or 1.0

    @property
    def _floor(self) -> float:
        return NOISE_FLOOR * self._signal

    def _limits(self, theta: np.ndarray, noises: Noises, left: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """Return upper limits (C, 9) of the damping coefficients, each freed alone: estimate or 0, plus 1.645 sd."""
        white, turned = self.whitened(noises, left, slopes)
        limits, used = np.full((len(theta), self.law), np.inf), self.open
        for case in range(len(theta)):
            for i in np.flatnonzero(POSITIVE):
                columns = used[case].copy()
                columns[i] = True
                jacobian = turned[case].reshape(-1, self.size)[:, columns]
                inverse = covariances(jacobian[None])[0] if np.all(np.isfinite(jacobian)) else None
                if inverse is not None:
                    j = int(np.sum(columns[:i]))
                    step = -float(inverse[j] @ (jacobian.T @ white[case].ravel()))
                    limits[case, i] = max(theta[case, i] + step, 0.0) + ONE_SIDED * float(np.sqrt(inverse[j, j]))
        return limits


def _log_likelihoods(noise: Autoregression, residuals: np.ndarray, floor: float) -> np.ndarray:
    """Compute the log-likelihoods of the samples.

    The first samples are dropped, the same number for every order. The noise is at least ``floor``.
    """
    errors = noise.whiten(residuals)[min(MOST_ORDER, residuals.size // SAMPLES_PER_ORDER) :]
    scale = max(float(np.mean(errors**2)), floor**2 / noise.variance)
    return np.asarray(-0.5 * (np.log(2 * np.pi * scale * noise.variance) + errors**2 / scale))


def _independent(noise: Autoregression, n: int) -> float:
    """Return the number of independent samples that give the same variance: ``n c_0² / sum c_k²`` (Bartlett, 1946)."""
    covariances = noise.autocovariance(n)
    return float(n * covariances[0] ** 2 / (covariances[0] ** 2 + 2.0 * np.sum(covariances[1:] ** 2)))
