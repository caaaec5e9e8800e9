"""SINDy: sparse regression on a library of polynomials in displacement and velocity, by pysindy.

The acceleration of each degree of freedom is regressed on all monomials of displacements and velocities up to degree
three, and on the known forces, and few of them are kept (Brunton, Proctor and Kutz, PNAS 113 (2016) 3932-3937). The
library holds more than the equation of motion: sparsity has to find it.

* Derivatives decide everything on few samples. They are those of a smoothing spline, smoothed as in LS with
  ``derivative="spline"`` (:func:`methods.regression.bootstrap.spline_fits`).
* ``form="weak"`` regresses integrals over test functions in place of accelerations
  (:func:`methods.regression.weak.weak_rows`).
* Terms are taken one by one by forward orthogonal least squares (FROLS of pysindy; Billings, Nonlinear System
  Identification, 2013, chapter 3): each time the one that explains most of what is left of the acceleration.
* How many is decided as Mangan, Kutz, Brunton and Proctor do (Proceedings of the Royal Society A 473 (2017) 20170009):
  each sparse model is simulated, here from the smoothed state near the start of the record, and the one of least
  corrected Akaike criterion against the samples, ``N log(mean squared misfit) + 2 k N/(N - k - 1)``, is kept.
* The sparse model ``x'' = g(x, x', f)`` has no mass or spring. Its acceleration along the smoothed motion is put into
  the equation of motion, and the parameters are the least-squares solution, as in LS. Terms that the equation of motion
  does not have are thus projected onto those that it has.

Told: the equations (for that last step, and the smoothing), the samples, the known force; a told start is used in
choosing the smoothing. The prior is not used. No own reconstruction. The uncertainty is a parametric bootstrap's
spread, terms chosen anew each time. The terms kept are in the message, and as numbers in the trace ``coefficients``
(n_dof, n_terms), in the problem's units, with the powers of each monomial in the trace ``powers`` (n_monomials,
2 n_dof); forces follow the monomials.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import ClassVar, Literal

import numpy as np

from bench import Card, Dimension, Estimate, InputError, NoEstimate, Problem, Serves, Status
from methods.regression.bootstrap import SplineFit, bootstrap_covariances, smoothings, spline_fits
from methods.regression.derivatives import Motion
from methods.regression.equation import Regression, Values, answer, layout_objection, solve
from methods.regression.hausman import doubt, most_likely
from methods.regression.weak import weak_rows
from methods.starts.ambiguity import BandIdentifier

RADIANS_A_STEP = 0.35
"""Step of the fourth-order integrator: its error, a phase of some 4e-5 radians a step, is far below the noise."""

DEPENDENT = 1e-12
"""A term of which the terms taken leave less than this part, squared, is one of their combinations."""
EXACT = 1e-3
"""A misfit below this part of the motion is that of smoothing and integration: no further term is called for."""


@dataclass(frozen=True)
class SINDy(BandIdentifier):
    """Sparse identification; ``degree`` of the library, ``most_terms`` of an equation, ``bootstrap`` data sets.

    ``form="weak"`` regresses integrals over test functions in place of accelerations.
    """

    degree: int = 3
    most_terms: int = 8
    bootstrap: int = 40
    form: Literal["strong", "weak"] = "strong"

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
        colour="#009E73",
        marker="^",
        states_terms=True,
        variants={
            "sindy_weak": {
                "summary": "SINDy in weak form (WSINDy): integrals over test functions in place of accelerations",
                "settings_source": "test functions as in Messenger and Bortz (2021); number of terms: as sindy",
                "tuning": "on 5 development systems (damping 1-60 %) at 35 and 15 dB tried supports of 20 and 35 % of "
                "the record and of 1, 1.5 and 2 periods, x and v from samples or spline, rows weighed by their noise",
                "title": "SINDy, weak form",
                "order": 155,
                "colour": "#66C2A5",
                "marker": (3, 1, 180.0),
            }
        },
    )
    serves: ClassVar[Serves] = Serves(several_records=True, several_channels=True, offsets=True, max_dof=None)
    requires: ClassVar[tuple[str, ...]] = ("pysindy",)
    extra: ClassVar[str] = "sindy"
    works_in = "natural units"

    def __post_init__(self) -> None:
        if self.most_terms < 1:
            raise InputError("method.most_terms", self.most_terms, "at least 1")
        if self.degree < 1:
            raise InputError("method.degree", self.degree, "at least 1")

    def objection(self, problem: Problem) -> str | None:
        return super().objection(problem) or layout_objection(problem)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Estimate groups in free vibration, parameters with a known force."""
        regression = Regression.of(problem)
        (fit,) = spline_fits([regression])
        library = _Library.of(regression, self.degree, self.form == "weak")
        motions = regression.motions(regression.values, fit.smoother, np.array([fit.which]))
        models = library.sparse_models(motions, regression.values, fit.smoother[1], self.most_terms)
        best = library.best(models[None], motions, regression.values, fit.smoother[1])
        unknowns = library.projected(motions, best)[0]

        def fitter(values: Values) -> np.ndarray:
            return library.refit(values, fit, len(models))

        covariance = bootstrap_covariances([fit], fitter, [rng], self.bootstrap)[0]
        traces = {"coefficients": best[0], "powers": library.powers.astype(float)}
        dimensions = {"coefficients": library.dimensions()}
        said = [doubt(regression, unknowns, covariance, most_likely(regression, [fit])[0]), library.told(best[0])]
        return answer(regression, unknowns, covariance, "; ".join(filter(None, said)), traces, dimensions)


