"""The identifiability of a scenario's quantities: verdicts, the page that states them, profile likelihoods."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bench.information.fisher import Information
from bench.information.structural import Structure
from bench.reporting.rounding import number, readable, rounded
from bench.reporting.terminal import table, wrapped
from bench.scenario.scenario import Scenario
from bench.scoring.verdict import DECIDED_BY_PRIOR
from bench.systems import Quantity

LISTED = 5
"""Number of correlations that are listed, the strongest first."""
FROM_DATA, WITH_PRIOR, BY_PRIOR = "from the data", "with the prior", "decided by the prior"
PRACTICALLY_NOT, NOT = "practically not identifiable", "not identifiable"
MEANING = {
    FROM_DATA: "identifiable from the data alone",
    WITH_PRIOR: "identifiable only with the prior, but limited more by the noise than by the prior",
    BY_PRIOR: f"more than {100 * DECIDED_BY_PRIOR:.0f} % of its variance is due to the prior",
    PRACTICALLY_NOT: "identifiable from perfect data, but with these data the uncertainty exceeds the value",
    NOT: "not identifiable even from perfect data, and there is no prior",
}
"""Meanings of the verdicts on a quantity."""


def verdict(structural: bool, relative_sd: float, prior_share: float) -> str:
    """Return the verdict on a quantity.

    Args:
        structural: Whether it is identifiable from perfect data.
        relative_sd: Cramér-Rao bound on its relative standard deviation.
        prior_share: Share of the bound's variance that is due to the prior.
    """
    if not structural and not prior_share > 0:
        return NOT
    if prior_share > DECIDED_BY_PRIOR:
        return BY_PRIOR
    if relative_sd > 1.0:
        return PRACTICALLY_NOT
    return FROM_DATA if structural else WITH_PRIOR


def correlations(information: Information, quantities: Sequence[Quantity]) -> np.ndarray:
    """Return the correlations of the logarithms of n quantities at the bound, shape (n, n)."""
    w = np.zeros((len(quantities), len(information.precision)))
    w[:, : len(information.names)] = [q.vector(information.names) for q in quantities]
    covariance = w @ information.covariance @ w.T
    sd = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(sd, sd))


def identifiability_page(
    scenario: Scenario, measured: Sequence[int], structure: Structure, information: Information
) -> str:
    """Return the verdicts on a scenario's quantities as text for a terminal."""
    known = scenario.make_system().quantities
    quantities = [*known, *(group for group in structure.groups if group not in known)]
    initial = "the initial state of this scenario" if structure.at_start else "any initial state"
    force = "" if scenario.force is None else f" and a known force on DOF {scenario.force.dof}"
    rows = []
    for q in quantities:
        sd, share = math.sqrt(information.variance(q)), information.prior_share(q)
        word = verdict(structure.identifiable(q), sd, share)
        rows.append([readable(q.name), number(100 * sd) if math.isfinite(sd) else "-", f"{100 * share:.0f}", word])
    prior, used = scenario.prior.name if scenario.prior else "none", {row[-1] for row in rows}
    condition = f"condition number of the scaled information: {_condition(information, False)} from the data"
    if scenario.prior:
        condition += f", {_condition(information, True)} with the prior"
    return "\n".join(
        [
            f"{scenario.label}, {scenario.snr_db:g} dB, initial state {scenario.initial_state}, prior {prior}\n",
            wrapped(
                f"Perfect displacement of DOF {', '.join(map(str, measured))}, from {initial}{force}, without a prior:"
            ),
            *(wrapped(f"- {line}") for line in structure.sentences()),
            f"\nThese {scenario.samples} samples over {scenario.duration:g} s:\n",
            table(rows, ["", "bound %", "due to prior %", "verdict"], (0, 3)) + "\n",
            *(wrapped(f"{word}: {meaning}") for word, meaning in MEANING.items() if word in used),
            "",
            wrapped(condition),
            wrapped(f"strongest correlations of the logarithms: {_strongest(structure, information, quantities)}"),
        ]
    )


def _condition(information: Information, prior: bool) -> str:
    value, missing = information.condition(prior)
    directions = f" (and {missing} direction{'s' * (missing > 1)} without information)" if missing else ""
    return number(value) + directions


def _strongest(structure: Structure, information: Information, quantities: Sequence[Quantity]) -> str:
    """Return the strongest correlations of parameters, or of groups if some parameter is not identifiable."""
    compared = [q for q in quantities if len(q.exponents) == 1]
    if any(math.isinf(information.variance(q)) for q in compared):
        compared = list(structure.groups)
    matrix, names = correlations(information, compared), [readable(q.name) for q in compared]
    pairs = sorted(itertools.combinations(range(len(compared)), 2), key=lambda pair: -abs(matrix[pair]))[:LISTED]
    return "; ".join(f"{names[i]} and {names[j]} {matrix[i, j]:+.2f}" for i, j in pairs) or "none"


def profile_intervals(
    scenario: Scenario, measured: Sequence[int], structure: Structure, information: Information, seed: int, out: Path
) -> tuple[str, list[Path]]:
    """Return a table of the profile likelihoods of replicate 0, and the files of their picture, written to ``out``."""
    from bench.information.profile import profiles
    from bench.reporting.pictures.curves import draw_profiles
    from bench.reporting.pictures.style import save

    system = scenario.make_system()
    parameters = [system.quantity(name) for name in system.names]
    groups = {group.name: group for group in (*system.groups, *structure.groups) if len(group.exponents) > 1}
    computed = profiles(scenario, structure, information, [*parameters, *groups.values()], seed, tuple(measured))
    rows = []
    for p in computed:
        estimate, low, high = rounded(p.estimate, *p.interval)
        ends = [low if p.interval[0] > 0 else "open", high if math.isfinite(p.interval[1]) else "open"]
        rows.append([readable(p.quantity.name), estimate if structure.identifiable(p.quantity) else "any", *ends])
    headers = [f"profile of replicate 0, seed {seed}", "estimate", "95 % low", "95 % high"]
    prior = scenario.draw_prior(system, seed, 0)
    picture = draw_profiles(scenario.label, computed, dict(scenario.parameters), prior)
    return table(rows, headers), save(picture, out, svg=out)
