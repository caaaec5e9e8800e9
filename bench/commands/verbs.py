"""The verbs of ``python -m bench <verb> name=value ...``: selection, call, help and completion."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from importlib import import_module

from bench.errors import InputError, did_you_mean

VERBS = {
    "certify": "Write the certificate of a measured record, as a page and as JSON.",
    "design": "Design the smallest free decay that reaches a wanted accuracy.",
    "track": "Track the parameters of a system in a stream of samples.",
    "identifiability": "State which quantities the data of a scenario determine.",
    "audit": "State what the data of a published claim allow, and where its numbers fall.",
    "tables": "Write the tables of all experiments; what=frame, figures, claims, audits, all.",
    "report": "Build the site: the results as pages for a browser.",
    "status": "Show what is stored, failed, stale and missing, and why.",
    "reproduce": "Run a stored cell again and compare it with the stored one.",
    "check": "Check that a method or a system keeps the contract.",
    "new": "Write a small package with a method or a system to start from.",
    "round": "Make a round of problems whose truth is hidden: new, solve, open, verify.",
    "score": "Score a file of predictions of a round.",
    "share": "Share results: action=submit, merge, export or publish.",
}
"""The verbs with a line of help each. The function of a verb has its name, in the module of its name."""
RUN = ("run", "identify")
"""Optional verbs of a run of cells and of the identification of a measured record (data=)."""
COMMAND = "python -m bench"


def named_verb(arguments: Sequence[str]) -> str | None:
    """Return the verb of a command line: its first word after --help and --version; None for a run."""
    first = next((word for word in arguments if word not in ("-h", "--help", "--version")), "")
    return first if first.isidentifier() else None


def variants(name: str) -> dict[str, Callable[..., int]]:
    """Return the functions of a verb by the words that select them, ``field`` or ``field=value``, "" by default.

    Raises InputError for an unknown verb.
    """
    from bench.config.choices import choices

    if name not in VERBS:
        near = f"did you mean method={name}? " if name in choices("method") else did_you_mean(name, list(VERBS))
        raise InputError("verb", name, f"{near}verbs: {', '.join(VERBS)}; fields are written name=value")
    module = import_module(f"bench.commands.{name}")
    return {"": getattr(module, name), **getattr(module, "VARIANTS", {})}


def execute(name: str, words: Sequence[str]) -> int:
    """Run a verb on the words that follow it, or print its help; raises InputError."""
    from bench.config.declaration import fields_of

    functions, command = variants(name), f"{COMMAND} {name}"
    chosen = _selected(functions, words)
    shown = {chosen: functions[chosen]} if chosen else functions
    pages = [(command if key in fields_of(verb) else f"{command} {key}".rstrip(), verb) for key, verb in shown.items()]
    return call(functions[chosen], [word for word in words if word not in chosen.split()], pages)


def track(name: str, words: Sequence[str]) -> int:
    """Run an experiment that has its own fields, or print its help; raises InputError."""
    from bench.config.choices import TRACKS

    verb: Callable[..., int] = getattr(import_module(f"bench.commands.{TRACKS[name]}"), name)
    return call(verb, words, [(f"{COMMAND} -m experiment={name}", verb)])


def call(verb: Callable[..., int], words: Sequence[str], pages: Sequence[tuple[str, Callable[..., int]]]) -> int:
    """Call a verb with the fields of its command line, or print the version, or the pages of help."""
    from bench.commands.declaration import help_page, read_arguments

    if "--version" in words:
        from bench import __version__

        print(__version__)
        return 0
    if {"-h", "--help"} & set(words):
        print(*dict.fromkeys(help_page(command, shown) for command, shown in pages), sep="\n\n")
        return 0
    return verb(**read_arguments(verb, words))


def _selected(keys: Collection[str], words: Sequence[str]) -> str:
    """Return the key of the function that the words select; raises InputError for an unknown choice."""
    parts = [part for key in keys for part in key.split()]
    for word in words:
        name, _, value = word.partition("=")
        choices = list(dict.fromkeys(part.partition("=")[2] for part in parts if part.startswith(f"{name}=")))
        if choices and value not in choices:
            raise InputError(name, value, f"{did_you_mean(value, choices)}one of {', '.join(choices)}, or leave it out")
    names = {*words, *(word.partition("=")[0] for word in words)}
    return next((key for key in keys if key and names.issuperset(key.split())), "")


def completed(line: str) -> list[str]:
    """Return the completions of a shell's line: verbs, or the fields of a verb and their values."""
    from bench.commands.declaration import completions

    words = line.split()
    words = words[next((i + 1 for i, word in enumerate(words) if word.endswith("bench")), 0) :]
    last = words.pop() if words and not line.endswith(" ") else ""
    if not words:
        return [name for name in VERBS if last and name.startswith(last)]
    if words[0] not in VERBS:
        return []
    functions = variants(words[0])
    choices = [part for key in functions for part in key.split() if "=" in part and part.startswith(last)]
    return list(dict.fromkeys([*choices, *completions(functions[_selected(functions, words)], last)]))


def summaries() -> str:
    """Return a line for each verb."""
    return "\n".join(f"  {name:<15} {line}" for name, line in VERBS.items())
