"""Compare reported numbers with the Cramér-Rao bound of their data and the errors of an efficient estimator.

An efficient estimator is unbiased and has the covariance of the Cramér-Rao bound (S. M. Kay, Fundamentals of
Statistical Signal Processing: Estimation Theory, 1993, chapter 3), to first order in the noise; its errors are drawn
as normal ones, since those of maximum likelihood are so in the limit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bench.audit.claim import Reported, Situation, StatedClaim, StatedNoise
from bench.contract.problem import InitialState
from bench.errors import InputError
from bench.information.fisher import Information
from bench.information.sensitivities import linear_sensitivities, stepped_sensitivities
from bench.information.structural import structure
from bench.scoring.verdict import DECIDED_BY_PRIOR
from bench.systems import Quantity

RARE = 0.01
"""Level of the verdicts "smaller" and "larger": a share of the scores of an efficient estimator."""
DISAGREES = 1e-3
"""Level below which samples contradict the stated equation; for a solution, the relative difference that does."""
SIMULATED, MOST_SIMULATED, DENSE, STEP = 100_000, 10_000_000, 1000, 1e-5
Verdict = Literal[
    "within",
    "smaller",
    "larger",
    "not identifiable",
    "bias only",
    "decided by the prior",
    "known beforehand",
    "no number",
]


@dataclass(frozen=True, eq=False)
class Evidence:
    """The Fisher information of a situation, and the derivatives of its response.

    Attributes:
        situation: The situation.
        sigma: Standard deviations of the noise (n_channels,); zero without noise.
        information: Fisher information.
        slopes: Derivatives of the first channel by the unknowns, over the record (n_dense, n_unknowns).
    """

    situation: Situation
    sigma: np.ndarray
    information: Information
    slopes: np.ndarray

    def quantity(self, name: str) -> Quantity:
        """Approximate a quantity by a product of powers at the stated parameters, by central differences."""
        p, value = self.situation.p, self.situation.value
        ends = [[value(name, {**p, n: p[n] * np.exp(side * STEP)}) for side in (1, -1)] for n in p]
        return Quantity(
            name, "", {n: float(np.log(up / down) / (2 * STEP)) for n, (up, down) in zip(p, ends, strict=True)}
        )

    def spread(self, name: str) -> np.ndarray:
        """Return the standard deviations of the independent errors of an efficient estimator, in the quantity's unit.

        Returns:
            For a parameter one value, infinite if it is not identifiable; for the displacement those of its principal
            components, whose squares add up to the mean square error.
        """
        if name == "x":
            roots = self.slopes @ self.information.factor[: self.slopes.shape[1]]
            return np.asarray(np.linalg.svd(roots, compute_uv=False) / np.sqrt(DENSE))
        return np.array([abs(self.situation.value(name)) * np.sqrt(self.information.variance(self.quantity(name)))])


def evidence_of(situation: Situation) -> Evidence:
    """Compute the Fisher information of a situation; raises InputError if the motion is not finite."""
    setting, names = situation.setting, situation.system.names
    dense = np.linspace(0.0, situation.times[-1], DENSE)
    grid = np.unique(np.concatenate([situation.times, dense]))
    path, gradient = _response(situation, situation.p, situation.start, grid)
    if not (np.all(np.isfinite(path)) and np.all(np.isfinite(gradient))):
        raise InputError("equation", situation.system.equations[0], "the motion is not finite over the record")
    unknowns = len(names) if setting.initial_state.known else gradient.shape[2]
    rows, sampled = list(situation.rows), np.searchsorted(grid, situation.times)
    sigma = _sigma(setting.noise, path[rows][:, sampled])
    scaled = gradient[rows][:, sampled, :unknowns] / np.where(sigma > 0, sigma, 1.0)[:, None, None]
    precision = np.zeros(unknowns)
    for name, prior in setting.given.prior.items():
        if name in names:
            sd = prior.sd or (prior.percent or np.inf) / 100.0 * situation.p[name]
            precision[names.index(name)] = (situation.p[name] / sd) ** 2
    information = Information(names, np.einsum("dti,dtj->ij", scaled, scaled), precision)
    return Evidence(situation, sigma, information, gradient[rows[0]][np.searchsorted(grid, dense), :unknowns])


def _response(
    situation: Situation, p: Mapping[str, float], start: InitialState, times: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return displacements and velocities (2 n_dof, n_times), and their derivatives by log-parameters and state."""
    system = situation.system
    differentiate = linear_sensitivities if system.linear else stepped_sensitivities
    with np.errstate(all="ignore"):
        return differentiate(system, p, start, times, situation.forces, 2 * system.n_dof)


def _sigma(noise: StatedNoise, clean: np.ndarray) -> np.ndarray:
    """Return the standard deviation of the noise by channel (n_channels,), from clean samples (n_channels, n)."""
    values = np.broadcast_to(noise.value, len(clean)).astype(float)
    plain = {"none": 0.0 * values, "standard deviation": values, "variance": np.sqrt(values)}
    plain["half-width"] = values / np.sqrt(3.0)
    if noise.definition in plain:
        return plain[noise.definition]
    size = np.sqrt(np.mean(clean**2, axis=1))
    if noise.definition.endswith(("variance", "standard deviation")):
        size = np.std(clean, axis=1)
    if noise.definition.endswith(("peak", "largest value")):
        size = np.max(np.abs(clean), axis=1)
    return np.asarray(size * (values / 100.0 if noise.definition.startswith("percent") else 10.0 ** (-values / 20.0)))


