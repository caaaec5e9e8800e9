"""A system put together from terms: inertia, and of the usual forces of one degree of freedom whichever are named.

The laws are those of :mod:`bench.systems.nonlinear`, so that one residual can have several of them at once: what a
record of a real thing calls for is seldom one textbook system.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

from bench.errors import InputError
from bench.systems.contract import FORCE, LENGTH, MEASURED, Array, Dimension, Ops, Parameter, Quantity, System
from bench.systems.linear import SDOF

M, C, K = SDOF().parameters
K3 = Parameter("k3", "N/m³", "stiffness", Dimension(1, -2, -2))
K3S = Parameter("k3s", "N/m³", "stiffness", Dimension(1, -2, -2))
C2 = Parameter("c2", "N·s²/m²", "damping", Dimension(1, -1, 0))
MU = Parameter("mu", "N", "damping", FORCE)
L = Parameter("l", "m", "other", LENGTH)
B = Parameter("b", "N", "other", FORCE)

GROUPS = (
    *SDOF().groups,
    Quantity("k3_over_m", "1/(m²·s²)", {"k3": 1.0, "m": -1.0}),
    Quantity("k3s_over_m", "1/(m²·s²)", {"k3s": 1.0, "m": -1.0}),
    Quantity("c2_over_m", "1/m", {"c2": 1.0, "m": -1.0}),
    Quantity("mu_over_m", "m/s²", {"mu": 1.0, "m": -1.0}),
    Quantity("l", "m", {"l": 1.0}),
    Quantity("b_over_m", "m/s²", {"b": 1.0, "m": -1.0}),
)
"""The groups of all terms; a sum has those whose parameters are all its own and free."""


@dataclass(frozen=True)
class Term:
    """A force against the motion: its parameters, the first of them its size, and ``force(sum, p, x, v, ops)``."""

    parameters: tuple[Parameter, ...]
    force: Callable[[Sum, Mapping[str, Array], Array, Array, Ops], Array]
    linear: bool = False
    smooth: bool = True


TERMS = {
    "viscous": Term((C,), lambda s, p, x, v, ops: p["c"] * v, linear=True),
    "spring": Term((K,), lambda s, p, x, v, ops: p["k"] * x, linear=True),
    "pendulum": Term((K, L), lambda s, p, x, v, ops: p["k"] * p["l"] * ops.sin(x / p["l"])),
    "cubic": Term((K3,), lambda s, p, x, v, ops: p["k3"] * x * x * x),
    "softening": Term((K3S,), lambda s, p, x, v, ops: -p["k3s"] * x * x * x),
    "quadratic": Term((C2,), lambda s, p, x, v, ops: p["c2"] * ops.abs(v) * v, smooth=False),
    "coulomb": Term((MU,), lambda s, p, x, v, ops: p["mu"] * ops.tanh(v / s.smoothing_velocity), smooth=False),
    "bias": Term((B,), lambda s, p, x, v, ops: s.bias_sign * p["b"]),
}
"""The terms by name, in the order in which their parameters stand."""

RIVALS = (("spring", "pendulum"), ("cubic", "softening"))
"""Pairs of which a sum has one at most: they share a parameter, or differ in its sign."""


@dataclass(frozen=True)
class Sum(System):
    """One degree of freedom, ``m x'' + (the sum of the named terms) = f(t)``.

    - ``viscous``: ``c x'``, and ``spring``: ``k x`` (Inman, Engineering Vibration, section 1.3);
    - ``pendulum``: ``k l sin(x/l)``, in place of the spring, as in :class:`bench.systems.nonlinear.Pendulum`;
    - ``cubic``: ``k3 x³``, Duffing's hardening spring, and ``softening``: ``-k3s x³`` (Nayfeh and Mook, Nonlinear
      Oscillations, chapter 4), which beyond ``x² = k / k3s`` no longer pulls back;
    - ``quadratic``: ``c2 |x'| x'``, the drag of a fluid (the same, section 3.3);
    - ``coulomb``: ``mu tanh(x'/v_s)``, dry friction, as in :class:`bench.systems.nonlinear.Coulomb`, with
      ``smoothing_velocity`` for v_s (m/s);
    - ``bias``: ``bias_sign b``, a constant force, as that of a drive's amplifier (A. Janot, M. Gautier, M. Brunot,
      "Data set and reference models of EMPS", Nonlinear System Identification Benchmarks workshop, 2019). A parameter
      is positive, so the sign is an option; beside a spring it moves the rest, which an unknown offset does too.

    ``fixed`` names parameters that are told, with their values in SI units: they are numbers in the residual, and no
    parameters any more. A term whose size is told to be 0 is left out. In free vibration only a length can be told
    so: a force or stiffness would tell the mass, which is held there (``needs_scale``).
    """

    terms: tuple[str, ...]
    smoothing_velocity: float = 0.01
    fixed: tuple[tuple[str, float], ...] = ()
    bias_sign: int = 1
    name: ClassVar[str] = "sum"

    def __post_init__(self) -> None:
        terms, fixed = _terms(self.terms), _fixed(self.fixed)
        _check_fixed(terms, fixed)
        if not 0 < self.smoothing_velocity < float("inf"):
            raise InputError("system.options.smoothing_velocity", self.smoothing_velocity, "a positive velocity (m/s)")
        if self.bias_sign not in (-1, 1):
            raise InputError("system.options.bias_sign", self.bias_sign, "1 or -1: b itself is positive")
        left = tuple(term for term in terms if fixed.get(TERMS[term].parameters[0].name) != 0.0)
        if not left:
            raise InputError("system.options.terms", ", ".join(terms) or "none", f"name at least one of {_known()}")
        used = {p.name for term in left for p in TERMS[term].parameters}
        # one form for all that means the same, so that equal sums are equal and have one hash
        object.__setattr__(self, "terms", left)
        object.__setattr__(self, "fixed", tuple(sorted((n, v) for n, v in fixed.items() if n in used)))
        object.__setattr__(self, "linear", all(TERMS[term].linear for term in left))
        object.__setattr__(self, "smooth", all(TERMS[term].smooth for term in left))
        object.__setattr__(self, "affine_in_parameters", "l" not in self.names)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        told = dict(self.fixed)
        own = [p for term in self.terms for p in TERMS[term].parameters]
        return (M, *(p for p in own if p.name not in told))

    def residual(self, p, x, v, a, f, z, ops):  # type: ignore[no-untyped-def]
        if self.fixed:
            p = {**p, **dict(self.fixed)}
        total = p["m"] * a[0] - f[0]
        for term in self.terms:
            total = total + TERMS[term].force(self, p, x[0], v[0], ops)
        return [total]

    def rescaled(self, scale: Callable[[Dimension], float]) -> Self:
        by_name = {p.name: scale(p.dimension) for term in self.terms for p in TERMS[term].parameters}
        fixed = tuple((name, value / by_name[name]) for name, value in self.fixed)
        if "coulomb" not in self.terms:  # a velocity that plays no part stays, and the sum equal to itself
            return replace(self, fixed=fixed) if fixed else self
        return replace(self, fixed=fixed, smoothing_velocity=self.smoothing_velocity / scale(MEASURED["velocity"]))

    @property
    def groups(self) -> tuple[Quantity, ...]:
        return self._own(GROUPS)

    @property
    def modal(self) -> tuple[Quantity, ...]:
        """Natural frequency and damping ratio as by the linear terms alone, where their parameters are free."""
        return self._own(SDOF().modal)

    @property
    def needs_scale(self) -> bool:
        """Whether a told value has kilograms in it, so that the record must have a known force, or a prior be given."""
        told = dict(self.fixed)
        return any(p.name in told and p.dimension.mass for term in self.terms for p in TERMS[term].parameters)

    @property
    def tells_offset(self) -> bool:
        """Whether a sensor's unknown offset can be told from the motion: something pulls back to zero, and no bias."""
        pulls = {"spring", "pendulum", "cubic", "softening"} & set(self.terms)
        return bool(pulls) and "bias" not in self.terms

    def _own(self, quantities: Sequence[Quantity]) -> tuple[Quantity, ...]:
        return tuple(q for q in quantities if set(q.exponents) <= set(self.names))


