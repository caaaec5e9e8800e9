"""SINDy: sparse regression on a library of polynomials in displacement and velocity, by pysindy.

The acceleration of each degree of freedom is regressed on all monomials of displacements and velocities up to degree
three, and on the known forces; sequentially thresholded least squares removes the small terms (Brunton, Proctor and
Kutz, PNAS 113 (2016) 3932-3937). The library holds more than the equation of motion: sparsity has to find it.

* Derivatives decide everything on few samples. They are those of a smoothing spline, smoothed as in LS with
  ``derivative="spline"`` (:func:`methods.regression.spline_fit`).
* Every term is scaled to unit norm, and so is the acceleration: the threshold is the share of the acceleration below
  which a term is dropped, a number without unit. It is the one of ``thresholds`` whose sparse model, simulated from the
  smoothed state near the start of the record, has the least Bayesian information criterion against the samples:
  ``N log(mean squared misfit) + terms log N``.
* The sparse model ``x'' = g(x, x', f)`` has no mass or spring. Its acceleration along the smoothed motion is put into
  the equation of motion, and the parameters are the least-squares solution, as in LS. Terms that the equation of motion
  does not have are thus projected onto those that it has.

Told: the equations (for that last step, and the smoothing), the samples, the known force; a told start is used in
choosing the smoothing. The prior is not used. No own reconstruction. The uncertainty is a parametric bootstrap's
spread at the chosen threshold. The terms kept are in the message, and as numbers in the trace ``coefficients``
(n_dof, n_terms), in the method's natural units, with the powers of each in the trace ``powers`` (n_terms, n_inputs).
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from bench import Card, Estimate, Identifier, InputError, Problem, Serves, Status, Units
from methods.regression import (
    Motion,
    Regression,
    SplineFit,
    Unusable,
    Values,
    answer,
    bootstrap_covariance,
    layout_objection,
    smoothings,
    solve,
    spline_fit,
)

RADIANS_A_STEP = 0.25
"""Step of the fourth-order integrator: its error, some 1e-5 of the motion, is far below the noise."""
SWEEPS = 20
"""Thresholding rounds at most; the default of pysindy."""


@dataclass(frozen=True)
class SINDy(Identifier):
    """Sparse identification; ``degree`` of the library, ``most_terms`` in an equation, ``bootstrap`` data sets drawn."""

    degree: int = 3
    most_terms: int = 8
    bootstrap: int = 60

    card: ClassVar[Card] = Card(
        summary="pysindy: sparse regression (STLSQ) on polynomials in displacement and velocity of a smoothing spline",
        start="used when known",
        scale="groups",
        reconstruction="simulated",
        uncertainty="covariance of a parametric bootstrap at the chosen threshold: spread only, not bias",
        settings_source="threshold: least BIC of the simulated sparse model; smoothing: as ls with derivative=spline",
        tuning="",
    )
    serves: ClassVar[Serves] = Serves(several_records=True, several_channels=True, offsets=True, max_dof=None)
    requires: ClassVar[tuple[str, ...]] = ("pysindy",)
    extra: ClassVar[str] = "sindy"

    def __post_init__(self) -> None:
        if self.most_terms < 1:
            raise InputError("method.most_terms", self.most_terms, "at least 1")
        if self.degree < 1:
            raise InputError("method.degree", self.degree, "at least 1")

    def objection(self, problem: Problem) -> str | None:
        return super().objection(problem) or layout_objection(problem)

    def identify(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """The estimate for one problem: groups in free vibration, parameters with a known force."""
        units = problem.natural_units()
        try:
            regression = Regression.of(problem.expressed_in(units))
            fit = spline_fit(regression)
            library = _Library.of(regression, self.degree)
            motions = regression.motions(regression.values, fit.smoother, np.array([fit.which]))
            models = library.sparse_models(motions, self.most_terms)
        except Unusable as reason:
            return Estimate.failed(problem.system, reason.status, str(reason))
        best = library.best(models, motions, fit)
        unknowns = library.projected(motions, models[best][None])[0]

        def fitter(values: Values) -> np.ndarray:
            return library.refit(values, fit, best + 1)

        covariance = bootstrap_covariance(fit, fitter, rng, self.bootstrap)
        traces = {"coefficients": models[best] * library.scales(units), "powers": library.powers.astype(float)}
        return answer(regression, unknowns, covariance, library.told(models[best]), traces).expressed_in(units.inverse)


@dataclass(frozen=True, eq=False)
class _Library:
    """Monomials of displacements and velocities, ``powers`` (n_monomials, 2 n_dof), and the forces on ``pushed``."""

    regression: Regression
    powers: np.ndarray
    pushed: tuple[int, ...]

    @staticmethod
    def of(regression: Regression, degree: int) -> _Library:
        """The library; a constant is in it only where a sensor's offset is unknown. Raises Unusable for few samples."""
        import pysindy

        n = regression.system.n_dof
        offset = any(c.offset for record in regression.records for c in record.channels)
        polynomials = pysindy.PolynomialLibrary(degree=degree, include_bias=offset).fit(np.zeros((2, 2 * n)))
        acting = {f.dof for r in regression.records for f in r.forces if np.any(f.values)}
        return _Library(regression, np.array(polynomials.powers_), tuple(sorted(acting)))

    def features(self, motions: Sequence[Motion]) -> np.ndarray:
        """Library terms (sets, rows, terms) along the motions of all records."""
        parts = []
        for record, (times, x, v, _) in zip(self.regression.records, motions, strict=True):
            states = np.concatenate([x, v]).transpose(1, 2, 0)
            force = np.array(record.force(times, self.regression.system.n_dof))[list(self.pushed)].T
            parts.append(self.terms(states, np.broadcast_to(force, (*states.shape[:2], len(self.pushed)))))
        return np.concatenate(parts, axis=1)

    def terms(self, states: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Library terms (..., terms) at states (..., 2 n_dof) under forces (..., n_pushed)."""
        return np.concatenate([np.prod(states[..., None, :] ** self.powers, axis=-1), force], axis=-1)

    @cached_property
    def names(self) -> list[str]:
        """The terms in words, e.g. ``x^2 v``."""
        n = self.regression.system.n_dof
        state = ["x", "v"] if n == 1 else [f"{s}{i + 1}" for s in "xv" for i in range(n)]
        words = [[f"{s}^{p}" if p > 1 else s for s, p in zip(state, row, strict=True) if p] for row in self.powers]
        return [" ".join(word) or "1" for word in words] + [f"f{i + 1}" if n > 1 else "f" for i in self.pushed]

    def told(self, model: np.ndarray) -> str:
        """The terms that a model (n_dof, terms) kept, in a sentence."""
        kept = [", ".join(name for name, c in zip(self.names, row, strict=True) if c) or "none" for row in model]
        if len(kept) == 1:
            return f"terms kept of {len(self.names)}: {kept[0]}"
        return f"terms kept of {len(self.names)}: " + "; ".join(f"{row} (DOF {i + 1})" for i, row in enumerate(kept))

    def scales(self, units: Units) -> np.ndarray:
        """How much one natural unit of each coefficient is in the problem's units, shape (terms,)."""
        n = self.regression.system.n_dof
        acceleration, velocity = units.length / units.time**2, units.length / units.time
        monomials = units.length ** self.powers[:, :n].sum(1) * velocity ** self.powers[:, n:].sum(1)
        return acceleration / np.concatenate([monomials, np.full(len(self.pushed), units.mass * acceleration)])

    def sparse_models(self, motions: Sequence[Motion], most_terms: int) -> np.ndarray:
        """Models (sizes, n_dof, terms) of 1, 2, ... terms by pysindy's FROLS. Raises Unusable for too few samples."""
        from pysindy import FROLS

        features = self.features(motions)[0]
        if features.shape[0] <= features.shape[1]:
            lost = self.regression.values[0].shape[-1] - motions[0][0].size
            needed = features.shape[1] + 1 + lost * len(motions)
            sentence = f"its library of {features.shape[1]} terms needs at least {needed} samples"
            raise Unusable(Status.UNSUPPORTED, sentence)
        target = np.concatenate([a[:, 0] for _, _, _, a in motions], axis=-1).T
        norms, size = np.linalg.norm(features, axis=0), np.linalg.norm(target, axis=0)
        most = min(most_terms, features.shape[1] - 1)
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            # columns and target of unit norm: the greedy selection does not depend on them, its rounding does
            sparse = FROLS(alpha=0.0, max_iter=most, unbias=False).fit(features / norms, target / size)
        return np.stack(sparse.history_[1 : most + 1]) * size[:, None] / norms

    def best(self, models: np.ndarray, motions: Sequence[Motion], fit: SplineFit) -> int:
        """Number of the model of least Bayesian information criterion of its simulated response."""
        score = np.log(sum(y.size for y in self.regression.values)) * np.count_nonzero(models, axis=(1, 2))
        for i, motion in enumerate(motions):
            trim = fit.smoother[1]
            y = self.regression.values[i][:, 0, trim : self.regression.times[i].size - trim]
            with np.errstate(all="ignore"):
                square = np.mean((self._response(models, i, motion, y) - y[:, None]) ** 2, axis=-1)
                floor = 1e-28 * np.var(y, axis=-1)[:, None]
                score = score + np.sum(y.shape[-1] * np.log(np.maximum(square, floor)), axis=0)
        score[~np.any(models, axis=(1, 2))] = np.inf
        return int(np.argmin(np.where(np.isfinite(score), score, np.inf)))

    def _response(self, models: np.ndarray, number: int, motion: Motion, y: np.ndarray) -> np.ndarray:
        """Displacements (n_dof, models, rows) from the smoothed state, moved by one Gauss-Newton step towards y."""
        _, x, v, _ = motion
        start = np.concatenate([x[:, 0, 0], v[:, 0, 0]])
        size = np.sqrt(np.concatenate([np.mean(x[:, 0] ** 2, -1), np.mean(v[:, 0] ** 2, -1)]))
        count, trials = len(models), np.concatenate([np.zeros((1, start.size)), 1e-4 * np.diag(size)])
        repeated = np.repeat(models, len(trials), axis=0)
        path = self._simulated(repeated, np.tile(start + trials, (count, 1)), number, motion)
        path = path.reshape(y.shape[0], count, len(trials), -1)
        starts = np.tile(start, (count, 1))
        for i in range(count):
            here = path[:, i]
            if np.all(np.isfinite(here)):
                jacobian = (here[:, 1:] - here[:, :1]) / 1e-4
                misfit = (y - here[:, 0]).ravel()
                step, *_ = np.linalg.lstsq(jacobian.transpose(0, 2, 1).reshape(misfit.size, -1), misfit, rcond=1e-8)
                starts[i] += size * step
        return self._simulated(models, starts, number, motion)

    def _simulated(self, models: np.ndarray, starts: np.ndarray, number: int, motion: Motion) -> np.ndarray:
        """Displacements (n_dof, models, rows) from states (models, 2 n_dof), by classical Runge-Kutta steps."""
        times, _, v, a = motion
        n, record = self.regression.system.n_dof, self.regression.records[number]
        rate = np.sqrt(np.mean(a**2) / np.mean(v**2))

        def slope(state: np.ndarray, at: float) -> np.ndarray:
            force = np.array(record.force(np.array(at), n))[list(self.pushed)]
            terms = self.terms(state, np.broadcast_to(force, (len(models), len(self.pushed))))
            return np.concatenate([state[:, n:], np.einsum("mdk,mk->md", models, terms)], axis=1)

        state, path = starts, [starts[:, :n]]
        with np.errstate(all="ignore"):
            for start, end in zip(times[:-1], times[1:], strict=True):
                steps = int(np.clip(np.ceil((end - start) * rate / RADIANS_A_STEP), 1, 100))
                h = (end - start) / steps
                for j in range(steps):
                    t = start + j * h
                    k1 = slope(state, t)
                    k2 = slope(state + h / 2 * k1, t + h / 2)
                    k3 = slope(state + h / 2 * k2, t + h / 2)
                    k4 = slope(state + h * k3, t + h)
                    state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
                path.append(state[:, :n])
        return np.stack(path, axis=-1).transpose(1, 0, 2)

    def projected(self, motions: Sequence[Motion], models: np.ndarray) -> np.ndarray:
        """Unknowns (sets, q): the models' (sets, n_dof, terms) accelerations in the equation of motion."""
        accelerations = np.einsum("sdk,srk->dsr", models, self.features(motions))
        parts = np.split(accelerations, np.cumsum([m[0].size for m in motions])[:-1], axis=-1)
        replaced = [(t, x, v, a) for (t, x, v, _), a in zip(motions, parts, strict=True)]
        return solve(*self.regression.equations(replaced))

    def refit(self, values: Values, fit: SplineFit, size: int) -> np.ndarray:
        """Unknowns (sets, q) of other data (n_dof, sets, n) a record, with equally many terms."""
        chosen = smoothings(self.regression, fit, values)
        found = np.full((len(chosen), fit.unknowns.size), np.nan)
        for smoother in sorted({s for s, _ in chosen}):
            mine = np.array([s == smoother for s, _ in chosen])
            which = np.array([w for _, w in chosen])[mine]
            motions = self.regression.motions([y[:, mine] for y in values], smoother, which)
            target = np.concatenate([a for _, _, _, a in motions], axis=-1)
            features = self.features(motions)
            if features.shape[1] > features.shape[2]:
                models = np.stack([greedy(features, a, size) for a in target], axis=1)
                found[mine] = self.projected(motions, models)
        return found


def greedy(features: np.ndarray, target: np.ndarray, size: int) -> np.ndarray:
    """Forward orthogonal least squares, (sets, terms), of features (sets, rows, terms) and target (sets, rows).

    Each of ``size`` steps takes the term that, made orthogonal to those taken, explains most of the target. The
    vectorised twin of ``pysindy.FROLS(alpha=0)``, for the bootstrap; a test holds the two together.
    """
    norms = np.linalg.norm(features, axis=1)
    columns = features / np.where(norms > 0, norms, 1.0)[:, None]
    left, rows = columns.copy(), np.arange(len(features))
    kept = np.zeros(norms.shape, bool)
    for _ in range(size):
        power = np.sum(left**2, axis=1)
        free = ~kept & (power > 1e-20)
        gain = np.where(free, np.einsum("srk,sr->sk", left, target) ** 2 / np.where(free, power, 1.0), -1.0)
        best = np.argmax(gain, axis=1)
        kept[rows, best] = True
        taken = left[rows, :, best] / np.sqrt(np.maximum(power[rows, best], 1e-300))[:, None]
        left = left - taken[:, :, None] * np.einsum("sr,srk->sk", taken, left)[:, None]
    both = kept[:, :, None] & kept[:, None, :]
    square = np.where(both, np.swapaxes(columns, 1, 2) @ columns, np.eye(norms.shape[1]))
    moment = np.where(kept, np.einsum("srk,sr->sk", columns, target), 0.0)
    coefficients = np.linalg.solve(square, moment[..., None])[..., 0]
    return np.where(kept, coefficients, 0.0) / np.where(norms > 0, norms, 1.0)
