"""Answers that know when they are ambiguous: other frequencies that fit the samples as well, and the band of an answer.

Even samples of a free vibration do not tell a frequency from its aliases, and few or uneven samples may leave several
basins of the likelihood alike. A method that searches with a prior starts in the one that stands first: the most
probable that the sampling resolves, unless one beyond is twenty times as probable. The others are taken to their own
maxima by the output-error likelihood, which gives all of them their probabilities (:mod:`methods.starts.evidence`). The
method's own answer stands first, whatever its probability; others above :data:`LEAST_WEIGHT` are alternatives.

Without a prior, or by its nature, a method answers for frequencies below half the sampling rate. Where its answer has
few samples a cycle it says so, and names the next frequency that would give the same samples.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np

from bench import (
    Cost,
    Draws,
    Estimate,
    Identifier,
    Normal,
    OutputError,
    Problem,
    Status,
    System,
    degrees_used,
    estimate_at,
)
from methods.starts.candidates import screening
from methods.starts.evidence import Basins, basins
from methods.starts.reach import UP, expected_rate, first_stiffness, is_unresolved, resolved_cycles, unevenness
from methods.starts.scan import scan
from methods.starts.separate import APART
from methods.starts.time_scales import best_speeds, sped_up

LEAST_WEIGHT = 0.01
"""Probability above which another basin is an alternative."""
FEW_SAMPLES = 4.0
"""A cycle, below which an answer without a prior names its first alias."""
MOST_BASINS = 16
"""Minima of the scan that are compared."""
LEAST_LOG_ODDS = float(np.log(LEAST_WEIGHT)) - 5.0
"""Of an alias against the answer by the prior alone: the volumes of basins differ by less."""
SAME_RATE, SAME_SDS = 0.02, 5.0
"""Logarithms of stiffness over mass as near as this to a basin's, or within so many standard deviations, are in it."""


class SearchingIdentifier(Identifier):
    """A method that searches where the prior expects the motion: its answer holds the other basins that fit.

    Version 2: beyond half the sampling rate all of the prior's reach is searched, and other basins are named.
    """

    version: ClassVar[int] = 2

    def completed(self, problems: Sequence[Problem], estimates: Sequence[Estimate]) -> list[Estimate]:
        """Add alternatives and name them, or the alias where there is no prior."""
        answers, ambiguous = list(estimates), list[int]()
        for i, (problem, estimate) in enumerate(zip(problems, estimates, strict=True)):
            if not _is_one_oscillator(problem, estimate):
                continue
            if problem.prior is None:
                answers[i] = with_band(problem, estimate)
            elif is_unresolved(problem) and not (
                _are_even(problem) and not _aliases(problem, _log_rate(estimate.system, _values(estimate)))
            ):
                ambiguous.append(i)
        completed = with_alternatives([problems[i] for i in ambiguous], [answers[i] for i in ambiguous])
        for i, answer in zip(ambiguous, completed, strict=True):
            answers[i] = answer
        return answers


class BandIdentifier(Identifier):
    """A method that sees one band of frequencies, up to half the sampling rate: it says so, and names the alias."""

    def completed(self, problems: Sequence[Problem], estimates: Sequence[Estimate]) -> list[Estimate]:
        """State the band where the answer has few samples a cycle."""
        pairs = zip(problems, estimates, strict=True)
        return [with_band(p, estimate) if _is_one_oscillator(p, estimate) else estimate for p, estimate in pairs]


def _is_one_oscillator(problem: Problem, estimate: Estimate) -> bool:
    """Decide whether an answer is of one degree of freedom without hidden states, which has one frequency."""
    return estimate.status is Status.OK and problem.system.n_dof == 1 and not problem.system.n_hidden


def _may_be_ambiguous(problem: Problem, estimate: Estimate) -> bool:
    """Decide whether another basin is plausible: an alias of even samples, any of uneven ones in the prior's reach."""
    if not is_unresolved(problem):
        return False
    return not _are_even(problem) or bool(_aliases(problem, _log_rate(estimate.system, _values(estimate))))


