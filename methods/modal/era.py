"""Eigensystem realisation algorithm (ERA) for the free decay of several masses.

Displacements of all degrees of freedom (DOF) at even steps h are realised as ``y_j = C A^j s`` with two states per DOF
(J.-N. Juang, R. S. Pappa, J. Guidance, Control, and Dynamics 8:620, 1985; :mod:`methods.modal.realisation`), with
eigenvalues z of A and mode shapes ``C w``. The poles are ``s = log(z) / h``. For one DOF this is the matrix pencil
(:mod:`methods.modal.matrix_pencil`) with another number of rows.

**From poles and shapes to parameters.** Displacement shapes Phi and velocity shapes ``Phi S``, with the poles on the
diagonal of S, form a basis Psi of the state ``[x, x']``. The state matrix is ``Psi S Psi^-1``, whose lower half
``[-M^-1 K, -M^-1 C]`` has the acceleration of each unit state. Inserted into the equation of motion like a measured
motion, these give linear equations for the groups (:class:`methods.regression.equation.Regression`).

**Weights.** There are more entries than groups (8 for the 5 of a chain of two masses), with very different errors.
Synthetic records of the realised response and its misfit are realised again, and the covariance of their equation
residuals weights the equations (generalised least squares). The same records give the covariance of the groups
(parametric bootstrap). With ``bootstrap=0`` there are neither weights nor an uncertainty.

The block rows are ``rows`` times the samples: by default a half, a square Hankel matrix for one DOF; other values were
not tried. Even sampling and the displacement of every DOF are required.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from bench import Card, Estimate, InputError, Problem, Scope, Status
from methods.modal.realisation import MAX_SAMPLES, realise, step_of
from methods.regression.derivatives import Motion
from methods.regression.equation import Regression, solve
from methods.regression.identifier import RegressionIdentifier, answer, covariance
from methods.starts.search_range import unevenness

REALNESS = 1e-6
"""Largest imaginary part of a state matrix, relative to its size; with conjugate pairs it is zero."""
NO_VIBRATION = (
    "its poles are not those of a vibration of this system: "
    "a longer record, more samples per cycle or less noise are required"
)
UNDETERMINED = "the realised matrices do not determine the groups: more samples or more motion are required"


@dataclass(frozen=True)
class ERA(RegressionIdentifier):
    """ERA; ``rows``: block rows over samples; ``bootstrap``: synthetic records for weights and covariance."""

    rows: float = 0.5
    bootstrap: int = 200

    card: ClassVar[Card] = Card(
        summary="eigensystem realisation of the free decay, then the groups from poles and mode shapes",
        start="not used",
        scale="groups",
        reconstruction="own",
        uncertainty="covariance of a parametric bootstrap, Student t with N - (groups + 2 per DOF) degrees of freedom",
        settings_source="order 2 per DOF by the system; square Hankel matrix as in Juang and Pappa (1985)",
        tuning="none",
        title="Eigensystem realisation",
        order=190,
    )
    scope: ClassVar[Scope] = Scope(several_channels=True, forced=False, nonlinear=False, max_dof=None)
    uses_start = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.rows < 1:
            raise InputError("method.rows", self.rows, "a fraction of the number of samples, such as 0.5")

    def objection(self, problem: Problem) -> str | None:
        return super().objection(problem) or _sampling_objection(problem)

    def fit(self, regression: Regression, rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Realise all problems, and their synthetic records, at once."""
        y, times = regression.values[0].swapaxes(0, 1), regression.times[0]
        rates, shapes = self._realised(y)
        rows = state_rows(rates, shapes, step_of(times))
        answers = [Estimate.failed(regression.system, Status.DIVERGED, NO_VIBRATION) for _ in rngs]
        valid = np.flatnonzero(np.all(np.isfinite(rows), axis=(1, 2))).tolist()
        responses = [RealisedResponse.of(np.log(rates[i]) / step_of(times), shapes[i], times, y[i]) for i in valid]
        drawn = [rows[:0]] * len(valid)
        if self.bootstrap and len(valid):
            freedom = max(1.0 - (len(regression.names) + 2 * len(y[0])) / y[0].size, 1.0 / y[0].size)
            sets = []
            for i, response in zip(valid, responses, strict=True):
                centre = response(times)
                noise = np.sqrt(np.mean((centre - y[i]) ** 2, axis=1, keepdims=True) / freedom)
                sets.append(centre + noise * rngs[i].standard_normal((self.bootstrap, *centre.shape)))
            drawn = np.split(state_rows(*self._realised(np.concatenate(sets)), step_of(times)), len(valid))
        for i, response, drawn_rows in zip(valid, responses, drawn, strict=True):
            answers[i] = _answer(regression, rows[[i]], response, drawn_rows)
        return answers

    def _realised(self, sets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Realise samples (sets, n, N), N at least 4 n + 1, with at least as many rows and columns as required."""
        n, samples = sets.shape[1:]
        return realise(sets, int(np.clip(round(self.rows * samples), 2 * n + 1, samples + 1 - 2 * n)), 2 * n)


def _answer(regression: Regression, rows: np.ndarray, response: RealisedResponse, drawn: np.ndarray) -> Estimate:
    """Return the estimate of the groups from realised ``rows`` (1, n, 2n), weighted by those of synthetic records."""
    unknowns, spread = _weighted(regression, rows, drawn)
    if not np.all(np.isfinite(unknowns)):
        return Estimate.failed(regression.system, Status.DIVERGED, UNDETERMINED)
    messages = [
        f"the estimate of {name} is negative"
        for name, value in zip(regression.names, unknowns[0], strict=True)
        if value < 0
    ]
    return replace(answer(regression, unknowns[0], spread, "; ".join(messages)), reconstructions=(response,))


def _sampling_objection(problem: Problem) -> str | None:
    times, n = problem.records[0].channels[0].times, problem.system.n_dof
    # rows and columns for two states per DOF, a shift, and a sample for the noise
    least = 4 * n + 1
    if not least <= times.size <= MAX_SAMPLES:
        return f"it supports {least} to {MAX_SAMPLES} samples per channel; decimate a longer record"
    return unevenness(times)


def state_rows(z: np.ndarray, shapes: np.ndarray, step: float) -> np.ndarray:
    """Compute ``[-M^-1 K, -M^-1 C]``, (sets, n, 2n), from eigenvalues z and displacement shapes at a time step.

    NaN where poles and shapes are not closed under conjugation (a negative real z has no real continuous system).
    """
    n = shapes.shape[1]
    rates = np.log(z) / step
    basis = np.concatenate([shapes, shapes * rates[:, None]], axis=1)
    healthy = np.all(np.isfinite(basis), axis=(1, 2)) & (
        np.linalg.cond(np.where(np.isfinite(basis), basis, 0.0)) < 1e12
    )
    basis = np.where(healthy[:, None, None], basis, np.eye(2 * n))
    lower = (basis[:, n:] * rates[:, None]) @ np.linalg.inv(basis)
    size = np.max(np.abs(lower), axis=(1, 2))
    healthy &= np.max(np.abs(lower.imag), axis=(1, 2)) <= REALNESS * size
    return np.where(healthy[:, None, None], lower.real, np.nan)


# ----------------------------------------------------------------------------------------- groups and response


def _equations(regression: Regression, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return columns (sets, 2n², groups) and target of the equations for unit states with accelerations ``rows``."""
    sets, n, states = rows.shape
    units = np.broadcast_to(np.eye(states)[:, None], (states, sets, states))
    motion = Motion(np.zeros(states), units[:n], units[n:], rows.swapaxes(0, 1), np.zeros((n, sets, states)))
    return regression.equations([motion])


def _weighted(regression: Regression, rows: np.ndarray, drawn: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """Estimate groups (1, q) and their covariance by generalised least squares, with weights from synthetic records.

    Without enough of these, return ordinary least squares and no covariance.
    """
    equations = _equations(regression, rows)
    plain = solve(*equations)
    drawn = drawn[np.all(np.isfinite(drawn), axis=(1, 2))]
    entries = rows[0].size
    if len(drawn) <= 2 * entries or not np.all(np.isfinite(plain)):
        return plain, None
    columns, target = _equations(regression, drawn)
    missed = np.cov(columns @ plain[0] - target, rowvar=False)
    scale = np.sqrt(np.diag(missed))
    scale = np.where(scale > 0, scale, 1.0)
    # regularised against rounding, since entries are exact for data without noise
    root = np.linalg.cholesky(missed / np.outer(scale, scale) + 1e-9 * np.eye(entries)) * scale[:, None]

    def fit(columns: np.ndarray, target: np.ndarray) -> np.ndarray:
        return solve(np.linalg.solve(root, columns), np.linalg.solve(root, target[..., None])[..., 0])

    return fit(*equations), covariance(fit(columns, target))


@dataclass(frozen=True, eq=False)
class RealisedResponse:
    """The realised free decay as a function of time, with complex ``rates`` (2n,) and ``shapes`` (n, 2n)."""

    rates: np.ndarray
    shapes: np.ndarray
    origin: float

    @staticmethod
    def of(rates: np.ndarray, shapes: np.ndarray, times: np.ndarray, y: np.ndarray) -> RealisedResponse:
        """Fit the modal amplitudes to samples y (n, N), with given shapes and rates."""
        waves = np.exp(rates * (times - times[0])[:, None])
        columns = (shapes[:, None] * waves).reshape(-1, rates.size)
        stacked = np.concatenate([columns.real, -columns.imag], axis=1)
        parts = np.linalg.lstsq(stacked, y.ravel(), rcond=1e-12)[0]
        return RealisedResponse(rates, shapes * (parts[: rates.size] + 1j * parts[rates.size :]), float(times[0]))

    def __call__(self, times: np.ndarray) -> np.ndarray:
        """Evaluate the displacement, (n_dof, n_times), at times."""
        waves = np.exp(self.rates[:, None] * (np.asarray(times, float) - self.origin))
        return np.asarray((self.shapes @ waves).real)
