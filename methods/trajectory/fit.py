"""Alternation of fit and noise estimation for many problems at once, and the best maximum of each.

Multiple shooting and output error maximise the same posterior, since at a solution of the continuity constraints the
states at the nodes of shooting are functions of parameters and initial state. Both use this module with the guesses of
:mod:`methods.trajectory.screening`. All problems and guesses are searched together by Levenberg-Marquardt: fit,
``sigma² = RSS / (N - p)``, and repeat until convergence; p is the number of directions that the data determine,
``trace(H_data H^-1)``.

Where all parameters are identifiable without a prior (a known force, an added mass), the likelihood may have no maximum
at positive parameters, for instance if noise hides the damping; a very wide prior about the first guess is then used.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench import SIGMA_FLOOR, Cost, Estimate, OutputError, SimulatedData, degrees_used, estimate_at
from methods.starts.wide_prior import left_open, very_wide
from methods.trajectory.screening import Guesses, Rules

LEFT = 1e-6
"""Largest remaining decrease of minus twice the log-posterior at a maximum."""
LEFT_AT_KINKS = 1e-3
"""The same for a non-smooth system, whose likelihood has kinks where predicted decreases are not reached."""
WIDE_PRIOR = (
    "the likelihood has no maximum at positive parameters: a prior of a factor of 20 about the first guess was used"
)
OPEN = "the data do not determine a parameter, so no uncertainty is given"


@dataclass(frozen=True, eq=False)
class Maximum:
    """A maximum ``theta`` of the posterior, with residuals (N,), slopes (N, size) of the predictions, and noise there.

    ``covariance``: inverse of the Gauss-Newton Hessian, None where it is singular. ``used``: degrees of freedom used by
    the data. ``certificate``: see :class:`Fits`. ``objectives``: minus the log posterior at the end of each search.
    ``converged``: the search (of a linear system, that from every guess) ended at a maximum. ``done``: it ended before
    the iteration limit.
    """

    model: OutputError
    theta: np.ndarray
    residuals: np.ndarray
    slopes: np.ndarray
    sigma: np.ndarray
    covariance: np.ndarray | None
    used: float
    iterations: int
    certificate: float
    message: str = ""
    objectives: tuple[float, ...] = ()
    converged: bool = True
    done: bool = True

    def estimate(self) -> Estimate:
        """Return the estimate; without uncertainty, and with a message, where the covariance is None."""
        cost = Cost(self.iterations, self.iterations)
        message = "; ".join(filter(None, [self.message, OPEN if self.covariance is None else ""]))
        estimate = estimate_at(self.model, self.theta, self.covariance, self.used, cost, message)
        traces = {"start_objectives": np.sort(self.objectives), "certificate": np.array([self.certificate])}
        return replace(estimate, traces=traces)


def best_maxima(
    models: Sequence[OutputError], batch: OutputError, guesses: Guesses, rules: Rules
) -> list[Maximum | None]:
    """Fit a batch from its guesses; return the best end of each problem, None where no guess has a finite response."""
    if not guesses.cases.size:
        return [None] * len(models)
    fits = fit(batch, guesses.cases, guesses.thetas, rules, guesses.sigma)
    places = [np.flatnonzero((guesses.cases == i) & np.isfinite(fits.profile)) for i in range(len(models))]
    solved = [i for i, ends in enumerate(places) if ends.size]
    best = np.array([places[i][np.argmin(fits.profile[places[i]])] for i in solved], int)
    covariances = batch[guesses.cases[best]].covariances(fits.point[best], fits.sigma[best])
    maxima: list[Maximum | None] = [None] * len(models)
    for i, place, covariance in zip(solved, best, covariances, strict=True):
        model = models[i]
        wanted = np.flatnonzero(guesses.cases == i) if model.system.linear else place
        maxima[i] = Maximum(
            model=model,
            theta=fits.point.theta[place],
            residuals=model.data - fits.point.predicted[place],
            slopes=fits.point.slopes[place],
            sigma=fits.sigma[place],
            covariance=covariance,
            used=float(fits.used[place]),
            iterations=int(fits.iterations[places[i]].sum()),
            certificate=float(fits.certificates[place]),
            objectives=tuple(map(float, 0.5 * fits.profile[places[i]])),
            converged=bool(np.all(fits.converged[wanted])),
            done=bool(fits.done[place]),
        )
    return maxima


@dataclass(frozen=True, eq=False)
class Fits:
    """The ends of the searches of all cases.

    ``sigma``: noise of the residuals, without a floor. ``profile``: minus twice the log-posterior. ``settled``: the
    alternation of fit and noise converged. ``certificates``: ``‖Jᵀ r‖ / (‖J‖ ‖r‖)`` of the standardised residuals, with
    J in the Frobenius norm; zero at a minimum.
    """

    point: SimulatedData
    sigma: np.ndarray
    used: np.ndarray
    profile: np.ndarray
    iterations: np.ndarray
    converged: np.ndarray
    done: np.ndarray
    settled: np.ndarray
    certificates: np.ndarray


def fit(
    batch: OutputError, cases: np.ndarray, thetas: np.ndarray, rules: Rules, first_sigma: np.ndarray | None = None
) -> Fits:
    """Alternate fit and noise estimation until the noise converges, independently for each case.

    Args:
        batch: The models of all problems.
        cases: Index of the problem of each case, (cases,).
        thetas: Initial guess of each case, (cases, size).
        rules: Settings of the search.
        first_sigma: Initial noise, (cases, channels); that of the residuals where None.
    """
    most_left = LEFT if batch.system.linear or batch.system.smooth else LEFT_AT_KINKS
    current, n, samples = batch.for_screening(cases, thetas), cases.size, batch.channel_of.size
    point = current[cases].point(thetas)
    used, iterations = np.full(n, float(batch.size)), np.zeros(n, int)
    residuals = batch.data[cases] - point.predicted
    converged = np.all(np.isfinite(residuals), axis=1)
    done, settled, going = converged.copy(), np.zeros(n, bool), np.flatnonzero(converged)
    sigma, searched_at = np.ones((n, batch.counts.size)), np.ones((n, batch.counts.size))
    sigma[going] = (
        batch[cases[going]].noise(residuals[going], used[going]) if first_sigma is None else first_sigma[going]
    )
    for _ in range(rules.sigma_rounds if going.size else 0):
        chosen = cases[going]
        batch = batch.refined(chosen, point.theta[going], batch[chosen].noise(residuals[going], used[going], 0.0))
        if batch is not current:
            current = batch
            point.put(going, batch[chosen].point(point.theta[going]))
        model = batch[chosen]
        reached, end = model.search(point[going], sigma[going], rules.iterations, rules.damping)
        point.put(going, reached)
        iterations[going] += end.iterations
        finite = np.isfinite(end.point.cost)
        converged[going], done[going] = finite & (end.left < most_left), end.done
        used[going[finite]] = degrees_used(end.point.slopes[finite], samples)
        residuals[going] = model.data - reached.predicted
        before = searched_at[going] = sigma[going]
        sigma[going] = model.noise(residuals[going], used[going])
        moved = np.max(np.abs(np.log(sigma[going] / before)), axis=1) >= rules.sigma_tolerance
        # integration steps are too long where the motion became faster or the fit better
        coarse = batch.coarse(chosen, reached.theta, model.noise(residuals[going], used[going], 0.0))
        settled[going] = finite & end.done & ~(moved | coarse)
        going = going[finite & end.done & (moved | coarse)]
        if not going.size:
            break
    ended = np.flatnonzero(converged & batch.system.linear)
    if ended.size:
        reached, _ = batch[cases[ended]].search(point[ended], searched_at[ended], 0, polished=True)
        point.put(ended, reached)
        residuals[ended] = batch.data[cases[ended]] - reached.predicted
    model = batch[cases]
    free, profile = model.noise(residuals, used, 0.0), model.profile_of(point.theta, residuals)
    standardised = model.standardised(point, np.maximum(free, SIGMA_FLOOR * model.rms))
    gradient = np.linalg.norm(np.swapaxes(standardised.slopes, 1, 2) @ standardised.residuals[..., None], axis=(1, 2))
    lengths = np.linalg.norm(standardised.slopes, axis=(1, 2)) * np.linalg.norm(standardised.residuals, axis=1)
    certificates = gradient / np.maximum(lengths, 1e-300)
    return Fits(point, free, used, profile, iterations, converged, done, settled, certificates)


def with_wide_prior(
    maximum: Maximum, first: np.ndarray, join: Callable[[Sequence[OutputError]], OutputError], rules: Rules
) -> Maximum | None:
    """Fit again with a very wide prior where the data do not determine a parameter; otherwise return the maximum.

    The prior is centred at the ``first`` guess for undetermined parameters, and at the maximum for the others. ``join``
    returns a batch of one problem. None where the second search has no finite end.
    """
    model, k = maximum.model, len(maximum.model.free)
    which = leaves_open(maximum)
    if not np.any(which):
        return maximum
    theta = maximum.theta.copy()
    theta[:k] = np.where(which, first[:k], theta[:k])
    prior = very_wide({name: float(value) for name, value in model.parameters(theta).items()})
    wide = OutputError(replace(model.problem, prior=prior))
    again = best_maxima([wide], join([wide]), Guesses.of_one([theta]), rules)[0]
    if again is None:
        return None
    return replace(again, iterations=maximum.iterations + again.iterations, message=WIDE_PRIOR)


def leaves_open(maximum: Maximum) -> np.ndarray:
    """Return which log-parameters are determined less by the data than by the very wide prior; none with a prior."""
    model, k = maximum.model, len(maximum.model.free)
    if model.prior is not None or not model.problem.scale_known:
        return np.zeros(k, bool)
    return np.ones(k, bool) if maximum.covariance is None else left_open(np.diag(maximum.covariance)[:k])
