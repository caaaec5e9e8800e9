"""``python -m bench.claims``: every claim of README.md beside the results it rests on.

Prints of each claim whether it passes, its numbers, and what must be so for it to be true. ``write=true`` fills the
numbers in, and the panel of Table 3 with them. Exit status 1 where a claim does not hold, the text or the panel says
something else, or a number is typed by hand.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from bench.commands.fields import file_of, flag, folder_of, read_fields, text_of
from bench.commands.guard import command
from bench.commands.stores import store_of
from bench.reporting.whole_file import write
from bench.store.opening import DEFAULT_STORE

if TYPE_CHECKING:
    from bench.reporting.claims.document import Checked

USAGE = (
    f"usage: python -m bench.claims [write=true] [document=README.md] [results=results] [store={DEFAULT_STORE}] "
    "[archive=<folder>|none]"
)


def main(argv: Sequence[str] | None = None) -> int:
    """Check, and with ``write=true`` fill in; exit status 1 where something disagrees, 2 for bad input."""
    return command("bench.claims", f"{USAGE}\n\n{__doc__}", argv, _main)


def _main(arguments: Sequence[str]) -> int:
    from bench.reporting.claims.document import check, filled, typed, typed_in_claims, with_panels
    from bench.reporting.claims.evidence import Evidence

    known = {"write": "false", "document": "README.md", "results": "results", "store": DEFAULT_STORE, "archive": ""}
    fields = read_fields(arguments, known)
    writing, store = flag("write", fields["write"]), store_of(fields)
    path = file_of("document", fields["document"], "run the command in a clone")
    text, results = text_of("document", path), folder_of("results", fields["results"])
    evidence = Evidence(results, store)
    checked = list(check(text, evidence))
    if writing and (new := with_panels(filled(text, checked), results)) != text:
        write(path, new, field="document")
        print(f"{path}: written", file=sys.stderr)
        text, checked = new, list(check(new, evidence))
    loose = [*typed(text), *(one for found in typed_in_claims().values() for one in found)]
    for one in checked:
        print(_lines(one))
    for place in loose:
        print(f"typed by hand: {place}")
    passed = sum(one.passes for one in checked)
    print(f"{passed} of {len(checked)} claims pass; {len(loose)} numbers are typed by hand")
    stale = with_panels(text, results) != text
    if stale:
        print("the panel of a table differs: write=true fills it in")
    return 0 if passed == len(checked) and not loose and not stale and filled(text, checked) == text else 1


def _lines(one: Checked) -> str:
    """A claim: whether it passes, its numbers, and what must be so for it to be true."""
    if one.said is None:
        return f"{one.claim.name}: UNKNOWN: {one.problem}"
    wrong = [f"FALSE: {condition}" for condition in one.said.broken]
    wrong += [] if one.agrees else ["THE TEXT DIFFERS: write=true fills it in"]
    numbers = ", ".join(f"{name} {value}" for name, value in one.said.numbers.items())
    conditions = "; ".join(one.said.conditions)
    return f"{one.claim.name}: {'; '.join(wrong) or 'holds'}\n    {numbers}\n    while {conditions}"


if __name__ == "__main__":
    sys.exit(main())
