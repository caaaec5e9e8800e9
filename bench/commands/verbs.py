"""The verbs of ``python -m bench <verb> name=value ...``, and how each is run."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from importlib import import_module

from bench.errors import InputError

VERBS = ("certify", "design", "track", "identifiability", "tables", "report", "check", "new")
"""Each is the function of its name in the module of its name; a line without one of them is a run."""
COMMAND = "python -m bench"


def named_verb(arguments: Sequence[str]) -> str | None:
    """Return the verb of a command line: its first word, which --help or --version may precede; None for a run."""
    first = next((word for word in arguments if word not in ("-h", "--help", "--version")), "")
    return first if first.isidentifier() else None


def variants(name: str) -> dict[str, Callable[..., int]]:
    """Return the functions of a verb by the word that selects them: ``field`` or ``field=value``; "" is the verb's own.

    Raises InputError where there is no such verb.
    """
    from bench.config.choices import choices
    from bench.config.suggest import did_you_mean

    if name not in VERBS:
        near = f"did you mean method={name}? " if name in choices("method") else did_you_mean(name, VERBS)
        raise InputError("verb", name, f"{near}verbs: {', '.join(VERBS)}; fields are written name=value")
    module = import_module(f"bench.commands.{name}")
    return {"": getattr(module, name), **getattr(module, "VARIANTS", {})}


def execute(name: str, words: Sequence[str]) -> int:
    """Run a verb on the words behind it, or show its help; raises InputError."""
    from bench.commands.declaration import help_page, read_arguments

    functions, command = variants(name), f"{COMMAND} {name}"
    if "--version" in words:
        from bench import __version__

        print(__version__)
        return 0
    chosen = _selected(functions, words)
    if {"-h", "--help"} & set(words):
        shown = {chosen: functions[chosen]} if chosen else functions
        pages = {verb: help_page(f"{command} {key}" if "=" in key else command, verb) for key, verb in shown.items()}
        print("\n\n".join(pages.values()))
        return 0
    verb = functions[chosen]
    return verb(**read_arguments(verb, [word for word in words if word != chosen]))


def _selected(keys: Collection[str], words: Sequence[str]) -> str:
    """Return the key of the function that the words select; raises InputError for a choice that selects none."""
    from bench.config.suggest import did_you_mean

    for word in words:
        name, _, value = word.partition("=")
        choices = [key.partition("=")[2] for key in keys if key.startswith(f"{name}=")]
        if choices and value not in choices:
            raise InputError(name, value, f"{did_you_mean(value, choices)}one of {', '.join(choices)}, or leave it out")
    return next((key for key in keys if key and any(f"{word}=".startswith(f"{key}=") for word in words)), "")


def summaries() -> str:
    """Return a line for each verb."""
    from bench.commands.declaration import summary

    return "\n".join(f"  {name:<16} {summary(variants(name)[''])}" for name in VERBS)
