"""The command line of a verb: arguments, help and completion, derived from the parameters of its function."""

from __future__ import annotations

import inspect
import os
import shlex
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.config.declaration import Bare, Field, OneOf, Others, fields_of, written
from bench.errors import InputError, did_you_mean
from bench.scenario.declaration import Parsed, Within

__all__ = ["Bare", "OneOf", "Others", "Parsed", "Within"]
WIDE = 14
"""Largest width of the column of names on a page of help."""


def read_arguments(verb: Callable[..., int], words: Sequence[str]) -> dict[str, Any]:
    """Read the words of a command line as the arguments of a verb.

    Args:
        verb: The function of the verb.
        words: ``name=value``, or the value alone of a field that is marked :class:`Bare`.

    Returns:
        The arguments by parameter.

    Raises:
        InputError: for the first word that is wrong, or a required field that is missing.
    """
    fields = fields_of(verb)
    rest = next((field for field in fields.values() if field.others), None)
    known = [name for name, field in fields.items() if not field.others]
    values: dict[str, Any] = {rest.parameter: []} if rest else {}
    for word in words:
        name, equals, text = word.partition("=")
        unnamed = next((f.name for f in fields.values() if f.bare and f.parameter not in values), "")
        if unnamed and not equals and not word.startswith("-"):
            name, equals, text = unnamed, "=", word
        if not equals:
            raise InputError("argument", word, how_to_write(word, [fields[name] for name in known]))
        if name in known and fields[name].parameter in values:
            raise InputError(name, text, "given twice; give it once")
        if name in known:
            values[fields[name].parameter] = fields[name].read(text)
        elif rest and rest.others and rest.others.take(name):
            values[rest.parameter].append(word)
        else:
            also = f", {rest.text}" if rest else ""
            raise InputError(name, text, f"not a field; {did_you_mean(name, known)}fields: {', '.join(known)}{also}")
    for field in fields.values():
        if field.required and field.parameter not in values:
            raise InputError(field.name, "", f"needed: {field.text}")
    return values


def how_to_write(word: str, fields: Collection[Field]) -> str:
    """Return the remedy for a word that is not ``field=value``."""
    bare = word.lstrip("-")
    names = [field.name for field in fields]
    if bare in names:
        return f"write {bare}=<value>, without spaces or dashes"
    if word.startswith("-"):
        return "options are --help, --version, -v and -q"
    name = next((field.name for field in fields if word in field.choices), names[0] if names else "<field>")
    return f"write {name}={word}; see --help"


def command_line(verb: Callable[..., int], values: Mapping[str, Any]) -> str:
    """Return the command that calls a verb with these arguments; defaults are left out."""
    words = ["python", "-m", "bench", verb.__name__]
    for field in fields_of(verb).values():
        value = values[field.parameter]
        if field.others:
            words += value
        elif value != field.default:
            words.append(f"{field.name}={written(value)}")
    return shlex.join(words)


def help_page(command: str, verb: Callable[..., int]) -> str:
    """Return the page of help: usage, description, fields."""
    from bench.reporting.terminal import help_page as laid_out

    fields = sorted(fields_of(verb).values(), key=lambda field: bool(field.others))
    required = "".join(
        f" <{field.name}>" if field.bare else f" {field.name}=<value>" for field in fields if field.required
    )
    wide = min(WIDE, max((len(field.name) for field in fields if not field.others), default=0))
    lines = [field.line(wide) for field in fields]
    head = f"usage: {command}{required} [field=value ...]\n\n{inspect.getdoc(verb)}"
    return laid_out("\n".join([head, *(["\nfields (defaults in brackets):", *lines] if lines else [])]))


def completions(verb: Callable[..., int], word: str) -> list[str]:
    """Return the completions of the last word of a command line."""
    name, equals, _ = word.partition("=")
    fields = {name: field for name, field in fields_of(verb).items() if not field.others}
    offered = [f"{field}=" for field in fields]
    if equals:
        offered = [f"{name}={value}" for value in fields[name].choices] if name in fields else []
    return [text for text in offered if text.startswith(word)]


def settings_of(words: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Read ``method.width=32 system.n=3`` as settings by group and name; raises InputError for several values."""
    from bench.config.overrides import read_overrides

    settings: dict[str, dict[str, Any]] = {}
    for key, values in read_overrides(words).items():
        group, _, name = key.partition(".")
        if not name or len(values) > 1:
            raise InputError(key, written(values), f"write {group}.<name>=<value>, one value")
        settings.setdefault(group, {})[name] = values[0]
    return settings


def file(field: str, path: Path, wanted: str = "name an existing file") -> Path:
    """Return the path of a regular file; raises InputError for any other path."""
    if not os.path.isfile(path):
        raise InputError(field, path, f"{'not a file' if os.path.exists(path) else 'file not found'}; {wanted}")
    return path


def folder(field: str, path: Path) -> Path:
    """Return the path of a folder; raises InputError if it does not exist."""
    if not os.path.isdir(path):
        raise InputError(field, path, "folder not found; name an existing one")
    return path
