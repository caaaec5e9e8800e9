"""The registered modal methods: entry points of the group ``bench.modal``."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from importlib.metadata import EntryPoint
from typing import Any

from bench.contract.modal import ModalIdentifier
from bench.entrants.registry import load_dataclass, make
from bench.entry_points import entry_points_of

GROUP = "bench.modal"


def registered_modal() -> dict[str, EntryPoint]:
    """Return the entry points of modal methods by name; nothing is imported."""
    return entry_points_of(GROUP)


def load_modal(name: str) -> type[ModalIdentifier]:
    """Return the class of a modal method; raises InputError for a name that is not registered."""
    cls: type[ModalIdentifier] = load_dataclass(registered_modal(), name, ModalIdentifier, list(registered_modal()))
    return cls


def make_modal(name: str, settings: Mapping[str, Any] | None = None) -> ModalIdentifier:
    """Return a modal method with validated settings; raises InputError that names the setting."""
    cls = load_modal(name)
    return make(cls, name, dict(settings or {}), [field.name for field in dataclasses.fields(cls)])  # type: ignore[arg-type]
