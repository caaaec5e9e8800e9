"""Bayesian sampling of the posterior with emcee (D. Foreman-Mackey et al., PASP 125:306, 2013).

Sampled together: the log-parameters, the initial states and offsets that are not told, and the logarithm of each
channel's noise. Likelihood: independent normal errors about the simulated response, all walkers at once; that of a
nonlinear system is integrated as finely as the noise asks for (:func:`methods.starts.spectral.as_fine_as_noise`).
Priors, all proper but one: the problem's nominal prior on the log-parameters (without one, a normal of standard
deviation 3, a factor of 20, about the best fit to the data); ``log sigma ~ Normal(log(rms of the channel / 10), 3²)``,
its two standard deviations reach from 70 dB to -30 dB; flat on initial states and offsets, which the data fix.

Moves: mostly independent Metropolis-Hastings with a proposal that stands on the modes of the posterior, a mixture of
multivariate Student t around each half-period that could still be true, so walkers change from one to the other;
mixed with differential evolution and snooker moves (C. ter Braak, J. Vrugt, Statistics and Computing 18:435, 2008),
which do not rely on the modes. The modes come from the data alone (:mod:`methods.starts.spectral`).

Convergence is judged over independent ensembles, each from an overdispersed start: the split R-hat of
rank-normalised draws and of their distances from the median (A. Vehtari et al., Bayesian Analysis 16:667, 2021), the
integrated autocorrelation time (emcee's estimate, A. Sokal's window), and the effective sample size that it implies.
A chain that has not converged is extended; one that never does is a failure with a sentence.

The response of a nonlinear system is integrated step by step, which takes about as long for many walkers as for few:
it has ``STEPPED`` times the walkers, in blocks of half the length.

Walkers that propose from each other mix ever more slowly as the unknowns grow beyond some ten (D. Huijser et al.,
arXiv:1509.02230). Here most moves do not, but where the posterior is far from its Laplace approximation little else is
left. The autocorrelation time against the length of the chain tells, and the sentence of a failure says so and names
the way out, a sampler with gradients.

The point value of a quantity is that of least expected squared relative error (:class:`bench.Draws`); the
reconstruction is the mean response over draws: of all curves the one of least expected square error.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from scipy.special import gammaln, logsumexp
from scipy.stats import norm, rankdata

from bench import (
    Card,
    Cost,
    Draws,
    Estimate,
    Force,
    Identifier,
    InitialState,
    Normal,
    Problem,
    Serves,
    Status,
    System,
    Units,
    report_progress,
    simulate,
)
from methods.starts.spectral import LOG_LIMIT, PRIORLESS_SD, OutputError, as_fine_as_noise, screened, silent

NOISE_CENTRE = float(np.log(0.1))
NOISE_SD = 3.0
STEPPED = 4
MANY = 10
"""Unknowns beyond which slow mixing is put down to their number."""
MODE_MARGIN = 25.0
"""A mode joins the proposal while minus twice its log-posterior is within this of the best."""


@dataclass(frozen=True)
class MCMC(Identifier):
    """Ensemble sampling; settings below, the method in the module's docstring.

    ``ensembles`` independent ensembles of at least ``walkers`` each run ``burn`` steps that are dropped, then blocks of
    ``block`` steps until converged: R-hat at most ``r_hat``, effective sample size at least ``effective`` and
    ``autocorrelations`` autocorrelation times in each chain, for every unknown; at most ``blocks`` blocks.
    ``independent`` is the share of independent moves. At most ``draws`` draws are kept, and ``curves`` of them
    are averaged in the reconstruction.
    """

    ensembles: int = 2
    walkers: int = 32
    burn: int = 20
    block: int = 60
    blocks: int = 40
    r_hat: float = 1.02
    effective: float = 400.0
    autocorrelations: float = 15.0
    independent: float = 0.8
    draws: int = 2000
    curves: int = 100

    card: ClassVar[Card] = Card(
        summary="Posterior sampling by emcee with the noise level unknown",
        start="used when known",
        scale="native",
        reconstruction="own",
        uncertainty="quantiles of the posterior draws (without a prior in free vibration: their covariance)",
        settings_source="convergence criteria from the literature; lengths for a fit in half a second",
        tuning="two shares of moves, three lengths; on development systems (40 to 5 dB, damping 2-20 %, 2-10 cycles)",
        title="Bayesian MCMC",
        order=20,
        colour="#56B4E9",
        marker="v",
    )
    serves: ClassVar[Serves] = Serves(
        measures=("displacement", "velocity", "acceleration"),
        several_records=True,
        several_channels=True,
        offsets=True,
        max_dof=None,
        added_mass=True,
        hidden_states=True,
    )
    requires: ClassVar[tuple[str, ...]] = ("emcee",)
    extra: ClassVar[str] = "mcmc"

    def identify(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """The posterior as draws of all parameters, or as a normal over the groups where no mass is known."""
        units = problem.natural_units()
        scaled = problem.expressed_in(units)
        if silent(scaled):
            return Estimate.failed(
                problem.system, Status.DIVERGED, "no sensor shows any motion; check the wiring or choose another record"
            )
        with np.errstate(all="ignore"):
            estimate = self._sample(
                OutputError(scaled),
                rng,
                lambda so_far: report_progress(problem, lambda: _in_si(problem, units, so_far())),
            )
        return _in_si(problem, units, estimate)

    def _sample(
        self, model: OutputError, rng: np.random.Generator, on_block: Callable[[Callable[[], Estimate]], None]
    ) -> Estimate:
        modes = screened(model, n=3, rounds=3, iterations=12)
        if not modes:
            return Estimate.failed(
                model.system, Status.DIVERGED, "no start gave a finite response; give a prior nearer to the system"
            )
        posterior = Posterior(as_fine_as_noise(model, modes[0][1]), modes[0][1])
        proposal = Proposal.around(posterior, [theta for value, theta in modes if value < modes[0][0] + MODE_MARGIN])
        if proposal is None:
            sentence = "the data leave a parameter open; give more samples, a known force or a prior"
            return Estimate.failed(model.system, Status.DIVERGED, sentence)
        many, few = (1, 1) if model.system.linear else (STEPPED, 2)
        burn, block = -(-self.burn // few), -(-self.block // few)
        walkers = 2 * max(many * self.walkers // 2, posterior.size + 1)
        chains = [self._ensemble(posterior, proposal, walkers, burn, rng) for _ in range(self.ensembles)]
        steps = burn
        for _ in range(self.blocks):
            for chain in chains:
                chain(block)
            steps += block
            paths = np.stack([chain.path() for chain in chains])
            health = Health.of(paths)
            if health.converged(self, paths.shape[1]):
                break
            on_block(lambda paths=paths: estimate_from_draws(posterior, self._kept(paths), {}, Cost(), self.curves))  # type: ignore[misc]
        cost = Cost(evaluations=posterior.calls, iterations=steps * self.ensembles)
        if not health.converged(self, paths.shape[1]):
            sentence = health.sentence(self, paths.shape[1], posterior.size)
            return Estimate.failed(model.system, Status.DIVERGED, sentence, cost)
        traces = {
            "r_hat": np.array([health.r_hat]),
            "effective_sample_size": np.array([health.effective]),
            "autocorrelation_time": np.array([health.time]),
        }
        return estimate_from_draws(posterior, self._kept(paths), traces, cost, self.curves)

    def _kept(self, paths: np.ndarray) -> np.ndarray:
        """So many draws of all chains, evenly spread over them."""
        flat = paths.reshape(-1, paths.shape[-1])
        return np.asarray(flat[np.linspace(0, len(flat) - 1, min(self.draws, len(flat))).astype(int)])

    def _ensemble(
        self, posterior: Posterior, proposal: Proposal, walkers: int, burn: int, rng: np.random.Generator
    ) -> Ensemble:
        return Ensemble(posterior, proposal, walkers, burn, self.independent, int(rng.integers(2**31)))


def _in_si(problem: Problem, units: Units, estimate: Estimate) -> Estimate:
    """An estimate in natural units in those of the problem, its traces too."""
    logs = estimate.traces.get("mode")
    if logs is not None:
        scales = np.log([units.scales(problem.system)[name] for name in problem.system.names])
        estimate = replace(estimate, traces={**estimate.traces, "mode": logs + scales})
    return replace(estimate, offsets=problem.offsets_from(units, estimate.offsets)).expressed_in(units.inverse)


class Posterior:
    """The log-density over ``phi = [theta, log sigma by channel]``, up to a constant; ``calls`` counts responses."""

    def __init__(self, model: OutputError, mode: np.ndarray) -> None:
        self.model, self.mode, self.calls = model, mode, 0
        self.noise_centre = NOISE_CENTRE + np.log(model.rms)
        k = len(model.free)
        self.centre = mode[:k] if model.prior is None else model.prior.log_mean
        self.sds = np.full(k, PRIORLESS_SD) if model.prior is None else model.prior.log_sds

    @property
    def size(self) -> int:
        return self.model.size + len(self.model.channels)

    def __call__(self, phi: np.ndarray) -> np.ndarray:
        """Log-density, shape (n,), of ``phi`` of shape (n, size); minus infinity where the response diverges."""
        model, d, k = self.model, self.model.size, len(self.model.free)
        theta, log_sigma = phi[:, :d], phi[:, d:]
        inside = np.all(np.abs(theta[:, :k]) < LOG_LIMIT, axis=1) & np.all(np.abs(log_sigma) < LOG_LIMIT, axis=1)
        self.calls += len(phi)
        with np.errstate(all="ignore"):
            predicted = model.predict(np.where(inside[:, None], theta, 0.0))
            r = (model.data - predicted) * np.exp(-log_sigma)[:, model.channel_of]
            value = -0.5 * np.einsum("ni,ni->n", r, r) - log_sigma @ model.counts
            value -= 0.5 * np.sum(((theta[:, :k] - self.centre) / self.sds) ** 2, axis=1)
            value -= 0.5 * np.sum(((log_sigma - self.noise_centre) / NOISE_SD) ** 2, axis=1)
        return np.where(inside & np.isfinite(value), value, -np.inf)


@dataclass(frozen=True)
class Proposal:
    """A mixture of multivariate Student t: weights (m,), centres (m, d), roots (m, d, d) of the scale matrices."""

    weights: np.ndarray
    centres: np.ndarray
    roots: np.ndarray
    dof: float = 6.0

    @staticmethod
    def around(posterior: Posterior, modes: list[np.ndarray]) -> Proposal | None:
        """Laplace approximations at the modes, a little widened; None where none of them is proper."""
        model, found = posterior.model, []
        n_channels = len(model.channels)
        for theta in modes:
            predicted, slopes = model.jacobian(theta)
            left = max(model.data.size - theta.size, 1)
            sigma = np.maximum(model.noise(model.data - predicted, float(theta.size), floor=0.0), 1e-8 * model.rms)
            covariance = model.covariance(slopes, sigma, PRIORLESS_SD)
            if covariance is None:
                continue
            whole = np.zeros((posterior.size, posterior.size))
            whole[: theta.size, : theta.size] = covariance
            share = np.maximum(model.counts * left / model.data.size, 0.5)
            whole[theta.size :, theta.size :] = np.diag(1.0 / (2.0 * share + NOISE_SD**-2)).reshape(n_channels, -1)
            scale = np.sqrt(np.diag(whole))
            root = scale[:, None] * np.linalg.cholesky(whole / np.outer(scale, scale) + 1e-10 * np.eye(len(scale)))
            centre = np.concatenate([theta, np.log(sigma)])
            mass = float(posterior(centre[None])[0] + np.sum(np.log(np.diag(root))))
            found.append((mass, centre, 1.1 * root))
        if not found:
            return None
        masses = np.array([mass for mass, _, _ in found])
        # the Laplace approximation of a mode's weight is rough: none is left without visits
        weights = 0.9 * np.exp(masses - logsumexp(masses)) + 0.1 / len(found)
        return Proposal(weights, np.stack([c for _, c, _ in found]), np.stack([r for _, _, r in found]))

    def draw(self, n: int, random: Any, spread: float = 1.0) -> np.ndarray:
        """``n`` draws, shape (n, d), ``spread`` times as wide."""
        which = random.choice(len(self.weights), size=n, p=self.weights / self.weights.sum())
        z = random.standard_normal((n, self.centres.shape[1]))
        z *= np.sqrt(self.dof / random.chisquare(self.dof, size=n))[:, None]
        return np.asarray(self.centres[which] + spread * np.einsum("nij,nj->ni", self.roots[which], z))

    @cached_property
    def inverse_roots(self) -> np.ndarray:
        return np.linalg.inv(self.roots)

    def log_density(self, phi: np.ndarray) -> np.ndarray:
        """Log-density, shape (n,), of phi (n, d)."""
        d = phi.shape[1]
        z = np.einsum("mij,nmj->nmi", self.inverse_roots, phi[:, None] - self.centres)
        log_det = np.sum(np.log(np.diagonal(self.roots, axis1=1, axis2=2)), axis=1)
        tails = -0.5 * (self.dof + d) * np.log1p(np.sum(z**2, axis=2) / self.dof)
        constant = gammaln(0.5 * (self.dof + d)) - gammaln(0.5 * self.dof) - 0.5 * d * np.log(self.dof * np.pi)
        parts = tails - log_det + np.log(self.weights)
        largest = parts.max(axis=1)
        return np.asarray(largest + np.log(np.sum(np.exp(parts - largest[:, None]), axis=1)) + constant)

    def __call__(self, coordinates: np.ndarray, random: Any) -> tuple[np.ndarray, np.ndarray]:
        """emcee's proposal function: new coordinates and the logarithm of q(old) / q(new)."""
        new = self.draw(len(coordinates), random)
        return new, self.log_density(coordinates) - self.log_density(new)


