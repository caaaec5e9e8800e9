"""The configuration of some choices: files of ``conf`` or of one's own, the settings of methods, fields in them.

Hydra composes it. Whole files that only name those they start from are merged as Hydra would, without loading it: that
takes milliseconds instead of a tenth of a second each, and an experiment has dozens.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import fields
from functools import cache
from typing import Any

from bench.config.choices import choices, own_file
from bench.config.drawn import drawn_scenario
from bench.config.files import FOLDERS, file_names, file_text, read_yaml
from bench.config.own_file import read_own_system
from bench.entrants.reference import REFERENCES
from bench.entrants.registry import default_settings, registered
from bench.errors import InputError
from bench.scenario import scenario as declared
from bench.scenario.force import ForceSpec

PLAIN = re.compile(r"[A-Za-z_][\w./-]*")
"""Texts that need no quotes in Hydra's grammar, unless they are one of the words that it takes for something else."""
TOLD = ("nominal.", "fixed.")
"""What fields begin with that no file has: they are of the user's own system."""
NO_NAMES = ("null", "true", "false", "nan", "inf")
COMPOSED = ("method", "system", "prior", "disturbance")
"""Groups whose files Hydra composes."""


def composed(chosen: Mapping[str, Any]) -> dict[str, Any]:
    """The configuration of some choices of groups and of fields in them, as plain values.

    Each group is composed by itself, since none refers to another: a sum of compositions instead of a product. Raises
    InputError.
    """
    literals = {key: _literal(value) for key, value in chosen.items()}
    if own_file("system", chosen.get("system")):
        literals["system"] = _register_file(os.path.expanduser(chosen["system"]))
    rest = tuple((key, text) for key, text in literals.items() if key.split(".")[0] not in COMPOSED)
    content: dict[str, Any] = json.loads(_composed("", rest))
    for group in COMPOSED:
        own = tuple((key, text) for key, text in literals.items() if key.split(".")[0] == group)
        if own or isinstance(content[group], str):
            content[group] = json.loads(_composed(group, own or ((group, content[group]),)))
    return content


def _defaults() -> dict[str, str]:
    """The choice of every group that ``conf/config.yaml`` makes."""
    named = [entry for entry in read_yaml("", "config")["defaults"] if isinstance(entry, dict)]
    return {group: name for entry in named for group, name in entry.items()}


def _literal(value: Any) -> str:
    """A value as Hydra's grammar has it."""
    if isinstance(value, list | tuple):
        return f"[{','.join(map(_literal, value))}]"
    if isinstance(value, Mapping):
        return f"{{{','.join(f'{_literal(key)}:{_literal(item)}' for key, item in value.items())}}}"
    if value is None or isinstance(value, bool):
        return json.dumps(value)
    if not isinstance(value, str) or (PLAIN.fullmatch(value) and value.lower() not in NO_NAMES):
        return str(value)
    return "'" + re.sub(r"(\\*)('|$)", lambda found: 2 * found[1] + found[2].replace("'", "\\'"), value) + "'"


_OWN_FILES: dict[str, str] = {}
"""The file of one's own behind each name that Hydra has been given."""


def _register_file(path: str) -> str:
    """Give Hydra a scenario from a file of one's own, which may start from one of ``conf/system``; its name there."""
    from hydra.core.config_store import ConfigStore

    content = read_own_system(path)
    name = f"file_{hashlib.sha256(json.dumps(content, default=str).encode()).hexdigest()[:16]}"
    ConfigStore.instance().store(group="system", name=name, node=content)
    _OWN_FILES[name] = path
    return name


def _register_system(name: str) -> None:
    """Give Hydra a scenario that is drawn, or of a folder in which it does not look."""
    from hydra.core.config_store import ConfigStore

    drawn = drawn_scenario(name)
    if drawn:
        ConfigStore.instance().store(group="system", name=name, node=dict(drawn.system))
    elif file_names("system").get(name) in FOLDERS["system"][1:]:
        ConfigStore.instance().store(group="system", name=name, node=read_yaml("system", name))


@cache
def _composed(group: str, overrides: tuple[tuple[str, str], ...]) -> str:
    """The composed configuration of a group, or of all of them, as JSON; once for each choice and nested fields."""
    found = None
    if not overrides:
        found = _unchosen()
    elif len(overrides) == 1:
        found = _whole_file(*overrides[0])
    if found is None:
        found = _by_hydra(overrides)
        found = found[group] if group else found
    return json.dumps(found)


