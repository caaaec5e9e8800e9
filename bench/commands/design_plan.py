"""The cheapest free decays that tell a quantity as well as is wanted, as a table; or what a given one tells."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from bench.commands.design_request import TITLES, Request, Simulation, errors_of, length, percent, positive
from bench.commands.fields import whole
from bench.config.atlas import on_the_bound
from bench.planning.free_decay import QUANTITIES, Decay
from bench.planning.search import MOST_SAMPLES, SHARE, WITHIN, Proposal, cheapest, proposal
from bench.reporting.terminal import table, wrapped

STARTS = (5.0, 10.0, 20.0, 50.0, 100.0, 200.0)
"""Starts that are proposed where none is said, over the noise."""


def planned(request: Request) -> int:
    """Propose free decays, print, and simulate where asked; raises InputError."""
    found = _proposals(request)
    if not found:
        wanted = f"{request.title} to {100 * request.error:g} %"
        print(f"no free decay of up to 100,000 samples tells {wanted}; start further out")
        return 1
    checked = simulated_shares(request, [one.decay for one in found]) if request.simulations else None
    print(_table(found, request.noise, checked))
    print(f"\n{wrapped(_meaning(request), '')}")
    return 0


def _proposals(request: Request) -> list[Proposal]:
    fields, likely, noise = request.fields, request.likely, request.noise
    starts = [length("amplitude", fields["amplitude"]) / noise] if fields["amplitude"] else list(STARTS)
    if fields["samples"] or fields["duration"]:
        request.need(("samples", "duration"), "errors are")
        samples = whole("samples", fields["samples"], 8, MOST_SAMPLES)
        duration = positive("duration", fields["duration"])
        return [proposal(likely, Decay(samples, duration, start)) for start in starts]
    rate = positive("rate", fields["rate"]) if fields["rate"] else 0.0
    tried = [cheapest(likely, request.quantity, request.error, start, rate) for start in starts]
    return [one for one in tried if one is not None]


def _table(found: Sequence[Proposal], noise: float, checked: Sequence[str] | None) -> str:
    """A line a test; ``checked``: what simulating it gave."""
    rows = []
    for one in found:
        rate = (one.decay.samples - 1) / one.decay.duration
        cells = [f"{1e3 * noise * one.decay.amplitude:.3g}", f"{one.decay.samples}", f"{one.decay.duration:.3g}",
                 f"{rate:.3g}"]  # fmt: skip
        for name in QUANTITIES:
            same = math.isclose(one.median[name], one.share[name], rel_tol=1e-3)
            cells.append(f"{percent(one.median[name])}" + ("" if same else f" ({percent(one.share[name])})"))
        rows.append([*cells, f"{100 * one.wrong_basin:.1g}"])
    headers = ["start, mm", "samples", "duration, s", "samples a second", *(f"{t}, %" for t in TITLES.values()),
               "wrong frequency, %"]  # fmt: skip
    if checked is not None:
        rows, headers = [[*row, text] for row, text in zip(rows, checked, strict=True)], [*headers, "simulated, %"]
    return table(rows, headers, ())


def _meaning(request: Request) -> str:
    said = ["Each line is the test of fewest samples for its start, released from rest; percentages are standard",
            "deviations by the Cramér-Rao bound"]  # fmt: skip
    if request.likely.in_doubt:
        said.append(f"(median over the likely oscillators; in brackets not exceeded in {100 * SHARE:g} % of them)")
    text = " ".join(said) + f". Methods that reach it: {', '.join(on_the_bound())}."
    if request.simulations:
        text += (
            f" simulated: of {request.simulations} tests, answered by {request.method}, those whose error of "
            f"{request.title} is within {WITHIN:g} times the wanted one; 95 % where it is just reached."
        )
    return text


def simulated_shares(request: Request, decays: Sequence[Decay], times: Sequence[np.ndarray | None] = ()) -> list[str]:
    """The share (%) of simulated free decays that reach what was wanted, test by test; sampled at ``times``, if any."""
    from bench.planning.verify import reached, simulated

    def test(decay: Decay, at: np.ndarray | None) -> Simulation:
        return lambda method, number, report: simulated(
            request.likely, decay, request.quantity, method, number, report, at
        )

    every = errors_of(request, [test(*one) for one in zip(decays, times or [None] * len(decays), strict=True)])
    return [f"{100 * reached(errors, request.error):.1f}" for errors in every]
