"""Cost of a fit as the problem grows: residuals, degrees of freedom, cycles in the record."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.entrants.registry import make_method
from bench.scenario.scenario import Scenario
from tests.studies.common import scenario, tracked
from tests.studies.pinn.common import METHODS, Comparison, Part, compare, trials

COLLOCATIONS = (100, 200, 400, 1000, 2000)
MASSES = (2, 3, 5, 10)
CYCLES = (2, 5, 10, 20, 30, 50, 100, 200)
MASS_SAMPLES = 245
"""Samples of each displacement where the chain grows."""
PER_CYCLE = 5
"""Samples a cycle where the horizon grows."""
NETWORK_UP_TO = {"masses": 5, "cycles": 30}
"""The largest sizes at which the network is fitted: beyond, a fit takes minutes."""
ASTRAY = 1.15
"""Errors over the oracle's from which on a fit is said not to be at the oracle."""


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
    label, options = f"{n} masses", {"n": n}
    return replace(cell, parameters=parameters, options=options, initial=initial, samples=MASS_SAMPLES, label=label)


@dataclass(frozen=True)
class Ratios:
    """Errors over the oracle's on the same data: of the groups together, each over its bound, and of displacement."""

    groups: float
    displacement: float


def ratios(found: Comparison) -> Ratios:
    """Root mean squares over the groups, and the displacement's own, which is the first score."""
    own = found.over_bound[1:]
    theirs = own / found.over_oracle[1:]
    return Ratios(float(np.sqrt(np.mean(own**2) / np.mean(theirs**2))), float(found.over_oracle[0]))


def reference(_collocation: int) -> Scenario:
    """The reference record, which does not grow with the collocation points."""
    return scenario(system="sdof", snr=20, initial_state="unknown")


GROWN: Mapping[str, tuple[Sequence[int], Callable[[int], Scenario]]] = {
    "residuals": (COLLOCATIONS, reference),
    "masses": (MASSES, chain),
    "cycles": (CYCLES, horizon),
}
"""Sizes of what grows, and the scenario of each."""


def settings(kind: str, n: int) -> Mapping[str, Mapping[str, int]]:
    """The methods that are fitted at a size, with what is not at its default."""
    network, spline, _ = METHODS
    if kind == "residuals":
        return {name: {"collocation": n} for name in (network, spline)}
    return {name: {} for name in METHODS if name != network or n <= NETWORK_UP_TO[kind]}


def scaling(replicates: int) -> Part:
    """The table, and its numbers for the picture."""
    rows: list[list[str]] = []
    data: dict[str, list[dict[str, float | str]]] = {kind: [] for kind in GROWN}
    for kind, n in tracked([(kind, n) for kind, (sizes, _) in GROWN.items() for n in sizes], "size"):
        size, on = n + 25 * (kind == "residuals"), trials(GROWN[kind][1](n), replicates)
        for name, own in settings(kind, n).items():
            found = compare(make_method(name, dict(own)), on)
            ratio = ratios(found)
            data[kind].append({"method": name, "size": size, "seconds": found.seconds, "ratio": ratio.groups})
            verdict = "" if ratio.groups < ASTRAY and not found.failed else "not at the oracle"
            numbers = [f"{found.seconds:.3f}", f"{ratio.groups:.2f}", f"{ratio.displacement:.2f}", verdict]
            rows.append([f"{size} {kind}", name, *numbers])
    columns = ["size", "method", "CPU s a fit", "groups / oracle", "displacement / oracle", ""]
    text = (
        f"{replicates} data sets each; root mean square errors over those of the oracle on the same data: of all "
        "groups together, each over its bound, and of the displacement. The equation of motion is softened by a share "
        "of the noise, not of the standard error, so that with many samples a displacement is farther from the "
        "oracle's than the groups are. The oracle starts from the truth and takes one noise level for all channels, "
        "where the methods estimate one for each: with several masses they can be nearer to the truth. "
        "Residuals: collocation points on the reference record. "
        f"Masses: chains, 30 dB, {MASS_SAMPLES} samples a channel, started from nothing but the data and the prior. "
        f"Cycles: {PER_CYCLE} samples a cycle at 20 dB, unknown start, decay by e² over the record. The network is "
        f"fitted up to {NETWORK_UP_TO['masses']} masses and {NETWORK_UP_TO['cycles']} cycles, beyond which a fit takes "
        "minutes."
    )
    return Part("scaling", "Cost and reach", text, columns, rows, data)
