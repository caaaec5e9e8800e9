"""What any method must keep, ours or anybody's; in the order in which they are worth reading."""

from __future__ import annotations

import math
import multiprocessing
import pickle
import threading
from functools import partial

import numpy as np

from bench.conformance.candidate import TIMES, Candidate, answered, difference_of_answers, stream, values
from bench.conformance.check import Check, Refusal
from bench.conformance.imports import foreign_imports, package_files
from bench.conformance.problems import HARD, PLANT, forced, problem, without_prior
from bench.contract.estimate import Estimate, Status
from bench.contract.method import Card
from bench.contract.problem import Units
from bench.scoring.combination import combine_with_prior
from bench.sweep.wire import plain, rebuilt

SAME_IN_COMPANY = 1e-12
"""Relative: a matrix product sums in another order with more rows, on some processors."""
SAME_IN_UNITS = 1e-3
"""Of a standard error."""
WITHOUT_ERROR = 0.01
"""Taken for the relative standard error of a method that states none."""
MASS_WITHIN = 2.5
"""A factor: equation-error methods are biased by their sampling step, but the scale is not arbitrary."""
FEWEST_WORDS = 4
LONGEST_MESSAGE = 300


def card(candidate: Candidate) -> str:
    """It has a card and a docstring, is immutable, and says what it needs."""
    method = candidate.method
    own = getattr(type(method), "card", None)
    if not isinstance(own, Card):
        raise Refusal("the class has no card")
    for name in ("summary", "uncertainty", "settings_source", "tuning"):
        if not str(getattr(own, name)).strip():
            raise Refusal(f"card.{name} is empty")
    if not (type(method).__doc__ or "").strip() or (type(method).__doc__ or "").startswith(f"{type(method).__name__}("):
        raise Refusal("the class has no docstring", "say in its docstring what the method does, and where it is from")
    if not type(method).__dataclass_params__.frozen:  # type: ignore[attr-defined]
        raise Refusal("its settings can be changed", "declare it @dataclass(frozen=True)")
    if method.requires and not method.extra:
        raise Refusal(f"requires {', '.join(method.requires)}, but no extra", "say in extra what installs its packages")
    return own.summary


def only_the_contract(candidate: Candidate) -> str:
    """Its modules import public names of the contract only."""
    found = [line for path in package_files(type(candidate.method)) for line in foreign_imports(path)]
    if found:
        raise Refusal("; ".join(found[:3]))
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
    at, _ = values(estimate, problem().prior)
    return f"k/m {at[0]:.3g} 1/s², c/m {at[1]:.3g} 1/s"


def same_seed(candidate: Candidate) -> str:
    """The same problem and the same seed give the same answer to the last bit."""
    if not candidate.differs(candidate.elsewhere[0]):
        return ""
    repeated = difference_of_answers(candidate.fit(), candidate.fit())
    if repeated:
        raise Refusal(f"two fits of one problem with one seed differ: {repeated}")
    np.random.seed(1)  # noqa: NPY002 (the stream that a method must not use)
    one = candidate.fit()
    np.random.seed(2)  # noqa: NPY002
    other = difference_of_answers(one, candidate.fit())
    if other:
        raise Refusal(f"it draws from numpy's global stream: {other}")
    return ""


def keeps_nothing(candidate: Candidate) -> str:
    """An answer does not hang on what was fitted before."""
    if not candidate.differs(candidate.elsewhere[0]):
        return ""
    second, third = candidate.fit(), candidate.fit()
    repeated = difference_of_answers(second, third)
    if repeated:
        raise Refusal(f"fits of one problem, one after another, differ: {repeated}")
    candidate.fit(problem(seed=2), seed=2)
    found = difference_of_answers(third, candidate.fit()) or candidate.differs(third)
    if found:
        raise Refusal(f"after another problem the answer is another: {found}")
    return ""


def honest(candidate: Candidate) -> str:
    """It looks for no truth, and none that lies in reach changes its answer."""
    found, surroundings = candidate.elsewhere
    if surroundings.seen:
        raise Refusal("; ".join(f"it {what}" for what in surroundings.seen[:3]))
    if candidate.differs(found) and not difference_of_answers(candidate.fit(), candidate.fit()):
        answers = [candidate.surroundings(which).fit(candidate.fit, problem()) for which in (0, 1)]
        moved = difference_of_answers(*answers)
        if moved:
            raise Refusal(f"its answer changes with a truth that lies in reach: {moved}")
    return ""


def input_untouched(candidate: Candidate) -> str:
    """The problem is as it was."""
    _, surroundings = candidate.elsewhere
    if surroundings.changes:
        raise Refusal(surroundings.changes[0])
    return ""


def in_company(candidate: Candidate) -> str:
    """Alone or together with others, the answer to a problem is the same."""
    other, own = problem(seed=2), problem()
    together = candidate.method.identify_many([other, own], [stream(2), stream()])
    if len(together) != 2:
        raise Refusal(f"estimate_many answered two problems with {len(together)} estimates")
    (there, _), (here, _) = values(answered(together[1]), own.prior), values(candidate.first, own.prior)
    if not np.allclose(there, here, rtol=SAME_IN_COMPANY, atol=0.0):
        raise Refusal(f"k/m and c/m are {here.tolist()} alone and {there.tolist()} in company")
    return ""


