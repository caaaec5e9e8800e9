"""Files of ``conf``, and scenarios in files of your own: YAML of plain values, as Hydra reads it."""

from __future__ import annotations

import re
from copy import deepcopy
from functools import cache
from importlib.resources import files
from typing import Any

import yaml

from bench.errors import InputError

FOLDERS = {"system": ("system", "development")}
"""Where the files of a group lie, if not in the folder of its name alone."""
ENDING = ".yaml"
MOST_BYTES = 2**16
"""Size of a scenario's file at most; chains of twenty masses take 2 kB."""
KIND = "a file like those of conf/system is wanted"
NUMBER = re.compile(r"[-+]?\d+(\.\d*)?[eE][-+]?\d+$")
"""A number such as 1e-3, which YAML alone takes for a word."""


@cache
def file_names(group: str) -> dict[str, str]:
    """Return the files of a group by name, each with its folder."""
    folders = FOLDERS.get(group, (group,))
    entries = [(entry.name, folder) for folder in folders for entry in files("conf").joinpath(folder).iterdir()]
    return {name.removesuffix(ENDING): folder for name, folder in entries if name.endswith(ENDING)}


def read_yaml(group: str, name: str) -> dict[str, Any]:
    """Return the content of a file of ``conf``, by itself; one beside its folders where the group is empty."""
    return deepcopy(_content(group, name))


@cache
def _content(group: str, name: str) -> dict[str, Any]:
    folder = file_names(group).get(name, group) if group else ""
    text = files("conf").joinpath(folder, f"{name}{ENDING}").read_text(encoding="utf-8")
    content = yaml.load(text, _Loader)
    assert isinstance(content, dict)
    return {str(key): value for key, value in content.items()}


_Loader: Any = type("_Loader", (getattr(yaml, "CSafeLoader", yaml.SafeLoader),), {})
_Loader.add_implicit_resolver("tag:yaml.org,2002:float", NUMBER, list("-+0123456789"))


class _Strict(yaml.SafeLoader):
    """Refuses aliases, a few lines of which stand for gigabytes, and keys that stand twice."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise ValueError("aliases are not read; write the values out")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        keys = [self.construct_object(key, deep=True) for key, _ in node.value]
        for key in keys:
            if keys.count(key) > 1:
                raise ValueError(f"duplicate key {key}")
        return super().construct_mapping(node, deep)


_Strict.add_implicit_resolver("tag:yaml.org,2002:float", NUMBER, list("-+0123456789"))


def read_own(path: str, field: str = "system", kind: str = KIND) -> dict[str, Any]:
    """Return the content of a user's YAML file; raises InputError, with the ``kind`` that is wanted, where it is none.

    Interpolations are not read: they stand for what the machine's environment holds.
    """
    try:
        with open(path, "rb") as file:
            data = file.read(MOST_BYTES + 1)
        text = data.decode("utf-8")
    except OSError as error:
        raise InputError(field, path, f"it cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(field, path, f"it is no text in UTF-8; {kind}") from None
    if len(data) > MOST_BYTES:
        raise InputError(field, path, f"at most {MOST_BYTES} bytes; {kind}")
    if "${" in text:
        raise InputError(field, path, "write values, not ${...}")
    try:
        content = yaml.load(text, _Strict)
    except (yaml.YAMLError, ValueError, TypeError, RecursionError) as error:
        raise InputError(field, path, f"it is no plain YAML ({error}); {kind}") from None
    if not isinstance(content, dict) or not all(isinstance(key, str) for key in content):
        raise InputError(field, path, f"it has no fields; {kind}")
    return content


def read_own_system(path: str) -> dict[str, Any]:
    """Return the content of a scenario's file, which may start from scenarios of ``conf/system``, by ``defaults``.

    Raises InputError where it is none.
    """
    content = read_own(path)
    defaults = content.get("defaults", [])
    for name in defaults if isinstance(defaults, list) else [defaults]:
        if not isinstance(defaults, list) or name not in ("_self_", *file_names("system")):
            known = ", ".join(sorted(file_names("system")))
            raise InputError("system", path, f"defaults has {name}; it is a list of scenarios: {known}")
    return content
