"""The files of ``conf``: which there are of a group, and what one of them says by itself."""

from __future__ import annotations

import re
from copy import deepcopy
from functools import cache
from importlib.resources import files
from typing import Any

import yaml

FOLDERS = {"system": ("system", "development")}
"""Where the files of a group lie, if not in the folder of its name alone."""
ENDING = ".yaml"


@cache
def file_names(group: str) -> dict[str, str]:
    """The files of a group by name, each with its folder."""
    found = {}
    for folder in FOLDERS.get(group, (group,)):
        for entry in files("conf").joinpath(folder).iterdir():
            if entry.name.endswith(ENDING):
                found[entry.name.removesuffix(ENDING)] = folder
    return found


def file_text(group: str, name: str) -> str:
    """The text of a file; of ``conf/config.yaml`` where the group is empty."""
    folder = file_names(group).get(name, group) if group else ""
    return files("conf").joinpath(folder, f"{name}{ENDING}").read_text(encoding="utf-8")


def read_yaml(group: str, name: str) -> dict[str, Any]:
    """The content of a file of ``conf``, by itself."""
    return deepcopy(_content(group, name))


@cache
def _content(group: str, name: str) -> dict[str, Any]:
    content = yaml.load(file_text(group, name), _Loader)
    assert isinstance(content, dict)
    return {str(key): value for key, value in content.items()}


_Loader: Any = type("_Loader", (getattr(yaml, "CSafeLoader", yaml.SafeLoader),), {})
"""YAML as Hydra reads it, in which ``1e-3`` is a number, by the parser in C where there is one."""
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?\d+(\.\d*)?[eE][-+]?\d+$"), list("-+0123456789")
)
