"""SINDy: sparse regression on a library of polynomials in displacement and velocity, by pysindy.

The acceleration of each degree of freedom is regressed on all monomials of displacements and velocities up to degree
three, and on the known forces, and few of these terms are kept (Brunton, Proctor and Kutz, PNAS 113 (2016) 3932-3937).

* Derivatives are those of a smoothing spline, smoothed as in LS with ``derivative="spline"``. ``form="weak"`` regresses
  integrals over test functions in place of accelerations (:func:`methods.regression.weak.weak_rows`).
* Terms are selected one by one by forward orthogonal least squares (FROLS of pysindy; Billings, Nonlinear System
  Identification, 2013, chapter 3).
* Their number is chosen as by Mangan, Kutz, Brunton and Proctor (Proceedings of the Royal Society A 473 (2017)
  20170009): each sparse model is simulated, here from the smoothed state near the beginning of the record, and the one
  of least corrected Akaike criterion, ``N log(mean squared misfit) + 2 k N/(N - k - 1)``, is kept.
* The sparse model ``x'' = g(x, x', f)`` has no mass or stiffness. Its acceleration along the smoothed motion is
  inserted into the equation of motion, and the parameters are the least-squares solution, as in LS. Terms outside the
  equation of motion are thus projected onto its terms.

A known initial state is used to choose the smoothing. The prior is not used. The uncertainty is the spread of a
parametric bootstrap that repeats the selection of terms. The message names the selected terms; the trace
``coefficients`` (n_dof, n_terms) has their coefficients in the problem's units, the trace ``powers`` (n_monomials,
2 n_dof) the powers of each monomial; forces follow the monomials.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import ClassVar, Literal

import numpy as np

from bench import Card, Dimension, Estimate, InputError, NoEstimate, Scope, Status, rk4
from methods.regression.derivatives import Motion
from methods.regression.equation import Regression, solve
from methods.regression.hausman import bias_warnings
from methods.regression.identifier import MOST_AT_ONCE, RegressionIdentifier, answer, bootstrap_covariances
from methods.regression.smoothing import SMOOTHERS, SplineFits, smoothing_again, spline_fits
from methods.regression.weak import weak_rows

RADIANS_A_STEP = 0.35
"""Step of the fourth-order integrator, with a phase error of some 4e-5 radians per step, far below the noise."""
DEPENDENT = 1e-12
"""A term is dependent on the selected ones if its squared residual after them is below this fraction."""
RIDGE = 1e-14
"""Regularisation of the normal equations of unit columns, for nearly dependent terms."""
EXACT = 1e-3
"""Misfits below this fraction of the motion are due to smoothing and integration and count as equal."""


@dataclass(frozen=True)
class SINDy(RegressionIdentifier):
    """Sparse identification; ``degree`` of the library, ``most_terms`` per equation, ``bootstrap`` synthetic records.

    ``form="weak"`` regresses integrals over test functions in place of accelerations.
    """

    degree: int = 3
    most_terms: int = 8
    bootstrap: int = 40
    form: Literal["strong", "weak"] = "strong"

    version: ClassVar[int] = 2
    """2: smoothing splines are accurate at irregular times and for the weak form."""
    card: ClassVar[Card] = Card(
        summary="pysindy: greedy sparse regression (FROLS) on cubic polynomials of a smoothing spline's motion",
        start="used when known",
        scale="groups",
        reconstruction="simulated",
        uncertainty="covariance of a parametric bootstrap, terms selected again: spread only; Hausman's test warns",
        settings_source="number of terms: least AICc of the simulated model; smoothing: as ls with derivative=spline",
        tuning="on 3 development systems (damping 3-26 %, 2.7-5.4 cycles) at 40-5 dB compared STLSQ and FROLS, BIC of "
        "the simulated response (initial state fixed or fitted), of the regression, and AICc of the response",
        title="SINDy",
        order=150,
        states_terms=True,
        variants={
            "sindy_weak": {
                "summary": "SINDy in weak form (WSINDy): integrals over test functions in place of accelerations",
                "settings_source": "test functions as in Messenger and Bortz (2021); number of terms: as sindy",
                "tuning": "on 5 development systems (damping 1-60 %) at 35 and 15 dB compared supports of 20, 35 % of "
                "the record and of 1, 1.5 and 2 periods, x and v from samples or spline, rows weighted by their noise",
                "title": "SINDy, weak form",
                "order": 155,
            }
        },
    )
    scope: ClassVar[Scope] = Scope(several_records=True, several_channels=True, offsets=True, max_dof=None)
    requires: ClassVar[tuple[str, ...]] = ("pysindy",)
    extra: ClassVar[str] = "sindy"

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, value in (("most_terms", self.most_terms), ("degree", self.degree)):
            if value < 1:
                raise InputError(f"method.{name}", value, "at least 1")

    @property
    def records_held(self) -> int:
        return MOST_AT_ONCE  # one problem at a time, since the number of models differs

    def fit(self, regression: Regression, rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Select the terms for one problem, and again for each of its synthetic records."""
        splines = spline_fits(regression)
        library = _Library.of(regression, self.degree, self.form == "weak")
        curves = Curves.of(regression, int(splines.smoother[0]), splines.weight)
        models = library.sparse_models(curves, self.most_terms)
        best = library.best(models[None], curves)
        unknowns = library.projected(curves, best)
        covariances = bootstrap_covariances(
            regression,
            splines.centres,
            splines.noise,
            lambda data: library.refit(data, splines, len(models)),
            rngs,
            self.bootstrap,
        )
        ((warning, hopeless),) = bias_warnings(regression, unknowns, covariances, splines)
        message = warning if hopeless else "; ".join(filter(None, [warning, library.sentence(best[0])]))
        traces = {"coefficients": best[0], "powers": library.powers.astype(float)}
        dimensions = {"coefficients": library.dimensions()}
        return [answer(regression, unknowns[0], covariances[0], message, hopeless, traces, dimensions)]


