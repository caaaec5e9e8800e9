"""Scenarios in files of one's own: YAML of plain values, small, and read to its end before anything is made of it."""

from __future__ import annotations

import os
from typing import Any

import yaml

from bench.config.files import file_names
from bench.errors import InputError
from bench.isolation.failure import one_line

MOST_BYTES, MOST_NODES, DEEPEST = 2**20, 20_000, 20
TOP = 2
"""The event behind the starts of a stream and of a document: what the file is."""
KIND = "a file like those of conf/system is wanted"


def read_own_system(path: str) -> dict[str, Any]:
    """The content of a scenario's file; raises InputError where it is none.

    It may start from scenarios of ``conf/system``, by ``defaults``. Aliases and interpolations are not read: a few
    lines of them stand for gigabytes, or for what the machine's environment holds.
    """
    text = _text(path)
    if "${" in text:
        raise InputError("system", path, "write values, not ${...}")
    try:
        _check_nodes(path, text)
        content = _loaded(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise InputError("system", path, f"it is no plain YAML ({one_line(error)}); {KIND}") from None
    if not isinstance(content, dict) or not content or not all(isinstance(key, str) for key in content):
        raise InputError("system", path, f"it has no fields; {KIND}")
    _check_defaults(path, content.get("defaults", []))
    return content


def _text(path: str) -> str:
    try:
        with open(path, "rb") as file:
            data = file.read(MOST_BYTES + 1)
    except OSError as error:
        raise InputError("system", path, f"it cannot be read: {error.strerror}") from None
    if len(data) > MOST_BYTES:
        raise InputError("system", path, f"{os.path.getsize(path)} bytes; at most {MOST_BYTES}, {KIND}")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        raise InputError("system", path, f"it is no text in UTF-8; {KIND}") from None


def _check_nodes(path: str, text: str) -> None:
    """Raise InputError before anything is made of a file that is nested too deep or has aliases."""
    depth = 0
    for number, event in enumerate(yaml.parse(text, yaml.SafeLoader)):
        if number == TOP and not isinstance(event, yaml.MappingStartEvent):
            raise InputError("system", path, f"it has no fields; {KIND}")
        if isinstance(event, yaml.AliasEvent):
            raise InputError("system", path, f"aliases (*{event.anchor}) are not read; write the values out")
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > DEEPEST or number > MOST_NODES:
            raise InputError("system", path, f"it is too long or nested too deep; {KIND}")


def _loaded(text: str) -> Any:
    """The content as Hydra reads it; a key that stands twice raises yaml.YAMLError."""
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    try:
        return OmegaConf.to_container(OmegaConf.create(text))
    except OmegaConfBaseException as error:
        raise ValueError(str(error)) from None


def _check_defaults(path: str, defaults: Any) -> None:
    known = file_names("system")
    names = defaults if isinstance(defaults, list) else [defaults]
    for name in names:
        if name != "_self_" and (not isinstance(name, str) or name not in known):
            raise InputError("system", path, f"defaults has {name}; it may name scenarios: {', '.join(sorted(known))}")
    if not isinstance(defaults, list):
        raise InputError("system", path, f"defaults is a list: [{defaults}]")
