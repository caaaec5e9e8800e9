"""Write a small package of a method or a system to start from, from the templates beside this module."""

from __future__ import annotations

import keyword
import string
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

from bench.conformance.target import Kind
from bench.entrants.registry import method_names
from bench.errors import InputError
from bench.systems import registered_systems

ENDING = ".template"
LONGEST = 60
"""Letters of a name: files and folders get it with an ending."""


def written(kind: Kind, name: str, folder: Path) -> list[Path]:
    """Write the package called ``name`` into a folder that is not there yet, or empty; returns its files.

    Raises InputError for a name that cannot be one or is taken, and a folder that cannot be written.
    """
    words = name.strip("_").split("_")
    class_name = "".join(word.capitalize() for word in words)
    spelt = name.isascii() and name.isidentifier() and name.islower() and class_name.isidentifier()
    if not spelt or keyword.iskeyword(name) or keyword.iskeyword(class_name):
        raise InputError(kind, name, "small letters, digits and _, a letter first, as Python names a module")
    if len(name) > LONGEST:
        raise InputError(kind, name, f"at most {LONGEST} letters")
    if name in (method_names() if kind == "method" else registered_systems()):
        raise InputError(kind, name, f"the benchmark has a {kind} of that name; choose another")
    if _is_module(name):
        raise InputError(kind, name, "Python has a module of that name, which it would hide; choose another")
    fields = {
        "name": name,
        "class_name": class_name,
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
    """Return whether something is imported by a name; a folder without ``__init__.py`` is nothing."""
    try:
        spec = find_spec(name)
    except ValueError:  # it is loaded, and was made by hand
        return True
    return spec is not None and spec.origin is not None
