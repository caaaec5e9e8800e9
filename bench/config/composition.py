"""Composition of a choice of a configuration group: the choices that it builds on, and the fields changed below it.

Hydra composes the same for ``--cfg``; a sweep would wait for it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bench.config.choices import content, name_for_hydra
from bench.config.overrides import DELETED
from bench.errors import InputError

_COMPOSED: dict[tuple[str, str, str], dict[str, Any]] = {}


def content_of(group: str, choice: Any, below: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return the content of a choice as plain values, which are cached and shared: do not change them.

    Args:
        group: Group of the configuration.
        choice: Name in the group, or the path of a scenario file of the user.
        below: Values of fields below the group.

    Raises:
        InputError: The file is not a scenario, or a field cannot be changed.
    """
    name = name_for_hydra(group, choice)
    key = group, name, repr(below)
    if key not in _COMPOSED:
        stated = _with_defaults(group, name)
        _COMPOSED[key] = _changed(stated, group, choice, below) if below else stated
    return _COMPOSED[key]


def _with_defaults(group: str, name: str) -> dict[str, Any]:
    """Return the content of a choice, merged over that of the choices in its ``defaults``."""
    stated = content(group, name)
    if "defaults" not in stated:
        return stated
    from omegaconf import OmegaConf

    order = stated.pop("defaults")
    order = order if "_self_" in order else [*order, "_self_"]
    merged = OmegaConf.merge(*(stated if part == "_self_" else _with_defaults(group, part) for part in order))
    return OmegaConf.to_container(merged)  # type: ignore[return-value]


def _changed(stated: dict[str, Any], group: str, choice: Any, below: Mapping[str, Any]) -> dict[str, Any]:
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    config = OmegaConf.create(stated)
    for field, value in below.items():
        path, _, last = field.rpartition(".")
        try:
            if value is DELETED:
                del (OmegaConf.select(config, path) if path else config)[last]
            else:
                OmegaConf.update(config, field, value, force_add=True)
        except (OmegaConfBaseException, KeyError, TypeError):
            shown, where = ("", "~") if value is DELETED else (value, "")
            raise InputError(f"{where}{group}.{field}", shown, f"{choice} has no such field") from None
    return OmegaConf.to_container(config)  # type: ignore[return-value]
