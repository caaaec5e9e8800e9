"""Free decays: the smallest that reach a wanted error, the errors of a given one, and its best sampling times."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from bench.config.atlas import on_the_bound
from bench.planning.free_decay import QUANTITIES, Decay
from bench.planning.optimal import VOLUME, best_times, told_by
from bench.planning.search import SHARE, WITHIN, ProposedTest, cheapest, proposal
from bench.planning.verify import reached, simulated
from bench.reporting.plans.request import TITLES, PlanRequest, Simulation, percent
from bench.reporting.terminal import table, wrapped

AMPLITUDES = (5.0, 10.0, 20.0, 50.0, 100.0, 200.0)
"""Initial displacements that are proposed where none is given, in units of the noise."""


def proposals(request: PlanRequest, amplitude: float | None, rate: float) -> list[ProposedTest]:
    """Return the free decay of fewest samples for each initial displacement (in units of the noise) that has one."""
    amplitudes = AMPLITUDES if amplitude is None else (amplitude,)
    tests = [cheapest(request.likely, request.quantity, request.error, start, rate) for start in amplitudes]
    return [test for test in tests if test is not None]


def errors_of(request: PlanRequest, amplitude: float | None, samples: int, duration: float) -> list[ProposedTest]:
    """Return what a given test reaches from each initial displacement."""
    amplitudes = AMPLITUDES if amplitude is None else (amplitude,)
    return [proposal(request.likely, Decay(samples, duration, start)) for start in amplitudes]


def decay_page(request: PlanRequest, tests: Sequence[ProposedTest]) -> str:
    """Return a table of tests with their errors, and what it means."""
    rows = []
    for test in tests:
        rate = (test.decay.samples - 1) / test.decay.duration
        cells = [f"{1e3 * request.noise * test.decay.amplitude:.3g}", f"{test.decay.samples}",
                 f"{test.decay.duration:.3g}", f"{rate:.3g}"]  # fmt: skip
        for name in QUANTITIES:
            same = math.isclose(test.median[name], test.share[name], rel_tol=1e-3)
            cells.append(f"{percent(test.median[name])}" + ("" if same else f" ({percent(test.share[name])})"))
        rows.append([*cells, f"{100 * test.wrong_basin:.1g}"])
    headers = ["initial, mm", "samples", "duration, s", "rate, 1/s",
               *(f"{t}, %" for t in TITLES.values()), "wrong frequency, %"]  # fmt: skip
    if request.simulations:
        shares = simulated_shares(request, [test.decay for test in tests])
        rows, headers = [[*row, share] for row, share in zip(rows, shares, strict=True)], [*headers, "simulated, %"]
    return f"{table(rows, headers, ())}\n\n{wrapped(_meaning(request), '')}"


def _meaning(request: PlanRequest) -> str:
    parts = ["Each line is the test of fewest samples for its initial displacement, released from rest; percentages are"
             " standard deviations by the Cramér-Rao bound"]  # fmt: skip
    if request.likely.in_doubt:
        parts.append(f"(median over the likely oscillators; in brackets not exceeded in {100 * SHARE:g} % of them)")
    text = " ".join(parts) + f". Methods that reach it: {', '.join(on_the_bound())}."
    if request.simulations:
        text += (
            f" simulated: of {request.simulations} tests, fitted by {request.method}, those whose error of "
            f"{request.title} is within {WITHIN:g} times the wanted one; 95 % where it is just reached."
        )
    return text


def times_page(request: PlanRequest, decay: Decay) -> tuple[str, np.ndarray]:
    """Return a table that compares even sampling times with the best ones, and the best for the wanted quantity (s)."""
    best = f"best for {request.title}"
    compared = {
        "even": told_by(request.likely, decay.times, decay.amplitude),
        best: best_times(request.likely, decay, request.quantity),
        "best for k/m and c/m": best_times(request.likely, decay, VOLUME),
    }
    rows = [[title, *(percent(row.median[name]) for name in QUANTITIES)] for title, row in compared.items()]
    headers = ["times", *(f"{title}, %" for title in TITLES.values())]
    if request.simulations:
        shares = simulated_shares(request, [decay] * len(compared), [row.times for row in compared.values()])
        rows, headers = [[*row, share] for row, share in zip(rows, shares, strict=True)], [*headers, "simulated, %"]
    times = compared[best].times
    notes = (
        f"Best for {request.title} (s): {_bursts(times, decay)}.",
        f"Percentages are standard deviations by the Cramér-Rao bound{request.median}.",
    )
    return "\n".join([table(rows, headers), "", *(wrapped(note, "") for note in notes)]), times


def _bursts(times: np.ndarray, decay: Decay) -> str:
    """Write consecutive sampling times as one burst."""
    gap, bursts = 0.5 * decay.duration / (decay.samples - 1), [[times[0]]]
    for time in times[1:]:
        if time - bursts[-1][-1] <= gap:
            bursts[-1].append(time)
        else:
            bursts.append([time])
    return ", ".join(
        f"{burst[0]:.3g}" if len(burst) == 1 else f"{len(burst)} from {burst[0]:.3g} to {burst[-1]:.3g}"
        for burst in bursts
    )


def simulated_shares(
    request: PlanRequest, decays: Sequence[Decay], times: Sequence[np.ndarray | None] = ()
) -> list[str]:
    """Return the share (%) of simulated decays, sampled at ``times`` if any, that reach the wanted error, by test."""

    def simulation(decay: Decay, sampled: np.ndarray | None) -> Simulation:
        return lambda method, number, report: simulated(
            request.likely, decay, request.quantity, method, number, report, sampled
        )

    tests = [simulation(*test) for test in zip(decays, times or [None] * len(decays), strict=True)]
    return [f"{100 * reached(errors, request.error):.1f}" for errors in request.simulated(tests)]
