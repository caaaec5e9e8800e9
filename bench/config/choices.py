"""Choices of the configuration groups: files of ``conf``, registered methods, and scenario files of the user."""

from __future__ import annotations

import hashlib
import json
import os
from functools import cache
from typing import Any

from bench.config import fields
from bench.config.files import ENDING, file_names, read_user_system, read_yaml
from bench.config.random_scenarios import drawn_ranges, drawn_scenario
from bench.entrants.registry import default_settings, load_method, method_names, registered
from bench.errors import InputError, did_you_mean

GROUPS = (*fields.GROUPS, "experiment")
"""Fields whose value is chosen by name."""
TRACKS = {"measured": "measured_track", "online": "online", "modal": "modal", "atlas": "atlas"}
"""Modules of ``bench.commands`` by the experiments that have fields of their own."""
_USER_SYSTEMS: dict[str, dict[str, Any]] = {}
"""Contents of the user's scenario files by the names under which Hydra composes them."""


@cache
def choices(group: str) -> list[str]:
    """Return the choices of a group: its files in ``conf``, and for methods also the registered ones."""
    return sorted({*file_names(group), *(method_names() if group == "method" else ())})


@cache
def default_choices() -> dict[str, str]:
    """Return the default choice of every group, from ``conf/config.yaml``."""
    named = [entry for entry in read_yaml("", "config")["defaults"] if isinstance(entry, dict)]
    return {group: name for entry in named for group, name in entry.items()}


def is_choice(group: str, name: str) -> bool:
    """Return whether a group has a choice of this name; drawn scenarios are included."""
    return name in choices(group) or (group == "system" and (name in _USER_SYSTEMS or drawn_scenario(name) is not None))


def check_choice(group: str, value: Any) -> None:
    """Raise InputError for an unknown choice, and for a method that cannot be imported."""
    if is_user_file(group, value) or (group == "experiment" and value is None):
        return
    if not is_choice(group, str(value)):
        names = [*choices(group), *(TRACKS if group == "experiment" else ())]
        known = ", ".join([f"known: {', '.join(names)}", *(drawn_ranges() if group == "system" else ())])
        own = "; to add your own, install its package: pip install -e <folder>" if group == "method" else ""
        raise InputError(group, value, f"{did_you_mean(value, names)}{known}{own}")
    if group == "method" and value in registered():
        load_method(value)  # raises InputError for a broken entry point


def is_user_file(group: str, value: Any) -> bool:
    """Return whether a choice is a file of the user, ``system=<path>.yaml``; raises InputError if it does not exist."""
    named = group == "system" and isinstance(value, str) and value.endswith(ENDING)
    if named and not os.path.isfile(os.path.expanduser(value)):
        raise InputError(group, value, "file not found; give the path of a file like those of conf/system")
    return named


def name_for_hydra(group: str, choice: Any) -> str:
    """Return the name of a choice in Hydra; for a file of the user it is a hash of the content."""
    if not is_user_file(group, choice):
        return str(choice)
    stated = read_user_system(os.path.expanduser(choice))
    name = f"file_{hashlib.sha256(json.dumps(stated, default=str).encode()).hexdigest()[:16]}"
    _USER_SYSTEMS[name] = stated
    return name


def content(group: str, name: str) -> dict[str, Any]:
    """Return the content of a choice before composition; raises InputError for a method that cannot be imported."""
    if group == "system" and name in _USER_SYSTEMS:
        return dict(_USER_SYSTEMS[name])
    if group == "system" and name not in file_names("system") and (drawn := drawn_scenario(name)):
        return dict(drawn.system)
    if group == "method" and name not in file_names("method"):
        return {"name": name, **default_settings(name)}
    return read_yaml(group, name)
