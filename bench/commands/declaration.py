"""A verb of the command line: one function, whose parameters are the fields ``name=value``.

The type of a parameter says how its text is read, its default is the field's default, and the text in ``Annotated`` is
its line of help. Help, errors and shell completion all follow from the function::

    def certify(
        data: Annotated[str, "measured record"],
        twins: Annotated[int, Whole(0, 100_000), "simulated repeats"] = 200,
    ) -> int:
        \"\"\"Write the certificate of a measured record.\"\"\"
"""

from __future__ import annotations

import inspect
import math
import os
import re
import shlex
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from bench.config.suggest import did_you_mean
from bench.errors import InputError

LARGEST = 10**9
"""Largest whole number where a field declares no limit of its own."""
LISTED = 12
"""Number of names up to which a page of help lists those of a field."""
DIGITS = 19
"""Digits of a whole number at most: no limit has more."""

EXPONENT = re.compile(r"[-+]?[0-9.]+e[-+]?[0-9]+", re.IGNORECASE)
"""A number such as 1e-3, which YAML reads as a word."""

Read = Callable[[str, str], Any]
"""Reads a field's text: called with the field's name and the text, raises InputError."""
Names = Sequence[str] | Callable[[], Sequence[str]]


@dataclass(frozen=True)
class Whole:
    """A whole number within limits."""

    least: int = 1
    most: int = LARGEST

    def __call__(self, field: str, text: str) -> int:
        if not re.fullmatch(rf"[0-9]{{1,{DIGITS}}}", text) or not self.least <= int(text) <= self.most:
            raise InputError(field, text, f"a whole number from {self.least} to {self.most}")
        return int(text)


@dataclass(frozen=True)
class Number:
    """A finite number above ``above`` and up to ``most``; ``wanted`` describes it in an error."""

    above: float = -math.inf
    most: float = math.inf
    wanted: str = "a number"

    def __call__(self, field: str, text: str, shown: str | None = None) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and self.above < value <= self.most):
            remedy = self.wanted if math.isinf(self.most) else f"{self.wanted}, at most {self.most:g}"
            raise InputError(field, text if shown is None else shown, remedy)
        return value


@dataclass(frozen=True)
class Choice:
    """One of some names, or, as ``several``, a list of them with commas; an error guesses what was meant."""

    names: Names
    several: bool = False

    def known(self) -> Sequence[str]:
        """Return the names."""
        return self.names() if callable(self.names) else self.names

    def __call__(self, field: str, text: str) -> Any:
        values = names_of(field, text) if self.several else (text,)
        for value in values:
            if value not in self.known():
                known = self.known()
                wanted = " or ".join(known) if len(known) < 3 else f"one of {', '.join(known)}"
                raise InputError(field, value if self.several else text, f"{did_you_mean(value, known)}{wanted}")
        return values if self.several else text


@dataclass(frozen=True)
class Others:
    """Fields of another command that a verb takes too, as they are written; ``system`` stands for ``system.n`` too."""

    names: Names

    def take(self, key: str) -> bool:
        """Return whether a field is one of these, or lies below one."""
        names = self.names() if callable(self.names) else self.names
        return key in names or key.partition(".")[0] in names


def names_of(field: str, text: str) -> tuple[str, ...]:
    """Read names with commas between them, each once."""
    names = tuple(part.strip() for part in text.split(","))
    if not all(names):
        raise InputError(field, text, "one name, or several with a comma between two")
    for name in names:
        if names.count(name) > 1:
            raise InputError(field, text, f"every name once; {name} is given twice")
    return names


def flag(field: str, text: str) -> bool:
    """Read true or false."""
    if text not in ("true", "false"):
        raise InputError(field, text, "true or false")
    return text == "true"


def path_of(field: str, text: str) -> Path:
    """Read a path; ``~`` stands for the home folder."""
    return Path(os.path.expanduser(text))


def folder(field: str, text: str) -> Path:
    """Read the path of a folder, which must exist."""
    path = path_of(field, text)
    if not os.path.isdir(path):
        raise InputError(field, text, "folder not found; name an existing one")
    return path


@dataclass(frozen=True)
class File:
    """A file to read, which must exist and be no pipe or device; ``wanted`` describes it in an error."""

    wanted: str = "name an existing file"

    def __call__(self, field: str, text: str) -> Path:
        path = path_of(field, text)
        if not os.path.isfile(path):
            raise InputError(
                field, text, f"{'not a file' if os.path.exists(path) else 'file not found'}; {self.wanted}"
            )
        return path


READERS: dict[Any, Read] = {
    bool: flag, int: Whole(), float: Number(), Path: path_of, tuple[str, ...]: names_of, str: lambda field, text: text,
}  # fmt: skip
"""How a type is read where its ``Annotated`` names no reader."""


@dataclass(frozen=True)
class Field:
    """A parameter of a verb as a field of the command line."""

    parameter: str
    read: Read | Others
    default: Any
    text: str

    @property
    def name(self) -> str:
        """The name as it is written: ``from``, whose parameter is ``from_``."""
        return self.parameter.rstrip("_")

    @property
    def required(self) -> bool:
        return self.default is inspect.Parameter.empty

    def values(self) -> Sequence[str]:
        """Return the values that the shell can complete."""
        return ("true", "false") if self.read is flag else self.read.known() if isinstance(self.read, Choice) else ()

    def shown(self) -> str:
        """Return the default as it is written; empty where there is none."""
        return "" if self.required else as_written(self.default)


