"""What the data of a claim allow: the bound, the scores of an efficient estimator, and where a number falls in them.

An efficient estimator is unbiased and has the covariance of the Cramér-Rao bound (S. M. Kay, Fundamentals of
Statistical Signal Processing: Estimation Theory, 1993, chapter 3), to first order in the noise; its errors are drawn
as normal ones, since those of maximum likelihood are so in the limit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from bench.audit.claim import Reported, Situation, Stated, StatedNoise
from bench.contract.problem import InitialState
from bench.errors import InputError
from bench.information.fisher import Information
from bench.information.sensitivities import linear_sensitivities, stepped_sensitivities
from bench.information.structural import structure
from bench.systems import Quantity

RARE_SMALL, RARE_LARGE = 0.01, 0.05
"""Shares of an efficient estimator's scores below which a smaller, or a larger, reported score is outside."""
DISAGREES = 1e-3
"""A chance below which samples contradict the stated equation, and a part of the largest value for a solution."""
SIMULATED, MOST_SIMULATED = 100_000, 20_000_000
DENSE = 1000
STEP = 1e-5
Verdict = Literal["within", "smaller", "larger", "not identifiable", "bias only", "known", "no number"]


@dataclass(frozen=True, eq=False)
class Evidence:
    """The Fisher information of a situation, and the response by its unknowns.

    ``sigma`` (n_channels,) has zeros where there is no noise; ``slopes`` (n_dense, n_unknowns) are those of the first
    channel over the record.
    """

    situation: Situation
    sigma: np.ndarray
    information: Information
    slopes: np.ndarray

    @cached_property
    def exact(self) -> bool:
        """Whether the samples have no noise."""
        return not np.all(self.sigma)

    def quantity(self, name: str) -> Quantity:
        """Return a quantity near the stated parameters as a product of powers, by central differences."""
        p, value = self.situation.p, self.situation.value
        ends = [[value(name, {**p, n: p[n] * np.exp(side * STEP)}) for side in (1, -1)] for n in p]
        powers = [float(np.log(up / down) / (2 * STEP)) for up, down in ends]
        return Quantity(name, "", dict(zip(p, powers, strict=True)))

    def identifiable(self, name: str) -> bool:
        """Return whether data and prior determine a quantity; the displacement always is."""
        return name == "x" or bool(np.isfinite(self.information.variance(self.quantity(name))))

    def spread(self, name: str) -> np.ndarray:
        """Return the standard deviations of an efficient estimator's independent errors, in the quantity's unit.

        One of a parameter; of the displacement those of its principal components, whose squares add up to the mean
        square error.
        """
        if name == "x":
            roots = self.slopes @ self.information.factor[: self.slopes.shape[1]]
            return np.linalg.svd(roots, compute_uv=False) / np.sqrt(len(roots))
        variance = self.information.variance(self.quantity(name))
        return np.array([abs(self.situation.value(name)) * np.sqrt(variance)])


def evidence_of(situation: Situation) -> Evidence:
    """Compute the information that the samples of a situation hold; raises InputError where nothing can move so."""
    n, setting = situation.full.n_dof, situation.setting
    dense = np.linspace(0.0, situation.times[-1], DENSE)
    grid = np.unique(np.concatenate([situation.times, dense]))
    path, gradient = _response(situation, situation.p, situation.start, grid)
    if not (np.all(np.isfinite(path)) and np.all(np.isfinite(gradient))):
        raise InputError("equation", " ".join(situation.full.names), "the motion is not finite over the record")
    unknowns = len(situation.p) + (0 if setting.initial_state.known else 2 * n)
    rows, at = list(situation.channels.values()), np.searchsorted(grid, situation.times)
    sigma = _sigma(setting.noise, path[rows][:, at])
    scaled = gradient[rows][:, at, :unknowns] / np.where(sigma > 0, sigma, 1.0)[:, None, None]
    precision = np.zeros(unknowns)
    for name, prior in setting.given.prior.items():
        if name in situation.p:
            precision[situation.system.names.index(name)] = (situation.p[name] / prior.sd) ** 2
    data = np.einsum("dti,dtj->ij", scaled, scaled)
    information = Information(situation.system.names, data, precision)
    return Evidence(situation, sigma, information, gradient[rows[0]][np.searchsorted(grid, dense), :unknowns])


