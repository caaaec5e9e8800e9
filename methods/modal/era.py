"""Eigensystem realisation: the free decay of several masses as a linear system, without a search.

Displacements of all degrees of freedom (DOF) at even steps h obey ``y_j = C A^j s``. Stacked in a block Hankel matrix,
``H[i, j] = y_{i+j}``, they span, without noise, as many dimensions as there are states, two a DOF. The singular vectors
of the largest singular values are the observability matrix ``[C; CA; CA²; ...]`` in some coordinates, and its shift by
one block is A: eigenvalues z and mode shapes ``C w`` (J.-N. Juang, R. S. Pappa, J. Guidance, Control, and Dynamics
8:620, 1985). ``s = log(z) / h`` are the poles. For one DOF this is the matrix pencil
(:mod:`methods.modal.matrix_pencil`) with the shift solved on the other side of the Hankel matrix.

**From poles and shapes to parameters.** Displacement shapes Phi and velocity shapes ``Phi S``, S the poles on the
diagonal, are a basis Psi of the state ``[x, x']``, so ``Psi S Psi^-1`` is the state matrix, and its lower half is
``[-M^-1 K, -M^-1 C]``: the acceleration that belongs to each unit state. Put into the system's residual, as a measured
motion is in a regression, these give linear equations for its groups (:class:`methods.regression.equation.Regression`).

**Weights.** There are more entries than groups (8 for the 5 of two masses in a chain), known with very different
errors. Synthetic records are drawn from the realised response and its misfit, realised again, and the covariance of
what the equations then miss weighs them: generalised least squares. The same draws give the covariance of the groups
(parametric bootstrap). With ``bootstrap=0`` there are neither weights nor an uncertainty.

``rows`` of the samples are the block rows: a half, a square Hankel matrix for one DOF; no trial was made of others.
Even sampling is needed, and the displacement of every DOF. Start, prior and noise level are not used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np

from bench import Card, Estimate, InputError, NoEstimate, Problem, Serves
from methods.modal.even_steps import unevenness
from methods.modal.free_decay import untold
from methods.modal.matrix_pencil import MAX_SAMPLES
from methods.modal.subspace import leading_vectors
from methods.regression.company import Finish, answers_together
from methods.regression.derivatives import Motion
from methods.regression.equation import Regression, answer, layout_objection, solve
from methods.starts.ambiguity import BandIdentifier

BATCH = 2_000_000
"""Matrix entries decomposed at once."""
REALNESS = 1e-6
"""The state matrix of poles and shapes that come in conjugate pairs has an imaginary part below this part of it."""


@dataclass(frozen=True)
class ERA(BandIdentifier):
    """Block rows ``rows`` times the samples; ``bootstrap`` synthetic records for weights and covariance."""

    rows: float = 0.5
    bootstrap: int = 200

    card: ClassVar[Card] = Card(
        summary="eigensystem realisation of the free decay, then the groups from poles and mode shapes",
        start="not used",
        scale="groups",
        reconstruction="own",
        uncertainty="covariance of a parametric bootstrap, Student t with N - (groups and start) degrees of freedom",
        settings_source="order 2 a DOF by the system; square Hankel matrix as in Juang and Pappa (1985)",
        tuning="none",
        title="Eigensystem realisation",
        order=190,
        colour="#AA4499",
        marker=(3, 1, 0.0),
    )
    serves: ClassVar[Serves] = Serves(several_channels=True, forced=False, nonlinear=False, max_dof=None)

    works_in = "natural units"

    def __post_init__(self) -> None:
        if not 0 < self.rows < 1:
            raise InputError("method.rows", self.rows, "a part of the number of samples, a half say")
        if self.bootstrap < 0:
            raise InputError("method.bootstrap", self.bootstrap, "a number of records, 0 for no uncertainty")

    def objection(self, problem: Problem) -> str | None:
        return super().objection(problem) or layout_objection(problem) or _sampling_objection(problem)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Estimate the identifiable groups; ``diverged`` where the realisation is no vibration of the system."""
        return self.estimate_many([problem], [rng])[0]

    def estimate_many(self, problems: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Estimate problems of one layout together."""
        return answers_together([untold(problem) for problem in problems], rngs, self._solve, max(1, self.bootstrap))

    def _solve(self, regressions: Sequence[Regression], rngs: Sequence[np.random.Generator]) -> Sequence[Finish]:
        first = Regression.joined(regressions)
        y, times = first.values[0].swapaxes(0, 1), first.times[0]
        step = float(times[-1] - times[0]) / (times.size - 1)
        rates, shapes = realise(y, self.rows)
        rows = state_rows(rates, shapes, step)
        responses: dict[int, RealisedResponse] = {
            int(i): RealisedResponse.of(np.log(rates[i]) / step, shapes[i], times, y[i])
            for i in np.flatnonzero(np.all(np.isfinite(rows), axis=(1, 2)))
        }
        drawn = dict[int, np.ndarray]()
        if self.bootstrap and responses:
            sets = [self._drawn(regressions[i], response, y[i], rngs[i]) for i, response in responses.items()]
            drawn_rows = state_rows(*realise(np.concatenate(sets), self.rows), step)
            drawn = dict(zip(responses, np.split(drawn_rows, len(sets)), strict=True))
        return [
            partial(_estimate, regression, rows[i : i + 1], responses.get(i), drawn.get(i))
            for i, regression in enumerate(regressions)
        ]

    def _drawn(
        self, regression: Regression, response: RealisedResponse, y: np.ndarray, rng: np.random.Generator
    ) -> np.ndarray:
        """Synthetic records (bootstrap, n_dof, N) like the record y (n_dof, N)."""
        centre = response(regression.times[0])
        spent = len(regression.names) + 2 * regression.system.n_dof
        left = max(1.0 - spent / y.size, 1.0 / y.size)
        noise = np.sqrt(np.mean((centre - y) ** 2, axis=1) / left)
        return np.asarray(centre + noise[:, None] * rng.standard_normal((self.bootstrap, *y.shape)))


def _estimate(
    regression: Regression, rows: np.ndarray, response: RealisedResponse | None, drawn: np.ndarray | None
) -> Estimate:
    """The groups of realised ``rows`` (1, n, 2n), with weights and covariance where rows of records were drawn."""
    if response is None:
        sentence = (
            "its poles are not those of a vibration of this system: take a longer record, more samples a cycle "
            "or less noise"
        )
        raise NoEstimate(sentence)
    unknowns, covariance = (_groups(regression, rows), None) if drawn is None else _weighted(regression, rows, drawn)
    if not np.all(np.isfinite(unknowns)):
        sentence = "the realised matrices do not determine the groups: take more samples, or samples of more motion"
        raise NoEstimate(sentence)
    said = [f"{name} came out negative" for name, value in zip(regression.names, unknowns[0], strict=True) if value < 0]
    estimate = answer(regression, unknowns[0], covariance, "; ".join(said))
    return replace(estimate, reconstructions=(response,))


def _sampling_objection(problem: Problem) -> str | None:
    for record in problem.records:
        times, n = record.channels[0].times, problem.system.n_dof
        # rows and columns enough for two states a DOF, a shift, and a sample for the noise
        least = 4 * n + 1
        if not least <= times.size <= MAX_SAMPLES:
            return f"it takes {least} to {MAX_SAMPLES} samples a channel; thin a longer record"
        if (objection := unevenness(times)) is not None:
            return objection
    return None


def realise(sets: np.ndarray, rows: float) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues z (sets, 2n) and displacement shapes (sets, n, 2n), complex, of even samples (sets, n, N).

    The N samples must be at least 4 n + 1. NaN where the data span less than two dimensions a DOF.
    """
    n, samples = sets.shape[1:]
    blocks = int(np.clip(round(rows * samples), 3, samples + 1 - 2 * n))
    blocks = max(blocks, 2 * n + 1) if samples + 1 - (2 * n + 1) >= 2 * n else blocks
    batch = max(1, BATCH // (n * blocks * (samples + 1 - blocks)))
    parts = [_realise(sets[i : i + batch], blocks) for i in range(0, len(sets), batch)]
    return np.concatenate([z for z, _ in parts]), np.concatenate([shapes for _, shapes in parts])


def _realise(sets: np.ndarray, blocks: int) -> tuple[np.ndarray, np.ndarray]:
    count, n, _ = sets.shape
    # windows (sets, n, columns, blocks) to block rows of n channels each
    hankel = np.lib.stride_tricks.sliding_window_view(sets, sets.shape[2] + 1 - blocks, axis=-1)
    hankel = hankel.swapaxes(1, 2).reshape(count, blocks * n, -1)
    main = leading_vectors(hankel, 2 * n)
    shift = np.linalg.pinv(main[:, :-n]) @ main[:, n:]
    z, vectors = np.linalg.eig(shift)
    return z.astype(complex), (main[:, :n] @ vectors).astype(complex)


def state_rows(z: np.ndarray, shapes: np.ndarray, step: float) -> np.ndarray:
    """``[-M^-1 K, -M^-1 C]``, (sets, n, 2n), of eigenvalues z and displacement shapes at a step of time.

    NaN where poles and shapes are not closed under conjugation (a negative real z has no continuous real system).
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
    """Columns (sets, 2n², groups) and target of the residual at the unit states, whose accelerations ``rows`` hold."""
    sets, n, states = rows.shape
    units = np.broadcast_to(np.eye(states)[:, None], (states, sets, states))
    motion = Motion(np.zeros(states), units[:n], units[n:], rows.swapaxes(0, 1), np.zeros((n, sets, states)))
    return regression.equations([motion])


def _groups(regression: Regression, rows: np.ndarray) -> np.ndarray:
    """Groups (sets, q) by least squares, all entries alike."""
    return solve(*_equations(regression, rows))


def _weighted(regression: Regression, rows: np.ndarray, drawn: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """Groups (1, q) by generalised least squares and their covariance, both from realised rows of synthetic records."""
    plain = _groups(regression, rows)
    drawn = drawn[np.all(np.isfinite(drawn), axis=(1, 2))]
    columns, target = _equations(regression, drawn)
    count, entries = target.shape
    if count <= 2 * entries or not np.all(np.isfinite(plain)):
        return plain, None
    missed = np.cov(columns @ plain[0] - target, rowvar=False)
    scale = np.sqrt(np.diag(missed))
    scale = np.where(scale > 0, scale, 1.0)
    # a ridge of the rounding's size: entries may be exact, as those of a data set without noise are
    root = np.linalg.cholesky(missed / np.outer(scale, scale) + 1e-9 * np.eye(entries)) * scale[:, None]

    def fit(columns: np.ndarray, target: np.ndarray) -> np.ndarray:
        return solve(np.linalg.solve(root, columns), np.linalg.solve(root, target[..., None])[..., 0])

    found = fit(columns, target)
    found = found[np.all(np.isfinite(found), axis=1)]
    covariance = np.atleast_2d(np.cov(found, rowvar=False)) if len(found) > found.shape[1] + 1 else None
    return fit(*_equations(regression, rows)), covariance


@dataclass(frozen=True, eq=False)
class RealisedResponse:
    """The realised free decay as a function of time; can be pickled. ``rates`` (2n,), ``shapes`` (n, 2n) complex."""

    rates: np.ndarray
    shapes: np.ndarray
    origin: float

    @staticmethod
    def of(rates: np.ndarray, shapes: np.ndarray, times: np.ndarray, y: np.ndarray) -> RealisedResponse:
        """With the modal amplitudes that fit the samples y (n, N) best; shapes and rates stay."""
        waves = np.exp(rates * (times - times[0])[:, None])
        columns = (shapes[:, None] * waves).reshape(-1, rates.size)
        stacked = np.concatenate([columns.real, -columns.imag], axis=1)
        found = np.linalg.lstsq(stacked, y.ravel(), rcond=1e-12)[0]
        return RealisedResponse(rates, shapes * (found[: rates.size] + 1j * found[rates.size :]), float(times[0]))

    def __call__(self, times: np.ndarray) -> np.ndarray:
        """Displacement (m), shape (n_dof, n_times), at times (s)."""
        waves = np.exp(self.rates[:, None] * (np.asarray(times, float) - self.origin))
        return np.asarray((self.shapes @ waves).real)
