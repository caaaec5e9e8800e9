"""The requirements on any method, ours or anybody's, in the order in which they are worth reading."""

from __future__ import annotations

import math
import multiprocessing
import pickle
import threading
from functools import partial

import numpy as np

from bench.conformance.candidate import (
    REPLICATES,
    SEED,
    Candidate,
    difference,
    replicate_values,
    valid,
    values,
)
from bench.conformance.check import Check, Refusal
from bench.conformance.imports import foreign_imports, package_files
from bench.conformance.problems import HARD, PLANT, forced, problem, without_prior
from bench.contract.estimate import Estimate, Status
from bench.contract.method import Card
from bench.contract.problem import Units
from bench.scenario.stream import anonymous_stream
from bench.scoring.combination import combine_with_prior
from bench.sweep.wire import plain, rebuilt

TIMES = np.linspace(0.0, 8.0, 9)
"""Where reconstructions are compared (s)."""
SAME_IN_BATCH = 1e-12
"""Relative difference: on some processors a matrix product sums in another order with more rows."""
SAME_IN_PROCESS = 1e-9
"""Relative difference: sums may be ordered by where arrays lie in memory."""
SAME_IN_UNITS = 1e-3
"""Difference over the standard error."""
WITHOUT_ERROR = 0.01
"""Relative standard error assumed of a method that states none."""
MASS_WITHIN = 2.5
"""Factor about the true mass: equation-error methods are biased by their sampling step, but not arbitrary."""
FEWEST_WORDS = 4
LONGEST_MESSAGE = 300


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


def only_the_contract(candidate: Candidate) -> str:
    """Its modules import public names of the contract only."""
    lines = [line for path in package_files(type(candidate.method)) for line in foreign_imports(path)]
    if lines:
        raise Refusal("; ".join(lines[:3]))
    return ""


def answer(candidate: Candidate) -> str:
    """Ordinary data have an answer that can be scored."""
    objection = candidate.method.objection(problem())
    if objection is not None:
        raise Refusal(f"it objects to a free decay of one mass, the first scenario of every table: {objection}")
    estimate = candidate.first
    belief = estimate.belief
    assert belief is not None
    if min(belief.values().values()) <= 0:
        raise Refusal(f"a value is not a positive number: {belief.values()}")
    covariance = getattr(belief, "covariance", None)
    if covariance is not None and float(np.linalg.eigvalsh(covariance)[0]) < -1e-9 * float(np.trace(covariance)):
        raise Refusal("its covariance has a negative eigenvalue")
    try:
        rebuilt(plain(estimate, TIMES), estimate.system)
    except (TypeError, ValueError, AttributeError) as error:
        raise Refusal(f"it cannot be scored: {error}") from None
    (k_over_m, c_over_m), _ = values(estimate, problem().prior)
    return f"k/m {k_over_m:.3g} 1/s², c/m {c_over_m:.3g} 1/s"


def same_seed(candidate: Candidate) -> str:
    """The same problem and the same seed give the same answer to the last bit, whatever was fitted before."""
    changed = difference(candidate.first, candidate.second[0])
    if changed:
        raise Refusal(f"after another problem, with other global random streams and among decoys, {changed}")
    return ""


def no_state(candidate: Candidate) -> str:
    """In another process and in the reverse order, problems have the same answers."""
    here = [replicate_values(candidate, seed) for seed in REPLICATES]
    there = candidate.values_elsewhere
    if not np.allclose(here, there, rtol=SAME_IN_PROCESS, atol=0.0, equal_nan=True):
        raise Refusal(f"k/m and c/m of {len(here)} problems are {here} here and {there} there")
    return f"{len(here)} problems"


def honest(candidate: Candidate) -> str:
    """No truth or seed within reach changes its answer, and it looks into no store and no scenario."""
    among_decoys, watch, _ = candidate.second
    if watch.seen:
        raise Refusal("; ".join(f"it {what}" for what in list(dict.fromkeys(watch.seen))[:3]))
    if difference(candidate.first, among_decoys):
        one, other = candidate.fit(), candidate.fit()
        changed = difference(one, among_decoys)
        if changed and not difference(one, other):
            raise Refusal(f"its answer changes with a truth or a seed within reach: {changed}")
    return ""


def input_untouched(candidate: Candidate) -> str:
    """The problem is as it was."""
    *_, untouched = candidate.second
    if not untouched:
        raise Refusal("the samples, the initial state or the prior of the problem were changed")
    return ""


def in_batch(candidate: Candidate) -> str:
    """Alone or in a batch with others, a problem has the same answer."""
    given = problem()
    batch = candidate.method.identify_many([problem(seed=2), given], [anonymous_stream(2), anonymous_stream(SEED)])
    if len(batch) != 2:
        raise Refusal(f"estimate_many answered two problems with {len(batch)} estimates")
    (together, _), (alone, _) = values(valid(batch[1]), given.prior), values(candidate.first, given.prior)
    if not np.allclose(together, alone, rtol=SAME_IN_BATCH, atol=0.0):
        raise Refusal(f"k/m and c/m are {alone.tolist()} alone and {together.tolist()} in a batch")
    return ""


def in_units(candidate: Candidate, units: Units, start: bool) -> str:
    """The same data in other units give the same answer within a thousandth of a standard error."""
    given = problem(start=start)
    here, error = values(candidate.first if start else candidate.without_initial_state, given.prior)
    there, _ = values(valid(candidate.fit(given.expressed_in(units))).expressed_in(units.inverse), given.prior)
    error = np.where(np.isfinite(error), error, WITHOUT_ERROR * np.abs(here))
    if not np.all(np.abs(there - here) <= SAME_IN_UNITS * error):
        shown = [" and ".join(f"{value:.6g}" for value in pair) for pair in (here, there)]
        raise Refusal(
            f"k/m and c/m are {shown[0]} in SI units and {shown[1]}, converted back, "
            f"with displacements in {units.length:g} m and times in {units.time:g} s"
        )
    return ""


