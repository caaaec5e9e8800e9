"""Requirements on methods, of this project and of others, in order of importance."""

from __future__ import annotations

import math
import multiprocessing
import pickle
import threading
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cached_property

import numpy as np

from bench.conformance.check import Checks, Refusal
from bench.conformance.decoys import fit_among_decoys
from bench.conformance.imports import check_imports
from bench.conformance.problems import DIFFICULT, PLANT, forced_problem, free_problem
from bench.contract.estimate import Estimate, Status
from bench.contract.method import Card, Identifier
from bench.contract.prior import Prior
from bench.contract.problem import Problem, Units
from bench.engine.scoring_process import data_digest
from bench.engine.wire import pack, plain, unpack
from bench.scenario.stream import anonymous_stream
from bench.scoring.combination import combine_with_prior

METHOD_CHECKS = Checks()
GROUPS = ("k_over_m", "c_over_m")
SEED = 11
REPLICATES = (5, 2, 3)
"""Seeds of the problems that are solved again in another process, the ordinary one first."""
TIMES = np.linspace(0.0, 8.0, 9)
"""Times at which reconstructions are compared (s)."""
SAME_IN_BATCH = 1e-12
"""Largest relative difference in a batch: the order of sums in a matrix product may depend on the number of rows."""
SAME_IN_PROCESS = 1e-9
"""Largest relative difference between processes: the order of sums may depend on the alignment of arrays."""
SAME_IN_UNITS = 1e-3
"""Largest difference between units, over the standard error."""
WITHOUT_ERROR = 0.01
"""Relative standard error assumed of a method that states none."""
MASS_WITHIN = 2.5
"""Factor about the true mass: equation-error methods are biased by their sampling step, but not arbitrary."""
FEWEST_WORDS, LONGEST_MESSAGE = 4, 300
RANDOM = "draw from the rng that estimate is given, and from nothing else: no global stream, clock or order of a set"
STATE = "keep nothing on the class, in the module or in a file from one call of estimate to the next"


class Candidate:
    """A method under check, with the estimates that several checks need, each computed once."""

    def __init__(self, method: Identifier) -> None:
        self.method = method
        self.seconds = math.nan
        self.threads = set(threading.enumerate())

    def fit(self, problem: Problem | None = None) -> Estimate:
        """Fit a problem, by default the ordinary one."""
        return self.method.identify(problem or free_problem(), anonymous_stream(SEED))

    @cached_property
    def first(self) -> Estimate:
        """First estimate of the ordinary problem."""
        began = time.perf_counter()
        estimate = self.fit()
        self.seconds = time.perf_counter() - began
        return valid(estimate)

    @cached_property
    def second(self) -> tuple[Estimate, list[str], bool]:
        """Estimate after another problem and among decoys, accesses to files, and whether the data are unchanged."""
        _ = self.first, self.fit(free_problem(seed=2))
        problem = free_problem()
        digest = data_digest(problem)
        return *fit_among_decoys(self.method, problem, SEED), data_digest(problem) == digest


def valid(estimate: Estimate) -> Estimate:
    """Return the estimate if it has the form of the contract; else raises Refusal."""
    if not isinstance(estimate, Estimate):
        raise Refusal(f"estimate returned a {type(estimate).__name__}", "return a bench.Estimate")
    if estimate.status is not Status.OK:
        raise Refusal(f"no answer to ordinary data: {estimate.status}, {estimate.message}")
    distribution = estimate.distribution
    if distribution is None or (estimate.parameters is not None and estimate.groups is not None):
        raise Refusal("it gives parameters and groups, or neither")
    known = {quantity.name for quantity in estimate.system.quantities}
    if not set(distribution.names) <= known:
        raise Refusal(
            f"it names {', '.join(sorted(set(distribution.names) - known))}; known: {', '.join(sorted(known))}"
        )
    if not distribution.finite():
        raise Refusal("its answer is not finite, and its status is ok")
    return estimate


