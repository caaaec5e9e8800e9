"""Neural posterior estimation (NPE) by a network trained on simulations.

It supports the free decay of one mass with displacements at even times. A mixture density network
(:mod:`methods.amortised.density`) is trained once per layout (number of samples, and whether the initial state is
known) on records simulated over a wide box of frequency, damping ratio, phase and noise
(:mod:`methods.amortised.simulations`), independent of the problem. Training maximises the expected log-density of the
true frequency and decay, which is maximal for the posterior under the box (G. Papamakarios, I. Murray, NeurIPS 2016,
arXiv:1605.06376; K. Cranmer, J. Brehmer, G. Louppe, PNAS 117:30055, 2020). The posterior of any record of the layout
then costs one evaluation of the network.

Since the box is uniform in the logarithms, the posterior under the prior of a problem is the network's mixture times
that prior, again a mixture in closed form (Papamakarios and Murray). One network thus serves every prior and noise
level. The data determine k/m and c/m only; m is drawn from the prior given these.

The accuracy is limited by the training: at low noise, where the posterior is narrower than the network resolves, the
estimate is underconfident; for some systems it is overconfident. With ``corrected`` the draws are weighted by the exact
likelihood and resampled (importance sampling: M. Dax et al., Physical Review Letters 130:171403, 2023). The method
fails with too few effective draws, with draws outside the box, and with residuals above the largest noise in training.

Trained networks are stored in ``folder`` (default: ``vibration-bench/npe`` in the user's cache). Training is
reproducible for a seed; with another build of torch, training amplifies rounding errors.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from bench import (
    Card,
    Cost,
    Draws,
    Estimate,
    InputError,
    NoEstimate,
    Normal,
    Prior,
    Problem,
    Scope,
    SimulatedResponse,
    fit_initial_state,
)
from methods.amortised.cache import Arrays, cache_folder, cached
from methods.amortised.correction import log_likelihood, resampled
from methods.amortised.simulations import DECIBELS, RATIOS, SampleLayout, network_inputs
from methods.sampling.mixture import Mixture
from methods.starts.band import BandIdentifier

if TYPE_CHECKING:
    from methods.amortised.density import Density

UNEVEN = 1e-3
"""Relative tolerance of even steps; rounding of printed times causes such errors."""
SAMPLES = (8, 300)
RATE = 2e-3
"""Largest learning rate."""
TRIES = 4
"""Number of draws made per draw kept within the box."""
LEAST_INSIDE = 0.05
"""Least share of draws within the training box."""
MARGIN = 1.15
"""Largest residual share of the median response over that of the noisiest training records."""
PROPOSALS = 5
"""Number of proposals per draw with importance sampling."""


@dataclass(frozen=True)
class NPE(BandIdentifier):
    """Neural posterior estimation; training of ``steps`` steps on ``batch`` records each.

    The network has ``depth`` blocks of ``width`` and a mixture of ``components`` normals; ``draws``: number of draws;
    ``seed``: seed of the training.
    """

    steps: int = 4000
    batch: int = 256
    width: int = 192
    depth: int = 3
    components: int = 6
    draws: int = 4000
    corrected: bool = False
    seed: int = 0
    folder: str = ""

    card: ClassVar[Card] = Card(
        summary="neural posterior estimation: a mixture density network trained once per layout on simulations",
        start="used when known",
        scale="native",
        reconstruction="own",
        uncertainty="quantiles of the draws (without a prior: their covariance); too wide at little noise, where "
        "the network does not resolve the posterior, and too narrow for some systems; corrected, neither",
        settings_source="a network that trains in one to three minutes on one core, once per layout",
        tuning="none: the first size and learning rate tried; calibration checked on development systems",
        title="Neural posterior",
        order=35,
        variants={
            "npe_corrected": {
                "title": "Neural posterior, corrected",
                "summary": "the same with draws weighted by the exact likelihood (importance sampling)",
                "uncertainty": "quantiles of the draws (without a prior: their covariance)",
                "order": 36,
            }
        },
    )
    scope: ClassVar[Scope] = Scope(forced=False, nonlinear=False, max_dof=1)
    requires: ClassVar[tuple[str, ...]] = ("torch",)
    extra: ClassVar[str] = "torch"
    works_in = "natural units"

    def __post_init__(self) -> None:
        for name in ("steps", "batch", "width", "depth", "components"):
            if getattr(self, name) < 1:
                raise InputError(f"method.{name}", getattr(self, name), "at least 1")
        if self.draws < 100:
            raise InputError("method.draws", self.draws, "at least 100")
        if self.seed < 0:
            raise InputError("method.seed", self.seed, "a number from 0")

    def objection(self, problem: Problem) -> str | None:
        return super().objection(problem) or _objection(problem)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Draw from the posterior; raises NoEstimate where it is unreliable. Trains the network if it is not cached."""
        import torch

        threads = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            posterior, seconds = self._network_posterior(problem)
        finally:
            torch.set_num_threads(threads)
        prior = None if problem.prior is None else _group_prior(problem, problem.prior)
        if prior is not None:
            posterior = posterior.times(*prior)
        logs = _inside(_layout(problem), posterior, (PROPOSALS if self.corrected else 1) * self.draws, rng)
        effective = float(len(logs))
        if self.corrected:
            target = log_likelihood(problem, logs)
            if prior is not None:
                away = logs - prior[0]
                target -= 0.5 * np.sum(away * np.linalg.solve(prior[1], away.T).T, axis=1)
            logs, effective = resampled(logs, target - posterior.log_density(logs), self.draws, rng)
        traces = {"training_seconds": np.array([seconds]), "effective_draws": np.array([effective])}
        return replace(_estimate(problem, logs, rng), traces=traces, cost=Cost(evaluations=1, iterations=self.steps))

    def _network_posterior(self, problem: Problem) -> tuple[Mixture, float]:
        """Return the network's mixture over log k/m and log c/m, and the processor time (s) of its training."""
        from methods.amortised.density import mixture_of

        layout, record = _layout(problem), problem.records[0]
        names = ("steps", "batch", "width", "depth", "components", "seed")
        network = _loaded(layout, tuple((name, getattr(self, name)) for name in names), self.folder)
        start = record.initial_state
        known = None if start is None else np.array([[start.displacement[0], start.velocity[0]]])
        mixture = mixture_of(network, network_inputs(layout, record.channels[0].values[None], known))
        # log k/m = 2 log frequency and log c/m = log 2 + log decay rate
        scale, shift = np.array([2.0, 1.0]), np.array([0.0, np.log(2.0)])
        scaled = replace(mixture, centres=scale * mixture.centres + shift, roots=scale[:, None] * mixture.roots)
        return scaled, float(network.training_seconds)


