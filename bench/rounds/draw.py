"""The problems of a round, drawn from stated ranges by its secret seed."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from bench.config.composition import content_of
from bench.config.drawn import one_mass
from bench.config.schema import scenario_from
from bench.contract.problem import Problem
from bench.errors import InputError
from bench.information.fisher import Bound, compute_bound
from bench.rounds.secret import SecretScenario, SecretStream, derived_key
from bench.scenario.scenario import Scenario
from bench.systems import Quantity

DIGITS = 9
"""Significant digits of what is drawn: no true value lies on a grid to which an estimate could be rounded."""
MISJUDGED = 0.4
"""A force is made for a natural frequency that is off by a factor of up to exp(0.4): its band says no more."""
LARGEST_BOUND = 0.3
"""Bound on the relative error up to which a quantity counts as determined; a problem beyond it is drawn again."""
PER_CYCLE = 10
"""Samples in a natural period, at least, of a forced problem, whose force is sampled with the motion."""
SPREAD = 0.5
"""Mass, damping and stiffness of each link of a chain are off those of one mass by a factor of up to exp(0.5)."""

Ranges = Mapping[str, tuple[float, float]]
Content = dict[str, Any]


@dataclass(frozen=True)
class DrawnProblem:
    """A problem of a round with its truth: value and bound (one standard deviation) of each quantity asked for."""

    name: str
    kind: str
    problem: Problem
    truth: Mapping[str, tuple[float, float]]


def draw_round(seed: int, scenarios: int, ranges: Ranges) -> list[DrawnProblem]:
    """Draw the problems of a round: as many of each of :data:`KINDS` as of the others, in random order.

    Args:
        seed: Secret, of 256 bits.
        scenarios: Number of problems.
        ranges: The two ends of each of :data:`bench.config.drawn.RANGES`.
    """
    order = sorted(range(scenarios), key=lambda i: derived_key(seed, "order", i))
    kinds = [list(KINDS)[i % len(KINDS)] for i in order]
    return [_draw(seed, f"P{number:03d}", kind, ranges) for number, kind in enumerate(kinds, 1)]


def _draw(seed: int, name: str, kind: str, ranges: Ranges) -> DrawnProblem:
    """Draw one problem, as often as it takes until the data determine every quantity asked for."""
    attempt = 0
    while True:
        attempt += 1
        rng = SecretStream(derived_key(seed, name, attempt, "parameters"))
        try:
            return _with_truth(name, kind, _scenario(kind, name, ranges, rng), derived_key(seed, name, attempt, "data"))
        except InputError:
            continue


def _scenario(kind: str, name: str, ranges: Ranges, rng: SecretStream) -> Scenario:
    """Draw a scenario; raises InputError for one that does not suit its kind."""
    drawn = one_mass(name, ranges, rng, DIGITS, MISJUDGED)
    system, p = dict(drawn.system), drawn.system["parameters"]
    rate, force = math.sqrt(p["k"] / p["m"]), system["force"]
    if kind in ("free decay", "forced") and (kind == "forced") != (force is not None):
        raise InputError("kind", kind, "a force, or none")
    if force:
        if system["samples"] < PER_CYCLE * system["duration"] * rate / (2 * math.pi):
            raise InputError("samples", system["samples"], "enough to show the force")
        hold = force["hold"] if force["hold"] == "zero_order" else "linear"
        system["force"] = {**force, "samples": system["samples"], "hold": hold}
    amplitude = force["amplitude"] / p["k"] if force else math.hypot(
        system["initial"]["displacement"][0], system["initial"]["velocity"][0] / rate
    )  # fmt: skip
    irregular = drawn.disturbance == "irregular" and not force
    changed = KINDS[kind](system, amplitude, rng)
    disturbance = changed.pop("disturbance", {"kind": "irregular", "size": 1.0} if irregular else {"kind": "none"})
    content = {
        "system": {**system, "dense": 2, **changed},
        "prior": content_of("prior", "none" if force else "nominal"),
        "disturbance": disturbance,
        "snr": drawn.snr,
        "initial_state": drawn.initial_state,
    }
    return scenario_from(content)


def _with_truth(name: str, kind: str, scenario: Scenario, key: int) -> DrawnProblem:
    """Make the data of a scenario; raises InputError where they do not determine what is asked for."""
    secret = SecretScenario.of(scenario)
    bound = compute_bound(secret, key)
    asked = quantities(secret, bound)
    if not asked or max(bound.relative_sd[quantity.name] for quantity in asked) > LARGEST_BOUND:
        raise InputError("scenario", name, "data that determine every quantity")
    problem, truth = secret.maker(key)(0)
    values = {quantity.name: float(quantity.value(truth.parameters)) for quantity in asked}
    return DrawnProblem(name, kind, problem, {q: (value, value * bound.relative_sd[q]) for q, value in values.items()})


def quantities(scenario: Scenario, bound: Bound) -> list[Quantity]:
    """Return the identifiable quantities: parameters where a force gives the scale, else groups."""
    system = scenario.make_system()
    asked = [system.quantity(name) for name in system.names] if scenario.force else system.groups
    return [quantity for quantity in asked if bound.identifiable[quantity.name]]


def _unchanged(system: Content, amplitude: float, rng: SecretStream) -> Content:
    return {}


def _coloured(system: Content, amplitude: float, rng: SecretStream) -> Content:
    return {"disturbance": {"kind": "coloured", "size": rng.uniform(0.3, 0.9)}}


def _drift(system: Content, amplitude: float, rng: SecretStream) -> Content:
    return {"disturbance": {"kind": "drift", "size": rng.uniform(0.02, 0.2)}}


def _chain(system: Content, amplitude: float, rng: SecretStream) -> Content:
    """Return a chain of two or three masses: released from any shape, or driven at its last mass."""
    n, p = rng.choice((2, 3)), system["parameters"]
    rate = math.sqrt(p["k"] / p["m"])
    changed: Content = {
        "kind": "chain",
        "options": {"n": n},
        "parameters": {
            f"{key}{i}": p[key] * math.exp(rng.uniform(-SPREAD, SPREAD)) for key in "mck" for i in range(1, n + 1)
        },
        "initial": {"displacement": [0.0] * n, "velocity": [0.0] * n},
    }
    if system["force"]:
        return {**changed, "force": {**system["force"], "dof": n - 1}}
    shape = {"displacement": amplitude * rng.uniform(-1, 1, n), "velocity": amplitude * rate * rng.uniform(-1, 1, n)}
    return {**changed, "initial": {part: [float(f"{x:.{DIGITS}g}") for x in values] for part, values in shape.items()}}


def _nonlinear(system: Content, amplitude: float, rng: SecretStream) -> Content:
    """Return a cubic spring, quadratic damping or a pendulum, its nonlinear part 0.1 to 1 of the linear one, or so."""
    p, size = system["parameters"], math.exp(rng.uniform(math.log(0.1), 0.0))
    kind, name, value = rng.choice((
        ("duffing", "k3", size * p["k"] / amplitude**2),
        ("quadratic_damping", "c2", size * p["m"] / amplitude),
        ("pendulum", "l", amplitude / (1.5 * math.sqrt(size))),
    ))  # fmt: skip
    return {"kind": kind, "parameters": {**p, name: value}}


KINDS: dict[str, Callable[[Content, float, SecretStream], Content]] = {
    "free decay": _unchanged, "forced": _unchanged, "several masses": _chain, "nonlinear": _nonlinear,
    "coloured noise": _coloured, "drift": _drift,
}  # fmt: skip
"""The kinds of problem, equally many of each, and what each changes of one mass with white noise."""