class Ensemble:
    """One emcee ensemble, from an overdispersed start; call it to run more steps."""

    def __init__(
        self, posterior: Posterior, proposal: Proposal, walkers: int, burn: int, independent: float, seed: int
    ) -> None:
        import emcee

        random = np.random.RandomState(seed)
        moves = [
            (emcee.moves.MHMove(proposal, ndim=posterior.size), independent),
            (emcee.moves.DEMove(), 0.8 * (1 - independent)),
            (emcee.moves.DESnookerMove(), 0.2 * (1 - independent)),
        ]
        self.sampler = emcee.EnsembleSampler(walkers, posterior.size, posterior, moves=moves, vectorize=True)
        start = proposal.draw(walkers, random, spread=2.0)
        self.state: Any = emcee.State(start, random_state=random.get_state())
        if burn:
            self(burn)
            self.sampler.reset()

    def __call__(self, steps: int) -> None:
        self.state = self.sampler.run_mcmc(self.state, steps, skip_initial_state_check=True)

    def path(self) -> np.ndarray:
        """The chain since burning in, shape (steps, walkers, size)."""
        return np.asarray(self.sampler.get_chain())


@dataclass(frozen=True)
class Health:
    """The worst over the unknowns: R-hat, effective sample size of all ensembles, autocorrelation time in steps."""

    r_hat: float
    effective: float
    time: float

    @staticmethod
    def of(paths: np.ndarray) -> Health:
        """Of chains of shape (ensembles, steps, walkers, size)."""
        from emcee.autocorr import integrated_time

        times = np.max([integrated_time(path, tol=0, quiet=True) for path in paths], axis=0)
        time = float(np.max(np.where(np.isfinite(times), np.maximum(times, 1.0), np.inf)))
        return Health(rank_r_hat(paths), paths[..., 0].size / time, time)

    def converged(self, settings: MCMC, steps: int) -> bool:
        return (
            self.r_hat <= settings.r_hat
            and self.effective >= settings.effective
            and steps >= settings.autocorrelations * self.time
        )

    def sentence(self, settings: MCMC, steps: int, unknowns: int) -> str:
        """Why chains of ``steps`` steps are not believed, and what to do."""
        said = (
            f"the chains have not converged (R-hat {self.r_hat:.3f}, effective draws {self.effective:.0f}, "
            f"autocorrelation time {self.time:.0f} of {steps} steps"
        )
        said += ", too long to be trusted)" if steps < settings.autocorrelations * self.time else ")"
        if unknowns > MANY:
            return f"{said}: walkers mix slowly among {unknowns} unknowns; take a sampler with gradients (nuts)"
        return f"{said}: raise blocks, or give more data or a narrower prior"


