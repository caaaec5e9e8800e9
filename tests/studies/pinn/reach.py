"""Reach of the engine beside an earlier one and the goals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bench.entrants.registry import make_method
from bench.scenario.scenario import METHOD, Scenario
from tests.studies.common import scenario, tracked
from tests.studies.pinn.common import METHODS, SEED, Comparison, Part, compare, trials
from tests.studies.pinn.products import roofline
from tests.studies.pinn.scaling import chain, horizon, ratios

SHORT = 40
"""Samples a channel of the shorter chains."""


def noisy(snr: int) -> Scenario:
    """Return the reference system with unknown start."""
    return scenario(system="sdof", snr=snr, initial_state="unknown")


def damped(ratio: float) -> Scenario:
    """Return the reference system with another damping ratio, 20 dB, unknown start."""
    cell = noisy(20)
    own = dict(cell.parameters)
    own["c"] = 2.0 * ratio * float(np.sqrt(own["k"] * own["m"]))
    return replace(cell, parameters=own, label=f"damping ratio {ratio:g}")


def time_and_error(found: Comparison) -> str:
    """Processor time of a fit, and the errors of groups and displacement over the oracle's."""
    own = ratios(found)
    return f"{found.seconds:.2f} s, {own.groups:.2f}, {own.displacement:.2f}"


def stiffness_over_bound(found: Comparison) -> str:
    """The error of k/m over its bound."""
    return f"{found.over_bound[found.names.index('k_over_m_error_pct')]:.2f}"


class Question(NamedTuple):
    """A line of the table: what was before and what was asked, and how each method is shown on a scenario."""

    what: str
    before: str
    asked: str
    scenario: Callable[[], Scenario]
    show: Callable[[Comparison], str]
    methods: Sequence[str] = METHODS


NETWORK, SPLINE, LIKELIHOOD = METHODS
FIT = "time, groups, displacement / oracle"
PAIR = (SPLINE, LIKELIHOOD)
QUESTIONS = (
    Question(f"3 masses: {FIT}", "48 s", "", lambda: chain(3, SHORT), time_and_error),
    Question(f"4 masses: {FIT}", "astray", "", lambda: chain(4, SHORT), time_and_error),
    Question(f"10 masses, cold start: {FIT}", "-", "60 s, 1, 1", lambda: chain(10), time_and_error, PAIR),
    Question(f"200 cycles: {FIT}", "45 cycles at most", "1, 1", lambda: horizon(200), time_and_error, PAIR),
    Question("0 dB, unknown start: k/m / bound", "8.9", "as shooting", lambda: noisy(0), stiffness_over_bound),
    Question(
        "damping ratio 1.2: fits that end at their limit", "30 of 40", "none", lambda: damped(1.2),
        lambda found: f"{found.capped} of {found.fits}", (NETWORK, SPLINE),
    ),
    Question(
        "40 dB: time", "0.4 to 0.5 s", "", lambda: noisy(40), lambda found: f"{found.seconds:.3f} s", (NETWORK, SPLINE)
    ),
)  # fmt: skip
WITH_PRODUCTS = (NETWORK, SPLINE)
"""The methods whose fit is held against its matrix products."""


def reach(replicates: int) -> Part:
    """The table: what, before, asked, and by method what is measured now."""
    rows: list[list[str]] = []
    for question in tracked(QUESTIONS, "question"):
        on, entries = trials(question.scenario(), replicates), dict.fromkeys(METHODS, "-")
        for name in question.methods:
            entries[name] = question.show(compare(make_method(name, {}), on))
        rows.append([question.what, question.before, question.asked, *entries.values()])
    rows.append(["reference fit / its matrix products", "-", "2", *_over_products(), "-"])
    columns = ["what", "before", "asked", *METHODS]
    text = (
        f"{replicates} data sets an entry; processor time of a fit; errors pooled as below. *Before*: the engine as it "
        "was before it was asked to go further, on another run of this machine, so its times are for orientation. The "
        f"shorter chains have {SHORT} samples a channel. The products are those of the same sizes and as many as in "
        "the fit of one reference record, by themselves."
    )
    return Part("reach", "Reach, beside before", text, columns, rows)


def _over_products() -> list[str]:
    """Measure, by method, the time of a fit of the reference record over that of its products."""
    cell = scenario(system="sdof", snr=20)
    problem, _ = cell.replicates(SEED, 1)[0]
    found = []
    for name in WITH_PRODUCTS:
        method = make_method(name, {})
        method.identify(problem, cell.stream(METHOD, SEED, 0))  # imports and caches apart
        measured = roofline(lambda method=method: method.identify(problem, cell.stream(METHOD, SEED, 0)))  # type: ignore[misc]
        found.append(f"{measured.ratio:.1f}")
    return found