def in_units(candidate: Candidate, units: Units, start: bool) -> str:
    """The same data in other units give the same answer within a thousandth of a standard error."""
    given = problem(start=start)
    here, error = values(candidate.first if start else candidate.start_untold, given.prior)
    there, _ = values(answered(candidate.fit(given.expressed_in(units))).expressed_in(units.inverse), given.prior)
    error = np.where(np.isfinite(error), error, WITHOUT_ERROR * np.abs(here))
    if not np.all(np.abs(there - here) <= SAME_IN_UNITS * error):
        raise Refusal(
            f"k/m and c/m are {_numbers(here)} in SI units and {_numbers(there)}, converted back, "
            f"with displacements in {units.length:g} m and times in {units.time:g} s"
        )
    return ""


def hard_data(candidate: Candidate, case: str) -> str:
    """Hard data have a finite answer, or a status with a sentence."""
    given = HARD[case]()
    found = candidate.fit(given)
    if found.status is Status.OK:
        answered(found)
    estimate = combine_with_prior(found, given.prior)
    if estimate.status is Status.OK:
        if not np.all(np.isfinite(values(estimate, given.prior)[0])):
            raise Refusal("with the prior its answer is not finite")
        for reconstruction in estimate.reconstructions:
            if not np.all(np.isfinite(reconstruction(np.linspace(0.0, 2.0, 7)))):
                raise Refusal("its reconstruction is not finite, and its status is ok")
        return ""
    if len(estimate.message.split()) < FEWEST_WORDS:
        raise Refusal(f"it says {estimate.message!r} of a fit that failed")
    return str(estimate.message)[:LONGEST_MESSAGE]


def travels(candidate: Candidate) -> str:
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
    """Where nothing tells the scale, only ratios of parameters are claimed."""
    given = without_prior()
    if candidate.method.objection(given):
        return "declined"
    estimate = answered(candidate.fit(given))
    if estimate.marginal(given.system.quantity("m")) is not None:
        raise Refusal("it states a mass that free vibration without a prior cannot tell")
    ratio = estimate.marginal(given.system.quantity("k_over_m"))
    if ratio is None or not math.isfinite(ratio.value):
        raise Refusal("it states no k/m without a prior")
    return ""


def mass_of_a_force(candidate: Candidate) -> str:
    """With a known force and no prior the mass is told, or the case is declined."""
    given = forced()
    objection = candidate.method.objection(given)
    if objection:
        return f"declined: {objection}"
    estimate = candidate.fit(given)
    if estimate.status is not Status.OK:
        if not estimate.message:
            raise Refusal(f"it ends as {estimate.status} without a word")
        return f"declined: {estimate.message}"
    mass = estimate.marginal(given.system.quantity("m"))
    if mass is None:
        raise Refusal("it states no mass, though the force is known")
    if not 1 / MASS_WITHIN < mass.value / PLANT["m"] < MASS_WITHIN:
        raise Refusal(f"a mass of {PLANT['m']:g} kg came out as {mass.value:.3g} kg")
    return ""


def in_time(candidate: Candidate) -> str:
    """A fit ends, and leaves nothing running."""
    _ = candidate.first
    left = [child.name for child in multiprocessing.active_children()]
    left += [thread.name for thread in threading.enumerate() if thread is not threading.main_thread()]
    left = [name for name in left if name not in candidate.running]
    if left:
        raise Refusal(f"it left {', '.join(left[:3])} running")
    return f"{candidate.first_s:.2g} s for {problem().n} samples"


def _numbers(found: np.ndarray) -> str:
    return " and ".join(f"{value:.6g}" for value in found)


SEED = "draw from the rng that estimate is given, and from nothing else: no global stream, no clock, no order of a set"
STATE = "keep nothing on the class, in the module or in a file from one call of estimate to the next"
TRUTH = "use the problem and the rng alone; in a sweep nothing else is there"
UNITS = "state works_in = 'natural units', or scale every constant, start value and tolerance by the data"
HARD_REMEDY = "check the data and the answer; raise bench.NoEstimate('why, and what to do') where there is none"

METHOD_CHECKS: tuple[Check[Candidate], ...] = (
    Check("card", card, "give the class a card = bench.Card(...) without empty fields"),
    Check("imports", only_the_contract, "import the names of bench itself (bench.__all__), and no module below it"),
    Check(
        "answer",
        answer,
        "return bench.Estimate with parameters (of all names) or groups, and shapes as its docstring says",
        gate=True,
    ),
    Check("seed", same_seed, SEED),
    Check("state", keeps_nothing, f"{STATE}; {SEED}"),
    Check("honesty", honest, TRUTH),
    Check("input", input_untouched, "copy what you change: the arrays are others', too"),
    Check("company", in_company, "treat each problem of estimate_many by itself"),
    *(
        Check(f"units, {name}", partial(in_units, units=units, start=start), UNITS, long=not start)
        for name, units, start in (
            ("mm", Units(length=1e-3), True),
            ("tenths of a second", Units(time=0.1), True),
            ("both, start unknown", Units(length=1e-3, time=0.1), False),
        )
    ),
    *(Check(case, partial(hard_data, case=case), HARD_REMEDY, long="dead" not in case) for case in HARD),
    Check("pickling", travels, "use classes and functions of a module, no lambdas or closures"),
    Check("no prior", ratios_alone, "give groups (k/m, c/m) only where there is neither prior nor force", long=True),
    Check(
        "known force",
        mass_of_a_force,
        "use problem.records[i].force, or set forced=False in serves",
        long=True,
    ),
    Check("time", in_time, "join what you start before you return"),
)
