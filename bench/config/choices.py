"""What may be chosen by name, and what each choice says: files of ``conf``, methods, scenarios in files of your own."""

from __future__ import annotations

import hashlib
import json
import os
from functools import cache
from typing import Any

from bench.config import fields
from bench.config.drawn import drawn_ranges, drawn_scenario
from bench.config.files import ENDING, file_names, read_own_system, read_yaml
from bench.entrants.registry import default_settings, load_method, method_names, registered
from bench.errors import InputError, did_you_mean

GROUPS = (*fields.GROUPS, "experiment")
"""Fields whose value is chosen by name."""
TRACKS = {"measured": "measured_track", "online": "online", "modal": "modal", "atlas": "atlas"}
"""Experiments with fields of their own, each a verb of the module of ``bench.commands``."""
_OWN: dict[str, dict[str, Any]] = {}
"""Contents of files of your own by the names under which Hydra gets them."""


@cache
def choices(group: str) -> list[str]:
    """Return what may be chosen for a group: the files of ``conf``, and for methods the registered ones too."""
    return sorted({*file_names(group), *(method_names() if group == "method" else ())})


@cache
def default_choices() -> dict[str, str]:
    """Return the choice of every group that ``conf/config.yaml`` makes."""
    named = [entry for entry in read_yaml("", "config")["defaults"] if isinstance(entry, dict)]
    return {group: name for entry in named for group, name in entry.items()}


def is_choice(group: str, name: str) -> bool:
    """Return whether a name stands for a choice, drawn and registered scenarios included."""
    return name in choices(group) or (group == "system" and (name in _OWN or drawn_scenario(name) is not None))


def check_choice(group: str, value: Any) -> None:
    """Raise InputError for what cannot be chosen for a group, which includes a method that does not load."""
    if own_file(group, value) or (group == "experiment" and value is None):
        return
    if not is_choice(group, str(value)):
        names = [*choices(group), *(TRACKS if group == "experiment" else ())]
        known = ", ".join([f"known: {', '.join(names)}", *(drawn_ranges() if group == "system" else ())])
        raise InputError(group, value, f"{did_you_mean(value, names)}{known}")
    if group == "method" and value in registered():
        load_method(value)  # a broken entry point is said here


def own_file(group: str, value: Any) -> bool:
    """Return whether a choice is a file of your own: ``system=<path>.yaml``; raises InputError if it does not exist."""
    named = group == "system" and isinstance(value, str) and value.endswith(ENDING)
    if named and not os.path.isfile(os.path.expanduser(value)):
        raise InputError(group, value, "there is no such file; give the path of a file like those of conf/system")
    return named


def name_for_hydra(group: str, choice: Any) -> str:
    """Return the name by which Hydra knows a choice, which for a file of your own is made of its content."""
    if not own_file(group, choice):
        return str(choice)
    stated = read_own_system(os.path.expanduser(choice))
    name = f"file_{hashlib.sha256(json.dumps(stated, default=str).encode()).hexdigest()[:16]}"
    _OWN[name] = stated
    return name


def content(group: str, name: str) -> dict[str, Any]:
    """Return what a choice says by itself, before it is composed; raises InputError for a method that does not load."""
    if group == "system" and name in _OWN:
        return dict(_OWN[name])
    if group == "system" and name not in file_names("system") and (drawn := drawn_scenario(name)):
        return dict(drawn.system)
    if group == "method" and name not in file_names("method"):
        return {"name": name, **default_settings(name)}
    return read_yaml(group, name)
