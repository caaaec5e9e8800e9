"""SINDy: sparse regression on a library of polynomials in displacement and velocity, by pysindy.

The acceleration of each degree of freedom is regressed on all monomials of displacements and velocities up to degree
three, and on the known forces, and few of them are kept (Brunton, Proctor and Kutz, PNAS 113 (2016) 3932-3937). The
library holds more than the equation of motion: sparsity has to find it.

* Derivatives decide everything on few samples. They are those of a smoothing spline, smoothed as in LS with
  ``derivative="spline"``. ``form="weak"`` regresses integrals over test functions in place of accelerations
  (:func:`methods.regression.weak.weak_rows`).
* Terms are taken one by one by forward orthogonal least squares (FROLS of pysindy; Billings, Nonlinear System
  Identification, 2013, chapter 3): each time the one that explains most of what is left of the acceleration.
* How many is decided as Mangan, Kutz, Brunton and Proctor do (Proceedings of the Royal Society A 473 (2017) 20170009):
  each sparse model is simulated, here from the smoothed state near the start of the record, and the one of least
  corrected Akaike criterion against the samples, ``N log(mean squared misfit) + 2 k N/(N - k - 1)``, is kept.
* The sparse model ``x'' = g(x, x', f)`` has no mass or spring. Its acceleration along the smoothed motion is put into
  the equation of motion, and the parameters are the least-squares solution, as in LS. Terms that the equation of motion
  does not have are thus projected onto those that it has.

A known initial state is used in choosing the smoothing. The prior is not used. The uncertainty is a parametric
bootstrap's spread, terms chosen again each time. The terms kept are in the message, and as numbers in the trace
``coefficients`` (n_dof, n_terms), in the problem's units, with the powers of each monomial in the trace ``powers``
(n_monomials, 2 n_dof); forces follow the monomials.
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
from methods.regression.hausman import doubts
from methods.regression.identifier import MOST_AT_ONCE, RegressionIdentifier, answer, bootstrap_covariances
from methods.regression.smoothing import SMOOTHERS, SplineFits, smoothing_again, spline_fits
from methods.regression.weak import weak_rows

RADIANS_A_STEP = 0.35
"""Step of the fourth-order integrator: its error, a phase of some 4e-5 radians a step, is far below the noise."""
DEPENDENT = 1e-12
"""A term of which the terms taken leave less than this part, squared, is one of their combinations."""
RIDGE = 1e-14
"""Added to products of columns of length one, which terms that nearly depend on each other make singular."""
EXACT = 1e-3
"""A misfit below this part of the motion is that of smoothing and integration: no further term is called for."""


@dataclass(frozen=True)
class SINDy(RegressionIdentifier):
    """Sparse identification; ``degree`` of the library, ``most_terms`` of an equation, ``bootstrap`` data sets.

    ``form="weak"`` regresses integrals over test functions in place of accelerations.
    """

    degree: int = 3
    most_terms: int = 8
    bootstrap: int = 40
    form: Literal["strong", "weak"] = "strong"

    version: ClassVar[int] = 2
    """2: its smoothing splines are exact to rounding, which decided irregular times and the weak form before."""
    card: ClassVar[Card] = Card(
        summary="pysindy: greedy sparse regression (FROLS) on cubic polynomials of a smoothing spline's motion",
        start="used when known",
        scale="groups",
        reconstruction="simulated",
        uncertainty="covariance of a parametric bootstrap, terms chosen anew: spread only; a bias beyond it is said",
        settings_source="number of terms: least AICc of the simulated model; smoothing: as ls with derivative=spline",
        tuning="on 3 development systems (damping 3-26 %, 2.7-5.4 cycles) at 40-5 dB tried STLSQ and FROLS, and BIC of "
        "the simulated response (start fixed or fitted), BIC of the regression, AICc of the simulated response",
        title="SINDy",
        order=150,
        states_terms=True,
        variants={
            "sindy_weak": {
                "summary": "SINDy in weak form (WSINDy): integrals over test functions in place of accelerations",
                "settings_source": "test functions as in Messenger and Bortz (2021); number of terms: as sindy",
                "tuning": "on 5 development systems (damping 1-60 %) at 35 and 15 dB tried supports of 20 and 35 % of "
                "the record and of 1, 1.5 and 2 periods, x and v from samples or spline, rows weighed by their noise",
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
        """Choose the terms of one problem, and again of its synthetic records."""
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
        ((doubt, hopeless),) = doubts(regression, unknowns, covariances, splines)
        message = doubt if hopeless else "; ".join(filter(None, [doubt, library.sentence(best[0])]))
        traces = {"coefficients": best[0], "powers": library.powers.astype(float)}
        dimensions = {"coefficients": library.dimensions()}
        return [answer(regression, unknowns[0], covariances[0], message, hopeless, traces, dimensions)]


@dataclass(frozen=True, eq=False)
class Curves:
    """Data sets with their smoothed motion a record, and the ``samples`` (n_dof, sets, rows) at its times."""

    data: Regression
    motions: list[Motion]
    samples: list[np.ndarray]

    @staticmethod
    def of(data: Regression, smoother: int, weights: np.ndarray) -> Curves:
        """Smooth all sets by the smoother of a number, at the weights of numbers (sets,)."""
        trim = SMOOTHERS[smoother][1]
        samples = [y[..., trim : y.shape[2] - trim] for y in data.values]
        return Curves(data, data.splines(SMOOTHERS[smoother], weights), samples)

    def split(self, rows: np.ndarray, axis: int) -> list[np.ndarray]:
        """Split what stands record by record on an axis."""
        return np.split(rows, np.cumsum([motion.times.size for motion in self.motions])[:-1], axis=axis)


@dataclass(frozen=True, eq=False)
class _Library:
    """Monomials of displacements and velocities, ``powers`` (n_monomials, 2 n_dof), and the forces on ``pushed``."""

    n_dof: int
    powers: np.ndarray
    pushed: list[int]
    weak: bool

    @staticmethod
    def of(regression: Regression, degree: int, weak: bool) -> _Library:
        """Make the library; a constant is in it only where a sensor's offset is unknown."""
        import pysindy

        n = regression.system.n_dof
        offset = any(c.offset for record in regression.records for c in record.channels)
        polynomials = pysindy.PolynomialLibrary(degree=degree, include_bias=offset).fit(np.zeros((2, 2 * n)))
        acting = {f.dof for r in regression.records for f in r.forces if np.any(f.values)}
        return _Library(n, np.array(polynomials.powers_), sorted(acting), weak)

    @cached_property
    def _factors(self) -> np.ndarray:
        """The states whose product each monomial is, (degree, n_monomials); 2 n_dof stands for 1."""
        states = [np.repeat(np.arange(row.size), row) for row in self.powers]
        degree = int(self.powers.sum(1).max())
        return np.array([np.pad(s, (0, degree - s.size), constant_values=2 * self.n_dof) for s in states]).T

    def terms(self, states: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Library terms (terms, ...) at states (2 n_dof, ...) under forces (n_dof, ...)."""
        with_one = np.concatenate([states, np.ones_like(states[:1])])
        monomials = with_one.take(self._factors[0], axis=0)
        for factor in self._factors[1:]:
            monomials *= with_one.take(factor, axis=0)
        if not self.pushed:
            return monomials
        pushed = np.broadcast_to(force[self.pushed], (len(self.pushed), *states.shape[1:]))
        return np.concatenate([monomials, pushed])

    def features(self, curves: Curves) -> np.ndarray:
        """Library terms (sets, rows, terms) along the motions of all records."""
        parts = []
        for motion in curves.motions:
            force = np.zeros((self.n_dof, *motion.x.shape[1:])) if motion.force is None else motion.force
            parts.append(self.terms(np.concatenate([motion.x, motion.v]), force))
        return np.moveaxis(np.concatenate(parts, axis=2), 0, -1)

    def rows(self, curves: Curves) -> tuple[np.ndarray, np.ndarray]:
        """Library terms (sets, rows, terms) and target (n_dof, sets, rows) of the regression over all records."""
        features = self.features(curves)
        if not self.weak:
            return features, np.concatenate([motion.a for motion in curves.motions], axis=-1)
        linear = np.array([np.flatnonzero((self.powers == row).all(1))[0] for row in np.eye(2 * self.n_dof)])
        records = zip(curves.motions, curves.samples, curves.split(features, 1), strict=True)
        parts = [weak_rows(motion, y, part, linear) for motion, y, part in records]
        return np.concatenate([rows for rows, _ in parts], axis=1), np.concatenate([a for _, a in parts], axis=-1)

    def sparse_models(self, curves: Curves, most_terms: int) -> np.ndarray:
        """Models (sizes, n_dof, terms) of 1, 2, ... terms by pysindy's FROLS. Raises NoEstimate for too few samples."""
        from pysindy import FROLS

        features, target = self.rows(curves)
        features, target = features[0], target[:, 0].T
        if features.shape[0] <= features.shape[1]:
            lost = sum(t.size for t in curves.data.times) - sum(motion.times.size for motion in curves.motions)
            sentence = f"its library of {features.shape[1]} terms needs at least {features.shape[1] + 1 + lost} samples"
            raise NoEstimate(sentence, Status.UNSUPPORTED)
        norms, size = np.linalg.norm(features, axis=0), np.linalg.norm(target, axis=0)
        if not np.all(size > 0):
            raise NoEstimate("the smoothed motion has no acceleration: take more samples or less noise")
        there = np.flatnonzero(norms > 0)  # not a force that acts between the samples alone
        most = min(most_terms, there.size - 1)
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            # columns and target of unit norm: the greedy selection does not depend on them, its rounding does
            sparse = FROLS(alpha=0.0, max_iter=most, unbias=False).fit(features[:, there] / norms[there], target / size)
        models = np.zeros((most, size.size, norms.size))
        models[..., there] = np.stack(sparse.history_[1 : most + 1]) * size[:, None] / norms[there]
        return models

    def best(self, models: np.ndarray, curves: Curves) -> np.ndarray:
        """Of models (sets, sizes, n_dof, terms), those (sets, n_dof, terms) of least corrected Akaike criterion."""
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
        """Displacements (n_dof, sets, sizes, rows) from each motion's first state, by classical Runge-Kutta steps."""
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
        """Unknowns (sets, q): the models' (sets, n_dof, terms) accelerations in the equation of motion."""
        accelerations = curves.split(np.einsum("sdk,srk->dsr", models, self.features(curves)), -1)
        replaced = [motion._replace(a=a) for motion, a in zip(curves.motions, accelerations, strict=True)]
        return solve(*curves.data.equations(replaced))

    def refit(self, data: Regression, fits: SplineFits, most_terms: int) -> np.ndarray:
        """Unknowns (sets, q) of data drawn like the fit's: the whole choice of terms again."""
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
        """The terms in words, e.g. ``x^2 v``."""
        n = self.n_dof
        state = ["x", "v"] if n == 1 else [f"{s}{i + 1}" for s in "xv" for i in range(n)]
        words = [[f"{s}^{p}" if p > 1 else s for s, p in zip(state, row, strict=True) if p] for row in self.powers]
        return [" ".join(word) or "1" for word in words] + [f"f{i + 1}" if n > 1 else "f" for i in self.pushed]

    def sentence(self, model: np.ndarray) -> str:
        """Name the terms that a model (n_dof, terms) kept."""
        kept = [", ".join(name for name, c in zip(self.names, row, strict=True) if c) or "none" for row in model]
        of_dof = kept if len(kept) == 1 else [f"{row} (DOF {i + 1})" for i, row in enumerate(kept)]
        return f"terms kept of {len(self.names)}: " + "; ".join(of_dof)

    def dimensions(self) -> list[Dimension]:
        """Dimension of each coefficient: of an acceleration over the term's own."""
        orders = zip(self.powers.sum(1), self.powers[:, self.n_dof :].sum(1), strict=True)
        monomials = [Dimension(0.0, 1.0 - float(length), float(velocity) - 2.0) for length, velocity in orders]
        return monomials + [Dimension(mass=-1.0)] * len(self.pushed)


def greedy(features: np.ndarray, target: np.ndarray, most: int) -> np.ndarray:
    """Models of 1 to ``most`` terms, (sets, most, terms), of features (sets, rows, terms) and target (sets, rows).

    Each step takes the term that, made orthogonal to those taken, explains most of the target. The vectorised twin of
    ``pysindy.FROLS(alpha=0)``, for the bootstrap; a test compares the two. A term that the ones taken already
    give is never taken; where no other is left, the larger models are the last one again.
    """
    norms = np.linalg.norm(features, axis=1)
    norms = np.where(norms > 0, norms, 1.0)
    columns = features / norms[:, None]
    left, sets = columns.copy(), np.arange(len(features))
    gram, moment = np.swapaxes(columns, 1, 2) @ columns, np.einsum("srk,sr->sk", columns, target)
    kept, models = np.zeros(norms.shape, bool), []
    for _ in range(most):
        power = np.sum(left**2, axis=1)
        free = ~kept & (power > DEPENDENT)
        gain = np.where(free, np.einsum("srk,sr->sk", left, target) ** 2 / np.where(free, power, 1.0), -1.0)
        best = np.argmax(gain, axis=1)
        kept[sets, best] |= free[sets, best]
        taken = left[sets, :, best] / np.sqrt(np.maximum(power[sets, best], 1e-300))[:, None]
        left = left - taken[:, :, None] * np.einsum("sr,srk->sk", taken, left)[:, None]
        eye = np.eye(norms.shape[1])
        square = np.where(kept[:, :, None] & kept[:, None, :], gram, 0.0) + np.where(kept, RIDGE, 1.0)[:, None] * eye
        solution = np.linalg.solve(square, np.where(kept, moment, 0.0)[..., None])[..., 0]
        models.append(solution / norms)
    return np.stack(models, axis=1)