def with_band(problem: Problem, estimate: Estimate) -> Estimate:
    """The estimate with a sentence on its band and its first alias, where it has few samples a cycle."""
    frequency = _frequency(problem, _values(estimate))
    rate = 2.0 * max(resolved_cycles(record) for record in problem.records)
    if frequency is None or frequency == 0.0 or rate >= FEW_SAMPLES * frequency or estimate.belief is None:
        return estimate
    alias = rate - frequency if frequency < rate else rate * np.ceil(frequency / rate) - frequency
    sentence = (
        f"it answers for frequencies below {rate / 2:.3g} Hz, half the sampling rate: at {rate / frequency:.2g} "
        f"samples a cycle {alias:.3g} Hz would give nearly the same samples as {frequency:.3g} Hz"
    )
    return replace(estimate, message="; ".join(filter(None, [estimate.message, sentence])))


def with_alternatives(problems: Sequence[Problem], estimates: Sequence[Estimate]) -> list[Estimate]:
    """The estimates with the other basins that data and prior support, each with its probability."""
    models, values, starts = list[OutputError](), list[dict[str, float]](), list[np.ndarray]()
    for problem, estimate in zip(problems, estimates, strict=True):
        units = problem.natural_units()
        scales, model = units.scales(problem.system), OutputError(problem.expressed_in(units))
        values.append({name: value / scales[name] for name, value in _values(estimate).items()})
        guesses = [p for p in _starts(model, values[-1]) if all(np.isfinite(v) and v > 0 for v in p.values())]
        models.append(model)
        starts.append(np.array([screening(model).vector(p) for p in guesses]).reshape(-1, model.size))
    cases = zip(problems, estimates, models, values, basins(models, starts), strict=True)
    return [_with_basins(*case) if case[-1].evidence.size else case[1] for case in cases]


def _with_basins(
    problem: Problem, estimate: Estimate, model: OutputError, values: Mapping[str, float], found: Basins
) -> Estimate:
    """One of them, from its ``model`` in natural units, its ``values`` there and the basins that were found."""
    units = problem.natural_units()
    scales = units.scales(problem.system)
    rates = np.array(
        [_log_rate(model.system, {n: float(v) for n, v in model.parameters(t).items()}) for t in found.thetas]
    )
    answers, weights = [_answer(model, found, i) for i in range(rates.size)], found.weights
    unit = np.log(scales[first_stiffness(problem.system)] / scales[problem.system.gauge])
    own, answer = _basin_of(answers, rates, _log_rate(model.system, values)), estimate
    if isinstance(estimate.parameters, Draws):
        own, answer = _largest_part(estimate, rates + unit)
    others = [i for i in np.argsort(-weights) if i != own and weights[i] > LEAST_WEIGHT]
    if not others:
        return estimate
    weight = 0.0 if own is None else float(weights[own])
    total = weight + float(weights[others].sum())
    alternatives = tuple(replace(answers[i].returned(problem, units), weight=float(weights[i]) / total) for i in others)
    answer = replace(answer, alternatives=alternatives, weight=weight / total)
    return replace(answer, message="; ".join(filter(None, [_sentence(problem, answer), estimate.message])))


def _starts(model: OutputError, values: Mapping[str, float]) -> list[dict[str, float]]:
    """The answer, its aliases, and the minima of the scan."""
    scanned = scan(model.problem, MOST_BASINS) if model.system.linear else best_speeds(screening(model), MOST_BASINS)
    aliases = [
        sped_up(model.system, values, factor) for factor in _aliases(model.problem, _log_rate(model.system, values))
    ]
    return [dict(values), *aliases, *scanned]


def _answer(model: OutputError, found: Basins, i: int) -> Estimate:
    """The answer that a basin is."""
    spent = _spent(model, found.slopes[i], model.noise(found.residuals[i], 0.0))
    covariance = model.covariance(found.slopes[i], model.noise(found.residuals[i], spent))
    return estimate_at(model, found.thetas[i], covariance, spent, Cost())


