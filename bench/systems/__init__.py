"""Vibrating systems, by the name that a configuration gives them; each is one residual (see ``contract``).

A system is registered by an entry point in the group ``bench.systems``, ours as anybody's; its module is imported when
it is first asked for, so that a cell is computed by the code of its own system alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint
from typing import Any

from bench.entry_points import entry_points_of, load_entry_point
from bench.errors import InputError
from bench.systems.added_mass import LoadedSystem
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

GROUP = "bench.systems"
OURS = {
    "linear": ("SDOF", "Chain", "Matrices", "RayleighChain"),
    "nonlinear": ("BoucWen", "Coulomb", "Duffing", "Pendulum", "QuadraticDamping", "VanDerPol"),
}
"""Classes that can be imported from here, by their module."""

__all__ = [
    "DAMPING",
    "FORCE",
    "LENGTH",
    "MASS",
    "MEASURED",
    "STIFFNESS",
    "Array",
    "Components",
    "Dimension",
    "Kind",
    "LoadedSystem",
    "Ops",
    "Parameter",
    "Quantity",
    "System",
    "load_system",
    "make_system",
    "registered_systems",
]


def __getattr__(name: str) -> Any:
    """Our own systems' classes, from their modules, when they are asked for."""
    for module, classes in OURS.items():
        if name in classes:
            return getattr(import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__} has no attribute {name}")


def registered_systems() -> dict[str, EntryPoint]:
    """Return the entry points by the name of the system; nothing is imported."""
    return entry_points_of(GROUP)


@cache
def load_system(name: str) -> type[System]:
    """Return the class of a system; raises InputError for an unknown name or an entry point that does not load."""
    cls: type[System] = load_entry_point("system", name, registered_systems(), System)
    return cls


def make_system(name: str, options: Mapping[str, Any]) -> System:
    """The system called ``name`` with its structural options (the number of masses, say)."""
    try:
        return load_system(name)(**options)
    except TypeError as error:
        raise InputError("system.options", dict(options), str(error)) from None
