"""The PINN in a sliding window with a warm start from the parameters of the previous window.

This is the digital twin outlined in the paper (Karkadakattil 2026, doi:10.25082/RIMA.2026.02.002). The log-parameters
initialise the next window; the network's weights do not, since the response of another window is another function of
time. Where the residual share of a window exceeds :data:`SUSPECT` times that of the previous one, it is trained again
from a cold start, and the better estimate is kept.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar

import numpy as np
from annotated_types import Interval

from bench import (
    Estimate,
    Layout,
    OnlineCard,
    OnlineIdentifier,
    Problem,
    Status,
    Tracker,
    WindowTracker,
)
from methods.pinn import PINN
from methods.pinn.task import SUSPECT, Task


@dataclass(frozen=True)
class ContinuedPINN(PINN):
    """The PINN, optionally started from the parameters of an earlier fit."""

    def continued(self, problem: Problem, rng: np.random.Generator, values: np.ndarray) -> Estimate:
        """Estimate from the parameters ``values`` of an earlier fit, in the problem's units and the system's order."""
        units = problem.natural_units()
        scales = units.scales(problem.system)
        logs = np.log(values / np.array([scales[name] for name in problem.system.names]))
        with np.errstate(all="ignore"):
            task = Task(problem.expressed_in(units), rng)
            task.guesses, task.rivals = [replace(task.guesses[0], logs=logs, firm=True)], 1
            self.attempt([task])
            return self._estimate(task).returned(problem, units)


@dataclass(frozen=True)
class OnlinePINN(OnlineIdentifier):
    """Windows of ``length`` samples, every ``every`` samples; ``arrival``: add an arrival cost."""

    version: ClassVar[int] = 2
    length: Annotated[int, Interval(ge=20)] = 150
    every: Annotated[int, Interval(ge=1)] = 10
    arrival: bool = False
    card: ClassVar[OnlineCard] = OnlineCard(
        "PINN in a sliding window, each training started at the parameters of the one before",
        "Karkadakattil 2026, doi:10.25082/RIMA.2026.02.002",
        "as the PINN's",
        "PINN, window, warm start",
        130,
    )
    requires: ClassVar[tuple[str, ...]] = ("torch",)
    extra: ClassVar[str] = "torch"

    def objection(self, layout: Layout) -> str | None:
        """Require a known force."""
        if layout.ambient:
            return "it requires a known force, and here a force is not measured"
        return None

    def start(self, layout: Layout) -> Tracker:
        """Return a tracker before its first sample."""
        return _PINNTracker(layout, self)


class _PINNTracker(WindowTracker):
    state_names = (*WindowTracker.state_names, "end", "left")

    def __init__(self, layout: Layout, settings: OnlinePINN) -> None:
        super().__init__(layout, settings.length, settings.every, settings.arrival)
        self.method = ContinuedPINN()
        self.end, self.left = np.zeros(0), float("inf")

    def answer(self, problem: Problem) -> Estimate:
        """Estimate from the previous window's parameters, or from a scan where there are none or they fail."""
        estimates = []
        if self.end.size:
            estimates.append(self.method.continued(problem, np.random.default_rng(0), self.end))
        if not estimates or not share_left(problem, estimates[0]) <= SUSPECT * self.left:
            estimates.append(self.method.identify(problem, np.random.default_rng(0)))
        best = min(estimates, key=lambda estimate: share_left(problem, estimate))
        values = _values(best)
        if values is not None:
            self.end, self.left = values, share_left(problem, best)
        return best


def share_left(problem: Problem, estimate: Estimate) -> float:
    """Return the residual sum of squares of the displacements over theirs; infinite without a reconstruction."""
    if estimate.status is not Status.OK or not estimate.reconstructions:
        return float("inf")
    channels = [c for c in problem.records[0].channels if c.measures == "displacement"]
    off = [np.sum((c.values - estimate.reconstructions[0](c.times)[c.dof]) ** 2) for c in channels]
    return float(sum(off) / sum(np.sum(c.values**2) for c in channels)) if channels else 0.0


def _values(estimate: Estimate) -> np.ndarray | None:
    """Return the parameters in the system's order; from groups, those with a gauge mass of one unit."""
    distribution: Any = estimate.distribution
    if estimate.status is not Status.OK or distribution is None:
        return None
    values, system = distribution.values(), estimate.system
    if set(system.names) <= set(values):
        return np.array([values[name] for name in system.names])
    ratios = {system.gauge: 1.0}
    for group in system.groups:
        if group.name in values and sorted(group.exponents.values()) == [-1.0, 1.0]:
            ratios[next(name for name, power in group.exponents.items() if power == 1.0)] = values[group.name]
    if set(ratios) != set(system.names) or min(ratios.values()) <= 0:
        return None
    return np.array([ratios[name] for name in system.names])
