"""Recursive least squares on the weak form of the equation of motion, with forgetting.

**Equation.** The equation of motion of a linear system is multiplied by a modulating function over the last ``span``
samples and integrated by parts, which avoids differentiation (M. Shinbrot, Trans. ASME 79:547, 1957): the integrals of
``w x``, ``-w' x``, ``w'' x`` and ``w f`` replace displacement, velocity, acceleration and force. There is one equation
per degree of freedom every quarter of a span, so that successive equations share little noise.

**Forgetting**, per sample:

- ``exponential``: by ``factor`` (L. Ljung, System Identification, 2nd ed. 1999, section 11.2);
- ``variable``: keeps the weighted sum of squared residuals constant (T. R. Fortescue, L. S. Kershenbaum, B. E. Ydstie,
  Automatica 17:831, 1981), so little is forgotten while residuals are small;
- ``directional``: only in the direction of the new equation's regressors (R. Kulhavy, Kybernetika 23:465, 1987).

**Zero.** Each equation has an unknown constant, for the zero of the sensor. Where the zero jumps
(:mod:`bench.contract.zero`), the jump is subtracted, the variance of the constants is reset, and no equation spans it.

The remaining noise in the regressors biases stiffness downwards and damping upwards; the interval, computed from the
residuals of the equations, does not include this bias.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Interval

from bench import (
    Layout,
    Normal,
    OnlineCard,
    OnlineIdentifier,
    Sample,
    SampleStatus,
    TrackerOutput,
    regression_columns,
    remove_jumps,
)
from methods.online.least_squares import LeastSquaresTracker

Forgetting = Literal["exponential", "variable", "directional"]
DIFFUSE = 1e8
"""Prior variance, over the square of the size suggested by the first equation."""
BUMP = 4
"""Power of the modulating function ``(1 - s²)^4``, whose first three derivatives are zero at both ends."""
SIDE = 3
"""Samples by which an equation is delayed, as many as the detection of a jump takes (:mod:`bench.contract.zero`)."""
JUMPED = "the sensor's zero has jumped; the jump is subtracted"
LEAST = 0.8
"""Least forgetting factor of variable forgetting."""


@dataclass(frozen=True)
class OnlineRLS(OnlineIdentifier):
    """``span``: samples per equation; ``factor``: forgetting factor per sample (exponential and directional)."""

    forgetting: Forgetting = "exponential"
    factor: Annotated[float, Interval(gt=0.5, le=1.0)] = 0.995
    span: Annotated[int, Interval(ge=8)] = 40
    version: ClassVar[int] = 2
    """2: no equation spans a jump of a sensor's zero."""
    card: ClassVar[OnlineCard] = OnlineCard(
        "recursive least squares with forgetting, on the weak form of the equation of motion",
        "M. Shinbrot, Trans. ASME 79:547, 1957; L. Ljung, System Identification, 1999, section 11.2",
        "factor: Ljung, System Identification Toolbox user's guide (0.97 to 0.995)",
        "RLS",
        100,
    )

    def objection(self, layout: Layout) -> str | None:
        """Require the displacement of every DOF, a linear system and a known force."""
        if layout.ambient:
            return "it requires a known force, and here a force is not measured"
        if not (layout.system.linear and layout.system.affine_in_parameters):
            return "it requires a linear system whose equation of motion is affine in the parameters"
        measured = {sensor.dof for sensor in layout.sensors if sensor.measures == "displacement"}
        if measured != set(range(layout.system.n_dof)):
            return "it requires the displacement of every degree of freedom"
        return None

    def start(self, layout: Layout) -> LeastSquaresTracker:
        """Return a tracker before its first sample."""
        return _RLSTracker(layout, self)


