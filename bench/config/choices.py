"""What may be chosen by name: the files of ``conf``, registered methods, and a scenario's file of one's own."""

from __future__ import annotations

import os
from functools import cache
from typing import Any

from bench.config.drawn import drawn_ranges, drawn_scenario
from bench.config.files import file_names
from bench.config.suggest import did_you_mean
from bench.entrants.registry import load_method, method_names, registered
from bench.errors import InputError

GROUPS = ("method", "system", "prior", "disturbance", "experiment")


@cache
def choices(group: str) -> list[str]:
    """What may be chosen for a group: the files of ``conf``, and for methods the registered ones too."""
    return sorted({*file_names(group), *(method_names() if group == "method" else ())})


def check_choice(group: str, value: Any) -> None:
    """Raise InputError for what cannot be chosen for a group, which includes a method that does not load."""
    if own_file(group, value) or (group == "system" and drawn_scenario(str(value))):
        return
    if value not in choices(group) and not (group == "experiment" and value is None):
        known = ", ".join([f"known: {', '.join(choices(group))}", *(drawn_ranges() if group == "system" else ())])
        raise InputError(group, value, f"{did_you_mean(value, choices(group))}{known}")
    if group == "method" and value in registered():
        load_method(value)  # a broken entry point is said here


def own_file(group: str, value: Any) -> bool:
    """Whether a choice names a file of one's own: ``system=<path>.yaml``; raises InputError if it is not there."""
    named = group == "system" and isinstance(value, str) and value.endswith(".yaml")
    if named and not os.path.isfile(os.path.expanduser(value)):
        raise InputError(group, value, "there is no such file; give the path of a file like those of conf/system")
    return named
