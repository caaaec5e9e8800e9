"""The verb ``report``: build the site of results."""

from __future__ import annotations

from itertools import chain
from pathlib import Path
from typing import Annotated

from bench.commands.declaration import folder
from bench.commands.log import LOG
from bench.commands.stores import DEFAULT, ArchiveFolder, StoreFolder, named_store

RESULTS = Path("results")


def report(
    store: StoreFolder = DEFAULT,
    archive: ArchiveFolder = None,
    results: Annotated[Path, "folder of tables and figures"] = RESULTS,
    out: Annotated[Path, "folder of the site"] = Path("build/site"),
) -> int:
    """Build the site of a store, whose pages open without a network or server; start with index.html.

    The same store and results give the same bytes.
    """
    from bench.reporting.page.folder import check_folder, results_files, write_site
    from bench.reporting.page.site import site_files

    opened = named_store(store, archive, filled=True)
    if results != RESULTS:  # an installed package has no folder of results
        folder("results", results)
    check_folder(out)
    LOG.info("building the site, which takes about a minute for the published results")
    write_site(out, chain(site_files(opened, results), results_files(results)))
    print(out / "index.html")
    return 0
