"""The command line: a verb, or a run where the first word is none."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from bench.isolation.secrecy import hide_arguments


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status: 0, 1 as the verb says, 2 for bad input, 130 when interrupted."""
    from bench.commands.guard import guarded
    from bench.commands.log import messages
    from bench.commands.verbs import RUN, execute, named_verb

    if argv is None:
        hide_arguments()
    with messages(sys.argv[1:] if argv is None else argv) as words:
        verb = named_verb(words)
        if verb is not None:
            words.remove(verb)
        if verb is not None and verb not in RUN:
            return guarded("bench", lambda: execute(verb, words))
        measured = any(word.startswith(("data=", "+data=")) for word in words)
        kept = (
            "results of a record are not saved" if measured else "finished cells are kept; the same command continues"
        )
        return guarded("bench", lambda: _run(words, early=argv is None), f"interrupted; {kept}")


def _run(words: Sequence[str], early: bool) -> int:
    """Run cells, identify a measured record, or run an experiment that has fields of its own."""
    from bench.commands.run import read_options, run
    from bench.commands.verbs import track
    from bench.config.choices import TRACKS

    name = next((name for name in TRACKS if {f"experiment={name}", f"+experiment={name}"} & set(words)), "")
    if not name:
        return run(read_options(words), early)
    selecting = ("-m", "--multirun", f"experiment={name}", f"+experiment={name}")
    return track(name, [word for word in words if word not in selecting])