def rank_r_hat(paths: np.ndarray) -> float:
    """The largest rank-normalised split R-hat over the unknowns, of chains (ensembles, steps, walkers, size).

    The sequences compared are the first and second half of each ensemble, all its walkers together: walkers of one
    ensemble move by each other and are not independent. Bulk and folded version, the larger (Vehtari et al., 2021,
    equations 1-4, 14 and section 4.2). Infinite where an unknown never moves.
    """
    steps = paths.shape[1] // 2
    halves = [half.reshape(-1, paths.shape[-1]) for path in paths for half in (path[:steps], path[-steps:])]
    x = np.stack(halves)

    def classic(draws: np.ndarray) -> np.ndarray:
        ranks = rankdata(draws.reshape(-1, draws.shape[-1]), axis=0).reshape(draws.shape)
        z = norm.ppf((ranks - 0.375) / (draws[..., 0].size + 0.25))
        within = np.mean(np.var(z, axis=1, ddof=1), axis=0)
        n = draws.shape[1]
        total = (n - 1) / n * within + np.var(z.mean(axis=1), axis=0, ddof=1)
        return np.asarray(np.sqrt(total / within))

    with np.errstate(all="ignore"):
        both = np.concatenate([classic(x), classic(np.abs(x - np.median(x, axis=(0, 1))))])
    moved = np.ptp(x, axis=(0, 1)) > 0
    return float(np.max(both)) if np.all(moved) and np.all(np.isfinite(both)) else float("inf")


