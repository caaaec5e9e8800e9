"""Shooting and output error beside what an engineer would otherwise write."""

from __future__ import annotations

import math
import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from statistics import median
from typing import Annotated

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from bench import Estimate, Normal, Problem, Status
from bench.entrants.registry import make_method
from bench.information.fisher import compute_bound
from bench.isolation.failure import one_line
from bench.isolation.limits import limited
from bench.isolation.machine import single_threaded
from bench.reporting.rounding import excess_text, number
from bench.reporting.tables.render import markdown_table
from bench.scenario.scenario import METHOD, Scenario
from bench.scenario.truth import Truth
from bench.scoring.combination import combine_with_prior
from bench.scoring.score import score
from bench.scoring.statistics import wilson_interval
from tests.studies.common import RESULTS, Count, Out, publish, scenario, study, tracked

SEED = 4242
"""A seed that nothing was tuned on and no table uses."""
SNRS = (40, 20)
WITHIN = 3.0
"""A fit succeeds if it says so itself and its displacement error is below so many times the bound."""
# ------------------------------------------------------------------------------------------------ by hand

Rates = Callable[[float, np.ndarray, np.ndarray], np.ndarray]


def duffing_rates(t: float, state: np.ndarray, p: np.ndarray) -> np.ndarray:
    """``m x'' + c x' + k x + k3 x³ = 0`` as first-order rates; p is m, c, k, k3."""
    x, v = state
    m, c, k, k3 = p
    return np.array([v, -(c * v + k * x + k3 * x**3) / m])


def chain_rates(t: float, state: np.ndarray, p: np.ndarray) -> np.ndarray:
    """A chain tied to the ground at one end as first-order rates; p is all masses, then dampers, then springs."""
    x, v = np.split(state, 2)
    m, c, k = np.split(p, 3)
    link = c * np.diff(v, prepend=0.0) + k * np.diff(x, prepend=0.0)
    return np.concatenate([v, (np.append(link[1:], 0.0) - link) / m])


RATES: dict[str, Rates] = {"duffing": duffing_rates, "chain": chain_rates}


def by_hand(problem: Problem, rng: np.random.Generator) -> Estimate:
    """The parameters that fit the record, from the nominal values, by scipy's defaults (integration at 1e-6).

    Plain residuals in metres, no weights and no prior rows, since the noise level is not known: the prior enters as the
    start. Positive parameters, each in units of its nominal value.
    """
    (record,), prior, rates = problem.records, problem.prior, RATES[problem.system.name]
    assert prior is not None
    assert record.initial_state is not None
    nominal = np.array([prior.nominal[name] for name in problem.system.names])
    start = np.concatenate([record.initial_state.displacement, record.initial_state.velocity])
    times, dofs = record.channels[0].times, [channel.dof for channel in record.channels]
    measured = np.stack([channel.values for channel in record.channels])

    def residuals(relative: np.ndarray) -> np.ndarray:
        solution = solve_ivp(rates, (0.0, times[-1]), start, t_eval=times, rtol=1e-6, args=(relative * nominal,))
        if not solution.success or not np.all(np.isfinite(solution.y)):
            return np.full(measured.size, 1e3)
        return np.asarray(solution.y[dofs] - measured).ravel()

    fit = least_squares(residuals, np.ones(nominal.size), bounds=(0.0, np.inf))
    distribution = Normal(problem.system.names, np.log(np.maximum(fit.x, 1e-12) * nominal), None, log=True)
    status = Status.OK if fit.success else Status.DIVERGED
    return Estimate(problem.system, parameters=distribution, status=status, message=str(fit.message))


# ------------------------------------------------------------------------------------------------ measuring


Fit = Callable[[Problem, np.random.Generator], Estimate]


@dataclass(frozen=True)
class Outcome:
    """One fit: processor seconds, displacement error over the bound (inf where it failed), and why it failed."""

    seconds: float
    excess: float
    reason: str

    @property
    def success(self) -> bool:
        return self.excess < WITHIN


def contenders() -> dict[str, Fit]:
    """Return the methods that are compared, by name, in the order of a turn."""
    ours = {name: make_method(name, {}).identify for name in ("shooting", "output_error")}
    return {"by_hand": by_hand, **ours}


def attempt(fit: Fit, problem: Problem, truth: Truth, rng: np.random.Generator, bound: float, limit: float) -> Outcome:
    """One timed fit, and its score; whatever it raises is a failure."""
    started = time.process_time()
    try:
        with limited(limit, "processor"), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            estimate = fit(problem, rng)
    except Exception as error:
        return Outcome(time.process_time() - started, math.inf, one_line(error))
    seconds = time.process_time() - started
    if estimate.status is not Status.OK:
        return Outcome(seconds, math.inf, f"{estimate.status}: {estimate.message}")
    off = score(combine_with_prior(estimate, problem.prior).checked(), problem, truth).get("rmse", math.inf)
    reason = "" if off < WITHIN * bound else "another minimum"
    return Outcome(seconds, off / bound, reason)


