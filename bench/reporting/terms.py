"""Compare the terms that sparse regressions select with those of the equation of motion."""

from __future__ import annotations

import re
from collections import Counter
from functools import cache

from bench.contract.estimate import Status
from bench.dynamics.mechanics import acceleration
from bench.dynamics.ops import sympy_ops
from bench.scenario.scenario import Scenario
from bench.store.stored_cell import StoredCell
from bench.systems import System


@cache
def true_terms(system: System, forced: frozenset[int]) -> tuple[frozenset[str], ...] | None:
    """Return the monomials of displacement (x), velocity (v) and force (f) in each acceleration, e.g. ``{x, v, x^3}``.

    With several DOFs the symbols are numbered from 1.

    Args:
        system: The system.
        forced: DOFs with a force.

    Returns:
        The monomials by DOF, or None if the acceleration is not a polynomial.
    """
    import sympy

    if system.n_hidden:
        return None
    numbers = [""] if system.n_dof == 1 else [str(i + 1) for i in range(system.n_dof)]
    x, v, f = ([sympy.Symbol(f"{name}{i}", real=True) for i in numbers] for name in "xvf")
    # Different primes for the parameters keep the arithmetic exact, and no coefficient vanishes by accident.
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
    """Return the terms by DOF that a method's message lists after ``terms kept of N:``; None without such a list."""
    match = re.search(r"terms kept of \d+: (.*)", message)
    if not match:
        return None
    listed = match.group(1)  # a condition may follow the terms
    parts = re.findall(r"([^;]+) \(DOF \d+\)", listed) or [listed.split(";")[0]]
    terms_by_dof = [frozenset(term.strip() for term in part.split(",")) for part in parts]
    return tuple(terms - {"none"} for terms in terms_by_dof)


def terms_found(stored: StoredCell, scenario: Scenario) -> str:
    """Describe in how many replicates the selected terms were right, and the most frequent selection."""
    replicates = zip(stored.columns.statuses, stored.columns.plain("message"), strict=True)
    kept = [kept_terms(message) for status, message in replicates if status is Status.OK]
    models = [model for model in kept if model is not None]
    if not models:
        return "no terms stated"
    forced = frozenset({scenario.force.dof}) if scenario.force else frozenset()
    true = true_terms(scenario.make_system(), forced)
    usual, times = Counter(models).most_common(1)[0]
    most_frequent = f"most often {_listed(usual)} ({times} of {len(models)})"
    if true is None:
        return f"its library does not contain the equation of motion; {most_frequent}"
    right = sum(model == true for model in models)
    complete = sum(all(w <= m for w, m in zip(true, model, strict=True)) for model in models)
    return f"exactly the right terms in {right} of {len(models)}, these and more in {complete - right}" + (
        "" if usual == true else f"; {most_frequent}"
    )


def _listed(model: tuple[frozenset[str], ...]) -> str:
    return "; ".join(", ".join(sorted(terms, key=lambda t: (t.count(" "), t))) or "none" for terms in model)