def summary(estimate: Estimate, prior: Prior | None) -> np.ndarray:
    """Return k/m and c/m, then their standard errors (half the 68 % interval); NaNs for a failed fit."""
    if estimate.status is not Status.OK:
        return np.full(4, math.nan)
    combined = combine_with_prior(estimate, prior)
    marginals = [combined.marginal(combined.system.quantity(name)) for name in GROUPS]
    if None in marginals:
        raise Refusal("it states no k/m or no c/m", "name parameters or groups of the problem's system")
    intervals = [marginal.interval(0.6827) for marginal in marginals if marginal]
    values = [marginal.value for marginal in marginals if marginal]
    return np.array(values + [(high - low) / 2 for low, high in intervals])


def same(first: Estimate, other: Estimate) -> bool:
    """Return whether two answers to the ordinary problem agree to the last bit."""
    prior = free_problem().prior
    return np.array_equal(summary(first, prior), summary(other, prior), equal_nan=True)


def solve(method: Identifier, seeds: Sequence[int]) -> list[np.ndarray]:
    """Return k/m and c/m of ordinary problems with these seeds."""
    problems = [free_problem(seed=seed) for seed in seeds]
    return [summary(Candidate(method).fit(problem), problem.prior)[:2] for problem in problems]


@METHOD_CHECKS.add("card", "give the class a card = bench.Card(...) without empty fields")
def card(candidate: Candidate) -> str:
    """It has a card and a docstring, is immutable, and says what it needs."""
    method = candidate.method
    declared = getattr(type(method), "card", None)
    if not isinstance(declared, Card):
        raise Refusal("the class has no card")
    for name in ("summary", "uncertainty", "settings_source", "tuning"):
        if not str(getattr(declared, name)).strip():
            raise Refusal(f"card.{name} is empty")
    text = (type(method).__doc__ or "").strip()
    if not text or text.startswith(f"{type(method).__name__}("):  # the second is a dataclass's own
        raise Refusal("the class has no docstring", "say in its docstring what the method does, and where it is from")
    if not type(method).__dataclass_params__.frozen:  # type: ignore[attr-defined]
        raise Refusal("its settings can be changed", "declare it @dataclass(frozen=True)")
    if method.requires and not method.extra:
        raise Refusal(f"requires {', '.join(method.requires)}, but no extra", "say in extra what installs its packages")
    return declared.summary


@METHOD_CHECKS.add("imports", "import the names of bench itself (bench.__all__), and no module below it")
def only_the_contract(candidate: Candidate) -> None:
    """Its modules import public names of the contract only."""
    check_imports(type(candidate.method))


@METHOD_CHECKS.add(
    "answer", "return bench.Estimate with parameters (of all names) or groups, shaped as its docstring says", gate=True
)
def answer(candidate: Candidate) -> str:
    """Ordinary data have an answer that can be scored."""
    objection = candidate.method.objection(free_problem())
    if objection is not None:
        raise Refusal(f"it objects to a free decay of one mass, the first scenario of every table: {objection}")
    estimate = candidate.first
    distribution = estimate.distribution
    assert distribution is not None
    if min(distribution.values().values()) <= 0:
        raise Refusal(f"a value is not a positive number: {distribution.values()}")
    covariance = getattr(distribution, "covariance", None)
    if covariance is not None and float(np.linalg.eigvalsh(covariance)[0]) < -1e-9 * float(np.trace(covariance)):
        raise Refusal("its covariance has a negative eigenvalue")
    try:
        unpack(pack(plain(estimate, TIMES)))
    except (TypeError, ValueError, AttributeError) as error:
        raise Refusal(f"it cannot be scored: {error}") from None
    k_over_m, c_over_m, *_ = summary(estimate, free_problem().prior)
    return f"k/m {k_over_m:.3g} 1/s², c/m {c_over_m:.3g} 1/s"


