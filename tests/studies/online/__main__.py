"""Filters and windows where nothing changes, behind a fault, and on a long record."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated

from bench.commands.declaration import OneOf
from bench.isolation.machine import compiled_single_threaded, single_threaded
from bench.reporting.whole_file import write
from tests.studies.common import RESULTS, Count, Out, publish, study
from tests.studies.online.constant import constant
from tests.studies.online.faults import faults
from tests.studies.online.long import long_record

PARTS = ("constant", "faults", "long")
TITLE = """# Online methods where the truth is simple

Filters and windows where nothing changes, behind a fault, and on a long record. Changes: [Table 10](table10.md)."""
REGENERATE = "Regenerate: `python -m tests.studies.online` (from a clone)"


def online(
    part: Annotated[tuple[str, ...], OneOf(PARTS), "parts to compute"] = PARTS,
    records: Annotated[Count, "records of the part constant"] = 1000,
    replicates: Annotated[Count, "records of the part faults"] = 16,
    store: Annotated[Path, "folder of finished parts, which stand in the page, and of records"] = Path(
        "outputs/online_study"
    ),
    out: Out = RESULTS,
) -> int:
    """Measure online methods where the truth is simple: online.md.

    constant: errors at the end of records in which nothing changes, over the bound, and false alarms.
    faults: the error behind a fault.
    long: 100,000 samples, the memory that they take and the time of a sample.
    """
    single_threaded()
    compiled_single_threaded()
    parts: dict[str, Callable[[], str]] = {
        "constant": lambda: constant(records, store / "records", os.cpu_count() or 1),
        "faults": lambda: faults(replicates),
        "long": long_record,
    }
    store.mkdir(parents=True, exist_ok=True)
    for name in part:
        write(store / f"{name}.md", parts[name]() + "\n", store, "store")
    texts = [(store / f"{name}.md").read_text(encoding="utf-8") for name in PARTS if (store / f"{name}.md").is_file()]
    publish(out / "online.md", "\n".join([f"{TITLE}\n", *texts, REGENERATE]) + "\n")
    return 0


main = partial(study, online, "tests.studies.online")

if __name__ == "__main__":
    sys.exit(main())
