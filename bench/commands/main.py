"""The command line: a verb, or a run where the first word is none."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from bench.isolation.secrecy import hide_arguments


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status: 0, 2 for bad input, 130 when interrupted."""
    from bench.commands.guard import guarded
    from bench.commands.options import read_options
    from bench.commands.run import run
    from bench.commands.verbs import RUN, execute, named_verb

    arguments = list(sys.argv[1:] if argv is None else argv)
    if argv is None:
        hide_arguments()
    verb = named_verb(arguments)
    if verb is not None:
        arguments.remove(verb)
    if verb is not None and verb not in RUN:
        return guarded("bench", lambda: execute(verb, arguments))
    kept = "interrupted; finished cells are kept, the same command goes on from here"
    return guarded("bench", lambda: run(read_options(arguments), early=argv is None), kept)
