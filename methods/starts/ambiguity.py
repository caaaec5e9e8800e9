"""Ambiguous estimates: the other basins of the posterior that data and prior support.

Evenly spaced samples of a free vibration fit a frequency and its aliases equally well, and with few or unevenly spaced
samples several maxima of the likelihood may be equally high. A method that searches with a prior starts in the most
probable basin below half the sampling rate, unless a basin above it is twenty times as probable. The output-error
likelihood is maximised in the other basins as well, which gives all basins their probabilities
(:mod:`methods.starts.evidence`). The method's estimate is listed first, whatever its probability; other basins with a
probability above :data:`LEAST_WEIGHT` are alternatives. Aliases more than three standard deviations from the frequency
that the prior expects, or much less probable by the prior, are not considered; draws of a sampler may have them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from bench import (
    Cost,
    Draws,
    Estimate,
    Identifier,
    Normal,
    OutputError,
    Problem,
    Quantity,
    Status,
    System,
    degrees_used,
    estimate_at,
)
from methods.starts.band import are_even, natural_frequencies, values_of, with_band
from methods.starts.candidates import candidates, screening
from methods.starts.distinct_minima import APART, aliased
from methods.starts.evidence import Basins, basins, preferred
from methods.starts.prior_guesses import sped_up
from methods.starts.search_range import MOST_MODES, UP, expected_rate, is_unresolved, resolved_cycles

LEAST_WEIGHT = 0.01
"""Probability above which another basin is an alternative."""
MOST_BASINS = 16
"""Largest number of minima of the scan that are compared."""
LEAST_LOG_ODDS = float(np.log(LEAST_WEIGHT)) - 5.0
"""Least prior log-odds of an alias against the estimate; the volumes of basins differ by less than the extra 5."""
SAME_RATE, SAME_SDS = 0.02, 5.0
"""An estimate belongs to a basin if log(k/m) differs by less than the first, or by less than this many standard
deviations."""


class SearchingIdentifier(Identifier):
    """Base of methods that search the frequencies the prior supports, and report other basins as alternatives.

    Version 2: above half the sampling rate, all frequencies the prior supports are searched, and other basins reported.
    From an unknown start, version 2: a basin that leaves the start open has no evidence.
    """

    version: ClassVar[int] = 2
    parts: ClassVar[Mapping[str, int]] = {"unknown_start": 2}

    def completed(self, problems: Sequence[Problem], estimates: Sequence[Estimate]) -> list[Estimate]:
        """Add alternatives to the estimates, or a warning about the first alias where there is no prior."""
        answers, ambiguous = list(estimates), list[int]()
        for i, (problem, estimate) in enumerate(zip(problems, estimates, strict=True)):
            if estimate.status is not Status.OK:
                continue
            if problem.system.n_hidden:
                answers[i] = _with_warning(problem, estimate)
            elif problem.prior is None or problem.system.n_dof > MOST_MODES:
                answers[i] = with_band(problem, estimate)
            elif _may_be_ambiguous(problem, estimate):
                ambiguous.append(i)
        completed = with_alternatives([problems[i] for i in ambiguous], [answers[i] for i in ambiguous])
        for i, answer in zip(ambiguous, completed, strict=True):
            answers[i] = answer
        return answers


def _may_be_ambiguous(problem: Problem, estimate: Estimate) -> bool:
    """Return True where another basin is plausible; evenly sampled, one degree of freedom has only aliases."""
    if not _ratios(problem.system) or not is_unresolved(problem):
        return False
    if problem.system.n_dof > 1 or not are_even(problem):
        return True
    return bool(_aliases(problem, float(_place(estimate.system, values_of(estimate))[0])))


def _with_warning(problem: Problem, estimate: Estimate) -> Estimate:
    """Warn that the other basins of a system with hidden states are not searched."""
    if not is_unresolved(problem):
        return estimate
    sentence = "the prior expects motion beyond half the sampling rate, and other frequencies were not searched for"
    return replace(estimate, message="; ".join(filter(None, [estimate.message, sentence])))


def with_alternatives(problems: Sequence[Problem], estimates: Sequence[Estimate]) -> list[Estimate]:
    """Add to each estimate the other basins that data and prior support, with their probabilities."""
    models, values, starts = list[OutputError](), list[dict[str, float]](), list[np.ndarray]()
    for problem, estimate in zip(problems, estimates, strict=True):
        units = problem.natural_units()
        scales, model = units.scales(problem.system), OutputError(problem.expressed_in(units))
        values.append({name: value / scales[name] for name, value in values_of(estimate).items()})
        guesses = [p for p in _starts(model, values[-1]) if all(np.isfinite(v) and v > 0 for v in p.values())]
        models.append(model)
        starts.append(np.array([screening(model).vector(p) for p in guesses]).reshape(-1, model.size))
    cases = zip(problems, estimates, models, values, basins(models, starts), strict=True)
    return [_with_basins(*case) if case[-1].evidence.size else case[1] for case in cases]


def _with_basins(
    problem: Problem, estimate: Estimate, model: OutputError, values: Mapping[str, float], maxima: Basins
) -> Estimate:
    """Add other basins to an estimate; ``model``, ``values`` of the estimate and ``maxima`` are in natural units."""
    units = problem.natural_units()
    scales = units.scales(problem.system)
    places = np.array([_place(model.system, model.parameters(theta)) for theta in maxima.thetas])
    answers, weights = [_answer(model, maxima, i) for i in range(len(places))], maxima.weights
    index, answer = _basin_of(answers, places, _place(model.system, values)), estimate
    if isinstance(estimate.parameters, Draws):
        beyond = aliased(model, maxima.thetas)
        index, inside = _preferred(
            estimate.system, estimate.parameters, places + _place(problem.system, scales), beyond
        )
        if not np.all(inside):
            answer = _part(estimate, estimate.parameters, inside, answers[index].returned(problem, units))
    others = [i for i in np.argsort(-weights) if i != index and weights[i] > LEAST_WEIGHT]
    if not others:
        return estimate
    weight = 0.0 if index is None else float(weights[index])
    total = weight + float(weights[others].sum())
    alternatives = tuple(replace(answers[i].returned(problem, units), weight=float(weights[i]) / total) for i in others)
    answer = replace(answer, alternatives=alternatives, weight=weight / total)
    return replace(answer, message="; ".join(filter(None, [_sentence(problem, answer), estimate.message])))


def _starts(model: OutputError, values: Mapping[str, float]) -> list[dict[str, float]]:
    """Return the estimate, its aliases, and the initial guesses of every search."""
    aliases = []
    if model.system.n_dof == 1:
        log_rate = float(_place(model.system, values)[0])
        aliases = [sped_up(model.system, values, factor) for factor in _aliases(model.problem, log_rate)]
    return [dict(values), *aliases, *candidates(model, MOST_BASINS)]


def _answer(model: OutputError, maxima: Basins, i: int) -> Estimate:
    """Return the estimate at the maximum of a basin."""
    spent = _spent(model, maxima.slopes[i], model.noise(maxima.residuals[i], 0.0))
    covariance = model.covariance(maxima.slopes[i], model.noise(maxima.residuals[i], spent))
    return estimate_at(model, maxima.thetas[i], covariance, spent, Cost())


def _basin_of(answers: Sequence[Estimate], places: np.ndarray, place: np.ndarray) -> int | None:
    """Return the index of the basin that contains a point; None where no basin does."""
    nearest = int(np.argmin(np.max(np.abs(places - place), axis=1)))
    system, distribution = answers[nearest].system, answers[nearest].parameters
    assert isinstance(distribution, Normal)
    if distribution.covariance is None:
        sds = np.zeros(place.size)
    else:
        directions = np.array([ratio.vector(distribution.names) for ratio in _ratios(system)])
        sds = np.sqrt(np.maximum(np.einsum("ri,ij,rj->r", directions, distribution.covariance, directions), 0.0))
    return nearest if np.all(np.abs(places[nearest] - place) <= np.maximum(SAME_RATE, SAME_SDS * sds)) else None


def _spent(model: OutputError, slopes: np.ndarray, sigma: np.ndarray) -> float:
    """Return the degrees of freedom used by the data, from slopes (N, size) and noise of each channel at a maximum."""
    assert model.prior is not None
    by_data = slopes / sigma[model.channel_of][:, None]
    by_prior = np.eye(len(model.free), model.size) / model.prior.log_sds[:, None]
    return float(degrees_used(np.concatenate([by_data, by_prior])[None], model.data.size)[0])


def _aliases(problem: Problem, log_rate: float) -> list[float]:
    """Return the frequency ratios of aliases at the median sampling step, less those too improbable by the prior."""
    expected = expected_rate(problem)
    assert expected is not None
    centre, sd = expected
    frequency = np.exp(0.5 * log_rate) / (2 * np.pi)
    rate = 2.0 * max(resolved_cycles(record) for record in problem.records)
    highest = np.exp(centre + UP * sd) / (2 * np.pi)
    multiples = rate * np.arange(0, int(min(highest / rate, MOST_BASINS)) + 2)
    factors = np.unique(np.abs(np.concatenate([multiples - frequency, multiples + frequency]))) / frequency
    factors = factors[(factors > 0) & (np.abs(np.log(np.maximum(factors, 1e-300))) > APART)]
    surprises = (0.5 * log_rate + np.log(factors) - centre) / sd
    odds = 0.5 * ((0.5 * log_rate - centre) / sd) ** 2 - 0.5 * surprises**2
    return list(factors[(np.abs(surprises) <= UP) & (odds > LEAST_LOG_ODDS)])


def _ratios(system: System) -> list[Quantity]:
    """Return stiffnesses and other masses over the gauge mass; basins differ in these, which set the frequencies."""
    names = [p.name for p in system.parameters if p.kind in ("mass", "stiffness") and p.name != system.gauge]
    return [Quantity(name, "", {name: 1.0, system.gauge: -1.0}) for name in names]


def _place(system: System, values: Mapping[str, Any]) -> np.ndarray:
    """Return the logarithms of those ratios, (..., n_ratios)."""
    return np.stack([np.log(np.asarray(ratio.value(values))) for ratio in _ratios(system)], axis=-1)


def _preferred(system: System, draws: Draws, places: np.ndarray, beyond: np.ndarray) -> tuple[int, np.ndarray]:
    """Return the basin of an answer by draws, and which draws lie in it (n_draws,).

    As in every search, it is the most probable one below half the sampling rate, unless one ``beyond`` it has twenty
    times as many draws.
    """
    of_draws = _place(system, dict(zip(draws.names, draws.samples.T, strict=True)))
    nearest = np.argmin(np.linalg.norm(of_draws[:, None] - places, axis=2), axis=1)
    counts = np.bincount(nearest, minlength=len(places))
    index = preferred(np.log(np.maximum(counts, 1e-300)), beyond)
    return index, nearest == index


def _part(estimate: Estimate, draws: Draws, inside: np.ndarray, mode: Estimate) -> Estimate:
    """Return an estimate with its draws in one basin, and the response of that basin's ``mode``."""
    return replace(
        estimate,
        parameters=replace(draws, samples=draws.samples[inside]),
        reconstructions=mode.reconstructions,
        bands=mode.bands,
        initial_states=mode.initial_states,
        offsets=mode.offsets,
    )


def _sentence(problem: Problem, answer: Estimate) -> str:
    """Return a message with the frequencies that fit and their probabilities."""
    shown = []
    for estimate in (answer, *answer.alternatives):
        frequencies = " and ".join(f"{frequency:.4g}" for frequency in natural_frequencies(problem, estimate))
        if frequencies:
            share = f"{100 * estimate.weight:.0f} %" if estimate.weight >= LEAST_WEIGHT else "below 1 %"
            shown.append(f"{frequencies} Hz ({share})")
    return f"ambiguous: the samples and the prior fit {' or '.join(shown)}"