@lru_cache(maxsize=8)
def _loaded(layout: SampleLayout, settings: tuple[tuple[str, int], ...], folder: str) -> Density:
    """Return the trained network of a layout, from the cache or by training."""
    from methods.amortised.density import from_arrays, trained

    values = dict(settings)

    def make() -> Arrays:
        return {name: value.numpy() for name, value in trained(layout, values, RATE).state_dict().items()}

    identity = {"version": NPE.version, **asdict(layout), **values}
    return from_arrays(cached(cache_folder(folder), identity, make), values)


def _layout(problem: Problem) -> SampleLayout:
    record = problem.records[0]
    times = record.channels[0].times
    return SampleLayout(times.size, round(float(times[0] / times[-1]), 6), record.initial_state is not None)


def _parameters(problem: Problem) -> list[str]:
    """Return the names of mass, damping and stiffness."""
    kinds = {p.kind: p.name for p in problem.system.parameters}
    return [kinds["mass"], kinds["damping"], kinds["stiffness"]]


def _log_prior(problem: Problem, prior: Prior) -> tuple[np.ndarray, np.ndarray]:
    """Return prior means and variances of the logarithms of mass, damping and stiffness."""
    names = _parameters(problem)
    return np.log([prior.nominal[name] for name in names]), np.array([prior.log_sd[name] for name in names]) ** 2


