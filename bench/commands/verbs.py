"""The verbs of ``python -m bench <verb> name=value ...``, and how each is run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module

from bench.errors import InputError

VERBS = ("certify", "identifiability", "check", "new")
"""Each is the function of its name in the module of its name; a line without one of them is a run."""
COMMAND = "python -m bench"


def named_verb(arguments: Sequence[str]) -> str | None:
    """Return the verb of a command line: its first word that is no option, where it is a word; None for a run."""
    first = next((word for word in arguments if not word.startswith("-")), "")
    return first if first.isidentifier() else None


def load(name: str) -> Callable[..., int]:
    """Return the function of a verb; raises InputError where there is none."""
    from bench.config.choices import choices
    from bench.config.suggest import did_you_mean

    if name not in VERBS:
        near = f"did you mean method={name}? " if name in choices("method") else did_you_mean(name, VERBS)
        raise InputError("verb", name, f"{near}verbs: {', '.join(VERBS)}; fields are written name=value")
    verb: Callable[..., int] = getattr(import_module(f"bench.commands.{name}"), name)
    return verb


def execute(name: str, arguments: Sequence[str]) -> int:
    """Run a verb on the words behind it; raises InputError."""
    if "--version" in arguments:
        from bench import __version__

        print(__version__)
        return 0
    return call(f"{COMMAND} {name}", load(name), arguments)


def call(command: str, verb: Callable[..., int], arguments: Sequence[str]) -> int:
    """Show the help of a declared function, or call it with the fields of a command line; raises InputError."""
    from bench.commands.declaration import help_page, read_arguments

    if {"-h", "--help"} & set(arguments):
        print(help_page(command, verb))
        return 0
    return verb(**read_arguments(verb, arguments))


def summaries() -> str:
    """Return a line for each verb."""
    from bench.commands.declaration import summary

    return "\n".join(f"  {name:<16} {summary(load(name))}" for name in VERBS)
