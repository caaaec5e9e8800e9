"""A free decay that is given with its samples evenly spread, and where they tell most."""

from __future__ import annotations

import numpy as np

from bench.commands.design_plan import simulated_shares
from bench.commands.design_request import TITLES, Request, length, median_words, percent, positive
from bench.commands.fields import path_of, whole
from bench.planning.free_decay import QUANTITIES, Decay
from bench.reporting.terminal import table, wrapped
from bench.reporting.whole_file import check_file, write


def sampled(request: Request) -> int:
    """Find the best times, print, simulate and write where asked; raises InputError."""
    from bench.planning.optimal import VOLUME, best_times, told_by

    fields, likely = request.fields, request.likely
    request.need(("samples", "duration", "amplitude"), "times are")
    decay = Decay(
        whole("samples", fields["samples"], 8, 500), positive("duration", fields["duration"]),
        length("amplitude", fields["amplitude"]) / request.noise,
    )  # fmt: skip
    out = path_of(fields["out"]) if fields["out"] else None
    if out is not None:
        check_file(out)
    found = {
        "even": told_by(likely, decay.times, decay.amplitude),
        f"best for {request.title}": best_times(likely, decay, request.quantity),
        "best for k/m and c/m": best_times(likely, decay, VOLUME),
    }
    rows = [[title, *(percent(one.median[name]) for name in QUANTITIES)] for title, one in found.items()]
    headers = ["times", *(f"{title}, %" for title in TITLES.values())]
    if request.simulations:
        headers.append("simulated, %")
        shares = simulated_shares(request, [decay] * len(found), [one.times for one in found.values()])
        rows = [[*row, share] for row, share in zip(rows, shares, strict=True)]
    best = found[f"best for {request.title}"].times
    print(f"{table(rows, headers)}\n")
    print(wrapped(f"Best for {request.title} (s): {_bursts(best, decay)}.", ""))
    print(wrapped(f"Percentages are standard deviations by the Cramér-Rao bound{median_words(likely)}.", ""))
    if out is not None:
        write(out, "\n".join(["t (s)", *(f"{time:.9g}" for time in best)]) + "\n")
    return 0


def _bursts(times: np.ndarray, decay: Decay) -> str:
    """Times in a row as one burst."""
    gap, bursts = 0.5 * decay.duration / (decay.samples - 1), [[times[0]]]
    for time in times[1:]:
        if time - bursts[-1][-1] <= gap:
            bursts[-1].append(time)
        else:
            bursts.append([time])
    return ", ".join(
        f"{one[0]:.3g}" if len(one) == 1 else f"{len(one)} from {one[0]:.3g} to {one[-1]:.3g}" for one in bursts
    )