def measure(scenario: Scenario, replicates: int, limit: float) -> dict[str, list[Outcome]]:
    """Every contender on every data set of a scenario, in turn.

    Before these, each fits one data set more that does not count: it loads and builds what a first fit needs.
    """
    fits, outcomes = contenders(), {name: list[Outcome]() for name in contenders()}
    bound = compute_bound(scenario, SEED).rmse
    make = scenario.maker(SEED)
    for i in tracked((replicates, *range(replicates)), "data set"):
        problem, truth = make(i)
        for name, fit in fits.items():
            outcome = attempt(fit, problem, truth, scenario.stream(METHOD, SEED, i), bound, limit)
            if i < replicates:
                outcomes[name].append(outcome)
    return outcomes


# ------------------------------------------------------------------------------------------------ the page

TITLES = {
    "by_hand": "by hand: least_squares around solve_ivp",
    "shooting": "method=shooting",
    "output_error": "method=output_error",
}
TEXT = """Regenerate: `python -m tests.studies.handwritten`.

What an engineer would otherwise write, `scipy.optimize.least_squares` around `scipy.integrate.solve_ivp` (RK45 at a
relative tolerance of 1e-6, forward differences, both scipy's defaults), compared with two methods of this benchmark.
Initial state known, nominal prior. By hand the fit starts once, at the nominal values, positive parameters in units of
these; its residuals are plain metres, without weights or prior rows, since the noise level is not known. `output_error`
starts there, too; `shooting` looks for its starts itself. The same data, one process, one thread, methods in turn, one
fit each before the first that counts; seconds of processor time, limit {limit:g} s a fit.

*Success*: the fit says that it has converged, and its displacement error is below {within:g} times the Cramér-Rao
bound; in brackets the 95 % interval of the rate (Wilson). *Excess*: root mean square displacement error over the
bound, of the successful fits. *Time, largest*: of all fits, those that failed among them."""


def row(label: str, snr: float, name: str, outcomes: Sequence[Outcome]) -> list[str]:
    """One line of the table."""
    good = [outcome.excess for outcome in outcomes if outcome.success]
    n, seconds = len(outcomes), [outcome.seconds for outcome in outcomes]
    low, high = wilson_interval(len(good), n)
    excess = excess_text(float(np.sqrt(np.mean(np.square(good))))) if good else "-"
    counts = Counter(outcome.reason for outcome in outcomes if not outcome.success)
    failures = "; ".join(f"{count} × {reason}" for reason, count in counts.items())
    success = f"{len(good)}/{n} ({100 * low:.0f} to {100 * high:.0f} %)"
    times = [number(median(seconds)), number(max(seconds))]
    return [label, f"{snr:g}", TITLES[name], success, excess, *times, failures]


def page(rows: Sequence[Sequence[str]], limit: float) -> str:
    """The table as a page."""
    headers = ["system", "dB", "what", "success", "excess", "time, median (s)", "largest (s)", "what failed"]
    text = TEXT.format(limit=limit, within=WITHIN)
    return "\n\n".join(["# Beside a fit by hand", text, markdown_table(rows, headers)]) + "\n"


def handwritten(
    duffing: Annotated[Count, "data sets of the Duffing oscillator"] = 20,
    chain5: Annotated[Count, "data sets of the chain of five masses"] = 5,
    timeout_s: Annotated[Count, "s of the processor, limit of a fit"] = 120,
    out: Out = RESULTS,
) -> int:
    """Measure shooting and output error beside what an engineer would otherwise write: handwritten.md.

    That is scipy.optimize.least_squares around scipy.integrate.solve_ivp, some twenty lines, started once from the
    nominal values. All methods fit the same data sets in one process, in turn, so that their times can be compared.
    """
    single_threaded()
    rows, counts = [], {"duffing": duffing, "chain5": chain5}
    for label, count in counts.items():
        for snr in SNRS:
            outcomes = measure(scenario(system=label, snr=snr), count, float(timeout_s))
            rows += [row(label, snr, name, own) for name, own in outcomes.items()]
    publish(out / "handwritten.md", page(rows, timeout_s))
    return 0


main = partial(study, handwritten, "tests.studies.handwritten")

if __name__ == "__main__":
    sys.exit(main())
