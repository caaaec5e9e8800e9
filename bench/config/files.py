"""Reading of YAML files: those of ``conf``, and scenario files of the user."""

from __future__ import annotations

import re
from copy import deepcopy
from functools import cache
from importlib.resources import files
from typing import Any

import yaml

from bench.errors import InputError

FOLDERS = {"system": ("system", "development")}
"""Folders of a group's files, where not only the folder of its name."""
ENDING = ".yaml"
MOST_BYTES = 2**16
"""Largest size of a scenario file; a chain of twenty masses takes 2 kB."""
KIND = "expected a file like those of conf/system"
NUMBER = re.compile(r"[-+]?\d+(\.\d*)?[eE][-+]?\d+$")
"""Numbers such as 1e-3, which YAML 1.1 reads as text."""


@cache
def file_names(group: str) -> dict[str, str]:
    """Return the folders of a group's files by file name."""
    folders = FOLDERS.get(group, (group,))
    entries = [(entry.name, folder) for folder in folders for entry in files("conf").joinpath(folder).iterdir()]
    return {name.removesuffix(ENDING): folder for name, folder in entries if name.endswith(ENDING)}


def read_yaml(group: str, name: str) -> dict[str, Any]:
    """Return the content of a file of ``conf``, before composition; an empty ``group`` means its top folder."""
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
    """Rejects aliases, a few lines of which can expand to gigabytes, and duplicate keys."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise ValueError("aliases are not supported; write the values out")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        keys = [self.construct_object(key, deep=True) for key, _ in node.value]
        for key in keys:
            if keys.count(key) > 1:
                raise ValueError(f"duplicate key {key}")
        return super().construct_mapping(node, deep)


_Strict.add_implicit_resolver("tag:yaml.org,2002:float", NUMBER, list("-+0123456789"))


def read_user_yaml(path: str, field: str = "system", kind: str = KIND) -> dict[str, Any]:
    """Return the content of a user's YAML file.

    Interpolations (``${...}``) are rejected, since they can read the environment of the machine.

    Args:
        path: The file.
        field: Field of the command line that names it, for error messages.
        kind: Description of the expected content, for error messages.

    Raises:
        InputError: The file cannot be read, is too large, or is not plain YAML with fields.
    """
    try:
        with open(path, "rb") as file:
            data = file.read(MOST_BYTES + 1)
        text = data.decode("utf-8")
    except OSError as error:
        raise InputError(field, path, f"cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(field, path, f"not UTF-8 text; {kind}") from None
    if len(data) > MOST_BYTES:
        raise InputError(field, path, f"at most {MOST_BYTES} bytes; {kind}")
    if "${" in text:
        raise InputError(field, path, "write values, not ${...}")
    try:
        content = yaml.load(text, _Strict)
    except (yaml.YAMLError, ValueError, TypeError, RecursionError) as error:
        raise InputError(field, path, f"not plain YAML ({error}); {kind}") from None
    if not isinstance(content, dict) or not all(isinstance(key, str) for key in content):
        raise InputError(field, path, f"has no fields; {kind}")
    return content


def read_user_system(path: str) -> dict[str, Any]:
    """Return the content of a user's scenario file; its ``defaults`` may name scenarios of ``conf/system``.

    Raises:
        InputError: The file is not a scenario.
    """
    content = read_user_yaml(path)
    defaults = content.get("defaults", [])
    for name in defaults if isinstance(defaults, list) else [defaults]:
        if not isinstance(defaults, list) or name not in ("_self_", *file_names("system")):
            known = ", ".join(sorted(file_names("system")))
            raise InputError("system", path, f"defaults contains {name}; it must be a list of scenarios: {known}")
    return content