def _group_prior(problem: Problem, prior: Prior) -> tuple[np.ndarray, np.ndarray]:
    """Return prior mean and covariance of the logarithms of k/m and c/m."""
    means, variances = _log_prior(problem, prior)
    return means[[2, 1]] - means[0], np.diag(variances[[2, 1]]) + variances[0]


def _inside(layout: SampleLayout, posterior: Mixture, n: int, rng: np.random.Generator) -> np.ndarray:
    """Draw at most ``n`` logarithms of k/m and c/m within the training box."""
    logs = posterior.draw(TRIES * n, rng)
    frequency = 0.5 * logs[:, 0]
    place = np.stack([frequency, logs[:, 1] - np.log(2.0) - frequency], axis=1)
    low, high = layout.box
    within = np.all((place >= low) & (place <= high), axis=1)
    if np.mean(within) < LEAST_INSIDE:
        cycles = " to ".join(f"{value:.3g}" for value in layout.cycles)
        raise NoEstimate(
            f"the record is outside the range of training, {cycles} cycles per record "
            f"and damping ratios of {RATIOS[0]:g} to {RATIOS[1]:g}: use another method, or more samples"
        )
    return logs[within][:n]


def _estimate(problem: Problem, logs: np.ndarray, rng: np.random.Generator) -> Estimate:
    """Return the estimate from draws of log k/m and log c/m; raises NoEstimate where it is unreliable."""
    system, record = problem.system, problem.records[0]
    mass, damping, stiffness = _parameters(problem)
    middle = np.exp(np.median(logs, axis=0))
    p = {mass: 1.0, damping: float(middle[1]), stiffness: float(middle[0])}
    start = fit_initial_state(system, p, record)
    response = SimulatedResponse(system, p, start)
    y = record.channels[0].values
    share = float(np.mean((y - response(record.channels[0].times)[0]) ** 2) / np.mean(y**2))
    noisiest = 1.0 / (1.0 + 10 ** (DECIBELS[0] / 10))
    if not share <= MARGIN * noisiest:
        raise NoEstimate(
            f"residuals at the median of the draws are {share:.0%} of the record's mean square, above the "
            f"largest noise in training: use another method, or less noise"
        )
    parameters, groups = None, None
    if problem.prior is None:
        columns = [0 if stiffness in group.exponents else 1 for group in system.groups]
        covariance = np.cov(np.exp(logs[:, columns]).T)
        groups = Normal(tuple(group.name for group in system.groups), middle[columns], covariance, log=False)
    else:
        m = _masses(problem, problem.prior, logs, rng)
        values = {mass: m, damping: m * np.exp(logs[:, 1]), stiffness: m * np.exp(logs[:, 0])}
        parameters = Draws(system.names, np.stack([values[name] for name in system.names], axis=1))
    return Estimate(system, parameters, groups, reconstructions=(response,), initial_states=(start,))


def _masses(problem: Problem, prior: Prior, logs: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Draw the mass from the prior given k/m and c/m, combining m, c and k by their precisions."""
    means, variances = _log_prior(problem, prior)
    weights = (1.0 / variances) / np.sum(1.0 / variances)
    mean = weights @ means - logs @ weights[[2, 1]]
    return np.asarray(np.exp(mean + rng.standard_normal(len(logs)) / np.sqrt(np.sum(1.0 / variances))))


def _objection(problem: Problem) -> str | None:
    if sorted(p.kind for p in problem.system.parameters) != ["damping", "mass", "stiffness"]:
        return "it requires one mass, one damping and one stiffness"
    times = problem.records[0].channels[0].times
    if not SAMPLES[0] <= times.size <= SAMPLES[1]:
        return (
            f"it supports {SAMPLES[0]} to {SAMPLES[1]} samples per record, since a network is trained for each number"
        )
    even = np.linspace(times[0], times[-1], times.size)
    if np.max(np.abs(times - even)) > UNEVEN * (even[1] - even[0]):
        return "it requires samples at even steps of time, since a network is trained for a layout; resample them"
    return None
