"""Systems of one degree of freedom that are sums of force terms, such as viscous damping, a spring and dry friction.

The terms are those of :mod:`bench.systems.nonlinear`. Measured systems often need several of them.
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
"""Groups of all terms; a sum has those whose parameters are all among its free parameters."""


@dataclass(frozen=True)
class Term:
    """A restoring or resisting force: its parameters, the first of them its size, and ``force(sum, p, x, v, ops)``."""

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
"""Terms by name, in the order of their parameters."""

EXCLUSIVE = (("spring", "pendulum"), ("cubic", "softening"))
"""Pairs of terms that exclude each other: they share a parameter, or differ only in its sign."""


@dataclass(frozen=True)
class Sum(System):
    """One degree of freedom, ``m x'' + (sum of the terms) = f(t)``.

    - ``viscous``: ``c x'``, and ``spring``: ``k x`` (Inman, Engineering Vibration, section 1.3);
    - ``pendulum``: ``k l sin(x/l)``, in place of the spring, as in :class:`bench.systems.nonlinear.Pendulum`;
    - ``cubic``: ``k3 x³``, Duffing's hardening spring, and ``softening``: ``-k3s x³`` (Nayfeh and Mook, Nonlinear
      Oscillations, chapter 4), which is no longer restoring beyond ``x² = k / k3s``;
    - ``quadratic``: ``c2 |x'| x'``, fluid drag (ibid., section 3.3);
    - ``coulomb``: ``mu tanh(x'/v_s)``, dry friction, as in :class:`bench.systems.nonlinear.Coulomb`, with
      ``smoothing_velocity`` for v_s (m/s);
    - ``bias``: ``bias_sign b``, a constant force, as from a drive's amplifier (A. Janot, M. Gautier, M. Brunot,
      "Data set and reference models of EMPS", Nonlinear System Identification Benchmarks workshop, 2019). Parameters
      are positive, so the sign is an option. With a spring it shifts the equilibrium, as an unknown offset does.

    ``fixed`` gives known parameters with their values in SI units; they are constants of the residual and are not
    estimated. A term whose size is 0 is dropped. In free vibration only a length can be fixed, since a known force or
    stiffness would determine the mass, to which all groups are ratios (``needs_scale``).
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
        present = tuple(term for term in terms if fixed.get(TERMS[term].parameters[0].name) != 0.0)
        if not present:
            raise InputError("system.options.terms", ", ".join(terms) or "none", f"name at least one of {_known()}")
        used = {p.name for term in present for p in TERMS[term].parameters}
        # equivalent sums get the same fields, so that they compare equal and share a hash
        object.__setattr__(self, "terms", present)
        object.__setattr__(self, "fixed", tuple(sorted((n, v) for n, v in fixed.items() if n in used)))
        object.__setattr__(self, "linear", all(TERMS[term].linear for term in present))
        object.__setattr__(self, "smooth", all(TERMS[term].smooth for term in present))
        object.__setattr__(self, "affine_in_parameters", "l" not in self.names)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        fixed = dict(self.fixed)
        return (M, *(p for term in self.terms for p in TERMS[term].parameters if p.name not in fixed))

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
        if "coulomb" not in self.terms:  # an unused smoothing velocity stays, so that the sum remains equal to itself
            return replace(self, fixed=fixed) if fixed else self
        return replace(self, fixed=fixed, smoothing_velocity=self.smoothing_velocity / scale(MEASURED["velocity"]))

    @property
    def groups(self) -> tuple[Quantity, ...]:
        return self._estimated(GROUPS)

    @property
    def modal(self) -> tuple[Quantity, ...]:
        """Natural frequency and damping ratio of the linear terms, where their parameters are free."""
        return self._estimated(SDOF().modal)

    @property
    def needs_scale(self) -> bool:
        """True if the dimension of a fixed value contains mass, so that a known force or a prior is required."""
        fixed = dict(self.fixed)
        return any(p.name in fixed and p.dimension.mass for term in self.terms for p in TERMS[term].parameters)

    @property
    def offset_identifiable(self) -> bool:
        """True if a sensor's unknown offset is identifiable: there is a restoring force, and no bias."""
        restoring = {"spring", "pendulum", "cubic", "softening"} & set(self.terms)
        return bool(restoring) and "bias" not in self.terms

    def _estimated(self, quantities: Sequence[Quantity]) -> tuple[Quantity, ...]:
        """Return the quantities of free parameters only."""
        return tuple(q for q in quantities if set(q.exponents) <= set(self.names))


