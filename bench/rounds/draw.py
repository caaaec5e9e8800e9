"""Draw the problems of a round from stated ranges by its secret seed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.config.composition import content_of
from bench.config.random_scenarios import one_mass
from bench.config.schema import scenario_from
from bench.contract.problem import Problem
from bench.errors import InputError
from bench.information.fisher import compute_bound
from bench.rounds.secret import SecretScenario, SecretStream, derived_key
from bench.scenario.scenario import Scenario

KINDS = ("free decay", "forced", "several masses", "nonlinear", "coloured noise", "drift")
"""Kinds of problem, in equal numbers; the last two are linear with one mass, like the first two."""
DISTURBANCES = {"coloured noise": ("coloured", 0.3, 0.9), "drift": ("drift", 0.02, 0.2)}
"""Disturbance of a kind, with the range of its size."""
DIGITS = 9
"""Significant digits of drawn values; rounding an estimate to fewer digits does not recover the true value."""
LARGEST_BOUND = 0.3
"""Largest bound on the relative error of an identifiable quantity; problems beyond it are drawn again."""
PER_CYCLE, PER_CYCLE_FORCED = 4, 10
"""Smallest number of samples per natural period, without and with a force, which is sampled with the motion."""
SPREAD = 0.5
"""Largest change of the log mass, damping and stiffness of the links of a chain from those of one mass."""

Ranges = Mapping[str, tuple[float, float]]
Content = dict[str, Any]


@dataclass(frozen=True)
class DrawnProblem:
    """A problem of a round with its true values, and the bound (standard deviation) of each requested quantity."""

    name: str
    kind: str
    problem: Problem
    truth: Mapping[str, tuple[float, float]]


def draw_round(seed: int, scenarios: int, ranges: Ranges) -> list[DrawnProblem]:
    """Draw the problems of a round, with their kinds in random order.

    Args:
        seed: Secret, of 256 bits.
        scenarios: Number of problems.
        ranges: Range of each of :data:`bench.config.random_scenarios.RANGES`.
    """
    order = sorted(range(scenarios), key=lambda i: derived_key(seed, "order", i))
    return [_draw(seed, f"P{number:03d}", KINDS[i % len(KINDS)], ranges) for number, i in enumerate(order, 1)]


def _draw(seed: int, name: str, kind: str, ranges: Ranges) -> DrawnProblem:
    """Draw a problem repeatedly until the data determine every requested quantity."""
    attempt = 0
    while True:
        attempt += 1
        try:
            rng = SecretStream(derived_key(seed, name, attempt, "parameters"))
            scenario = draw_scenario(name, kind, ranges, rng)
            with np.errstate(all="ignore"):
                return with_truth(name, kind, scenario, derived_key(seed, name, attempt, "data"), LARGEST_BOUND)
        except (InputError, np.linalg.LinAlgError):  # LinAlgError for a motion that diverges
            continue


def draw_scenario(name: str, kind: str, ranges: Ranges, rng: SecretStream) -> Scenario:
    """Draw a scenario of a kind; raises InputError if the drawn scenario does not suit the kind."""
    drawn = one_mass(name, ranges, rng, DIGITS)
    system, p = dict(drawn.system), drawn.system["parameters"]
    rate, force, start = math.sqrt(p["k"] / p["m"]), system["force"], system["initial"]
    if (kind == "forced" and not force) or (kind == "free decay" and force):
        raise InputError("kind", kind, "with a force, or without one")
    disturbance: Content = {"kind": drawn.disturbance, **({"size": 1.0} if drawn.disturbance == "irregular" else {})}
    if system["samples"] < (PER_CYCLE_FORCED if force else PER_CYCLE) * system["duration"] * rate / (2 * math.pi):
        raise InputError("samples", system["samples"], "enough to show motion and force")
    amplitude = math.hypot(start["displacement"][0], start["velocity"][0] / rate)
    if force:
        hold = force["hold"] if force["hold"] == "zero_order" else "linear"
        system["force"] = {**force, "samples": system["samples"], "hold": hold}
        amplitude, disturbance = force["amplitude"] / p["k"], {"kind": "none"}
    if kind in DISTURBANCES:
        named, low, high = DISTURBANCES[kind]
        disturbance = {"kind": named, "size": rng.uniform(low, high)}
    elif kind == "several masses":
        system |= _chain(system, amplitude, rng)
    elif kind == "nonlinear":
        system |= _nonlinear(p, amplitude, rng)
    return scenario_from({
        "system": {**system, "dense": 2},
        "prior": content_of("prior", "none" if force else "nominal"),
        "disturbance": disturbance,
        "snr": drawn.snr,
        "initial_state": drawn.initial_state,
    })  # fmt: skip


def with_truth(name: str, kind: str, scenario: Scenario, key: int, largest_bound: float = math.inf) -> DrawnProblem:
    """Generate the data of a scenario from a secret key, with the true values of the identifiable quantities.

    These are the parameters if a force gives the scale, else the groups. Raises InputError if a bound is too large, or
    nothing is identifiable.
    """
    secret = SecretScenario.of(scenario)
    system, bound = secret.make_system(), compute_bound(secret, key)
    quantities = [system.quantity(parameter) for parameter in system.names] if scenario.force else system.groups
    identifiable = [quantity for quantity in quantities if bound.identifiable[quantity.name]]
    if not identifiable or not all(
        bound.relative_sd[quantity.name] <= largest_bound for quantity in identifiable
    ):  # NaN, too
        raise InputError("scenario", name, "data that determine every quantity")
    problem, truth = secret.maker(key)(0)
    values = {quantity.name: float(quantity.value(truth.parameters)) for quantity in identifiable}
    return DrawnProblem(name, kind, problem, {q: (value, value * bound.relative_sd[q]) for q, value in values.items()})


def _chain(system: Content, amplitude: float, rng: SecretStream) -> Content:
    """Return the changes for two or three masses, released from a random shape or driven at the last mass."""
    n, p = rng.choice((2, 3)), system["parameters"]
    rate = math.sqrt(p["k"] / p["m"])
    links = [(key, i) for key in "mck" for i in range(1, n + 1)]
    parameters = {f"{key}{i}": p[key] * math.exp(rng.uniform(-SPREAD, SPREAD)) for key, i in links}
    size = 0.0 if system["force"] else amplitude
    start = {"displacement": size * rng.uniform(-1, 1, n), "velocity": size * rate * rng.uniform(-1, 1, n)}
    initial = {part: [float(f"{value:.{DIGITS}g}") + 0.0 for value in values] for part, values in start.items()}
    force = system["force"] and {**system["force"], "dof": n - 1}
    return {"kind": "chain", "options": {"n": n}, "parameters": parameters, "initial": initial, "force": force}


def _nonlinear(p: Mapping[str, float], amplitude: float, rng: SecretStream) -> Content:
    """Return the changes for a cubic spring, quadratic damping or a pendulum, about 0.1 to 1 of the linear force."""
    size = math.exp(rng.uniform(math.log(0.1), 0.0))
    kind, name, value = rng.choice((
        ("duffing", "k3", size * p["k"] / amplitude**2),
        ("quadratic_damping", "c2", size * p["m"] / amplitude),
        ("pendulum", "l", amplitude / (1.5 * math.sqrt(size))),
    ))  # fmt: skip
    return {"kind": kind, "parameters": {**p, name: value}}
