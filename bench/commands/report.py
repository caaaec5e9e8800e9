"""``python -m bench.report``: the results as one page, without network.

From stored cells, their arrays and the files beside the store (tables, figures) alone; nothing is computed anew but
ranks. The same store gives the same bytes.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from bench.commands.guard import command, read_fields
from bench.reporting.page.page import page
from bench.reporting.whole_file import write
from bench.store.opening import DEFAULT_STORE, open_store


def main(argv: Sequence[str] | None = None) -> int:
    """Write the page; exit status 2 for bad input."""
    usage = f"usage: python -m bench.report [store={DEFAULT_STORE}] [archive=<folder>|none] [out=results/report.html]"
    return command("bench.report", f"{usage}\n\n{__doc__}", argv, _main)


def _main(arguments: Sequence[str]) -> int:
    try:
        fields = read_fields(arguments, {"store": DEFAULT_STORE, "archive": "", "out": "results/report.html"})
        out = Path(fields["out"])
        write(out, page(open_store(fields["store"], fields["archive"]), out))
        print(out)
    except ImportError as error:
        print(f"bench.report: {error.name} is missing: pip install 'vibration-bench[report]'", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
