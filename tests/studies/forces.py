"""The best force of a test beside usual ones of its energy."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated

import numpy as np

from bench.config.atlas import efficient_methods
from bench.engine.progress import counter
from bench.entrants.registry import make_method
from bench.isolation.machine import single_threaded
from bench.planning.forced_test import ForcedTest
from bench.planning.forces import ForceInformation, Forces, evaluate_force
from bench.planning.search import Likely
from bench.planning.verify import robust_deviation, simulate_forced_tests
from bench.reporting.tables.render import markdown_table
from tests.studies.common import RESULTS, Count, Out, publish, study
from tests.studies.plans import drawn_likely, known

RATE = 16.0
"""Samples a cycle."""
ERRORS = {"k_over_m": 0.002, "c_over_m": 0.02}
"""Errors of the wanted quantity under the best force, set by the energy: the bound means nothing for large ones."""
SIMULATED = ("hammer blow", "best")


@dataclass(frozen=True)
class Request:
    """A quantity wanted of a likely oscillator by a test."""

    likely: Likely
    quantity: str
    test: ForcedTest

    @property
    def cycles(self) -> float:
        """Return the duration in cycles of the nominal frequency."""
        return self.test.duration * self.likely.frequency


def drawn(number: int) -> list[tuple[Request, dict[str, ForceInformation]]]:
    """Random tests with their forces; half of them with doubt about the oscillator."""
    rng, found = np.random.default_rng(2027), []
    for i in range(number):
        likely = drawn_likely(rng, i, -2.3)
        cycles, quantity = float(10 ** rng.uniform(0.6, 1.3)), str(rng.choice(list(ERRORS)))
        unit = ForcedTest(round(RATE * cycles) + 1, cycles / likely.frequency, 1.0)
        least = _forces(Request(likely, quantity, unit))["best"].median[quantity]
        one = Request(likely, quantity, ForcedTest(unit.samples, unit.duration, (least / ERRORS[quantity]) ** 2))
        found.append((one, _forces(one)))
    return found


def _forces(one: Request) -> dict[str, ForceInformation]:
    forces, wanted = Forces(one.likely, one.test), one.quantity
    every = {
        "hammer blow": forces.hammer_blow(), "noise": forces.noise(wanted),
        "even multisine": forces.even_multisine(wanted), "best pulse": forces.best_pulse(wanted),
        "best multisine": forces.best_multisine(wanted), "best": forces.best(wanted),
    }  # fmt: skip
    return {title: evaluate_force(one.likely, one.test, force) for title, force in every.items()}


def forces(
    requests: Annotated[Count, "random tests, for each of which forces are found"] = 12,
    tests: Annotated[Count, "simulations of each test, with a blow and with the best force"] = 20,
    out: Out = RESULTS,
) -> int:
    """Measure what an optimal force gains over usual ones of its energy: forces.md.

    Tests are drawn at random; for each the forces are found, and tests with a hammer blow and with the best force are
    simulated and fitted by a method.
    """
    single_threaded()
    name = efficient_methods()[0]
    method, planned = make_method(name, {}), drawn(requests)
    shares: dict[str, list[float]] = {title: [] for title in SIMULATED}
    with counter("test", requests * tests * len(SIMULATED)) as advance:
        for one, found in planned:
            for title in SIMULATED:
                told = found[title]
                errors = simulate_forced_tests(one.likely, one.test, told.force, one.quantity, method, tests, advance)
                shares[title] += list(errors / told.median[one.quantity])
    said = {title: robust_deviation(np.array(values)) for title, values in shares.items()}
    publish(out / "forces.md", page(planned, said, name, tests))
    return 0


def page(
    planned: Sequence[tuple[Request, dict[str, ForceInformation]]], said: dict[str, float], method: str, tests: int
) -> str:
    """The page, a line a test."""
    titles = [title for title in planned[0][1] if title != "best"]
    ratios = np.array([
        [found[title].median[one.quantity] / found["best"].median[one.quantity] for title in titles]
        for one, found in planned
    ])  # fmt: skip
    rows = [
        [one.quantity, *known(one.likely), f"{one.cycles:.3g}", *(f"{value:.2f}" for value in line)]
        for (one, _), line in zip(planned, ratios, strict=True)
    ]  # fmt: skip
    rows.append(["median", "", "", "", *(f"{value:.2f}" for value in np.median(ratios, axis=0))])
    headers = ["want", "frequency, Hz", "damping ratio", "cycles", *titles]
    counts = ", ".join(f"{value:.2f} ({title})" for title, value in said.items())
    simulated = (
        f"Simulated {tests} times each and fitted by `{method}`, errors over the bound, all tests together: {counts}; "
        "1 where estimates are as good as the bound."
    )
    head = HEAD.format(rate=RATE, errors=", ".join(f"{100 * v:g} % ({k})" for k, v in ERRORS.items()))
    return "\n\n".join([f"# Forces, compared\n\n{head}", markdown_table(rows, headers), simulated, REGENERATE]) + "\n"


HEAD = """Tests under a measured force are drawn at random, half of them with doubt about the oscillator (the standard
deviation stands behind the value), with {rate:g} samples per cycle, from rest; the initial state is unknown. All forces
of a test have the same energy, with which the best one determines the requested quantity to {errors}. Numbers are
errors over that of the best force, by the Cramér-Rao bound of the finite record (median over the likely oscillators); a
hammer blow is half a sine of a twentieth of a period, or of two sampling intervals, whichever is longer."""
REGENERATE = "Regenerate: `python -m tests.studies.forces` (from a clone)"


main = partial(study, forces, "tests.studies.forces")


if __name__ == "__main__":
    sys.exit(main())
