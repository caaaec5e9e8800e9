"""The floor of a row: its unavoidable arithmetic at the rates of this machine, which are measured in the same run."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.entrants.registry import default_settings
from tests.studies.engines.rows import Row

ELEMENTS, ORDER, TURNS = 4_000, 512, 7
TURN_S = 0.1
"""The least length of a turn, of processor time: some clocks move in steps of 10 ms."""
FORMULAS = {
    "elementary": "evaluated responses × samples × time of exp + cos + sin of an element",
    "pencil": "records (the measured and the bootstrap's) × rows × columns² × 2 of their data matrix / rate of dgemm",
    "bound": "times × time of exp + cos + sin of an element, since all derivatives share them",
    "normal": "steps × values × parameters² / rate of dgemm, which is half of the product of the derivatives with "
    "themselves",
}


@dataclass(frozen=True)
class Rates:
    """Processor seconds of exp, cos and sin together of one number; floating-point operations a second of dgemm."""

    functions_s: float
    flops: float


def least(step: Callable[[], object], turns: int = TURNS, calls: int = 20) -> float:
    """The least processor time of a step (s).

    Args:
        step: What is timed.
        turns: How often.
        calls: Steps between two looks at the clock. A turn goes on until it is long enough for the clock.
    """
    seconds = []
    for _ in range(turns):
        started, done, elapsed = time.process_time(), 0, 0.0
        while elapsed < TURN_S:
            for _ in range(calls):
                step()
            done, elapsed = done + calls, time.process_time() - started
        seconds.append(elapsed / done)
    return min(seconds)


def rates() -> Rates:
    """Those of this machine, in this process: call with one thread."""
    x, a = np.linspace(0.1, 9.0, ELEMENTS), np.linspace(-1.0, 1.0, ORDER**2).reshape(ORDER, ORDER)
    functions = least(lambda: (np.exp(-x), np.cos(x), np.sin(x)), calls=200)
    return Rates(functions / ELEMENTS, 2.0 * ORDER**3 / least(lambda: a @ a))


def pencil_flops(samples: int, settings: dict[str, Any]) -> float:
    """Count those of the products of the data matrices with themselves, sized as by Hua and Sarkar (1990)."""
    length = round(settings.get("pencil", 1.0 / 3.0) * samples)
    return float(2 * (1 + settings.get("bootstrap", 0)) * (samples - length) * (length + 1) ** 2)


def floor(row: Row, evaluations: float, machine: Rates) -> float:
    """Seconds a fit, by the formula of the row's kind; nan where it has none."""
    cell = row.scenario
    if row.floor == "elementary":
        return evaluations * cell.samples * machine.functions_s
    if row.floor == "pencil":
        return pencil_flops(cell.samples, default_settings(row.method)) / machine.flops
    if row.floor == "bound":
        times = np.unique(np.concatenate([cell.times, cell.dense_times, cell.forecast_times]))
        return times.size * machine.functions_s
    if row.floor == "normal":
        values = cell.samples * len(cell.measured_dofs)
        return evaluations * values * len(cell.parameters) ** 2 / machine.flops
    return float("nan")
