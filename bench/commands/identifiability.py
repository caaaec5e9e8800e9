"""``python -m bench.identifiability``: what the data of a scenario can tell, before any method is run.

Structure: what perfect data would tell, exactly (:mod:`bench.information.structural`). Practice: what these samples at
this noise tell, by the Cramér-Rao bound (:mod:`bench.information.fisher`), and how much of it is the prior's. On
request, the profile likelihood of each quantity on one replicate (:mod:`bench.information.profile`). It sees the
truth: it judges a scenario, and is no method.
"""

from __future__ import annotations

import itertools
import json
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.commands.fields import flag, path_of, read_fields
from bench.commands.guard import command
from bench.errors import InputError
from bench.information.fisher import Bound, Information, compute_bound, information
from bench.information.structural import Structure, check_dofs, structure_of
from bench.reporting.rounding import number, readable, rounded
from bench.reporting.terminal import table, wrapped
from bench.reporting.whole_file import check_folder
from bench.scenario.scenario import Scenario
from bench.scoring.verdict import DECIDED_BY_PRIOR
from bench.systems import Quantity

USAGE = """usage: python -m bench.identifiability [field=value ...]

fields (defaults in brackets):
  system, system.<field>, snr, initial_state, prior, seed
             as for python -m bench
  measured   [all] the DOFs whose displacement is measured, counted from 0:
             measured=[0]
  profile    [false] true: profile likelihoods of one replicate, printed, drawn
  out        [results/figures] where the picture goes"""
SCENARIO_FIELDS = ("system", "snr", "initial_state", "prior", "seed")
OWN_FIELDS = {"measured": "", "profile": "false", "out": "results/figures"}
LISTED = 5

FROM_DATA, WITH_PRIOR, BY_PRIOR = "from the data", "with the prior", "decided by the prior"
PRACTICALLY_NOT, NOT = "practically not identifiable", "not identifiable"
MEANING = {
    FROM_DATA: "the data alone tell it",
    WITH_PRIOR: "not without the prior, but the noise limits it more than the prior does",
    BY_PRIOR: f"more than {100 * DECIDED_BY_PRIOR:.0f} % of its variance is the prior's",
    PRACTICALLY_NOT: "perfect data would tell it, these leave it uncertain by more than its own size",
    NOT: "not even perfect data tell it, and there is no prior",
}
"""The verdicts on a quantity in short words, and what each means."""


def verdict(structural: bool, relative_sd: float, prior_share: float) -> str:
    """The verdict on a quantity from the structural one, its bound and the prior's share of its variance."""
    if not structural and not prior_share > 0:
        return NOT
    if prior_share > DECIDED_BY_PRIOR:
        return BY_PRIOR
    if relative_sd > 1.0:
        return PRACTICALLY_NOT
    return FROM_DATA if structural else WITH_PRIOR


def verdicts(scenario: Scenario, bound: Bound | None = None) -> dict[str, str]:
    """The verdict on every scored quantity, by name; from a bound that is at hand, or one computed here."""
    structure, bound = structure_of(scenario), bound or compute_bound(scenario)
    return {
        q.name: verdict(structure.identifiable(q), bound.relative_sd[q.name], bound.prior_share[q.name])
        for q in scenario.make_system().quantities
    }


def correlations(told: Information, quantities: Sequence[Quantity]) -> np.ndarray:
    """Correlation matrix of the logarithms of quantities at the bound, shape (n, n), on the informed directions."""
    w = np.zeros((len(quantities), len(told.precision)))
    w[:, : len(told.names)] = [q.vector(told.names) for q in quantities]
    covariance = w @ told.covariance @ w.T
    sd = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(sd, sd))


@dataclass(frozen=True)
class Request:
    """What a command line asks for."""

    scenario: Scenario
    seed: int
    measured: tuple[int, ...]
    profile: bool
    out: Path


def read_request(arguments: Sequence[str]) -> Request:
    """The request of a command line; raises InputError for what makes no sense."""
    from bench.config.experiment import expand

    for argument in arguments:
        key, equals, _ = argument.partition("=")
        if not equals or key.split(".")[0] not in (*SCENARIO_FIELDS, *OWN_FIELDS):
            fields = ", ".join((*SCENARIO_FIELDS, *OWN_FIELDS))
            raise InputError("argument", argument, f"write field=value with one of the fields {fields}")
    overrides = [argument for argument in arguments if argument.partition("=")[0] not in OWN_FIELDS]
    own = read_fields([argument for argument in arguments if argument not in overrides], OWN_FIELDS)
    profile = flag("profile", own["profile"])
    job = expand([*overrides, "method=oracle"], multirun=False)[0]
    scenario = job.cell().scenario
    system = scenario.make_system()
    measured = _dofs(own["measured"]) if own["measured"] else scenario.measured_dofs
    check_dofs(system, measured)
    return Request(scenario, job.config.seed, measured, profile, path_of(own["out"]))


def _dofs(text: str) -> tuple[int, ...]:
    try:
        value = json.loads(text)
    except ValueError:
        value = None
    value = [value] if type(value) is int else value
    if not isinstance(value, list) or not value or not all(type(entry) is int for entry in value):
        raise InputError("measured", text, "a list of DOFs counted from 0, such as [0,1]")
    return tuple(value)


