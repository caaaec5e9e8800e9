"""Coverage and width of the interval for this record on simulated records.

The narrowest calibrated interval is the narrower of two: that assuming white noise and the stated one, each multiplied
by a factor for all records of a kind at which its coverage is 95 %.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Annotated

import numpy as np
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

from bench.commands.declaration import OneOf, Within
from bench.config.overrides import overrides_of
from bench.contract.estimate import Cost
from bench.likelihood.compiled_model import compiled_output_error
from bench.likelihood.output_error import estimate_at
from bench.records.intervals import StatedInterval, stated_intervals
from bench.records.linearised_fit import at_theta, linearise
from bench.records.problem import read_measured
from bench.records.reading import of_arrays
from bench.records.request import request_of
from bench.reporting.tables.render import markdown_table
from bench.scoring.statistics import wilson_interval
from tests.studies.common import Count, study, tracked

QUANTITIES = ("k_over_m", "c_over_m")
Noise = Callable[[np.random.Generator, int], np.ndarray]


def white(rng: np.random.Generator, n: int) -> np.ndarray:
    return rng.standard_normal(n)


def autoregressive(rho: float, rng: np.random.Generator, n: int) -> np.ndarray:
    """Draw a first-order autoregression of unit variance."""
    innovations = rng.standard_normal(n) * np.sqrt(1 - rho**2)
    innovations[0] = rng.standard_normal()
    return np.asarray(lfilter([1.0], [1.0, -rho], innovations))


def drift(rng: np.random.Generator, n: int) -> np.ndarray:
    """Draw white noise with a linear drift to three times its standard deviation on either side."""
    return rng.standard_normal(n) + 3.0 * rng.choice([-1, 1]) * np.linspace(-1.0, 1.0, n)


KINDS: dict[str, tuple[Noise, tuple[float, float], bool]] = {
    "white_5": (white, (5.0, 5.0), False),
    "white_20": (white, (20.0, 20.0), False),
    "ar_0.8": (partial(autoregressive, 0.8), (20.0, 20.0), False),
    "ar_0.95": (partial(autoregressive, 0.95), (20.0, 20.0), False),
    "drift": (drift, (20.0, 20.0), False),
    "friction": (white, (20.0, 40.0), True),
}
"""Noise, range of the signal-to-noise ratio (dB), and whether record and model have dry friction."""


def intervals_of(kind: str, rng: np.random.Generator) -> tuple[dict[str, StatedInterval], dict[str, float]] | None:
    """Draw a record of 1 Hz; return its intervals and the true values, None if it is split or the fit fails."""
    noise, decibels, friction = KINDS[kind]
    rate, ratio = 2 * np.pi, float(np.exp(rng.uniform(np.log(0.005), np.log(0.05))))
    cycles = rng.uniform(6.0, 6.0 + 0.5 / ratio)
    t = np.arange(0.0, cycles, 1.0 / rng.uniform(8.0, 40.0))
    truth = {"m": 1.0, "c": 2 * ratio * rate, "k": rate**2}
    if friction:
        truth["mu"] = rate**2 / (4.0 * cycles * rng.uniform(1.2, 3.0))
    x = motion(t, truth, rng.uniform(0.0, 2 * np.pi))
    size = float(np.std(x)) * 10 ** (-rng.uniform(*decibels) / 20.0)
    x = x + size * noise(rng, t.size)
    request = request_of(overrides_of({"method": "output_error", "data": "arrays"}))
    if friction:
        request = replace(request, system="sdof+coulomb")
    problem = read_measured(request, (of_arrays(t, x),)).problem
    if len(problem.records) > 1:
        return None
    model = compiled_output_error(problem)
    theta = model.settle(model.vector(truth)[None])[0]
    fit = at_theta(model, theta)
    if fit is None or fit.white is None:
        return None
    estimate = estimate_at(model, theta, fit.white, fit.used, Cost())
    intervals = stated_intervals(estimate, linearise(problem, estimate))
    return intervals, {"k_over_m": truth["k"], "c_over_m": truth["c"]}


def motion(t: np.ndarray, p: dict[str, float], phase: float) -> np.ndarray:
    """Return the displacement (n,) of a free decay from unit amplitude, in closed form or by integration."""
    s, rate = p["c"] / 2.0, np.sqrt(p["k"])
    start = np.array([np.cos(phase), -rate * np.sin(phase)])
    if "mu" not in p:
        damped = np.sqrt(p["k"] - s**2)
        return np.asarray(
            np.exp(-s * t) * (start[0] * np.cos(damped * t) + (start[1] + s * start[0]) / damped * np.sin(damped * t))
        )

    def rates(_: float, y: np.ndarray) -> list[float]:
        return [y[1], -p["k"] * y[0] - p["c"] * y[1] - p["mu"] * float(np.tanh(y[1] / 1e-4))]

    return np.asarray(solve_ivp(rates, (0.0, t[-1]), start, "LSODA", t, rtol=1e-7, atol=1e-9).y[0])


def row(kind: str, name: str, drawn: list[tuple[dict[str, StatedInterval], dict[str, float]]]) -> list[str]:
    """Summarise the intervals of one quantity."""
    stated = [(intervals[name], truth[name]) for intervals, truth in drawn]
    covered = [i.record_low <= true <= i.record_high for i, true in stated]
    covered_white = [i.white_low <= true <= i.white_high for i, true in stated]
    finite = [(i, true) for i, true in stated if i.record_low > 0 and not i.limit]
    errors = np.array([abs(np.log(true / i.value)) for i, true in finite])
    halves = np.array([np.log(i.record_high / i.record_low) / 2.0 for i, _ in finite])
    of_white = np.array([(i.white_high - i.white_low) / 2.0 / i.value for i, _ in finite])
    narrowest = min(float(np.quantile(errors / half, 0.95) * np.median(half)) for half in (halves, of_white))
    low, high = wilson_interval(sum(covered), len(covered))
    return [
        kind, name.replace("_over_", "/"), str(len(stated)), str(len(stated) - len(finite)),
        f"{100 * np.mean(covered):.0f} [{100 * low:.0f}, {100 * high:.0f}]", f"{100 * np.mean(covered_white):.0f}",
        f"{100 * np.median(halves):.2g}", f"{np.median(halves) / narrowest:.2f}",
    ]  # fmt: skip


COLUMNS = (
    "record", "quantity", "records", "limits only", "coverage (%)", "coverage assuming white noise (%)",
    "median half-width (%)", "over the narrowest calibrated",
)  # fmt: skip


def record_intervals(
    records: Annotated[Count, "records of each kind"] = 150,
    kinds: Annotated[tuple[str, ...], OneOf(tuple(KINDS)), "kinds of records"] = tuple(KINDS),
    seed: Annotated[int, Within(ge=0), "seed of all records"] = 1,
) -> int:
    """Measure coverage and width of the interval for this record on simulated free decays."""
    rows = []
    for kind in kinds:
        rngs = [np.random.default_rng([seed, *kind.encode(), i]) for i in range(records)]
        drawn = [result for rng in tracked(rngs, "record") if (result := intervals_of(kind, rng)) is not None]
        rows += [row(kind, name, drawn) for name in QUANTITIES]
    print(markdown_table(rows, COLUMNS))
    return 0


main = partial(study, record_intervals, "tests.studies.record_intervals")

if __name__ == "__main__":
    sys.exit(main())
