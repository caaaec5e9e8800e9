"""Write a small package of a method or a system to start from, from the templates beside this module."""

from __future__ import annotations

import keyword
import re
import string
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

from bench.conformance.subjects import Kind
from bench.entrants.registry import method_names
from bench.errors import InputError
from bench.systems import registered_systems

ENDING = ".template"


def write_package(kind: Kind, name: str, folder: Path) -> list[Path]:
    """Write the package called ``name`` into a folder that is not there yet, or empty; returns its files.

    Raises:
        InputError: For a name that cannot be one or is taken, and for a folder that cannot be written.
    """
    words = name.split("_")
    class_name = "".join(map(str.capitalize, words))
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name) or keyword.iskeyword(name) or keyword.iskeyword(class_name):
        raise InputError(kind, name, "small letters, digits and _, a letter first, as Python names a module")
    if name in method_names() or name in registered_systems() or find_spec(name):
        raise InputError(kind, name, "there is a method, a system or a module of Python of that name; choose another")
    if folder.resolve().name == name:
        raise InputError("out", folder, f"a folder of this name hides the module {name} from whoever works beside it")
    fields = {
        "name": name,
        "class_name": class_name,
        "distribution": name.replace("_", "-"),
        "title": " ".join(words).capitalize(),
    }
    paths = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise InputError("out", folder, "it is there already; name another folder")
        for item in sorted(files(__package__).joinpath("template", kind).iterdir(), key=lambda item: item.name):
            path = folder / string.Template(item.name.removesuffix(ENDING)).substitute(fields)
            path.write_text(string.Template(item.read_text(encoding="utf-8")).substitute(fields), encoding="utf-8")
            paths.append(path)
    except OSError as error:
        raise InputError("out", folder, f"cannot be written ({error.strerror}); name another folder") from None
    return paths
