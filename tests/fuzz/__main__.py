"""``python -m tests.fuzz [minutes=5] [what=records,lines] [seed=0]``: fuzz the reader of records and the command line.

From a clone. What is found is printed as small as it can be made, with the exit status 1; it becomes a case of
``tests/malformed.py``. A tenth of a minute of the same is among the tests.
"""

from __future__ import annotations

import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # where the tests find what they share

from forked import Forked
from hypothesis import HealthCheck, given, seed, settings

from fuzz.lines import LINES, check_line
from fuzz.records import OPTIONS, RECORDS, check_record
from tests.studies.fields import command, listed, one_of, positive, read_fields, whole

EXAMPLES = 200
"""Of a round; each round has a seed of its own."""
HURRY = settings(
    max_examples=EXAMPLES, deadline=None, database=None, suppress_health_check=list(HealthCheck), print_blob=False
)


def records(number: int) -> None:
    """A round over records."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "record"
        seed(number)(HURRY(given(RECORDS, OPTIONS)(lambda data, options: check_record(data, options, place))))()


def lines(number: int) -> None:
    """A round over command lines."""
    forked = Forked()
    try:
        seed(number)(HURRY(given(LINES)(lambda line: check_line(line, forked))))()
    finally:
        forked.close()


ROUNDS: dict[str, Callable[[int], None]] = {"records": records, "lines": lines}


def main(arguments: list[str]) -> int:
    """Fuzz for so many minutes; 1 where something is found."""
    fields = read_fields(arguments, {"minutes": "5", "what": ",".join(ROUNDS), "seed": "0"})
    until = time.monotonic() + 60 * positive("minutes", fields["minutes"], 10_000)
    number, what = (
        whole("seed", fields["seed"], 0),
        [one_of("what", name, list(ROUNDS)) for name in listed("what", fields["what"])],
    )
    warnings.simplefilter("error")
    tried = 0
    while tried == 0 or time.monotonic() < until:
        for name in what:
            try:
                ROUNDS[name](number)
            except AssertionError as error:
                print(f"{name}, seed={number}: {error}\n" + "\n".join(getattr(error, "__notes__", [])))
                return 1
            tried += EXAMPLES
        number += 1
    print(f"{tried} examples, up to seed {number - 1}: nothing found")
    return 0


if __name__ == "__main__":
    sys.exit(command("tests.fuzz", __doc__ or "", None, main))