def report(request: Request, structure: Structure, told: Information, quantities: Sequence[Quantity]) -> str:
    """The verdicts on the quantities as text, no wider than a terminal."""
    scenario = request.scenario
    prior = scenario.prior.name if scenario.prior else "none"
    dofs = ", ".join(map(str, request.measured))
    start = "the start of this scenario" if structure.at_start else "any start"
    force = "" if scenario.force is None else f" and a known force on DOF {scenario.force.dof}"
    lines = [
        f"{scenario.label}, {scenario.snr_db:g} dB, initial state {scenario.initial_state}, prior {prior}",
        "",
        wrapped(f"Perfect displacement of DOF {dofs}, from {start}{force}, without a prior:"),
        *(wrapped(f"- {line}") for line in structure.sentences()),
        "",
        f"These {scenario.samples} samples over {scenario.duration:g} s:",
        "",
        _table(structure, told, quantities),
        "",
        wrapped(_condition(told, scenario.prior is not None)),
        wrapped(_strongest(structure, told, quantities)),
    ]
    return "\n".join(lines)


def listed(structure: Structure, scenario: Scenario) -> list[Quantity]:
    """The scored quantities of a system, and the groups that were found and are none of them."""
    known = scenario.make_system().quantities
    return [*known, *(group for group in structure.groups if group not in known)]


def _lines(
    structure: Structure, told: Information, quantities: Sequence[Quantity]
) -> list[tuple[str, float, float, str]]:
    found = []
    for q in quantities:
        sd, share = math.sqrt(told.variance(q)), told.prior_share(q)
        found.append((q.name, sd, share, verdict(structure.identifiable(q), sd, share)))
    return found


def _table(structure: Structure, told: Information, quantities: Sequence[Quantity]) -> str:
    lines = _lines(structure, told, quantities)
    rows = [
        [readable(name), number(100 * sd) if math.isfinite(sd) else "-", f"{100 * share:.0f}", word]
        for name, sd, share, word in lines
    ]
    used = {word for *_, word in lines}
    notes = [wrapped(f"{word}: {meaning}") for word, meaning in MEANING.items() if word in used]
    headers = ["", "bound %", "prior's share %", "verdict"]
    return "\n".join([table(rows, headers, (0, 3)), "", *notes])


def _condition(told: Information, with_prior: bool) -> str:
    def words(prior: bool) -> str:
        value, missing = told.condition(prior)
        return number(value) + (
            f" (and {missing} direction{'s' * (missing > 1)} without information)" if missing else ""
        )

    text = f"condition number of the scaled information: {words(False)} from the data"
    return text + (f", {words(True)} with the prior" if with_prior else "")


def _strongest(structure: Structure, told: Information, quantities: Sequence[Quantity]) -> str:
    """The strongest correlations of parameters, or of the found groups where some parameter is not told at all."""
    own = [q for q in quantities if len(q.exponents) == 1]
    if any(math.isinf(told.variance(q)) for q in own):
        own = list(structure.groups)
    matrix = correlations(told, own)
    pairs = sorted(itertools.combinations(range(len(own)), 2), key=lambda pair: -abs(matrix[pair]))[:LISTED]
    names = [readable(q.name) for q in own]
    told_pairs = [f"{names[i]} and {names[j]} {matrix[i, j]:+.2f}" for i, j in pairs]
    return "strongest correlations of the logarithms: " + ("; ".join(told_pairs) or "none")


def _profile(request: Request, structure: Structure, told: Information) -> None:
    """Print the intervals of the profile likelihoods and write their picture."""
    from bench.information.profile import profiles
    from bench.reporting.figures.profile_likelihood import CAPTION, draw_profiles
    from bench.reporting.figures.style import save_figure

    scenario = request.scenario
    system = scenario.make_system()
    parameters = [system.quantity(name) for name in system.names]
    groups = {group.name: group for group in (*system.groups, *structure.groups) if len(group.exponents) > 1}
    found = profiles(scenario, structure, told, [*parameters, *groups.values()], request.seed, request.measured)
    rows = []
    for p in found:
        estimate, low, high = rounded(p.estimate, *p.interval)
        ends = [low if p.interval[0] > 0 else "open", high if math.isfinite(p.interval[1]) else "open"]
        rows.append([readable(p.quantity.name), estimate if structure.identifiable(p.quantity) else "any", *ends])
    headers = [f"profile of replicate 0, seed {request.seed}", "estimate", "95 % low", "95 % high"]
    print("\n" + table(rows, headers))
    figure = draw_profiles(found, dict(scenario.parameters), scenario.draw_prior(system, request.seed, 0))
    name = f"profile_{scenario.label}"
    for path in save_figure(figure, request.out, name, CAPTION):
        print(path)


def main(argv: Sequence[str] | None = None) -> int:
    """``python -m bench.identifiability [field=value ...]``; exit status 2 for bad input."""
    return command("bench.identifiability", USAGE, argv, _main)


def _main(arguments: Sequence[str]) -> int:
    try:
        request = read_request(arguments)
        if request.profile:
            check_folder(request.out)
        structure = structure_of(request.scenario, request.measured)
        told = information(request.scenario, request.seed, request.measured)
        print(report(request, structure, told, listed(structure, request.scenario)))
        if request.profile:
            _profile(request, structure, told)
    except ImportError:
        print(
            "bench.identifiability: matplotlib is missing: pip install 'vibration-bench[figures]'",
            file=sys.stderr,
        )
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
