"""Fuzz the reader of records and the command line, from a clone."""

from __future__ import annotations

import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

sys.path.insert(0, str(Path(__file__).parents[1]))  # where the tests find what they share

from forked import Forked
from hypothesis import HealthCheck, given, settings
from hypothesis import seed as seeded

from bench.commands.declaration import OneOf, Within
from fuzz.lines import LINES, check_line
from fuzz.records import OPTIONS, RECORDS, check_record
from tests.studies.common import study

EXAMPLES = 200
"""Examples of a round; each round has a seed of its own."""
HURRY = settings(
    max_examples=EXAMPLES, deadline=None, database=None, suppress_health_check=list(HealthCheck), print_blob=False
)


def records(number: int) -> None:
    """A round over records."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "record"
        seeded(number)(HURRY(given(RECORDS, OPTIONS)(lambda data, options: check_record(data, options, place))))()


def lines(number: int) -> None:
    """A round over command lines."""
    forked = Forked()
    try:
        seeded(number)(HURRY(given(LINES)(lambda line: check_line(line, forked))))()
    finally:
        forked.close()


ROUNDS: dict[str, Callable[[int], None]] = {"records": records, "lines": lines}


def fuzz(
    minutes: Annotated[float, Within(gt=0, le=10_000), "duration"] = 5.0,
    what: Annotated[tuple[str, ...], OneOf(tuple(ROUNDS)), "what is fuzzed"] = tuple(ROUNDS),
    seed: Annotated[int, Within(ge=0), "seed of the first round"] = 0,
) -> int:
    """Fuzz the reader of records and the command line.

    What fails is printed as small as it can be made, with the exit status 1; it becomes a case of tests/malformed.py. A
    tenth of a minute of the same is among the tests.
    """
    until, tried = time.monotonic() + 60 * minutes, 0
    warnings.simplefilter("error")
    while tried == 0 or time.monotonic() < until:
        for name in what:
            try:
                ROUNDS[name](seed)
            except AssertionError as error:
                print(f"{name}, seed={seed}: {error}\n" + "\n".join(getattr(error, "__notes__", [])))
                return 1
            tried += EXAMPLES
        seed += 1
    print(f"{tried} examples, up to seed {seed - 1}: no failure")
    return 0


if __name__ == "__main__":
    sys.exit(study(fuzz, "tests.fuzz"))