# ---------------------------------------------------------------------------------------------------- the answer


@dataclass(frozen=True, eq=False)
class MeanResponse:
    """The mean displacement over draws, as a function of time; can be pickled. Starts have shape (n_dof, n_draws)."""

    system: System
    parameters: dict[str, np.ndarray]
    displacement: np.ndarray
    velocity: np.ndarray
    forces: tuple[Force, ...] = ()

    def __call__(self, times: np.ndarray) -> np.ndarray:
        """Displacement (m), shape (n_dof, n_times), at increasing times (s)."""
        start = (self.displacement, self.velocity)
        return np.asarray(simulate(self.system, self.parameters, start, times, self.forces).displacement.mean(axis=1))


def estimate_from_draws(
    posterior: Posterior, phi: np.ndarray, traces: Mapping[str, np.ndarray], cost: Cost, curves: int
) -> Estimate:
    """The answer from draws of phi (n, size), in the units of the model's problem; its mode is added to the traces."""
    model = posterior.model
    system, theta = model.system, phi[:, : model.size]
    p, starts = model.parameters(theta), model.starts(theta)
    few = np.linspace(0, len(phi) - 1, min(curves, len(phi))).astype(int)
    responses, states = [], []
    for record, start in zip(model.problem.records, starts, strict=True):
        if isinstance(start, InitialState):
            shape = (system.n_dof, len(few))
            x, v = (np.broadcast_to(part[:, None], shape) for part in (start.displacement, start.velocity))
            states.append(start)
        else:
            x, v = start[0][:, few], start[1][:, few]
            states.append(InitialState(np.median(start[0], axis=1), np.median(start[1], axis=1)))
        few_p = {name: value[few] for name, value in p.items()}
        responses.append(MeanResponse(record.rig(system), few_p, x, v, record.forces))
    parameters = groups = None
    if len(model.free) == len(system.names):
        parameters = Draws(system.names, np.stack([p[name] for name in system.names], axis=1))
    else:
        names = tuple(group.name for group in system.groups)
        values = np.stack([group.value(p) for group in system.groups], axis=1)
        groups = Normal(names, values.mean(axis=0), np.atleast_2d(np.cov(values.T)), log=False)
    return Estimate(
        system,
        parameters=parameters,
        groups=groups,
        reconstructions=tuple(responses),
        initial_states=tuple(states),
        offsets=tuple(map(float, np.median(model.offsets(theta), axis=0))),
        cost=cost,
        traces={"mode": np.log([float(value) for value in model.parameters(posterior.mode).values()]), **traces},
    )