@dataclass(frozen=True)
class AuditFinding:
    """A reported number under one reading.

    Attributes:
        row: The reported number.
        reading: Reading; empty for the stated one.
        verdict: Verdict.
        truth: True value.
        score: Reported error, in the form in which it was reported.
        bound: Standard deviation of an efficient estimator for one draw (displacement: its root mean square).
        median: Median score of an efficient estimator.
        low: Lower end of the 95 % range of its scores.
        high: Upper end of the 95 % range of its scores.
        smaller: Share of its scores that are at most the reported one, within the printed digits.
        larger: Share of its scores that are at least the reported one, within the printed digits.
        prior_share: Share of the bound's variance that is due to the prior.
        start: Distance of the initial guess from the stated value, over the bound.
        sd_ratio: Stated standard deviation over the bound.
        why: Reasons why the quantity is not identifiable.
    """

    row: Reported
    reading: str
    verdict: Verdict
    truth: float
    score: float
    bound: float = 0.0
    median: float = float("nan")
    low: float = float("nan")
    high: float = float("nan")
    smaller: float = float("nan")
    larger: float = float("nan")
    prior_share: float = 0.0
    start: float | None = None
    sd_ratio: float | None = None
    why: tuple[str, ...] = ()


def judge(row: Reported, reading: str, evidence: Evidence) -> AuditFinding:
    """Compare a reported number with the scores of an efficient estimator."""
    situation, nan = evidence.situation, float("nan")
    truth = nan if row.quantity == "x" else situation.value(row.quantity)
    score = nan if row.value is None else abs(row.value - truth) if row.form == "value" else row.value
    finding = AuditFinding(row, reading, "known beforehand", truth, score)
    spread = evidence.spread(row.quantity)
    bound = float(np.sqrt(np.sum(spread**2)))
    if situation.decided or bound == 0.0:
        return finding
    if not np.isfinite(bound):
        return replace(finding, verdict="not identifiable", bound=bound, why=_reasons(situation))
    if not np.all(evidence.sigma):
        return replace(finding, verdict="bias only")
    scores = _scores(row, spread, truth)
    smaller, larger = np.mean(scores <= score + row.half_digit), np.mean(scores >= score - row.half_digit)
    share = 0.0 if row.quantity == "x" else evidence.information.prior_share(evidence.quantity(row.quantity))
    verdict: Verdict = "smaller" if smaller < RARE else "larger" if larger < RARE else "within"
    verdict = "no number" if row.value is None else "decided by the prior" if share > DECIDED_BY_PRIOR else verdict
    low, median, high = np.quantile(scores, [0.025, 0.5, 0.975]).tolist()
    guess = situation.setting.given.starting_value.get(row.quantity)
    return replace(
        finding, verdict=verdict, bound=bound, median=median, low=low, high=high,
        smaller=float(smaller), larger=float(larger), start=None if guess is None else abs(guess - truth) / bound,
        prior_share=share, sd_ratio=None if row.sd is None else row.sd / bound,
    )  # fmt: skip