def _basin_of(answers: Sequence[Estimate], rates: np.ndarray, rate: float) -> int | None:
    """The basin in which an answer of this logarithm of stiffness over mass is; None where it is in none of them."""
    nearest = int(np.argmin(np.abs(rates - rate)))
    system, belief = answers[nearest].system, answers[nearest].parameters
    assert isinstance(belief, Normal)
    direction = np.array([(name == first_stiffness(system)) - float(name == system.gauge) for name in belief.names])
    sd = 0.0 if belief.covariance is None else np.sqrt(max(direction @ belief.covariance @ direction, 0.0))
    return nearest if abs(rates[nearest] - rate) <= max(SAME_RATE, SAME_SDS * sd) else None


def _spent(model: OutputError, slopes: np.ndarray, sigma: np.ndarray) -> float:
    """Degrees of freedom that the data spent at a maximum with these slopes (N, size) and noise by channel."""
    assert model.prior is not None
    by_data = slopes / sigma[model.channel_of][:, None]
    by_prior = np.eye(len(model.free), model.size) / model.prior.log_sds[:, None]
    return float(degrees_used(np.concatenate([by_data, by_prior])[None], model.data.size)[0])


def _aliases(problem: Problem, log_rate: float) -> list[float]:
    """Factors of the frequency by which the motion passes through the same points, sampled at the median step.

    They are within the prior's reach, and those that the prior makes too improbable are left out.
    """
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


def _are_even(problem: Problem) -> bool:
    """Decide whether every channel is sampled at even steps."""
    return all(unevenness(channel.times) is None for record in problem.records for channel in record.channels)


def _log_rate(system: System, values: Mapping[str, float]) -> float:
    """The logarithm of the first stiffness over the gauge mass."""
    return float(np.log(values[first_stiffness(system)] / values[system.gauge]))


def _log_rates(system: System, draws: Draws) -> np.ndarray:
    """The same of every draw, (n_draws,)."""
    stiffness, mass = (draws.samples[:, draws.names.index(name)] for name in (first_stiffness(system), system.gauge))
    return np.asarray(np.log(stiffness / mass))


def _values(estimate: Estimate) -> dict[str, float]:
    """Parameters of an answer; of groups, those with a gauge mass of 1. NaNs where it has none."""
    if isinstance(estimate.parameters, Draws):  # medians of several basins may lie in none of them: a draw does not
        draws = estimate.parameters.samples
        middle = np.argsort(_log_rates(estimate.system, estimate.parameters), kind="stable")[len(draws) // 2]
        return dict(zip(estimate.parameters.names, map(float, draws[middle]), strict=True))
    if estimate.parameters is not None:
        return {name: float(value) for name, value in estimate.parameters.values().items()}
    values = dict.fromkeys(estimate.system.names, 1.0)
    for name, value in (estimate.groups.values() if estimate.groups is not None else {}).items():
        numerator = next(n for n, power in estimate.system.quantity(name).exponents.items() if power > 0)
        values[numerator] = float(value)
    return values


def _frequency(problem: Problem, values: Mapping[str, float]) -> float | None:
    """The natural frequency (Hz) at parameters; None where it is none."""
    square = values[first_stiffness(problem.system)] / values[problem.system.gauge]
    return float(np.sqrt(square) / (2 * np.pi)) if np.isfinite(square) and square > 0 else None


def _largest_part(estimate: Estimate, rates: np.ndarray) -> tuple[int, Estimate]:
    """The basin that holds most draws, and the estimate with these alone: the others are in the alternatives.

    ``rates``: logarithms of stiffness over mass of the basins.
    """
    draws = estimate.parameters
    assert isinstance(draws, Draws)
    nearest = np.argmin(np.abs(_log_rates(estimate.system, draws)[:, None] - rates), axis=1)
    own = int(np.argmax(np.bincount(nearest, minlength=rates.size)))
    return own, replace(estimate, parameters=replace(draws, samples=draws.samples[nearest == own]))


def _sentence(problem: Problem, answer: Estimate) -> str:
    """Name the frequencies that fit, with their probabilities."""
    shown = []
    for estimate in (answer, *answer.alternatives):
        frequency = _frequency(problem, _values(estimate))
        if frequency is not None:
            share = f"{100 * estimate.weight:.0f} %" if estimate.weight >= LEAST_WEIGHT else "below 1 %"
            shown.append(f"{frequency:.4g} Hz ({share})")
    return f"ambiguous: the samples and the prior fit {' or '.join(shown)}"