def hard_data(candidate: Candidate, case: str) -> str:
    """Difficult data have a finite answer, or a status with a sentence."""
    given = HARD[case]()
    estimate = candidate.fit(given)
    if estimate.status is Status.OK:
        valid(estimate)
    estimate = combine_with_prior(estimate, given.prior)
    if estimate.status is not Status.OK:
        if len(estimate.message.split()) < FEWEST_WORDS:
            raise Refusal(f"it says {estimate.message!r} of a fit that failed")
        return str(estimate.message)[:LONGEST_MESSAGE]
    if not np.all(np.isfinite(values(estimate, given.prior)[0])):
        raise Refusal("with the prior its answer is not finite")
    for reconstruction in estimate.reconstructions:
        if not np.all(np.isfinite(reconstruction(np.linspace(0.0, 2.0, 7)))):
            raise Refusal("its reconstruction is not finite, and its status is ok")
    return ""


def can_be_pickled(candidate: Candidate) -> str:
    """The method and its answer can be sent to another process."""
    for what, item in (("the method", candidate.method), ("its estimate", candidate.first)):
        try:
            copied = pickle.loads(pickle.dumps(item))
        except Exception as error:
            raise Refusal(f"{what} cannot be pickled: {error}") from None
        if isinstance(copied, Estimate):
            for mine, theirs in zip(candidate.first.reconstructions, copied.reconstructions, strict=True):
                if not np.array_equal(mine(TIMES), theirs(TIMES)):
                    raise Refusal("a reconstruction gives other numbers in another process")
    return ""


def ratios_alone(candidate: Candidate) -> str:
    """Where nothing determines the scale, only ratios of parameters are claimed."""
    given = without_prior()
    if candidate.method.objection(given):
        return "declined"
    estimate = valid(candidate.fit(given))
    if estimate.marginal(given.system.quantity("m")) is not None:
        raise Refusal("it states a mass, which free vibration without a prior does not determine")
    ratio = estimate.marginal(given.system.quantity("k_over_m"))
    if ratio is None or not math.isfinite(ratio.value):
        raise Refusal("it states no k/m without a prior")
    return ""


def mass_of_a_force(candidate: Candidate) -> str:
    """With a known force and no prior the mass is determined, or the case is declined."""
    given = forced()
    objection = candidate.method.objection(given)
    if objection:
        return f"declined: {objection}"
    estimate = candidate.fit(given)
    if estimate.status is not Status.OK:
        if not estimate.message:
            raise Refusal(f"it ends as {estimate.status} without a message")
        return f"declined: {estimate.message}"
    mass = estimate.marginal(given.system.quantity("m"))
    if mass is None:
        raise Refusal("it states no mass, though the force is known")
    if not 1 / MASS_WITHIN < mass.value / PLANT["m"] < MASS_WITHIN:
        raise Refusal(f"a mass of {PLANT['m']:g} kg came out as {mass.value:.3g} kg")
    return ""


def leaves_nothing_running(candidate: Candidate) -> str:
    """A fit ends, and leaves nothing running."""
    _ = candidate.first
    names = [child.name for child in multiprocessing.active_children()]
    names += [thread.name for thread in threading.enumerate() if thread is not threading.main_thread()]
    running = [name for name in names if name not in candidate.threads]
    if running:
        raise Refusal(f"it left {', '.join(running[:3])} running")
    return f"{candidate.first_s:.2g} s for {problem().n} samples"


RANDOM = (
    "draw from the rng that estimate is given, and from nothing else: no global stream, no clock, no order of a set"
)
STATE = "keep nothing on the class, in the module or in a file from one call of estimate to the next"
TRUTH = "use the problem and the numbers of the rng alone; in a sweep nothing else is there"
UNITS = "state works_in = 'natural units', or scale every constant, start value and tolerance by the data"
FAILING = "check the data and the answer; raise bench.NoEstimate('why, and what to do') where there is none"
OTHER_UNITS = (
    ("mm", Units(length=1e-3), True),
    ("tenths of a second", Units(time=0.1), True),
    ("both, unknown initial state", Units(length=1e-3, time=0.1), False),
)
"""Name, units, and whether the initial state is known."""

METHOD_CHECKS: tuple[Check[Candidate], ...] = (
    Check("card", card, "give the class a card = bench.Card(...) without empty fields"),
    Check("imports", only_the_contract, "import the names of bench itself (bench.__all__), and no module below it"),
    Check(
        "answer",
        answer,
        "return bench.Estimate with parameters (of all names) or groups, and shapes as its docstring says",
        gate=True,
    ),
    Check("seed", same_seed, f"{RANDOM}; {STATE}"),
    Check("state", no_state, f"{STATE}; {RANDOM}"),
    Check("honesty", honest, TRUTH),
    Check("input", input_untouched, "copy what you change: the arrays belong to others, too"),
    Check("batch", in_batch, "treat each problem of estimate_many by itself"),
    *(
        Check(f"units, {name}", partial(in_units, units=units, start=start), UNITS, long=not start)
        for name, units, start in OTHER_UNITS
    ),
    *(Check(case, partial(hard_data, case=case), FAILING, long="dead" not in case) for case in HARD),
    Check("pickling", can_be_pickled, "use classes and functions of a module, no lambdas or closures"),
    Check("no prior", ratios_alone, "give groups (k/m, c/m) only where there is neither prior nor force", long=True),
    Check("known force", mass_of_a_force, "use problem.records[i].force, or set forced=False in serves", long=True),
    Check("time", leaves_nothing_running, "join what you start before you return"),
)