def _scores(row: Reported, spread: np.ndarray, truth: float) -> np.ndarray:
    """Draw scores of an efficient estimator, each from as many draws of the noise as the reported number."""
    n = max(100, min(SIMULATED, MOST_SIMULATED // (row.draws * len(spread))))
    errors = spread * np.random.default_rng(0).standard_normal((n, row.draws, len(spread)))
    if row.form == "value":
        return np.asarray(np.abs(np.mean(errors[..., 0], axis=1)))
    sizes = np.sqrt(np.sum(errors**2, axis=-1))
    if row.form == "rmse" and row.quantity != "x":
        return np.asarray(np.sqrt(np.mean(sizes**2, axis=1)))
    return np.asarray(np.mean(sizes, axis=1) * (100.0 / abs(truth) if row.form == "percent error" else 1.0))


def _reasons(situation: Situation) -> tuple[str, ...]:
    """Return the reasons why a quantity is not identifiable, from the structure of the equation."""
    state, n = situation.setting.initial_state, situation.system.n_dof
    masses, pushed = sorted({row % n for row in situation.rows}), [force.dof for force in situation.forces]
    start = (state.displacement, state.velocity) if state.known else None
    try:
        return tuple(structure(situation.system, masses, "known" if start else "unknown", pushed, start).sentences())
    except (TypeError, ZeroDivisionError):  # an equation without exact series
        return ()


@dataclass(frozen=True)
class Consistency:
    """Agreement of published samples, or of a published solution, with the stated equation.

    Attributes:
        what: Samples or solution.
        difference: Largest difference over the largest value.
        fitted: Parameters and initial state of the best fit, each with the stated value.
        remaining: Largest difference from the best fit, over the largest value.
        chance: p value of the difference under noise of the stated size; None for a solution.
    """

    what: Literal["samples", "solution"]
    difference: float
    fitted: Mapping[str, tuple[float, float]]
    remaining: float
    chance: float | None

    @property
    def agrees(self) -> bool:
        """Whether the stated equation explains the data."""
        return self.difference < DISAGREES if self.chance is None else self.chance >= DISAGREES


def consistency(evidence: Evidence, column: str, what: Literal["samples", "solution"]) -> Consistency:
    """Compare published data of the first channel with the equation, and fit parameters and initial state to them."""
    from scipy.optimize import least_squares
    from scipy.stats import chi2

    situation, data = evidence.situation, evidence.situation.setting.data
    assert data is not None
    times, order = np.unique(situation.columns[data.time], return_index=True)
    values, names, n = situation.columns[column][order], situation.system.names, situation.system.n_dof
    sigma, k, state = float(evidence.sigma[0]), len(names), [*situation.start.displacement, *situation.start.velocity]

    def difference(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        p = dict(zip(names, np.exp(theta[:k]).tolist(), strict=True))
        start = InitialState(theta[k : k + n], theta[k + n :])
        path, gradient = _response(situation, p, start, times)
        return path[situation.rows[0]] - values, gradient[situation.rows[0]]

    stated = np.array([*np.log([situation.p[name] for name in names]), *state])
    fit = least_squares(lambda theta: difference(theta)[0], stated, lambda theta: difference(theta)[1], x_scale="jac")
    before, largest = difference(stated)[0], float(np.max(np.abs(values)))
    fitted = {
        name: (situation.value(name, dict(zip(names, np.exp(fit.x[:k]).tolist(), strict=True))), situation.value(name))
        for name in names if np.isfinite(evidence.spread(name)[0])
    }  # fmt: skip
    labels = [f"{letter}{i + 1 if n > 1 else ''}(0)" for letter in ("x", "x'") for i in range(n)]
    fitted |= dict(zip(labels, zip(fit.x[k:].tolist(), map(float, state), strict=True), strict=True))
    explained = (before @ before - 2.0 * fit.cost) / sigma**2 if sigma else 0.0
    chance = float(chi2.sf(explained, np.linalg.matrix_rank(fit.jac))) if what == "samples" and sigma else None
    ends = [float(np.max(np.abs(residual))) / largest for residual in (before, fit.fun)]
    return Consistency(what, ends[0], fitted, ends[1], chance)


@dataclass(frozen=True)
class Audit:
    """The audit of a claim.

    Attributes:
        stated: The claim.
        findings: Findings on each reported number under each reading.
        rivals: Groups of findings of several methods on the same quantity and draws, the most accurate first.
        consistency: Agreement of the published data with the equation, by case.
    """

    stated: StatedClaim
    findings: tuple[AuditFinding, ...]
    rivals: tuple[tuple[AuditFinding, ...], ...]
    consistency: tuple[tuple[str, Consistency], ...]

    def of(self, reading: str) -> list[AuditFinding]:
        """Return the findings under a reading."""
        return [finding for finding in self.findings if finding.reading == reading]

    def others(self, finding: AuditFinding) -> str:
        """List the verdicts of the other readings, with their bounds."""
        number = self.of("").index(finding)
        other = [self.of(reading)[number] for reading in self.stated.claim.readings]
        if other and all(f.verdict == finding.verdict for f in other):
            ends = dict.fromkeys(f"{end(f.bound for f in other):.3g}" for end in (min, max))
            return f"the same, bound {' to '.join(ends)}" if 0 < finding.bound < np.inf else "the same"
        return ", ".join(
            f"{f.reading}: {f.verdict} (bound {f.bound:.3g})" for f in other if f.verdict != finding.verdict
        )


def audit(stated: StatedClaim) -> Audit:
    """Audit a claim; raises InputError if its equation has no finite solution."""
    rows, readings = stated.claim.reported, ("", *stated.claim.readings)
    cases = dict.fromkeys([row.case for row in rows] or [""])
    evidence = {(c, reading): evidence_of(stated.situations[c, reading]) for c in cases for reading in readings}
    findings = [judge(row, reading, evidence[row.case, reading]) for reading in readings for row in rows]
    groups: dict[tuple[object, ...], list[AuditFinding]] = {}
    for finding in findings[: len(rows)]:
        if finding.verdict in ("within", "smaller", "larger"):
            row = finding.row
            groups.setdefault((row.case, row.place, row.quantity, row.form, row.draws), []).append(finding)
    rivals = [tuple(sorted(group, key=lambda f: f.score)) for group in groups.values()]
    checks: dict[tuple[object, ...], tuple[str, Consistency]] = {}
    for case in cases:
        data = stated.situations[case, ""].setting.data
        for what, column in (("samples", data.x), ("solution", data.exact)) if data else ():
            if column and (what, column) not in checks:
                checks[what, column] = (case, consistency(evidence[case, ""], column, what))  # type: ignore[arg-type]
    several = [group for group in rivals if len({finding.row.method for finding in group}) > 1]
    return Audit(stated, tuple(findings), tuple(several), tuple(checks.values()))