def _known() -> str:
    return ", ".join(TERMS)


def _terms(given: Sequence[str]) -> list[str]:
    """The terms in their order; raises InputError for unknown ones, and for those that cannot be together."""
    field, names = "system.options.terms", [given] if isinstance(given, str) else list(given)
    for name in names:
        if name not in TERMS:
            raise InputError(field, name, f"known terms: {_known()}")
        if names.count(name) > 1:
            raise InputError(field, name, "it is there twice; name each term once")
    for one, other in RIVALS:
        if one in names and other in names:
            raise InputError(field, f"{one}, {other}", "a sum has one of the two; leave the other out")
    return [term for term in TERMS if term in names]


def _fixed(given: Mapping[str, float] | Sequence[tuple[str, float]]) -> dict[str, float]:
    """The told values by name; raises InputError for what is no list of a name and a number, or has a name twice."""
    field = "system.options.fixed"
    try:
        pairs = [(str(n), float(v)) for n, v in (given.items() if isinstance(given, Mapping) else given)]
    except (TypeError, ValueError):
        raise InputError(field, given, "write names with their values, as {l: 1.0}") from None
    if len(dict(pairs)) < len(pairs):
        raise InputError(field, ", ".join(n for n, _ in pairs), "a name is there twice; give each one value")
    return dict(pairs)