def _unchosen() -> dict[str, Any]:
    """The configuration where nothing is chosen, its groups by name: a method that is not wanted is not loaded."""
    content = {key: value for key, value in read_yaml("", "config").items() if key != "defaults"}
    return content | {group: name for group, name in _defaults().items() if group in COMPOSED}


def _whole_file(group: str, name: str) -> dict[str, Any] | None:
    """A file, or the defaults of a method, merged over those it starts from; None where that takes Hydra."""
    if group == "method" and name in (*registered(), *REFERENCES):
        return {"name": name, **default_settings(name)}
    if group not in COMPOSED:
        return None  # a field
    if name not in choices(group):
        drawn = drawn_scenario(name) if group == "system" else None
        return dict(drawn.system) if drawn else None  # None for a file of one's own
    if "${" in file_text(group, name) or "@package" in file_text(group, name):
        return None
    own = read_yaml(group, name)
    bases = own.pop("defaults", [])
    if not all(isinstance(base, str) and base.isidentifier() and base != "_self_" for base in bases):
        return None
    merged: dict[str, Any] = {}
    for base in bases:
        below = _whole_file(group, base)
        if below is None:
            return None
        merged = _merged(merged, below)
    return _merged(merged, own)


def _merged(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Two mappings as one, what stands in both from the one above."""
    both = {key for key in below.keys() & above.keys() if isinstance(below[key], dict) and isinstance(above[key], dict)}
    return {**below, **{key: _merged(below[key], own) if key in both else own for key, own in above.items()}}


def _by_hydra(overrides: Sequence[tuple[str, str]]) -> Any:
    """The same for any choice, and for fields; raises InputError."""
    from hydra import compose, initialize_config_module
    from hydra.errors import HydraException
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    register_method(dict(overrides).get("method") or _defaults()["method"])
    _register_system(dict(overrides).get("system") or "")
    addable = _addable(overrides)
    texts = [f"{'++' if key.startswith(TOLD) or key in addable else ''}{key}={value}" for key, value in overrides]
    try:
        with initialize_config_module("conf", version_base="1.3"):
            return OmegaConf.to_container(compose("config", overrides=texts), resolve=True)
    except (HydraException, OmegaConfBaseException) as error:
        match = re.search(r"'([\w.]+)'", str(error))
        key = match.group(1) if match and match.group(1) in dict(overrides) else overrides[-1][0]
        reason = str(error).splitlines()[0]
        if "Could not override" in reason:
            reason = f"no such field{_beside(key, overrides)}"
        value = dict(overrides).get(key, "")
        for name, path in _OWN_FILES.items():
            value, reason = value.replace(name, path), reason.replace(name, path)
        raise InputError(key, value, reason) from None


def _chosen(group: str, overrides: Sequence[tuple[str, str]]) -> Any:
    """What a group holds by its choice alone, without fields that are set in it; raises InputError."""
    return json.loads(
        _composed(group, tuple(one for one in overrides if one[0] == group) or ((group, _defaults()[group]),))
    )


def _beside(key: str, overrides: Sequence[tuple[str, str]]) -> str:
    """The fields beside one that is not there, in words; empty where nothing tells them."""
    group, *between, _ = key.split(".")
    try:
        found = _chosen(group, overrides)
        for name in between:
            found = found[name]
        return f"; there are {', '.join(found)}" if found else "; there is none"
    except (InputError, KeyError, TypeError):
        return ""


def _addable(overrides: Sequence[tuple[str, str]]) -> set[str]:
    """Fields of a scenario and its prior that need not stand in their files; those of a force where there is one."""
    found = {path for f in fields(declared.Scenario) if (path := declared.config_path(f)).startswith("system.")}
    found |= {f"prior.{f.name}" for f in fields(declared.PriorSpec)}
    of_force = {f"system.force.{f.name}" for f in fields(ForceSpec)}
    if of_force & set(dict(overrides)) and _chosen("system", overrides).get("force"):
        found |= of_force
    return found


def register_method(name: str) -> None:
    """Give Hydra a method's settings with their defaults, and those of the method that a variant starts from."""
    from hydra.core.config_store import ConfigStore

    if name not in (*registered(), *REFERENCES):
        for base in read_yaml("method", name).get("defaults", []):
            register_method(base)
        return
    ConfigStore.instance().store(group="method", name=name, node={"name": name, **default_settings(name)})
