"""The configuration of some choices: files of ``conf`` or of one's own, the settings of methods, fields in them.

Hydra composes it. Whole files that only name those they start from are merged as Hydra would, without loading it: that
takes milliseconds instead of a tenth of a second each, and an experiment has dozens.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any

from bench.config.choices import choices, own_file
from bench.config.drawn import drawn_scenario
from bench.config.files import FOLDERS, file_names, file_text, read_yaml
from bench.entrants.reference import REFERENCES
from bench.entrants.registry import default_settings, registered
from bench.errors import InputError
from bench.isolation.failure import one_line
from bench.scenario import scenario as declared

COMPOSED = ("method", "system", "prior", "disturbance")
"""Groups whose files Hydra composes."""


def composed(chosen: Mapping[str, Any]) -> dict[str, Any]:
    """The configuration of some choices of groups and of fields in them, as plain values.

    Each group is composed by itself, since none refers to another: a sum of compositions instead of a product. Raises
    InputError.
    """
    literals = {key: _literal(value) for key, value in chosen.items()}
    if own_file("system", chosen.get("system")):
        literals["system"] = _register_file(chosen["system"])
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
    return json.dumps(value) if isinstance(value, list | dict) or value is None else str(value)


def _register_file(path: str) -> str:
    """Give Hydra a scenario from a file of one's own, which may start from one of ``conf/system``; its name there."""
    from hydra.core.config_store import ConfigStore
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException
    from yaml import YAMLError

    try:
        text = Path(path).read_text(encoding="utf-8")
        content = OmegaConf.to_container(OmegaConf.create(text))
    except (OSError, UnicodeDecodeError, YAMLError, OmegaConfBaseException) as error:
        raise InputError("system", path, f"it cannot be read: {one_line(error)}") from None
    if not isinstance(content, dict) or not content:
        raise InputError("system", path, "fields like those of the files of conf/system are wanted")
    name = f"file_{hashlib.sha256(text.encode()).hexdigest()[:16]}"
    ConfigStore.instance().store(group="system", name=name, node=content)
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
    texts = [f"{'++' if _may_be_added(key) else ''}{key}={value}" for key, value in overrides]
    try:
        with initialize_config_module("conf", version_base="1.3"):
            return OmegaConf.to_container(compose("config", overrides=texts), resolve=True)
    except (HydraException, OmegaConfBaseException) as error:
        match = re.search(r"'([\w.]+)'", str(error))
        key = match.group(1) if match and match.group(1) in dict(overrides) else overrides[-1][0]
        reason = "no such field" if "Could not override" in str(error) else str(error).splitlines()[0]
        raise InputError(key, dict(overrides).get(key, ""), reason) from None


def _may_be_added(key: str) -> bool:
    """Whether a field need not stand in a file: a nominal value, or an optional field of a scenario."""
    optional = {declared.config_path(f) for f in fields(declared.Scenario) if not f.metadata.get("stated")}
    return key.startswith(("nominal.", "fixed.")) or (key.startswith("system.") and key in optional)


def register_method(name: str) -> None:
    """Give Hydra a method's settings with their defaults, and those of the method that a variant starts from."""
    from hydra.core.config_store import ConfigStore

    if name not in (*registered(), *REFERENCES):
        for base in read_yaml("method", name).get("defaults", []):
            register_method(base)
        return
    ConfigStore.instance().store(group="method", name=name, node={"name": name, **default_settings(name)})
