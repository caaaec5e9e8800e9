"""``share action=publish``: write the cells of a store to the published archive."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from bench.commands.stores import DEFAULT, StoreFolder, named_store
from bench.errors import InputError


def publish(
    store: StoreFolder = DEFAULT,
    archive: Annotated[Path | None, "folder of the published archive [that of the checkout]"] = None,
) -> int:
    """Write the cells of a store to the published archive, one file per experiment."""
    from bench.exchange.publishing import described, write_published
    from bench.reporting.whole_file import check_folder
    from bench.store.archive import Archive
    from bench.store.store import NONE, default_archive

    known = default_archive()
    published = Archive(archive or Path("results/archive" if known == NONE else known))
    folder, computed = published.folder, named_store(store, NONE, filled=True)
    check_folder(folder, "archive")
    try:
        changed = write_published(computed, published, described())
    except InputError:
        raise
    except (OSError, ValueError) as error:
        raise InputError("archive", folder, f"written only in part ({error})") from None
    for path in changed:
        print(f"{path}: {f'{path.stat().st_size / 1e6:.2f} MB' if path.exists() else 'removed'}")
    sizes = [path.stat().st_size for path in folder.rglob("*.parquet")]
    print(f"{len(changed)} of {len(sizes)} files written; the archive takes {sum(sizes) / 1e6:.2f} MB")
    return 0
