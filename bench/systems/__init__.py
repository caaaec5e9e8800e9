"""Vibrating systems by their names in the configuration (see :mod:`bench.systems.contract`).

Every system, built in or from another package, is registered by an entry point in the group ``bench.systems``. Its
module is imported on first use.
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
BUILT_IN = {
    "linear": ("SDOF", "Chain", "Matrices", "RayleighChain"),
    "nonlinear": ("BoucWen", "Coulomb", "Duffing", "Pendulum", "QuadraticDamping", "VanDerPol"),
}
"""Classes that can be imported from this package, by module."""

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
    """Import the class of a built-in system on first access."""
    for module, classes in BUILT_IN.items():
        if name in classes:
            return getattr(import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__} has no attribute {name}")


def registered_systems() -> dict[str, EntryPoint]:
    """Return the entry points by name of the system, without importing anything."""
    return entry_points_of(GROUP)


@cache
def load_system(name: str) -> type[System]:
    """Return the class of a system. Raises InputError if the name is unknown or its entry point does not load."""
    cls: type[System] = load_entry_point("system", name, registered_systems(), System)
    return cls


def make_system(name: str, options: Mapping[str, Any]) -> System:
    """Create a system.

    Args:
        name: Registered name.
        options: Structural options of the system, as the number of masses.

    Returns:
        The system.

    Raises:
        InputError: If the name is unknown, or the options do not fit the system.
    """
    try:
        return load_system(name)(**options)
    except TypeError as error:
        raise InputError("system.options", dict(options), str(error)) from None
