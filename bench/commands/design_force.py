"""A test under a measured force of a given energy: the forces that tell most beside the usual ones, as a table."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from bench.commands.design_request import TITLES, Request, Simulation, errors_of, median_words, percent, positive
from bench.commands.fields import path_of, whole
from bench.errors import InputError
from bench.planning.forced import FORCED_QUANTITIES, ForcedTest
from bench.planning.forces import LEAST_LINES, Forces, Told, line_frequencies, told_by
from bench.planning.multisine import ALL
from bench.planning.search import LEAST_RATE
from bench.reporting.terminal import table, wrapped
from bench.reporting.whole_file import check_file, write

MOST_SAMPLES = 500
MEANING = (
    "Each force has the energy {energy:g} N² s and starts at rest, which is not told; it is measured with the motion. "
    "Percentages are standard deviations by the Cramér-Rao bound of the finite record, with its transient{median}. "
    "Over the best: ratio of the errors of {title}."
)
COUNTED = (
    "Counted: the standard deviation of {title} in {number} simulated tests, answered by {method}, by the median size "
    "of their errors."
)


def driven(request: Request) -> int:
    """Find the best forces, print, simulate and write where asked; raises InputError."""
    test, size = _test(request)
    out = path_of(request.fields["out"]) if request.fields["out"] else None
    if out is not None:
        check_file(out)
    found = _compared(request, test)
    best = found[f"best for {request.title}"]
    headers = ["force", "peak, N", *(f"{TITLES.get(name, name)}, %" for name in FORCED_QUANTITIES), "over the best"]
    rows = [_row(title, told, size, told.median[request.quantity] / best.median[request.quantity])
            for title, told in found.items()]  # fmt: skip
    meaning = MEANING.format(
        energy=float(request.fields["energy"]), median=median_words(request.likely), title=request.title
    )
    said = wrapped(meaning, "")
    if request.simulations:
        headers.append("counted, %")
        rows = [[*row, value] for row, value in zip(rows, _counted(request, test, list(found.values())), strict=True)]
        counting = COUNTED.format(title=request.title, number=request.simulations, method=request.method)
        said += "\n" + wrapped(counting, "")
    print(f"{table(rows, headers)}\n\n{said}")
    if out is not None:
        _write(out, test.times, size * best.force)
    return 0


def _test(request: Request) -> tuple[ForcedTest, float]:
    """The test, and the force (N) that is 1 in the units of the plan; raises InputError."""
    fields, likely = request.fields, request.likely
    if fields["times"] != "even":
        raise InputError("times", fields["times"], "even, where a force is sought")
    for name in ("amplitude", "rate"):
        if fields[name]:
            raise InputError(name, fields[name], "left out with force=optimal: samples= and duration=, from rest")
    request.need(("samples", "duration", "energy", "mass"), "force is")
    size = positive("mass", fields["mass"]) * request.noise
    samples, duration = whole("samples", fields["samples"], 8, MOST_SAMPLES), positive("duration", fields["duration"])
    test = ForcedTest(samples, duration, positive("energy", fields["energy"]) / size**2)
    least = math.ceil(LEAST_RATE * likely.fastest * duration) + 1
    if samples < least:
        raise InputError("samples", samples, f"at least {least}: {LEAST_RATE:g} a cycle of {likely.fastest:.3g} Hz")
    if line_frequencies(likely, test).size < LEAST_LINES:
        raise InputError("duration", fields["duration"], f"longer: at least {LEAST_LINES} lines below the band's end")
    return test, size


def _compared(request: Request, test: ForcedTest) -> dict[str, Told]:
    forces, quantity, title = Forces(request.likely, test), request.quantity, request.title
    found = {
        "hammer blow": forces.hammer_blow(),
        "band-limited noise": forces.noise(quantity),
        "even multisine": forces.even_multisine(quantity),
        f"best pulse for {title}": forces.best_pulse(quantity),
        f"best multisine for {title}": forces.best_multisine(quantity),
        f"best for {title}": forces.best(quantity),
        "best for m, c and k": forces.best(ALL),
    }
    return {title: told_by(request.likely, test, force) for title, force in found.items()}


def _row(title: str, told: Told, size: float, over: float) -> list[str]:
    peak = size * float(np.abs(told.force).max())
    return [title, f"{peak:.3g}", *(percent(told.median[name]) for name in FORCED_QUANTITIES), f"{over:.2f}"]


def _counted(request: Request, test: ForcedTest, every: list[Told]) -> list[str]:
    """The errors of simulated tests, force by force."""
    from bench.planning.verify import counted, simulated_forced

    def simulation(told: Told) -> Simulation:
        return lambda method, number, report: simulated_forced(
            request.likely, test, told.force, request.quantity, method, number, report
        )

    return [percent(counted(errors)) for errors in errors_of(request, [simulation(told) for told in every])]


def _write(path: Path, times: np.ndarray, force: np.ndarray) -> None:
    """A record of the force, which lacks only the motion."""
    rows = "\n".join(f"{time:.9g},{value:.9g}" for time, value in zip(times, force, strict=True))
    write(path, f"t (s),force (N)\n{rows}\n")
