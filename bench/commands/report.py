"""The verb ``report``: the results as a site."""

from __future__ import annotations

from itertools import chain
from pathlib import Path
from typing import Annotated

from bench.commands.declaration import folder
from bench.commands.stores import OWN, ArchiveFolder, StoreFolder, named_store
from bench.errors import InputError

RESULTS = Path("results")


def report(
    store: StoreFolder = OWN,
    archive: ArchiveFolder = None,
    results: Annotated[Path, "folder of tables and figures"] = RESULTS,
    out: Annotated[Path, "folder of the site"] = Path("build/site"),
) -> int:
    """Build a site of a store: its results as pages that open without a network or server.

    It comes from stored cells, their arrays and the folder of results alone; the same store gives the same bytes. Open
    index.html. The published results are in the documentation, which mkdocs builds.
    """
    try:
        from bench.reporting.page.folder import check_folder, results_files, write_site
        from bench.reporting.page.site import site_files

        opened = named_store(store, archive, filled=True)
        if results != RESULTS:  # an installed package has none, and shows what is in the store
            folder("results", results)
        check_folder(out)
        write_site(out, chain(site_files(opened, results), results_files(results)))
    except ImportError as error:
        raise InputError("package", error.name, "missing: pip install 'vibration-bench[report]'") from None
    print(out / "index.html")
    return 0