@dataclass(frozen=True, eq=False)
class _Library:
    """Monomials of displacements and velocities, ``powers`` (n_monomials, 2 n_dof), and the forces on ``pushed``."""

    regression: Regression
    powers: np.ndarray
    pushed: tuple[int, ...]
    weak: bool

    @staticmethod
    def of(regression: Regression, degree: int, weak: bool) -> _Library:
        """Make the library; a constant is in it only where a sensor's offset is unknown."""
        import pysindy

        n = regression.system.n_dof
        offset = any(c.offset for record in regression.records for c in record.channels)
        polynomials = pysindy.PolynomialLibrary(degree=degree, include_bias=offset).fit(np.zeros((2, 2 * n)))
        acting = {f.dof for r in regression.records for f in r.forces if np.any(f.values)}
        return _Library(regression, np.array(polynomials.powers_), tuple(sorted(acting)), weak)

    def features(self, motions: Sequence[Motion]) -> np.ndarray:
        """Library terms (sets, rows, terms) along the motions of all records."""
        parts = []
        for motion in motions:
            states = np.concatenate([motion.x, motion.v]).transpose(1, 2, 0)
            force = np.zeros((0, *motion.x.shape[1:])) if motion.force is None else motion.force[list(self.pushed)]
            force = np.broadcast_to(force, (len(self.pushed), *states.shape[:2]))
            parts.append(self.terms(states, np.moveaxis(force, 0, -1)))
        return np.concatenate(parts, axis=1)

    def rows(self, motions: Sequence[Motion], values: Values, trim: int) -> tuple[np.ndarray, np.ndarray]:
        """Library terms (sets, rows, terms) and target (n_dof, sets, rows) of the regression over all records."""
        features = self.features(motions)
        if not self.weak:
            return features, np.concatenate([motion.a for motion in motions], axis=-1)
        ends = np.cumsum([motion.times.size for motion in motions])[:-1]
        linear = np.array([int(np.flatnonzero((self.powers == row).all(1))[0]) for row in np.eye(self.powers.shape[1])])
        parts = [
            weak_rows(motion, y[..., trim : y.shape[2] - trim], part, linear)
            for motion, y, part in zip(motions, values, np.split(features, ends, axis=1), strict=True)
        ]
        return np.concatenate([part[0] for part in parts], axis=1), np.concatenate([part[1] for part in parts], axis=-1)

    def terms(self, states: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Library terms (..., terms) at states (..., 2 n_dof) under forces (..., n_pushed)."""
        n = len(self.powers)
        found = np.empty((n + len(self.pushed), *states.shape[:-1]))
        for i, (shorter, factor) in enumerate(self._products):
            if factor < 0:
                found[i] = 1.0
            elif shorter < 0:
                found[i] = states[..., factor]
            else:
                np.multiply(found[shorter], states[..., factor], out=found[i])
        for i in range(len(self.pushed)):
            found[n + i] = force[..., i]
        return np.moveaxis(found, 0, -1)

    @cached_property
    def _products(self) -> list[tuple[int, int]]:
        """Each monomial as (number of a shorter one, state to multiply it with); -1 for 1. They come by degree."""
        numbers = {tuple(row): i for i, row in enumerate(self.powers)}
        products = []
        for row in self.powers:
            factor = int(np.argmax(row > 0)) if np.any(row) else -1
            shorter = row - (np.arange(row.size) == factor)
            products.append((numbers[tuple(shorter)] if np.sum(row) > 1 else -1, factor))
        return products

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

    def dimensions(self) -> list[Dimension]:
        """Dimension of each coefficient: of an acceleration over the term's own."""
        velocities = self.powers[:, self.regression.system.n_dof :].sum(1)
        orders = zip(self.powers.sum(1), velocities, strict=True)
        monomials = [Dimension(0.0, 1.0 - float(length), float(velocity) - 2.0) for length, velocity in orders]
        return monomials + [Dimension(mass=-1.0)] * len(self.pushed)

    def sparse_models(self, motions: Sequence[Motion], values: Values, trim: int, most_terms: int) -> np.ndarray:
        """Models (sizes, n_dof, terms) of 1, 2, ... terms by pysindy's FROLS. Raises NoEstimate for too few samples."""
        from pysindy import FROLS

        features, target = self.rows(motions, values, trim)
        features, target = features[0], target[:, 0].T
        if features.shape[0] <= features.shape[1]:
            lost = self.regression.values[0].shape[-1] - motions[0].times.size
            needed = features.shape[1] + 1 + lost * len(motions)
            sentence = f"its library of {features.shape[1]} terms needs at least {needed} samples"
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

    def best(self, models: np.ndarray, motions: Sequence[Motion], values: Values, trim: int) -> np.ndarray:
        """Of models (sets, sizes, n_dof, terms), those (sets, n_dof, terms) of least corrected Akaike criterion."""
        count = np.count_nonzero(models, axis=(2, 3))
        samples = sum(y.shape[0] * y.shape[2] for y in values)
        score = 2.0 * count * samples / np.maximum(samples - count - 1, 1e-3)
        for i, (motion, y) in enumerate(zip(motions, values, strict=True)):
            inner = y[:, :, None, trim : y.shape[2] - trim]
            with np.errstate(all="ignore"):
                square = np.mean((self._simulated(models, i, motion) - inner) ** 2, axis=-1)
                floor = EXACT**2 * np.var(inner, axis=-1)
                score = score + np.sum(inner.shape[-1] * np.log(np.maximum(square, floor)), axis=0)
        chosen = np.argmin(np.where(np.isfinite(score), score, np.inf), axis=1)
        return models[np.arange(len(models)), chosen]

    def _simulated(self, models: np.ndarray, number: int, motion: Motion) -> np.ndarray:
        """Displacements (n_dof, sets, sizes, rows) from each motion's first state, by classical Runge-Kutta steps."""
        times, x, v, a = motion[:4]
        n, record = self.regression.system.n_dof, self.regression.records[number]
        rate = np.sqrt(np.mean(a**2) / np.mean(v**2))
        shape = models.shape[:2]
        result = np.empty((*shape, 2 * n))

        def slope(state: np.ndarray, at: float) -> np.ndarray:
            force = np.array(record.force(np.array(at), n))[list(self.pushed)] if self.pushed else np.empty(0)
            result[..., :n] = state[..., n:]
            result[..., n:] = np.einsum("...dk,...k->...d", models, self.terms(state, force))
            return result.copy()

        first = np.concatenate([x[..., 0], v[..., 0]]).T[:, None]
        state = np.broadcast_to(first, (*shape, 2 * n))
        path = [state[..., :n]]
        with np.errstate(all="ignore"):
            for start, end in pairwise(times):
                steps = int(np.clip(np.ceil((end - start) * rate / RADIANS_A_STEP), 1, 100))
                h = (end - start) / steps
                for j in range(steps):
                    t = start + j * h
                    k1 = slope(state, t)
                    k2 = slope(state + h / 2 * k1, t + h / 2)
                    k3 = slope(state + h / 2 * k2, t + h / 2)
                    k4 = slope(state + h * k3, t + h)
                    state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
                path.append(state[..., :n])
        return np.moveaxis(np.stack(path), (0, -1), (-1, 0))

    def projected(self, motions: Sequence[Motion], models: np.ndarray) -> np.ndarray:
        """Unknowns (sets, q): the models' (sets, n_dof, terms) accelerations in the equation of motion."""
        accelerations = np.einsum("sdk,srk->dsr", models, self.features(motions))
        parts = np.split(accelerations, np.cumsum([motion.times.size for motion in motions])[:-1], axis=-1)
        replaced = [motion._replace(a=a) for motion, a in zip(motions, parts, strict=True)]
        return solve(*self.regression.equations(replaced))

    def refit(self, values: Values, fit: SplineFit, most_terms: int) -> np.ndarray:
        """Unknowns (sets, q) of other data (n_dof, sets, n) a record: the whole choice of terms, made anew."""
        chosen = smoothings(self.regression, [fit], values)
        found = np.full((len(chosen), fit.unknowns.size), np.nan)
        for smoother in sorted({s for s, _ in chosen}):
            mine = np.array([s == smoother for s, _ in chosen])
            which = np.array([w for _, w in chosen])[mine]
            mine_values = [y[:, mine] for y in values]
            motions = self.regression.motions(mine_values, smoother, which)
            features, target = self.rows(motions, mine_values, smoother[1])
            if features.shape[1] > features.shape[2]:
                models = np.stack([greedy(features, a, most_terms) for a in target], axis=2)
                found[mine] = self.projected(motions, self.best(models, motions, mine_values, smoother[1]))
        return found


def _solved(square: np.ndarray, moment: np.ndarray) -> np.ndarray:
    """Coefficients (sets, terms) of normal equations; of least norm in all sets where one is singular to rounding."""
    try:
        return np.asarray(np.linalg.solve(square, moment[..., None])[..., 0])
    except np.linalg.LinAlgError:
        finite = np.all(np.isfinite(square), axis=(1, 2))
        inverse = np.linalg.pinv(np.where(finite[:, None, None], square, 0.0), hermitian=True)
        return np.where(finite[:, None], np.einsum("sjk,sk->sj", inverse, moment), np.nan)


def greedy(features: np.ndarray, target: np.ndarray, most: int) -> np.ndarray:
    """Models of 1 to ``most`` terms, (sets, most, terms), of features (sets, rows, terms) and target (sets, rows).

    Each step takes the term that, made orthogonal to those taken, explains most of the target. The vectorised twin of
    ``pysindy.FROLS(alpha=0)``, for the bootstrap; a test holds the two together. A term that the ones taken already
    give is never taken; where no other is left, the larger models are the last one again.
    """
    norms = np.linalg.norm(features, axis=1)
    norms = np.where(norms > 0, norms, 1.0)
    columns = features / norms[:, None]
    left, rows = columns.copy(), np.arange(len(features))
    gram, moment = np.swapaxes(columns, 1, 2) @ columns, np.einsum("srk,sr->sk", columns, target)
    kept, models = np.zeros(norms.shape, bool), []
    for _ in range(most):
        power = np.sum(left**2, axis=1)
        free = ~kept & (power > DEPENDENT)
        gain = np.where(free, np.einsum("srk,sr->sk", left, target) ** 2 / np.where(free, power, 1.0), -1.0)
        best = np.argmax(gain, axis=1)
        kept[rows, best] |= free[rows, best]
        taken = left[rows, :, best] / np.sqrt(np.maximum(power[rows, best], 1e-300))[:, None]
        left = left - taken[:, :, None] * np.einsum("sr,srk->sk", taken, left)[:, None]
        square = np.where(kept[:, :, None] & kept[:, None, :], gram, np.eye(norms.shape[1]))
        solution = _solved(square, np.where(kept, moment, 0.0))
        models.append(np.where(kept, solution, 0.0) / norms)
    return np.stack(models, axis=1)
