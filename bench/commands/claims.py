"""``python -m bench.claims``: every claim of the documents beside the results it rests on.

The documents are README.md, the paper, the pages of docs/ and results/README.md below ``root``. Prints of each claim
whether it passes, its numbers, and what must be so for it to be true. ``write=true`` fills the numbers in, and the
panels of tables with them. Exit status 1 where a claim does not hold, a text or a panel says something else, or a
number is typed by hand.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from bench.commands.fields import flag, folder_of, read_fields
from bench.commands.guard import command
from bench.commands.stores import store_of
from bench.reporting.whole_file import write
from bench.store.opening import DEFAULT_STORE

if TYPE_CHECKING:
    from bench.reporting.claims.document import Checked

USAGE = (
    f"usage: python -m bench.claims [write=true] [root=.] [results=results] [store={DEFAULT_STORE}] "
    "[archive=<folder>|none]"
)


def main(argv: Sequence[str] | None = None) -> int:
    """Check, and with ``write=true`` fill in; exit status 1 where something disagrees, 2 for bad input."""
    return command("bench.claims", f"{USAGE}\n\n{__doc__}", argv, _main)


def _main(arguments: Sequence[str]) -> int:
    from bench.reporting.claims.document import check, documents, typed_in_claims
    from bench.reporting.claims.evidence import Evidence

    known = {"write": "false", "root": ".", "results": "results", "store": DEFAULT_STORE, "archive": ""}
    fields = read_fields(arguments, known)
    writing, store = flag("write", fields["write"]), store_of(fields)
    root, results = folder_of("root", fields["root"]), folder_of("results", fields["results"])
    pages, evidence = documents(root), Evidence(results, store)
    checked = list(check(pages, evidence))
    anew = [page.written(checked, results) for page in pages]
    if writing and anew != pages:
        for page in (page for page in anew if page not in pages):
            write(root / page.path, page.text, field="root")
            print(f"{page.path}: written", file=sys.stderr)
        pages, checked = anew, list(check(anew, evidence))
    for one in checked:
        print(_lines(one))
    loose = [f"{page.path}: {place}" for page in pages for place in page.typed()]
    loose += [f"claim {name}: {place}" for name, places in typed_in_claims().items() for place in places]
    for place in loose:
        print(f"typed by hand: {place}")
    passed = sum(one.passes for one in checked)
    print(f"{passed} of {len(checked)} claims pass; {len(loose)} numbers are typed by hand")
    for page in (page for page, new in zip(pages, anew, strict=True) if page != new):
        print(f"{page.path}: its passages or the panel of a table differ: write=true fills them in")
    return 0 if passed == len(checked) and not loose and pages == anew else 1


def _lines(one: Checked) -> str:
    """A claim: whether it passes, its numbers, and what must be so for it to be true."""
    if one.said is None:
        return f"{one.claim.name}: UNKNOWN: {one.problem}"
    wrong = [f"FALSE: {condition}" for condition in one.said.broken]
    wrong += [] if one.agrees else ["THE TEXT DIFFERS OR IS IN NO DOCUMENT: write=true fills it in"]
    numbers = ", ".join(f"{name} {value}" for name, value in one.said.numbers.items())
    conditions = "; ".join(one.said.conditions)
    return f"{one.claim.name}: {'; '.join(wrong) or 'holds'}\n    {numbers}\n    while {conditions}"


if __name__ == "__main__":
    sys.exit(main())
