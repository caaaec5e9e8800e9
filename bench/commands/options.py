"""The options of a run, which are Hydra's; ``--help`` and ``--version`` are answered here."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field

from bench.errors import InputError

FLAGS = {
    "-m": "multirun", "--multirun": "multirun", "-r": "", "--run": "", "-h": "help", "--help": "help",
    "--version": "version",
}  # fmt: skip
COMPLETION = ("-sc", "--shell-completion", "--shell_completion")
CFG, INFO = ("job", "hydra", "all"), ("all", "config", "defaults", "defaults-tree", "plugins", "searchpath")
SHOWN = {"--cfg": CFG, "-c": CFG, "--info": INFO, "-i": INFO}
"""Options by which Hydra shows a configuration, with their values; the first value is the default."""
PACKAGE, ALONE = ("-p", "--package"), ("--resolve", "--hydra-help", *COMPLETION)


@dataclass
class Options:
    """The words of a command line: options of the run, options that Hydra answers, and ``field=value``."""

    flags: set[str] = field(default_factory=set)
    shown: list[str] = field(default_factory=list)
    words: list[str] = field(default_factory=list)

    @property
    def completes(self) -> bool:
        """Return whether the shell asks for completions."""
        return bool(set(COMPLETION) & set(self.shown))


def read_options(arguments: Sequence[str]) -> Options:
    """Sort the words of a command line; raises InputError for an option that does not exist."""
    options, rest = Options(), list(arguments)
    while rest:
        word = rest.pop(0)
        name, _, value = word.partition("=") if word.startswith("--") else (word, "", "")
        if not name.startswith("-"):
            if "=" not in name and os.path.isfile(name):
                remedy = f"write data={name}, or python -m bench certify {name}"
                raise InputError("argument", name, remedy)
            options.words.append(name)
        elif name in FLAGS:
            options.flags.add(FLAGS[name])
        elif name in SHOWN:
            options.shown += [name, value or (rest.pop(0) if rest and rest[0] in SHOWN[name] else SHOWN[name][0])]
        elif name in PACKAGE:
            options.shown += [name, value or (rest.pop(0) if rest else "")]
        elif name in ALONE:
            options.shown.append(name)
        else:
            from bench.config.fields import declared

            bare = name.lstrip("-").replace("-", "_")
            near = f"; a field has no dashes: {bare}=<value>" if bare in declared() else ""
            known = "options are -m, -v, -q, --cfg, --info, --package, --resolve, -sc, --hydra-help, --version, --help"
            raise InputError("option", word, known + near)
    return options
