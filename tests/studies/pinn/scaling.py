"""What a fit costs as the problem grows: residuals, degrees of freedom, cycles in the record; and where it ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from bench import Identifier
from bench.scenario.scenario import Scenario
from methods.pinn.collocation import Collocation
from methods.pinn.method import PINN
from tests.studies.pinn.common import Part, compare, scenario

Advance = Callable[[int], object]
COLLOCATIONS = (100, 200, 400, 1000, 2000)
MASSES = (1, 2, 3, 4)
CYCLES = (2, 5, 10, 20, 30)
PER_CYCLE = 5
"""Samples a cycle where the horizon grows."""
COUNT = 2 * (len(COLLOCATIONS) + len(MASSES) + len(CYCLES))
"""Rows of the table."""
ASTRAY = 1.5
"""A root mean square error over the oracle's beyond which a fit is said not to converge."""


def horizon(cycles: int) -> Scenario:
    """A free oscillator of so many cycles in 10 s, decaying by e² over the record."""
    cell, omega = scenario(system="sdof", snr=20, initial_state="unknown"), 2.0 * np.pi * cycles / 10.0
    parameters = {"m": 1.0, "c": 0.4, "k": float(omega**2)}
    return replace(cell, parameters=parameters, samples=max(25, PER_CYCLE * cycles), label=f"{cycles} cycles")


def chain(n: int) -> Scenario:
    """A chain of n masses, every displacement measured, the first released from 1 m."""
    cell = scenario(system="chain2", snr=30)
    parameters = {f"{kind}{i}": value for kind, value in (("m", 1.0), ("c", 0.2), ("k", 12.0)) for i in range(1, n + 1)}
    parameters = {name: value * (1.0 - 0.05 * (int(name[1:]) - 1)) for name, value in parameters.items()}
    initial = ((1.0, *[0.0] * (n - 1)), (0.0,) * n)
    return replace(cell, parameters=parameters, options={"n": n}, initial=initial, label=f"{n} masses")


def scaling(replicates: int, advance: Advance) -> Part:
    """The table, and its numbers for the picture."""
    rows: list[list[str]] = []
    data: dict[str, list[dict[str, float | str]]] = {"residuals": [], "masses": [], "cycles": []}
    reference = scenario(system="sdof", snr=20, initial_state="unknown")

    def add(kind: str, size: int, label: str, method: Identifier, cell: Scenario, name: str) -> None:
        found = compare(method, cell, replicates)
        advance(1)
        worst = float(found.over_oracle.max())
        data[kind].append({"method": name, "size": size, "seconds": found.seconds, "ratio": worst})
        verdict = "" if worst < ASTRAY and not found.failed else "does not converge"
        rows.append([label, name, f"{found.seconds:.3f}", f"{worst:.2f}", verdict])

    for n in COLLOCATIONS:
        for name, method in (("pinn", PINN(collocation=n)), ("collocation", Collocation(collocation=n))):
            add("residuals", n + 25, f"{n + 25} residuals", method, reference, name)
    for n in MASSES:
        for name, method in (("pinn", PINN()), ("collocation", Collocation())):
            add("masses", n, f"{n} masses", method, chain(n), name)
    for n in CYCLES:
        for name, method in (("pinn", PINN()), ("collocation", Collocation())):
            add("cycles", n, f"{n} cycles", method, horizon(n), name)
    columns = ["size", "method", "CPU s a fit", "largest error / oracle", ""]
    text = (
        f"{replicates} data sets each; the largest of the root mean square errors of displacement and groups over the "
        "oracle's. Residuals: collocation points on the reference record. Masses: chains, 30 dB, 40 samples a channel. "
        f"Cycles: {PER_CYCLE} samples a cycle at 20 dB, unknown start, decay by e² over the record."
    )
    return Part("scaling", "Cost and reach", text, columns, rows, data)