def _response(
    situation: Situation, p: Mapping[str, float], start: InitialState, times: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return displacements and velocities (2 n_dof, n_times) and their derivatives by log-parameters and state."""
    differentiate = linear_sensitivities if situation.system.linear else stepped_sensitivities
    with np.errstate(all="ignore"):
        return differentiate(situation.system, p, start, times, situation.forces, 2 * situation.full.n_dof)


def _sigma(noise: StatedNoise, clean: np.ndarray) -> np.ndarray:
    """Return the standard deviation of the noise of each channel (n_channels,), of clean samples (n_channels, n)."""
    mean_square, variance = np.mean(clean**2, axis=1), np.var(clean, axis=1)
    peak, values = np.max(np.abs(clean), axis=1), np.broadcast_to(noise.value, len(clean)).astype(float)
    decibels, part = 10.0 ** (-values / 20.0), values / 100.0
    return np.asarray(
        {
            "none": 0.0 * values, "standard deviation": values, "variance": np.sqrt(values),
            "half-width": values / np.sqrt(3.0), "snr db": decibels * np.sqrt(mean_square),
            "snr db of the variance": decibels * np.sqrt(variance), "snr db of the peak": decibels * peak,
            "percent of the rms": part * np.sqrt(mean_square), "percent of the largest value": part * peak,
            "percent of the standard deviation": part * np.sqrt(variance),
        }[noise.definition]
    )  # fmt: skip


@dataclass(frozen=True)
class AuditFinding:
    """A reported number under one reading.

    ``bound``: standard deviation of one draw of an efficient estimator (of the displacement: its root mean square).
    ``score``: the reported error in the form in which it was reported; ``median``, ``low``, ``high``: of an efficient
    estimator's scores, with its 95 % range. ``smaller`` and ``larger``: the shares of those scores that are as small,
    and as large, as far as the printed digits tell. ``start``: distance of the starting value from the stated one,
    ``sd_ratio`` the stated standard deviation, both over the bound.
    """

    row: Reported
    reading: str
    verdict: Verdict
    truth: float
    score: float
    bound: float
    median: float
    low: float
    high: float
    smaller: float
    larger: float
    prior_share: float
    start: float | None
    sd_ratio: float | None
    why: tuple[str, ...] = ()


def judge(row: Reported, reading: str, evidence: Evidence) -> AuditFinding:
    """Place a reported number among the scores of an efficient estimator."""
    situation, nan = evidence.situation, float("nan")
    truth = nan if row.quantity == "x" else situation.value(row.quantity)
    score = nan if row.value is None else abs(row.value - truth) if row.form == "value" else row.value
    blank = AuditFinding(row, reading, "bias only", truth, score, 0.0, nan, nan, nan, nan, nan, 0.0, None, None)
    if situation.decided:
        return replace(blank, verdict="known")
    if not evidence.identifiable(row.quantity):
        return replace(blank, verdict="not identifiable", bound=float("inf"), why=_reasons(situation))
    if evidence.exact:
        return blank
    spread = evidence.spread(row.quantity)
    bound = float(np.sqrt(np.sum(spread**2)))
    if bound == 0.0:
        return replace(blank, verdict="known")
    scores = _scores(row, spread, truth)
    share = 0.0 if row.quantity == "x" else evidence.information.prior_share(evidence.quantity(row.quantity))
    smaller = float(np.mean(scores <= score + row.half_digit))
    larger = float(np.mean(scores >= score - row.half_digit))
    verdict: Verdict = "smaller" if smaller < RARE_SMALL else "larger" if larger < RARE_LARGE else "within"
    verdict = "no number" if row.value is None else verdict
    low, median, high = np.quantile(scores, [0.025, 0.5, 0.975]).tolist()
    guess = situation.setting.given.starting_value.get(row.quantity)
    start = None if guess is None else abs(guess - truth) / bound
    ratio = None if row.sd is None else row.sd / bound
    return AuditFinding(
        row, reading, verdict, truth, score, bound, median, low, high, smaller, larger, share, start, ratio
    )


def _scores(row: Reported, spread: np.ndarray, truth: float) -> np.ndarray:
    """Draw the scores of an efficient estimator, each of as many draws as were reported."""
    n = min(SIMULATED, MOST_SIMULATED // (row.draws * len(spread)))
    normal = np.random.default_rng(0).standard_normal((n, row.draws, len(spread)))
    squares = np.sum((normal * spread) ** 2, axis=-1)
    if row.form == "value":
        return np.abs(np.mean(normal[..., 0], axis=1)) * spread[0]
    if row.form == "rmse" and row.quantity != "x":
        return np.sqrt(np.mean(squares, axis=1))
    mean = np.mean(np.sqrt(squares), axis=1)
    return mean * (100.0 / abs(truth)) if row.form == "percent error" else mean


def _reasons(situation: Situation) -> tuple[str, ...]:
    """Return why a quantity is not identifiable, by the exact structure of the equation."""
    state = situation.setting.initial_state
    n, known = situation.full.n_dof, "known" if state.known else "unknown"
    masses = sorted({row % n for row in situation.channels.values()})
    start = (state.displacement, state.velocity) if state.known else None
    pushed = [force.dof for force in situation.forces]
    try:
        return tuple(structure(situation.system, masses, known, pushed, start).sentences())  # type: ignore[arg-type]
    except (TypeError, ZeroDivisionError):  # an equation without exact series
        return ()


@dataclass(frozen=True)
class Consistency:
    """How published samples, or a published solution, agree with the stated equation.

    ``difference``: the largest, over the largest value. ``fitted``: quantities and initial state of the equation that
    fits best, each with what is stated. ``chance``: that noise of the stated size differs so much; None for a solution.
    """

    what: str
    difference: float
    fitted: Mapping[str, tuple[float, float]]
    remaining: float
    chance: float | None

    @property
    def agrees(self) -> bool:
        return self.chance >= DISAGREES if self.chance is not None else self.difference < DISAGREES


def consistency(evidence: Evidence, quantities: Sequence[str]) -> list[Consistency]:
    """Compare the columns of a situation with its equation, and fit unknown parameters and initial state to them."""
    situation, data = evidence.situation, evidence.situation.setting.data
    if data is None:
        return []
    first = next(iter(situation.channels))
    sets = {"samples": dict(data.channels), **({"solution": {first: data.exact}} if data.exact else {})}
    names = list(dict.fromkeys([*situation.system.names, *(q for q in quantities if q != "x")]))
    return [_compared(evidence, what, columns, names) for what, columns in sets.items() if columns]


def _compared(evidence: Evidence, what: str, columns: Mapping[str, str], names: Sequence[str]) -> Consistency:
    from scipy.optimize import least_squares
    from scipy.stats import chi2

    situation, data, n = evidence.situation, evidence.situation.setting.data, evidence.situation.full.n_dof
    assert data is not None
    times, order = np.unique(situation.columns[data.time], return_index=True)
    values = np.stack([situation.columns[column][order] for column in columns.values()])
    rows = [situation.channels[name] for name in columns]
    noise = dict(zip(situation.channels, evidence.sigma, strict=True))
    scale = np.array([noise[name] or 1.0 for name in columns])[:, None]
    k = len(situation.p)

    def at(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        p = dict(zip(situation.system.names, np.exp(theta[:k]).tolist(), strict=True))
        path, gradient = _response(situation, p, InitialState(theta[k : k + n], theta[k + n :]), times)
        residual = (path[rows] - values) / scale
        return residual.ravel(), (gradient[rows] / scale[..., None]).reshape(residual.size, -1)

    state = [*situation.start.displacement, *situation.start.velocity]
    claimed = np.array([*np.log([situation.p[name] for name in situation.system.names]), *state])
    fit = least_squares(lambda theta: at(theta)[0], claimed, lambda theta: at(theta)[1], x_scale="jac")
    before, rank = at(claimed)[0], int(np.linalg.matrix_rank(fit.jac))
    sizes = dict(zip(situation.system.names, np.exp(fit.x[:k]).tolist(), strict=True))
    fitted = {
        name: (situation.value(name, sizes), situation.value(name)) for name in names if evidence.identifiable(name)
    }
    labels = [f"{letter}{i + 1 if n > 1 else ''}(0)" for letter in ("x", "x'") for i in range(n)]
    fitted |= dict(zip(labels, zip(fit.x[k:].tolist(), map(float, state), strict=True), strict=True))
    largest = float(np.max(np.abs(values)))
    difference = float(np.max(np.abs(before.reshape(values.shape) * scale))) / largest
    chance = None if what == "solution" or evidence.exact else float(chi2.sf(before @ before - 2 * fit.cost, rank))
    left = float(np.max(np.abs(fit.fun.reshape(values.shape) * scale))) / largest
    return Consistency(what, difference, fitted, left, chance)


@dataclass(frozen=True)
class MethodComparison:
    """Methods that reported the same score of the same draws, the nearest to the stated value first."""

    findings: tuple[AuditFinding, ...]

    @property
    def decided(self) -> bool:
        """Whether the farthest is outside an efficient estimator's range, and the nearest is not."""
        return self.findings[-1].verdict == "larger" and self.findings[0].verdict != "larger"


@dataclass(frozen=True)
class Audit:
    """A claim with all that was found: a finding a reported number and reading, comparisons, consistency by case."""

    stated: Stated
    evidence: Mapping[tuple[str, str], Evidence]
    findings: tuple[AuditFinding, ...]
    comparisons: tuple[MethodComparison, ...]
    consistency: Mapping[str, tuple[Consistency, ...]]

    def of(self, reading: str) -> list[AuditFinding]:
        """Return the findings under a reading."""
        return [finding for finding in self.findings if finding.reading == reading]


def audit(stated: Stated) -> Audit:
    """Audit a claim; raises InputError where its equation cannot be followed."""
    rows = stated.claim.reported
    used = {key: s for key, s in stated.situations.items() if key[0] in {row.case for row in rows}}
    evidence = {key: evidence_of(situation) for key, situation in used.items()}
    findings = [judge(row, reading, evidence[row.case, reading]) for reading in stated.readings for row in rows]
    groups: dict[tuple[object, ...], list[AuditFinding]] = {}
    for finding in findings:
        row = finding.row
        if finding.reading == "" and finding.verdict in ("within", "smaller", "larger"):
            groups.setdefault((row.case, row.quantity, row.form, row.draws), []).append(finding)
    comparisons = [MethodComparison(tuple(sorted(g, key=lambda f: f.score))) for g in groups.values() if len(g) > 1]
    checked = {
        case: tuple(consistency(evidence[case, ""], [row.quantity for row in rows if row.case == case]))
        for case in dict.fromkeys(row.case for row in rows)
    }
    return Audit(stated, evidence, tuple(findings), tuple(comparisons), {k: v for k, v in checked.items() if v})