@METHOD_CHECKS.add("seed", f"{RANDOM}; {STATE}")
def same_seed(candidate: Candidate) -> None:
    """The same problem and the same seed give the same answer to the last bit, whatever was fitted before."""
    again, *_ = candidate.second
    if not same(candidate.first, again):
        raise Refusal(f"after another problem, with other global random streams and among decoys, {again} is another")


@METHOD_CHECKS.add("state", f"{STATE}; {RANDOM}")
def no_state(candidate: Candidate) -> str:
    """In another process and in the reverse order, problems have the same answers."""
    here = solve(candidate.method, REPLICATES)
    multiprocessing.current_process().daemon = False  # type: ignore[misc]  # it may have a process of its own
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        there = pool.submit(solve, candidate.method, REPLICATES[::-1]).result()[::-1]
    if not np.allclose(here, there, rtol=SAME_IN_PROCESS, atol=0.0, equal_nan=True):
        raise Refusal(f"k/m and c/m of {len(here)} problems are {here} here and {there} there")
    return f"{len(here)} problems"


@METHOD_CHECKS.add("honesty", "use the problem and the numbers of the rng alone; in a sweep nothing else is there")
def honest(candidate: Candidate) -> None:
    """No truth or seed within reach changes its answer, and it looks into no store and no scenario."""
    among_decoys, looks, _ = candidate.second
    if looks:
        raise Refusal("; ".join(f"it {look}" for look in list(dict.fromkeys(looks))[:3]))
    if not same(candidate.first, among_decoys):
        again = candidate.fit()
        if not same(again, among_decoys) and same(again, candidate.fit()):
            raise Refusal("its answer changes with a truth or a seed within reach")


@METHOD_CHECKS.add("input", "copy what you change: the arrays belong to others, too")
def input_untouched(candidate: Candidate) -> None:
    """The problem is as it was."""
    *_, untouched = candidate.second
    if not untouched:
        raise Refusal("the samples, the initial state or the prior of the problem were changed")


@METHOD_CHECKS.add("batch", "treat each problem of estimate_many by itself")
def in_batch(candidate: Candidate) -> None:
    """Alone or in a batch with others, a problem has the same answer."""
    problem = free_problem()
    streams = [anonymous_stream(2), anonymous_stream(SEED)]
    batch = candidate.method.identify_many([free_problem(seed=2), problem], streams)
    if len(batch) != 2:
        raise Refusal(f"estimate_many answered two problems with {len(batch)} estimates")
    together, alone = (summary(estimate, problem.prior)[:2] for estimate in (valid(batch[1]), candidate.first))
    if not np.allclose(together, alone, rtol=SAME_IN_BATCH, atol=0.0):
        raise Refusal(f"k/m and c/m are {alone} alone and {together} in a batch")


UNITS = "state works_in = 'natural units', or scale every constant, start value and tolerance by the data"


@METHOD_CHECKS.add("units, mm", UNITS, units=Units(length=1e-3))
@METHOD_CHECKS.add("units, tenths of a second", UNITS, units=Units(time=0.1))
@METHOD_CHECKS.add("units, both, unknown initial state", UNITS, units=Units(length=1e-3, time=0.1), known=False)
def in_units(candidate: Candidate, units: Units, known: bool = True) -> None:
    """The same data in other units give the same answer within a thousandth of a standard error."""
    problem = free_problem(known=known)
    estimate = candidate.first if known else valid(candidate.fit(problem))
    converted = valid(candidate.fit(problem.expressed_in(units))).expressed_in(units.inverse)
    here, error = summary(estimate, problem.prior).reshape(2, 2)
    there = summary(converted, problem.prior)[:2]
    error = np.where(np.isfinite(error), error, WITHOUT_ERROR * np.abs(here))
    if not np.all(np.abs(there - here) <= SAME_IN_UNITS * error):
        raise Refusal(
            f"k/m and c/m are {here} in SI units and {there}, converted back, "
            f"with displacements in {units.length:g} m and times in {units.time:g} s"
        )


