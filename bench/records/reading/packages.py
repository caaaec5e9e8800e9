"""Packages that only some kinds of file need."""

from __future__ import annotations

import importlib
from typing import Any

from bench.errors import InputError


def optional(name: str, source: object) -> Any:
    """A package by name; raises InputError that says how to install it where it is missing."""
    try:
        return importlib.import_module(name)
    except ImportError:
        remedy = f'this kind of file needs the package {name}: pip install "vibration-bench[files]"'
        raise InputError("data", source, remedy) from None