def as_written(value: Any) -> str:
    """Return a value as the text of a field."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return ",".join(value)
    return f"{value:g}" if isinstance(value, float) else "" if value is None else str(value)


def command_line(verb: Callable[..., int], values: Mapping[str, Any]) -> str:
    """Return the command that calls a verb with these values of its parameters, without those of a default."""
    words = ["python", "-m", "bench", verb.__name__]
    for field in fields_of(verb):
        value = values[field.parameter]
        if isinstance(field.read, Others):
            words += value
        elif field.required or value != field.default:
            words.append(f"{field.name}={as_written(value)}")
    return shlex.join(words)


def fields_of(verb: Callable[..., int]) -> list[Field]:
    """Return the fields that a function declares."""
    types_of = typing.get_type_hints(verb, include_extras=True)
    return [_field(name, types_of[name], p.default) for name, p in inspect.signature(verb).parameters.items()]


def _field(parameter: str, declared: Any, default: Any) -> Field:
    kind, *extras = typing.get_args(declared)
    read = next((extra for extra in extras if callable(extra) or isinstance(extra, Others)), None)
    text = next(extra for extra in extras if isinstance(extra, str))
    if isinstance(kind, types.UnionType):
        (kind,) = (part for part in typing.get_args(kind) if part is not types.NoneType)
    if read is None:
        read = Choice(typing.get_args(kind)) if typing.get_origin(kind) is Literal else READERS[kind]
    return Field(parameter, read, default, " ".join(text.split()))


def read_arguments(verb: Callable[..., int], arguments: Sequence[str]) -> dict[str, Any]:
    """Read the words of a command line as the arguments of a verb; raises InputError for the first that is wrong."""
    fields, given, rest = {}, {}, []
    others, parameter, also = Others(()), "", ""
    for field in fields_of(verb):
        if isinstance(field.read, Others):
            others, parameter, also = field.read, field.parameter, f", {field.text}"
        else:
            fields[field.name] = field
    for argument in arguments:
        name, equals, text = argument.partition("=")
        if not equals:
            raise InputError("argument", argument, _bare(argument, fields))
        if name not in fields:
            if not others.take(name):
                near = did_you_mean(name, list(fields))
                raise InputError(name, text, f"not a field; {near}fields: {', '.join(fields)}{also}")
            rest.append(argument)
            continue
        if not text:
            raise InputError(name, text, "give a value, or leave the field out")
        if name in given:
            raise InputError(name, text, "given twice; give it once")
        given[name] = text
    for name, field in fields.items():
        if field.required and name not in given:
            raise InputError(name, "", f"needed: {field.text}")
    values = {fields[name].parameter: _read(fields[name], text) for name, text in given.items()}
    return {**values, parameter: rest} if parameter else values


def _read(field: Field, text: str) -> Any:
    assert not isinstance(field.read, Others)
    return field.read(field.name, text)


def _bare(argument: str, fields: dict[str, Field]) -> str:
    """Return what to write in place of a word without ``=``."""
    if argument.startswith("-"):
        known = argument.lstrip("-") in fields
        return f"write {argument.lstrip('-')}=<value>" if known else "options are --help and --version"
    if argument in fields:
        return f"write {argument}=<value>, without spaces"
    fitting = [name for name, field in fields.items() if argument in field.values()]
    return f"write {next(iter([*fitting, *fields]))}={argument}; see --help"


def help_page(command: str, verb: Callable[..., int]) -> str:
    """Return the page of help: usage, description, fields."""
    from bench.reporting.terminal import help_page as laid_out

    fields = fields_of(verb)
    required = "".join(
        f" {field.name}=<value>" for field in fields if field.required and not isinstance(field.read, Others)
    )
    wide = min(14, max((len(field.name) for field in fields if not isinstance(field.read, Others)), default=0))
    lines = []
    for field in sorted(fields, key=lambda field: isinstance(field.read, Others)):
        if isinstance(field.read, Others):
            lines.append(f"  {'...':<{wide}}  {field.text}")
            continue
        shown = f"[{field.shown()}] " if field.shown() else ""
        values = ", ".join(field.values()) if isinstance(field.read, Choice) and len(field.values()) <= LISTED else ""
        text = "; ".join(part for part in (values, field.text) if part)
        lines.append(f"  {field.name:<{wide}}  {shown}{text}")
    head = f"usage: {command}{required} [field=value ...]\n\n{inspect.getdoc(verb)}"
    return laid_out("\n".join([head, *(["\nfields (defaults in brackets):", *lines] if lines else [])]))


def completions(verb: Callable[..., int], word: str) -> list[str]:
    """Return what a shell may put in place of the last word of a line."""
    name, equals, _ = word.partition("=")
    fields = {field.name: field for field in fields_of(verb) if not isinstance(field.read, Others)}
    if equals:
        offered = [f"{name}={value}" for value in (fields[name].values() if name in fields else ())]
    else:
        offered = [f"{field}=" for field in fields]
    return [text for text in offered if text.startswith(word)]


def read_settings(arguments: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Read ``method.width=32 system.n=3`` as values by group and name; raises InputError."""
    import yaml

    settings: dict[str, dict[str, Any]] = {}
    for argument in arguments:
        path, _, text = argument.partition("=")
        group, _, name = path.partition(".")
        if not name or not text:
            raise InputError(path, text, f"write {group}.<name>=<value>")
        if name in settings.setdefault(group, {}):
            raise InputError(path, text, "given twice; give it once")
        try:
            value = float(text) if EXPONENT.fullmatch(text) else yaml.safe_load(text)
        except (yaml.YAMLError, RecursionError, ValueError):
            raise InputError(path, text, "a number, a word or a list") from None
        settings[group][name] = value
    return settings
