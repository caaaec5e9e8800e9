"""``python -m bench.report``: the results as a folder of pages that opens from a disk, without network or server.

From stored cells, their arrays and the folder ``results`` (tables, figures) alone; nothing is computed anew but ranks.
The same store gives the same bytes. Open ``index.html``.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from bench.commands.fields import folder_of, path_of, read_fields
from bench.commands.guard import command
from bench.commands.stores import FIELDS, filled_store
from bench.reporting.page.folder import check_folder, write_folder
from bench.reporting.page.site import site_files
from bench.store.opening import DEFAULT_STORE

RESULTS = "results"


def main(argv: Sequence[str] | None = None) -> int:
    """Write the site; exit status 2 for bad input."""
    places = f"[results={RESULTS}] [out=build/site]"
    usage = f"usage: python -m bench.report [store={DEFAULT_STORE}] [archive=<folder>|none] {places}"
    return command("bench.report", f"{usage}\n\n{__doc__}", argv, _main)


def _main(arguments: Sequence[str]) -> int:
    try:
        fields = read_fields(arguments, {**FIELDS, "results": RESULTS, "out": "build/site"})
        store, out, results = filled_store(fields), path_of(fields["out"]), path_of(fields["results"])
        if fields["results"] != RESULTS:  # an installed package has none, and shows what is in the store
            folder_of("results", fields["results"])
        check_folder(out)
        write_folder(out, site_files(store, results))
        print(out / "index.html")
    except ImportError as error:
        print(f"bench.report: {error.name} is missing: pip install 'vibration-bench[report]'", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
