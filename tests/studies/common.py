"""Helpers of the studies: a command line of typed fields, scenarios, progress, written results."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

from bench.commands.declaration import Within, help_page, read_arguments
from bench.commands.guard import guarded
from bench.config.declaration import fields_of
from bench.engine.progress import counter
from bench.reporting.whole_file import check_folder, write

if TYPE_CHECKING:
    from bench.scenario.scenario import Scenario

Item = TypeVar("Item")
Count = Annotated[int, Within(ge=1, le=10**9)]
Out = Annotated[Path, "folder of the results"]
RESULTS = Path("results")


def study(
    function: Callable[..., int], name: str, argv: Sequence[str] | None = None, interrupted: str = "interrupted"
) -> int:
    """Run a function of typed fields as the command ``python -m <name>``; exit status 2 for bad input.

    Args:
        function: The study; its docstring is the page of help. Its field ``out``, a folder, is tried before any work.
        name: The module that is run.
        argv: The words of the command line, those of this process if None.
        interrupted: What is said after Ctrl-C.
    """
    words = sys.argv[1:] if argv is None else argv

    def run() -> int:
        if {"-h", "--help"} & set(words):
            print(help_page(f"python -m {name}", function))
            return 0
        values = read_arguments(function, words)
        fields = fields_of(function)
        if "out" in fields:
            check_folder(values.get("out", fields["out"].default))
        return function(**values)

    return guarded(name, run, interrupted)


def scenario(**fields: object) -> Scenario:
    """Return a scenario by fields of a run, e.g. ``system="sdof", snr=20``."""
    from bench.config.experiment import expand

    words = [f"{name}={value}" for name, value in {"method": "prior", **fields}.items()]
    return expand(words, multirun=False)[0].scenario


def tracked(items: Sequence[Item], unit: str) -> Iterator[Item]:
    """Yield the items, with their progress on the error stream."""
    with counter(unit, len(items)) as advance:
        for item in items:
            yield item
            advance()


def publish(path: Path, text: str) -> None:
    """Write a file of results, and print its path."""
    write(path, text, path.parent)
    print(path)
