"""A small package of a method or a system to start from, made of the templates beside this module."""

from __future__ import annotations

import keyword
import string
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

from bench.conformance.target import KINDS
from bench.entrants.registry import method_names
from bench.errors import InputError
from bench.systems import registered_systems

ENDING = ".template"
LONGEST = 60
"""Letters of a name: files and folders get it with an ending."""


def written(kind: str, name: str, folder: Path) -> list[Path]:
    """Write the package called ``name`` into a folder that is not there yet, or empty; returns its files.

    Raises InputError for an unknown kind, a name that cannot be one or is taken, and a folder that cannot be written.
    """
    if kind not in KINDS.values():
        raise InputError("kind", kind, f"one of {', '.join(KINDS.values())}")
    if not (name.isascii() and name.isidentifier() and name.islower()) or keyword.iskeyword(name):
        raise InputError("name", name, "small letters, digits and _, a letter first, as Python names a module")
    if len(name) > LONGEST:
        raise InputError("name", name, f"at most {LONGEST} letters")
    if name in (method_names() if kind == "method" else registered_systems()):
        raise InputError("name", name, f"the benchmark has a {kind} of that name; choose another")
    if _is_module(name):
        raise InputError("name", name, "Python has a module of that name, which it would hide; choose another")
    words = name.strip("_").split("_")
    fields = {
        "name": name,
        "class_name": "".join(word.capitalize() for word in words),
        "distribution": name.strip("_").replace("_", "-"),
        "title": " ".join(words).capitalize(),
    }
    paths = []
    try:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise InputError("out", folder, "it is there already; name another folder")
        folder.mkdir(parents=True, exist_ok=True)
        for item in sorted(files(__package__).joinpath("template", kind).iterdir(), key=lambda item: item.name):
            path = folder / string.Template(item.name.removesuffix(ENDING)).substitute(fields)
            text = string.Template(item.read_text(encoding="utf-8")).substitute(fields)
            path.write_text(text, encoding="utf-8")
            paths.append(path)
    except OSError as error:
        raise InputError("out", folder, f"cannot be written ({error.strerror}); name another folder") from None
    return paths


def _is_module(name: str) -> bool:
    """Whether something is imported by a name; a folder without ``__init__.py`` is nothing."""
    try:
        found = find_spec(name)
    except ValueError:  # one that is loaded, and was made by hand
        return True
    return found is not None and found.origin is not None
