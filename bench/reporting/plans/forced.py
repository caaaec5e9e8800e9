"""Tests under a measured force of a given energy: the best forces beside the usual ones."""

from __future__ import annotations

import math

import numpy as np

from bench.errors import InputError
from bench.planning.forced import FORCED_QUANTITIES, ForcedTest
from bench.planning.forces import LEAST_LINES, ForceInformation, Forces, line_frequencies, told_by
from bench.planning.multisine import ALL
from bench.planning.search import LEAST_RATE
from bench.planning.verify import counted, simulated_forced
from bench.reporting.plans.request import TITLES, PlanRequest, Simulation, percent
from bench.reporting.terminal import table, wrapped

MEANING = (
    "Each force has the energy {energy:g} N² s and starts from an unknown state of rest; it is measured with the "
    "motion. Percentages are standard deviations by the Cramér-Rao bound of the finite record, with its "
    "transient{median}. Over the best: ratio of the errors of {title}."
)
COUNTED = (
    "Counted: the standard deviation of {title} in {number} simulated tests, fitted by {method}, by the median size of "
    "their errors."
)


def forced_test(
    request: PlanRequest, samples: int, duration: float, energy: float, mass: float
) -> tuple[ForcedTest, float]:
    """Return a test, and the force (N) of one unit of the plan; raises InputError for a test that is too short."""
    size = mass * request.noise
    test = ForcedTest(samples, duration, energy / size**2)
    least = math.ceil(LEAST_RATE * request.likely.fastest * duration) + 1
    if samples < least:
        fastest = f"{LEAST_RATE:g} a cycle of {request.likely.fastest:.3g} Hz"
        raise InputError("samples", samples, f"at least {least}: {fastest}")
    if line_frequencies(request.likely, test).size < LEAST_LINES:
        raise InputError("duration", f"{duration:g}", f"longer: at least {LEAST_LINES} lines below the band's end")
    return test, size


def forces_page(request: PlanRequest, test: ForcedTest, size: float, energy: float) -> tuple[str, np.ndarray]:
    """Return a table of forces with their errors, and the best force (N) for the wanted quantity."""
    compared = _compared(request, test)
    best = compared[f"best for {request.title}"]
    headers = ["force", "peak, N", *(f"{TITLES.get(name, name)}, %" for name in FORCED_QUANTITIES), "over the best"]
    rows = [_row(title, force, size, force.median[request.quantity] / best.median[request.quantity])
            for title, force in compared.items()]  # fmt: skip
    notes = [MEANING.format(energy=energy, median=request.median, title=request.title)]
    if request.simulations:
        shares = _counted(request, test, list(compared.values()))
        rows, headers = [[*row, share] for row, share in zip(rows, shares, strict=True)], [*headers, "counted, %"]
        notes.append(COUNTED.format(title=request.title, number=request.simulations, method=request.method))
    return "\n".join([table(rows, headers), "", *(wrapped(note, "") for note in notes)]), size * best.force


def _compared(request: PlanRequest, test: ForcedTest) -> dict[str, ForceInformation]:
    forces, quantity, title = Forces(request.likely, test), request.quantity, request.title
    compared = {
        "hammer blow": forces.hammer_blow(),
        "band-limited noise": forces.noise(quantity),
        "even multisine": forces.even_multisine(quantity),
        f"best pulse for {title}": forces.best_pulse(quantity),
        f"best multisine for {title}": forces.best_multisine(quantity),
        f"best for {title}": forces.best(quantity),
        "best for m, c and k": forces.best(ALL),
    }
    return {title: told_by(request.likely, test, force) for title, force in compared.items()}


def _row(title: str, force: ForceInformation, size: float, over: float) -> list[str]:
    peak = size * float(np.abs(force.force).max())
    return [title, f"{peak:.3g}", *(percent(force.median[name]) for name in FORCED_QUANTITIES), f"{over:.2f}"]


def _counted(request: PlanRequest, test: ForcedTest, forces: list[ForceInformation]) -> list[str]:
    """Return the errors of simulated tests, force by force."""

    def simulation(force: ForceInformation) -> Simulation:
        return lambda method, number, report: simulated_forced(
            request.likely, test, force.force, request.quantity, method, number, report
        )

    return [percent(counted(errors)) for errors in request.simulated([simulation(force) for force in forces])]
