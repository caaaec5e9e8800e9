"""Whether a sparse regression found the terms of the equation of motion, no more and no fewer."""

from __future__ import annotations

import re
from collections import Counter
from functools import cache

from bench.contract.estimate import Status
from bench.dynamics.mechanics import acceleration
from bench.dynamics.ops import sympy_ops
from bench.scenario.scenario import Scenario
from bench.store.stored import StoredCell
from bench.systems import System


@cache
def true_terms(system: System, forced: frozenset[int]) -> tuple[frozenset[str], ...] | None:
    """By DOF, the monomials of displacement (x), velocity (v) and force (f) in the acceleration, e.g. ``{x, v, x^3}``.

    With several DOFs they are numbered from 1. ``forced``: the DOFs a force acts on. None where the acceleration is no
    polynomial: then no library of monomials holds it.
    """
    import sympy

    if system.n_hidden:
        return None
    numbers = [""] if system.n_dof == 1 else [str(i + 1) for i in range(system.n_dof)]
    x, v, f = ([sympy.Symbol(f"{name}{i}", real=True) for i in numbers] for name in "xvf")
    # parameters as different primes: exact, fast, and no term of theirs is nil by accident
    p = {name: sympy.Integer(sympy.prime(10 + i)) for i, name in enumerate(system.names)}
    pushed = [symbol if i in forced else sympy.Integer(0) for i, symbol in enumerate(f)]
    try:
        accelerations = [
            sympy.Poly(sympy.expand(a), *x, *v, *f) for a in acceleration(system, p, x, v, pushed, [], sympy_ops())
        ]
    except sympy.PolynomialError:
        return None
    states = [str(symbol) for symbol in (*x, *v, *f)]
    return tuple(frozenset(_name(powers, states) for powers in polynomial.monoms()) for polynomial in accelerations)


def _name(powers: tuple[int, ...], states: list[str]) -> str:
    return " ".join(f"{s}^{k}" if k > 1 else s for s, k in zip(states, powers, strict=True) if k) or "1"


def kept_terms(message: str) -> tuple[frozenset[str], ...] | None:
    """By DOF, the terms that a method's sentence names after ``terms kept of N:``; None where it says nothing."""
    match = re.search(r"terms kept of \d+: (.*)", message)
    if not match:
        return None
    parts = [re.sub(r" \(DOF \d+\)$", "", part.strip()) for part in match.group(1).split(";")]
    return tuple(frozenset() if part == "none" else frozenset(t.strip() for t in part.split(",")) for part in parts)


def terms_found(stored: StoredCell, scenario: Scenario) -> str:
    """In words: in how many replicates the right terms were found, and what is found most often instead."""
    replicates = zip(stored.columns.statuses, stored.columns.plain("message"), strict=True)
    kept = [kept_terms(message) for status, message in replicates if status is Status.OK]
    models = [model for model in kept if model is not None]
    if not models:
        return "no terms stated"
    forced = frozenset({scenario.force.dof}) if scenario.force else frozenset()
    wanted = true_terms(scenario.make_system(), forced)
    usual, times = Counter(models).most_common(1)[0]
    often = f"most often {_told(usual)} ({times} of {len(models)})"
    if wanted is None:
        return f"its library does not hold the equation of motion; {often}"
    right = sum(model == wanted for model in models)
    held = sum(all(w <= m for w, m in zip(wanted, model, strict=True)) for model in models)
    return f"exactly the right terms in {right} of {len(models)}, these and more in {held - right}" + (
        "" if usual == wanted else f"; {often}"
    )


def _told(model: tuple[frozenset[str], ...]) -> str:
    return "; ".join(", ".join(sorted(terms, key=lambda t: (t.count(" "), t))) or "none" for terms in model)