@dataclass(frozen=True, eq=False)
class Curves:
    """Data sets with the smoothed motion of each record, and ``samples`` (n_dof, sets, rows) at its times."""

    data: Regression
    motions: list[Motion]
    samples: list[np.ndarray]

    @staticmethod
    def of(data: Regression, smoother: int, weights: np.ndarray) -> Curves:
        """Smooth all sets by a smoother at weights (sets,), both given as indices."""
        trim = SMOOTHERS[smoother][1]
        samples = [y[..., trim : y.shape[2] - trim] for y in data.values]
        return Curves(data, data.splines(SMOOTHERS[smoother], weights), samples)

    def split(self, rows: np.ndarray, axis: int) -> list[np.ndarray]:
        """Split an axis of all records' rows into records."""
        return np.split(rows, np.cumsum([motion.times.size for motion in self.motions])[:-1], axis=axis)


@dataclass(frozen=True, eq=False)
class _Library:
    """Monomials of displacements and velocities, ``powers`` (n_monomials, 2 n_dof), and forces on DOFs ``pushed``."""

    n_dof: int
    powers: np.ndarray
    pushed: list[int]
    weak: bool

    @staticmethod
    def of(regression: Regression, degree: int, weak: bool) -> _Library:
        """Return the library; it has a constant only where a sensor's offset is unknown."""
        import pysindy

        n = regression.system.n_dof
        offset = any(c.offset for record in regression.records for c in record.channels)
        polynomials = pysindy.PolynomialLibrary(degree=degree, include_bias=offset).fit(np.zeros((2, 2 * n)))
        acting = {f.dof for r in regression.records for f in r.forces if np.any(f.values)}
        return _Library(n, np.array(polynomials.powers_), sorted(acting), weak)

    @cached_property
    def _factors(self) -> np.ndarray:
        """Return the indices of the states in each monomial, (degree, n_monomials); index 2 n_dof means 1."""
        states = [np.repeat(np.arange(row.size), row) for row in self.powers]
        degree = int(self.powers.sum(1).max())
        return np.array([np.pad(s, (0, degree - s.size), constant_values=2 * self.n_dof) for s in states]).T

    def terms(self, states: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Return library terms (terms, ...) at states (2 n_dof, ...) under forces (n_dof, ...)."""
        with_one = np.concatenate([states, np.ones_like(states[:1])])
        monomials = with_one.take(self._factors[0], axis=0)
        for factor in self._factors[1:]:
            monomials *= with_one.take(factor, axis=0)
        if not self.pushed:
            return monomials
        pushed = np.broadcast_to(force[self.pushed], (len(self.pushed), *states.shape[1:]))
        return np.concatenate([monomials, pushed])

    def features(self, curves: Curves) -> np.ndarray:
        """Return library terms (sets, rows, terms) along the motions of all records."""
        parts = []
        for motion in curves.motions:
            force = np.zeros((self.n_dof, *motion.x.shape[1:])) if motion.force is None else motion.force
            parts.append(self.terms(np.concatenate([motion.x, motion.v]), force))
        return np.moveaxis(np.concatenate(parts, axis=2), 0, -1)

    def rows(self, curves: Curves) -> tuple[np.ndarray, np.ndarray]:
        """Return library terms (sets, rows, terms) and target (n_dof, sets, rows) of all records."""
        features = self.features(curves)
        if not self.weak:
            return features, np.concatenate([motion.a for motion in curves.motions], axis=-1)
        linear = np.array([np.flatnonzero((self.powers == row).all(1))[0] for row in np.eye(2 * self.n_dof)])
        records = zip(curves.motions, curves.samples, curves.split(features, 1), strict=True)
        parts = [weak_rows(motion, y, part, linear) for motion, y, part in records]
        return np.concatenate([rows for rows, _ in parts], axis=1), np.concatenate([a for _, a in parts], axis=-1)

    def sparse_models(self, curves: Curves, most_terms: int) -> np.ndarray:
        """Return models (sizes, n_dof, terms) of 1, 2, ... terms by FROLS; NoEstimate for too few samples."""
        from pysindy import FROLS

        features, target = self.rows(curves)
        features, target = features[0], target[:, 0].T
        if features.shape[0] <= features.shape[1]:
            lost = sum(t.size for t in curves.data.times) - sum(motion.times.size for motion in curves.motions)
            sentence = (
                f"its library of {features.shape[1]} terms requires at least {features.shape[1] + 1 + lost} samples"
            )
            raise NoEstimate(sentence, Status.UNSUPPORTED)
        norms, size = np.linalg.norm(features, axis=0), np.linalg.norm(target, axis=0)
        if not np.all(size > 0):
            raise NoEstimate("the smoothed motion has no acceleration: more samples or less noise are required")
        present = np.flatnonzero(norms > 0)  # a force between samples gives a column of zeros
        most = min(most_terms, present.size - 1)
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            # unit norms change the rounding of the greedy selection, not its result
            sparse = FROLS(alpha=0.0, max_iter=most, unbias=False).fit(
                features[:, present] / norms[present], target / size
            )
        models = np.zeros((most, size.size, norms.size))
        models[..., present] = np.stack(sparse.history_[1 : most + 1]) * size[:, None] / norms[present]
        return models

    def best(self, models: np.ndarray, curves: Curves) -> np.ndarray:
        """Select from models (sets, sizes, n_dof, terms) one per set by the corrected Akaike criterion."""
        count, samples = np.count_nonzero(models, axis=(2, 3)), sum(record.n for record in curves.data.records)
        score = 2.0 * count * samples / np.maximum(samples - count - 1, 1e-3)
        for i, y in enumerate(curves.samples):
            with np.errstate(all="ignore"):
                square = np.mean((self._simulated(models, curves, i) - y[:, :, None]) ** 2, axis=-1)
                floor = EXACT**2 * np.var(y, axis=-1)[..., None]
                score = score + np.sum(y.shape[-1] * np.log(np.maximum(square, floor)), axis=0)
        chosen = np.argmin(np.where(np.isfinite(score), score, np.inf), axis=1)
        return models[np.arange(len(models)), chosen]

    def _simulated(self, models: np.ndarray, curves: Curves, number: int) -> np.ndarray:
        """Simulate displacements (n_dof, sets, sizes, rows) from each motion's first state by Runge-Kutta steps."""
        times, x, v, a = curves.motions[number][:4]
        record, n = curves.data.records[number], self.n_dof
        rate = np.sqrt(np.mean(a**2) / np.mean(v**2))

        def slope(components: Sequence[np.ndarray], time: float) -> list[np.ndarray]:
            (state,), force = components, np.array(record.force(np.array(time), n)).reshape(n, 1, 1)
            return [np.concatenate([state[n:], np.einsum("szdk,ksz->dsz", models, self.terms(state, force))])]

        state = np.repeat(np.concatenate([x[..., :1], v[..., :1]]), models.shape[1], axis=2)
        path = [state[:n]]
        with np.errstate(all="ignore"):
            for start, end in pairwise(times):
                steps = int(np.clip(np.ceil((end - start) * rate / RADIANS_A_STEP), 1, 100))
                h = (end - start) / steps
                for t in start + h * np.arange(steps):
                    (state,) = rk4(slope, [state], h, (t, t + h / 2, t + h))
                path.append(state[:n])
        return np.stack(path, axis=-1)

    def projected(self, curves: Curves, models: np.ndarray) -> np.ndarray:
        """Return the unknowns (sets, q) for the accelerations of models (sets, n_dof, terms)."""
        accelerations = curves.split(np.einsum("sdk,srk->dsr", models, self.features(curves)), -1)
        replaced = [motion._replace(a=a) for motion, a in zip(curves.motions, accelerations, strict=True)]
        return solve(*curves.data.equations(replaced))

    def refit(self, data: Regression, fits: SplineFits, most_terms: int) -> np.ndarray:
        """Return the unknowns (sets, q) of synthetic data, with a new selection of terms."""
        smoother, weight = smoothing_again(data, fits)
        unknowns = np.full((data.sets, fits.unknowns.shape[1]), np.nan)
        for number in np.unique(smoother):
            sets = smoother == number
            curves = Curves.of(data[sets], number, weight[sets])
            features, target = self.rows(curves)
            if features.shape[1] > features.shape[2]:
                models = np.stack([greedy(features, a, most_terms) for a in target], axis=2)
                unknowns[sets] = self.projected(curves, self.best(models, curves))
        return unknowns

    @cached_property
    def names(self) -> list[str]:
        """Return the names of the terms, e.g. ``x^2 v``."""
        n = self.n_dof
        state = ["x", "v"] if n == 1 else [f"{s}{i + 1}" for s in "xv" for i in range(n)]
        words = [[f"{s}^{p}" if p > 1 else s for s, p in zip(state, row, strict=True) if p] for row in self.powers]
        return [" ".join(word) or "1" for word in words] + [f"f{i + 1}" if n > 1 else "f" for i in self.pushed]

    def sentence(self, model: np.ndarray) -> str:
        """Return a message that names the selected terms of a model (n_dof, terms)."""
        kept = [", ".join(name for name, c in zip(self.names, row, strict=True) if c) or "none" for row in model]
        of_dof = kept if len(kept) == 1 else [f"{row} (DOF {i + 1})" for i, row in enumerate(kept)]
        return f"terms kept of {len(self.names)}: " + "; ".join(of_dof)

    def dimensions(self) -> list[Dimension]:
        """Return the dimension of each coefficient: of an acceleration over that of the term."""
        orders = zip(self.powers.sum(1), self.powers[:, self.n_dof :].sum(1), strict=True)
        monomials = [Dimension(0.0, 1.0 - float(length), float(velocity) - 2.0) for length, velocity in orders]
        return monomials + [Dimension(mass=-1.0)] * len(self.pushed)


def greedy(features: np.ndarray, target: np.ndarray, most: int) -> np.ndarray:
    """Return models of 1 to ``most`` terms, (sets, most, terms), of features (sets, rows, terms), target (sets, rows).

    Each step selects the term that, orthogonalised against the selected ones, explains most of the target. This is the
    vectorised form of ``pysindy.FROLS(alpha=0)`` for the bootstrap; a test compares the two. Dependent terms are never
    selected; where no other term remains, larger models repeat the last one.
    """
    norms = np.linalg.norm(features, axis=1)
    norms = np.where(norms > 0, norms, 1.0)
    columns = features / norms[:, None]
    residual, sets = columns.copy(), np.arange(len(features))
    gram, moment = np.swapaxes(columns, 1, 2) @ columns, np.einsum("srk,sr->sk", columns, target)
    selected, models = np.zeros(norms.shape, bool), []
    for _ in range(most):
        power = np.sum(residual**2, axis=1)
        free = ~selected & (power > DEPENDENT)
        gain = np.where(free, np.einsum("srk,sr->sk", residual, target) ** 2 / np.where(free, power, 1.0), -1.0)
        best = np.argmax(gain, axis=1)
        selected[sets, best] |= free[sets, best]
        taken = residual[sets, :, best] / np.sqrt(np.maximum(power[sets, best], 1e-300))[:, None]
        residual = residual - taken[:, :, None] * np.einsum("sr,srk->sk", taken, residual)[:, None]
        eye = np.eye(norms.shape[1])
        square = (
            np.where(selected[:, :, None] & selected[:, None, :], gram, 0.0)
            + np.where(selected, RIDGE, 1.0)[:, None] * eye
        )
        solution = np.linalg.solve(square, np.where(selected, moment, 0.0)[..., None])[..., 0]
        models.append(solution / norms)
    return np.stack(models, axis=1)
