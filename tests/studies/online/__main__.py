"""``python -m tests.studies.online part=constant,faults,long``: writes ``online.md``; finished parts are kept."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path

from bench.errors import InputError
from bench.isolation.machine import compiled_single_threaded, single_threaded
from tests.studies.fields import command, read_fields, whole
from tests.studies.online.constant import constant
from tests.studies.online.faults import faults
from tests.studies.online.live import live
from tests.studies.online.long import long_record

PARTS = ("constant", "faults", "long", "live")
FIELDS = {
    "part": "constant,faults,long", "records": "1000", "replicates": "16", "seconds": "60",
    "store": "outputs/online_study", "out": "results",
}  # fmt: skip
USAGE = """usage: python -m tests.studies.online [part=constant,faults,long] [records=1000]
       [replicates=16] [seconds=60] [store=outputs/online_study] [out=results]

  part        constant  errors at the end of records in which nothing changes,
                        over the bound, and false alarms; records= so many
              faults    the error behind a fault; replicates= so many records
              long      100,000 samples: memory, and the time of a sample
              live      a live run with its page in headless Chromium, for
                        seconds=; needs the extras twin and browser
  A part that was made before stands in store, and in the page; asked for, it
  is made anew, but for the records that are kept."""


def main(argv: Sequence[str] | None = None) -> int:
    """Make the parts that are asked for, and the page of all that there are."""
    return command("tests.studies.online", USAGE, argv, made)


def made(arguments: Sequence[str]) -> int:
    """Raises InputError."""
    fields = read_fields(arguments, FIELDS)
    asked = [part.strip() for part in fields["part"].split(",")]
    for part in asked:
        if part not in PARTS:
            raise InputError("part", part, f"some of {', '.join(PARTS)}")
    single_threaded()
    compiled_single_threaded()
    store, out = Path(fields["store"]), Path(fields["out"])
    store.mkdir(parents=True, exist_ok=True)
    for part in asked:
        if part == "constant":
            text = constant(whole("records", fields["records"]), store / "records", os.cpu_count() or 1)
        elif part == "faults":
            text = faults(whole("replicates", fields["replicates"]))
        elif part == "long":
            text = long_record()
        else:
            text = live(whole("seconds", fields["seconds"]), store)
        (store / f"{part}.md").write_text(text + "\n", encoding="utf-8")
    parts = [(store / f"{part}.md").read_text(encoding="utf-8") for part in PARTS if (store / f"{part}.md").is_file()]
    ended = "Regenerate: `python -m tests.studies.online part=constant,faults,long,live` (from a clone)"
    out.mkdir(parents=True, exist_ok=True)
    (out / "online.md").write_text("\n".join([f"{TITLE}\n", *parts, ended]) + "\n", encoding="utf-8")
    print(out / "online.md")
    return 0


TITLE = """# Online methods where the truth is simple

What filters and windows are worth where nothing changes, behind a fault, on a long record, and on a live stream.
Changes: [Table 10](table10.md)."""

if __name__ == "__main__":
    sys.exit(main())
