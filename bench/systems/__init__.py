"""Vibrating systems, by the name that a configuration gives them; each is one residual (see ``contract``)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bench.errors import InputError
from bench.systems.contract import (
    DAMPING,
    FORCE,
    LENGTH,
    MASS,
    MEASURED,
    STIFFNESS,
    Array,
    Components,
    Dimension,
    Kind,
    Ops,
    Parameter,
    Quantity,
    System,
)
from bench.systems.linear import SDOF, Chain, Matrices, RayleighChain
from bench.systems.loaded import Loaded
from bench.systems.nonlinear import BoucWen, Coulomb, Duffing, Pendulum, QuadraticDamping, VanDerPol

__all__ = [
    "DAMPING",
    "FORCE",
    "LENGTH",
    "MASS",
    "MEASURED",
    "SDOF",
    "STIFFNESS",
    "SYSTEMS",
    "Array",
    "BoucWen",
    "Chain",
    "Components",
    "Coulomb",
    "Dimension",
    "Duffing",
    "Kind",
    "Loaded",
    "Matrices",
    "Ops",
    "Parameter",
    "Pendulum",
    "QuadraticDamping",
    "Quantity",
    "RayleighChain",
    "System",
    "VanDerPol",
    "make_system",
]

SYSTEMS: dict[str, type[System]] = {
    cls.name: cls
    for cls in (SDOF, Chain, RayleighChain, Matrices, Duffing, QuadraticDamping, Coulomb, VanDerPol, Pendulum, BoucWen)
}
"""Systems by the name that a configuration gives them."""


def make_system(name: str, options: Mapping[str, Any]) -> System:
    """The system called ``name`` with its structural options (the number of masses, say)."""
    if name not in SYSTEMS:
        raise InputError("system", name, f"known systems: {', '.join(sorted(SYSTEMS))}")
    try:
        return SYSTEMS[name](**options)
    except TypeError as error:
        raise InputError("system.options", dict(options), str(error)) from None