class _RLSTracker(LeastSquaresTracker):
    state_names = (*LeastSquaresTracker.state_names, "values", "pushes", "waits", "zero")

    def __init__(self, layout: Layout, settings: OnlineRLS) -> None:
        super().__init__(layout, len(layout.free) + layout.system.n_dof)
        self.settings, self.waits, self.zero = settings, 0, np.zeros(len(layout.sensors))
        self.values, self.pushes = np.zeros((0, len(layout.sensors))), np.zeros((0, len(layout.forced)))
        s = np.linspace(-1.0, 1.0, settings.span)
        bump = np.polynomial.Polynomial([1.0, 0.0, -1.0]) ** BUMP
        half, h = 0.5 * (settings.span - 1) * layout.interval, layout.interval
        self._weights = h * np.stack([bump.deriv(i)(s) / half**i if i else bump(s) for i in range(3)])

    def step(self, sample: Sample, steps: int) -> TrackerOutput:
        """Store a sample; update by an equation every quarter of a span."""
        span = self.settings.span
        if steps > 1 or not np.all(np.isfinite(sample.values)):  # no equation spans missing samples
            self.values, self.pushes = self.values[:0], self.pushes[:0]
            if steps <= 1:
                return TrackerOutput(sample.time, SampleStatus.OK, self._distribution())
        self.values = np.concatenate([self.values, [np.subtract(sample.values, self.zero)]])[-span - SIDE :]
        self.pushes = np.concatenate([self.pushes, [sample.forces]])[-span - SIDE :]
        self.waits += 1
        if len(self.values) == span + SIDE and self.waits >= span // 4:
            self.waits = 0
            if self._remove_jump():
                return TrackerOutput(sample.time, SampleStatus.SENSOR_JUMP, self._distribution(), message=JUMPED)
            self._learn(*self._equation(self.values[:span], self.pushes[:span]))
        distribution = self._distribution()
        status = SampleStatus.OK if distribution is not None else SampleStatus.WARMING_UP
        return TrackerOutput(
            sample.time, status, distribution, message="" if distribution else "the parameters are not determined yet"
        )

    def _equation(self, values: np.ndarray, pushes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return regressors (n_dof, n_free + n_dof), the zeros last, and target (n_dof,) of the newest equations."""
        system, w = self.layout.system, self._weights
        by_dof = {sensor.dof: column for sensor, column in zip(self.layout.sensors, values.T, strict=True)}
        x = [np.array([w[0] @ by_dof[i]]) for i in range(system.n_dof)]
        v = [np.array([-(w[1] @ by_dof[i])]) for i in range(system.n_dof)]
        a = [np.array([w[2] @ by_dof[i]]) for i in range(system.n_dof)]
        f = [np.zeros(1) for _ in range(system.n_dof)]
        middle = 0.5 * (w[0][1:] + w[0][:-1])  # a force is held from its sample to the next
        for dof, column in zip(self.layout.forced, pushes.T, strict=True):
            f[dof] = f[dof] + middle @ column[:-1]
        columns, offset = regression_columns(system, x, v, a, f)
        free = [system.names.index(name) for name in self.layout.free]
        known = [i for i in range(len(system.names)) if i not in free]
        constant = w[0].sum() * np.eye(system.n_dof)
        return np.concatenate([columns[:, free], constant], axis=1), -offset - columns[:, known].sum(axis=1)

    def _learn(self, columns: np.ndarray, target: np.ndarray) -> None:
        if self.weight == 0:
            self.inverse = np.diag(DIFFUSE * np.mean(target**2) / np.maximum(np.mean(columns**2, axis=0), 1e-300))
        for i, (phi, y) in enumerate(zip(columns, target, strict=True)):
            left = float(y - phi @ self.theta)
            if i == 0:
                self._forget(phi, left)
            self.learn(phi, left)

    def _forget(self, phi: np.ndarray, left: float) -> None:
        """Forget for the samples since the last equation, given regressors (q,) and error of the new one."""
        keep = self.settings.factor ** (self.settings.span // 4)
        gain_direction = self.inverse @ phi
        size = float(phi @ gain_direction)
        if self.settings.forgetting == "directional":
            self.inverse = self.inverse + (1.0 - keep) / keep * np.outer(gain_direction, gain_direction) / max(
                size, 1e-300
            )
            self.forget_noise(keep)
            return
        if self.settings.forgetting == "variable":
            horizon = 1.0 / (1.0 - keep) if keep < 1 else 1e6
            level = self.power / max(self.weight, 1.0)
            surprise = left**2 / (1.0 + size) / (level * horizon) if level > 0 else 0.0
            keep = float(np.clip(1.0 - surprise, LEAST, 1.0))
        self.forget(keep)

    def _remove_jump(self) -> bool:
        """Detect a jump of a sensor's zero; discard the samples before it and reset the variance of the constants."""
        jump = remove_jumps(self.values, self.zero)
        if jump is None:
            return False
        self.values, self.pushes = self.values[jump:], self.pushes[jump:]
        if self.weight:
            zeros, weight = range(len(self.layout.free), len(self.theta)), self._weights[0].sum()
            self.inverse[zeros, zeros] += DIFFUSE * np.mean(self.values**2) / weight**2
        return True

    def _distribution(self) -> Normal | None:
        """Return the distribution of the log-parameters, by the delta method; None for a non-positive estimate."""
        q, variance = len(self.layout.free), self.variance
        theta = self.theta[:q]
        if variance is None or np.any(theta <= 0):
            return None
        return Normal(
            self.layout.free, np.log(theta), variance * self.inverse[:q, :q] / np.outer(theta, theta), log=True
        )