def _check_fixed(terms: Sequence[str], fixed: Mapping[str, float]) -> None:
    """Raise InputError for a name that no term has, or a value that it cannot have."""
    free = [p.name for term in terms for p in TERMS[term].parameters]
    for name, value in fixed.items():
        field = f"system.options.fixed.{name}"
        if name == M.name:
            raise InputError(field, value, "the mass stays free: the groups are ratios to it; tell another parameter")
        if name not in free:
            raise InputError(field, value, f"parameters of these terms: {', '.join(free) or 'none'}")
        if not 0 <= value < float("inf") or (name == L.name and value == 0):
            least = "positive" if name == L.name else "0 or more (0 leaves the term out)"
            raise InputError(field, value, f"a finite number, {least}")


SYSTEMS: dict[str, tuple[str, ...]] = {
    "sdof": ("viscous", "spring"),
    "duffing": ("viscous", "spring", "cubic"),
    "quadratic_damping": ("viscous", "spring", "quadratic"),
    "pendulum": ("viscous", "pendulum"),
}
"""Names of systems that stand for their terms, wherever they are."""
FIRST: dict[str, tuple[str, ...]] = {"coulomb": ("viscous", "spring", "coulomb")}
"""Words that name a system where they come first, and a term elsewhere."""


def sum_from(text: str, **options: Any) -> Sum:
    """The sum that a user writes, as ``sdof+coulomb+quadratic``: names of terms, or of systems that stand for theirs.

    ``coulomb`` is our system of that name, spring and all, where it comes first, and friction alone elsewhere; so a
    driven axis is ``viscous+coulomb``. ``options`` are those of :class:`Sum`. Raises InputError.
    """
    words = [word.strip().lower() for word in text.split("+")]
    found: set[str] = set()
    for i, word in enumerate(words):
        own = FIRST.get(word) if i == 0 else None
        own = own or SYSTEMS.get(word) or ((word,) if word in TERMS else None)
        if own is None:
            known = ", ".join(dict.fromkeys([*SYSTEMS, *TERMS]))
            raise InputError("system", text, f"{word or 'an empty word'} is unknown; join by + some of: {known}")
        if word in words[:i]:
            raise InputError("system", text, f"{word} is there twice; name each once")
        found.update(own)
    try:
        return Sum(tuple(term for term in TERMS if term in found), **options)
    except TypeError as error:
        raise InputError("system.options", options, str(error)) from None