def difficult_data(candidate: Candidate, case: str) -> str:
    """Difficult data have a finite answer, or a status with a sentence."""
    problem = free_problem(**DIFFICULT[case])
    estimate = candidate.fit(problem)
    if estimate.status is Status.OK:
        valid(estimate)
    estimate = combine_with_prior(estimate, problem.prior)
    if estimate.status is not Status.OK:
        if len(estimate.message.split()) < FEWEST_WORDS:
            raise Refusal(f"it says {estimate.message!r} of a fit that failed")
        return str(estimate.message)[:LONGEST_MESSAGE]
    if not np.all(np.isfinite(summary(estimate, problem.prior)[:2])):
        raise Refusal("with the prior its answer is not finite")
    for reconstruction in estimate.reconstructions:
        if not np.all(np.isfinite(reconstruction(np.linspace(0.0, 2.0, 7)))):
            raise Refusal("its reconstruction is not finite, and its status is ok")
    return ""


for _case in DIFFICULT:
    METHOD_CHECKS.add(
        _case,
        "check the data and the answer; raise bench.NoEstimate('why, and what to do') if there is none",
        case=_case,
    )(difficult_data)


@METHOD_CHECKS.add("pickling", "use classes and functions of a module, no lambdas or closures")
def can_be_pickled(candidate: Candidate) -> None:
    """The method and its answer can be sent to another process."""
    estimate = candidate.first
    try:
        pickle.dumps(candidate.method)
        copy = pickle.loads(pickle.dumps(estimate))
    except Exception as error:
        raise Refusal(f"the method or its estimate cannot be pickled: {error}") from None
    for mine, theirs in zip(estimate.reconstructions, copy.reconstructions, strict=True):
        if not np.array_equal(mine(TIMES), theirs(TIMES)):
            raise Refusal("a reconstruction gives other numbers in another process")


@METHOD_CHECKS.add("no prior", "give groups (k/m, c/m) only where there is neither prior nor force")
def ratios_alone(candidate: Candidate) -> str:
    """Where nothing determines the scale, only ratios of parameters are claimed."""
    problem = free_problem(prior=None)
    if candidate.method.objection(problem):
        return "declined"
    estimate = valid(candidate.fit(problem))
    if estimate.marginal(problem.system.quantity("m")) is not None:
        raise Refusal("it states a mass, which free vibration without a prior does not determine")
    ratio = estimate.marginal(problem.system.quantity("k_over_m"))
    if ratio is None or not math.isfinite(ratio.value):
        raise Refusal("it states no k/m without a prior")
    return ""


@METHOD_CHECKS.add("known force", "use problem.records[i].force, or set forced=False in scope")
def mass_of_a_force(candidate: Candidate) -> str:
    """With a known force and no prior the mass is determined, or the case is declined."""
    problem = forced_problem()
    objection = candidate.method.objection(problem)
    estimate = candidate.fit(problem)  # of one that objects: the objection
    if estimate.status is not Status.OK:
        if not (objection or estimate.message):
            raise Refusal(f"it ends as {estimate.status} without a message")
        return f"declined: {objection or estimate.message}"
    mass = estimate.marginal(problem.system.quantity("m"))
    if mass is None:
        raise Refusal("it states no mass, though the force is known")
    if not 1 / MASS_WITHIN < mass.value / PLANT["m"] < MASS_WITHIN:
        raise Refusal(f"a mass of {PLANT['m']:g} kg came out as {mass.value:.3g} kg")
    return ""


@METHOD_CHECKS.add("time", "join what you start before you return")
def leaves_nothing_running(candidate: Candidate) -> str:
    """A fit ends, and leaves nothing running."""
    _ = candidate.first
    running = [child.name for child in multiprocessing.active_children()]
    running += [thread.name for thread in set(threading.enumerate()) - candidate.threads]
    if running:
        raise Refusal(f"it left {', '.join(running[:3])} running")
    return f"{candidate.seconds:.2g} s for {free_problem().n} samples"
