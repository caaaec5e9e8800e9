"""``python -m bench.report``: the results as one page, without network.

From stored cells, their arrays and the files beside the store (tables, figures) alone; nothing is computed anew but
ranks. The same store gives the same bytes.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from bench.commands.fields import path_of, read_fields
from bench.commands.guard import command
from bench.commands.stores import FIELDS, filled_store
from bench.reporting.page.page import page
from bench.reporting.whole_file import check_file, write
from bench.store.opening import DEFAULT_STORE


def main(argv: Sequence[str] | None = None) -> int:
    """Write the page; exit status 2 for bad input."""
    usage = f"usage: python -m bench.report [store={DEFAULT_STORE}] [archive=<folder>|none] [out=results/report.html]"
    return command("bench.report", f"{usage}\n\n{__doc__}", argv, _main)


def _main(arguments: Sequence[str]) -> int:
    try:
        fields = read_fields(arguments, {**FIELDS, "out": "results/report.html"})
        store, out = filled_store(fields), path_of(fields["out"])
        check_file(out)
        write(out, page(store, out))
        print(out)
    except ImportError as error:
        print(f"bench.report: {error.name} is missing: pip install 'vibration-bench[report]'", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
