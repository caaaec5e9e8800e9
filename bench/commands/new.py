"""``python -m bench.new``: a small package of a method or a system of one's own to start from.

It has a ``pyproject.toml`` with the entry point that makes the name known, one module, a README, and a test that runs
``python -m bench.check``, which it passes as it is.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from bench.commands.fields import path_of, read_fields
from bench.commands.guard import command
from bench.errors import InputError

USAGE = """usage: python -m bench.new method <name> [out=<folder>]
       python -m bench.new system <name> [out=<folder>]

out: where it is written; by default <name> in the current folder\n\n"""


def main(argv: Sequence[str] | None = None) -> int:
    """Print the files written; exit status 2 for bad input."""
    return command("bench.new", USAGE + str(__doc__), argv, _main)


def _main(arguments: Sequence[str]) -> int:
    words = [argument for argument in arguments if "=" not in argument]
    if len(words) != 2:
        raise InputError("argument", " ".join(words), "write method <name> or system <name>")
    fields = read_fields([argument for argument in arguments if "=" in argument], {"out": words[1]})

    from bench.conformance.template_files import written

    for path in written(words[0], words[1], path_of(fields["out"])):
        print(path)
    print(f"try it: python -m bench.check {fields['out']}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