def _known() -> str:
    return ", ".join(TERMS)


def _terms(given: Sequence[str]) -> list[str]:
    """Return the terms in the order of TERMS. Raises InputError for unknown, repeated and incompatible terms."""
    field, names = "system.options.terms", [given] if isinstance(given, str) else list(given)
    for name in names:
        if name not in TERMS:
            raise InputError(field, name, f"known terms: {_known()}")
        if names.count(name) > 1:
            raise InputError(field, name, "the term is repeated; name each term once")
    for pair in EXCLUSIVE:
        if set(pair) <= set(names):
            raise InputError(field, ", ".join(pair), "these terms exclude each other; remove one")
    return [term for term in TERMS if term in names]


def _fixed(given: Mapping[str, float] | Sequence[tuple[str, float]]) -> dict[str, float]:
    """Return the fixed values by name. Raises InputError unless names are unique and values are numbers."""
    field = "system.options.fixed"
    try:
        pairs = [(str(n), float(v)) for n, v in (given.items() if isinstance(given, Mapping) else given)]
    except (TypeError, ValueError):
        raise InputError(field, given, "write names and values, as {l: 1.0}") from None
    if len(dict(pairs)) < len(pairs):
        raise InputError(field, ", ".join(n for n, _ in pairs), "a name is repeated; give each parameter one value")
    return dict(pairs)


def _check_fixed(terms: Sequence[str], fixed: Mapping[str, float]) -> None:
    """Raise InputError for a parameter that no term has, or an invalid value."""
    free = [p.name for term in terms for p in TERMS[term].parameters]
    for name, value in fixed.items():
        field = f"system.options.fixed.{name}"
        if name == M.name:
            raise InputError(field, value, "the mass cannot be fixed, since groups are ratios to it; fix another one")
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
"""Systems that are abbreviations of their terms."""
FIRST: dict[str, tuple[str, ...]] = {"coulomb": ("viscous", "spring", "coulomb")}
"""Names that denote a system in the first place and a term elsewhere."""


def sum_from(text: str, **options: Any) -> Sum:
    """Parse a sum written as names of terms or systems, as ``sdof+coulomb+quadratic``.

    ``coulomb`` in the first place is the system (with spring and viscous damping), elsewhere the friction term; a
    driven axis is ``viscous+coulomb``.

    Args:
        text: Names joined by ``+``.
        **options: Other fields of :class:`Sum`.

    Returns:
        The sum.

    Raises:
        InputError: If a name is unknown or repeated, or an option is invalid.
    """
    words = [word.strip().lower() for word in text.split("+")]
    included: set[str] = set()
    for i, word in enumerate(words):
        terms = FIRST.get(word) if i == 0 else None
        terms = terms or SYSTEMS.get(word) or ((word,) if word in TERMS else None)
        if terms is None:
            known = ", ".join(dict.fromkeys([*SYSTEMS, *TERMS]))
            raise InputError("system", text, f"{word or 'an empty word'} is unknown; join by + some of: {known}")
        if word in words[:i]:
            raise InputError("system", text, f"{word} is repeated; name each term once")
        included.update(terms)
    try:
        return Sum(tuple(term for term in TERMS if term in included), **options)
    except TypeError as error:
        raise InputError("system.options", options, str(error)) from None
