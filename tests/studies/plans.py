"""Proposed tests, simulated: the promised errors beside those of real estimates."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated

import numpy as np
from scipy.stats import binom, norm

from bench.config.atlas import efficient_methods
from bench.engine.progress import counter
from bench.entrants.registry import make_method
from bench.isolation.machine import single_threaded
from bench.planning.free_decay import QUANTITIES, Decay, errors, information
from bench.planning.search import MOST_SAMPLES, WITHIN, Likely, ProposedTest, cheapest, quantile_error
from bench.planning.verify import share_within, simulate_decays
from bench.reporting.tables.render import markdown_table
from tests.studies.common import RESULTS, Count, Out, publish, study

MOST = 2000
"""Samples of a test, beyond which a request is drawn anew: it would take long to simulate."""
HABIT = 10.0
"""Samples a cycle of the test that is doubled."""


@dataclass(frozen=True)
class Request:
    """A quantity wanted of a likely oscillator with an error, from a start over the noise."""

    likely: Likely
    quantity: str
    error: float
    amplitude: float


def drawn(number: int) -> list[tuple[Request, ProposedTest]]:
    """Random requests with the test that is proposed for each; half of them with doubt about the oscillator."""
    rng = np.random.default_rng(2027)
    found = list[tuple[Request, ProposedTest]]()
    while len(found) < number:
        likely = drawn_likely(rng, len(found), -3.0)
        quantity = str(rng.choice(list(QUANTITIES)))
        error = float(10 ** rng.uniform(-2, -1)) * (0.1 if quantity in ("k_over_m", "natural_frequency") else 1.0)
        one = Request(likely, quantity, error, float(10 ** rng.uniform(0.5, 2)))
        plan = cheapest(one.likely, quantity, error, one.amplitude)
        if plan is not None and plan.decay.samples <= MOST:
            found.append((one, plan))
    return found


def expected_share(one: Request, decay: Decay) -> float:
    """Share of tests within :data:`WITHIN` wanted errors, where estimates are as good as the bound."""
    every = [errors(information(own, decay))[one.quantity] for own in one.likely.oscillators]
    return float(np.mean([2.0 * norm.cdf(WITHIN * one.error / sd) - 1.0 for sd in every]))


def doubled(one: Request) -> int | None:
    """Samples of a test at :data:`HABIT` samples a cycle, its length doubled from one cycle on until it is enough."""
    cycles = 1.0
    while HABIT * cycles < MOST_SAMPLES:
        decay = Decay(round(HABIT * cycles) + 1, cycles / one.likely.frequency, one.amplitude)
        if quantile_error(one.likely, decay, one.quantity) <= one.error:
            return decay.samples
        cycles *= 2.0
    return None


def plans(
    requests: Annotated[Count, "random requests, each planned"] = 20,
    tests: Annotated[Count, "simulations of each proposed test"] = 500,
    out: Out = RESULTS,
) -> int:
    """Measure whether proposed tests keep what they promise: plans.md.

    Requests are drawn at random, each is planned, and the test that is proposed is simulated and fitted by a method.
    """
    single_threaded()
    name = efficient_methods()[0]
    method, lines, inside = make_method(name, {}), [], 0
    planned = drawn(requests)
    with counter("test", requests * tests) as advance:
        for one, plan in planned:
            found = share_within(
                simulate_decays(one.likely, plan.decay, one.quantity, method, tests, advance), one.error
            )
            share = expected_share(one, plan.decay)
            low, high = (float(value) / tests for value in binom.interval(0.95, tests, share))
            inside += low <= found <= high
            lines.append((one, plan, share, found, low <= found <= high, doubled(one)))
    publish(out / "plans.md", page(lines, name, tests, inside))
    return 0


Line = tuple[Request, ProposedTest, float, float, bool, int | None]


def page(lines: Sequence[Line], method: str, tests: int, inside: int) -> str:
    """The page, a line a request."""
    rows = []
    for one, plan, share, found, kept, samples in lines:
        own = one.likely
        rows.append([
            f"{one.quantity}:{100 * one.error:.2g}%", *known(own), f"{one.amplitude:.3g}", f"{plan.decay.samples}",
            f"{plan.decay.duration * own.frequency:.3g}", f"{100 * share:.1f}", f"{100 * found:.1f}",
            "yes" if kept else "no", f"{samples:,}" if samples else "never",
            f"{samples / plan.decay.samples:.1f}" if samples else "-",
        ])  # fmt: skip
    headers = ["want", "frequency, Hz", "damping ratio", "start / noise", "samples", "cycles", "expected %",
               "simulated %", "inside", "samples by doubling", "over the plan's"]  # fmt: skip
    more = [samples / plan.decay.samples for _, plan, *_, samples in lines if samples]
    said = (
        f"Inside: {inside} of {len(lines)}. A test that is doubled takes {np.median(more):.1f} times the samples of the"
        f" proposed one (median), and never reaches the error in {sum(line[-1] is None for line in lines)} requests."
    )
    head = HEAD.format(tests=tests, method=method, within=WITHIN, habit=HABIT, most=MOST)
    return "\n\n".join([f"# Plans, simulated\n\n{head}", markdown_table(rows, headers), said, REGENERATE]) + "\n"


HEAD = """Requests are drawn at random, half of them with doubt about the oscillator (the standard deviation stands
behind the value); those are left out whose test takes more than {most} samples. For each the test of fewest samples is
proposed, released from rest, and simulated {tests} times with oscillators as likely as they are known, answered by
`{method}`. **expected**: share of tests whose error of the wanted quantity is within {within:g} wanted errors, where an
estimate is as good as the Cramér-Rao bound; **inside**: whether the simulated share is in the binomial 95 % interval
about it. **samples by doubling**: of a test of one cycle at {habit:g} samples a cycle, whose length is doubled until it
reaches the same; a motion that has decayed adds no information, however long it is."""
REGENERATE = "Regenerate: `python -m tests.studies.plans` (from a clone)"


def drawn_likely(rng: np.random.Generator, number: int, least_damping: float) -> Likely:
    """Draw an oscillator, in doubt where its number is odd, of a damping ratio of at least that power of ten."""
    doubt = (float(rng.uniform(0.01, 0.1)), float(rng.uniform(0.1, 0.5))) if number % 2 else (0.0, 0.0)
    return Likely(float(10 ** rng.uniform(-1, 2)), float(10 ** rng.uniform(least_damping, -0.7)), *doubt)


def known(likely: Likely) -> list[str]:
    """Return frequency and damping ratio, each with its standard deviation where it is in doubt."""
    values = (likely.frequency, likely.frequency_sd), (likely.damping_ratio, likely.damping_sd)
    return [f"{value:.3g}" + (f" : {100 * sd:.0f} %" if math.isfinite(sd) and sd else "") for value, sd in values]


main = partial(study, plans, "tests.studies.plans")

if __name__ == "__main__":
    sys.exit(main())
