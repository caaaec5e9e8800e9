"""``python -m tests.studies.engines``: what a fit costs, beside goals, floors, an earlier checkout and other engines.

Every row is measured in fresh processes with limits of time and memory; ``before=`` names the folder of another
checkout, whose code then takes turns with this one's in the same run. The page is ``<out>/engines.md``, the numbers
``<out>/engines.csv``, the picture of growth ``<out>/figures/engines_scaling.png``.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from bench.engine.progress import counter
from bench.errors import InputError
from bench.isolation.machine import single_threaded
from bench.store.store import Store
from tests.studies.fields import command, flag, read_fields, whole

if TYPE_CHECKING:
    from tests.studies.engines.page import Study

TABLE = "engines.csv"
USAGE = """usage: python -m tests.studies.engines [rows=<a,b>|none] [before=<folder of an earlier checkout>]
                                           [scaling=true|false] [rivals=true|false] [rival_python=<with their packages>]
                                           [limit_s=120] [out=results] [fit=true]
fit=false: the picture alone, of the numbers in <out>/engines.csv; nothing is measured"""


@dataclass(frozen=True)
class Options:
    """What the command line says."""

    rows: tuple[str, ...]
    before: Path | None
    scaling: bool
    rivals: bool
    rival_python: str
    limit_s: float
    out: Path
    fit: bool


def read_options(arguments: Sequence[str]) -> Options:
    """The arguments, checked; raises InputError. Named rows alone come without the picture and the rivals."""
    from tests.studies.engines.rows import rows

    texts = dict.fromkeys(("rows", "before", "scaling", "rivals"), "")
    texts |= {"rival_python": sys.executable, "limit_s": "120", "out": "results", "fit": "true"}
    texts = read_fields(arguments, texts)
    known = rows()
    chosen = () if texts["rows"] == "none" else tuple(filter(None, texts["rows"].split(","))) or tuple(known)
    for name in chosen:
        if name not in known:
            raise InputError("rows", name, f"known: {', '.join(known)}, or none")
    before = Path(texts["before"]).resolve() if texts["before"] else None
    if before and not (before / "bench" / "config" / "experiment.py").is_file():
        raise InputError("before", before, "the folder of a checkout of this repository")
    whole_run = "false" if texts["rows"] else "true"
    flags = {name: texts[name] or whole_run for name in ("scaling", "rivals")}
    for name, text in flags.items():
        if text not in ("true", "false"):
            raise InputError(name, text, "true or false")
    python = str(Path(texts["rival_python"]).absolute())
    if not Path(python).is_file():
        raise InputError("rival_python", python, "the path of a Python interpreter")
    limit, wanted = float(whole("limit_s", texts["limit_s"])), {name: text == "true" for name, text in flags.items()}
    out, fit = Path(texts["out"]), flag("fit", texts["fit"])
    if not fit and not (out / TABLE).is_file():
        raise InputError("out", out, f"a folder with {TABLE}; without fit=false it is measured")
    return Options(chosen, before, wanted["scaling"], wanted["rivals"], python, limit, out, fit)


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, and write page, numbers and picture; exit status 2 for bad input, 130 interrupted."""
    return command("tests.studies.engines", f"{USAGE}\n\n{__doc__}", argv, _main)


def _main(arguments: Sequence[str]) -> int:
    single_threaded()  # before numpy: this process measures the rates of the floors
    chosen = read_options(arguments)
    Store(chosen.out / "figures").prepare()
    for path in _measured_page(chosen) if chosen.fit else _drawn(chosen.out):
        print(path)
    return 0


def _drawn(out: Path) -> list[Path]:
    """The picture of the stored numbers; its files, none where no curve is stored."""
    import pandas as pd

    from tests.studies.engines.picture import picture, stored_growths

    growths = stored_growths(pd.read_csv(out / TABLE))
    return picture(growths, out / "figures") if growths else []


def _measured_page(chosen: Options) -> list[Path]:
    """Measure, and write page, numbers and picture; the files."""
    from tests.studies.engines.page import page, tidy
    from tests.studies.engines.picture import picture

    study = _measured(chosen)
    written = [chosen.out / "engines.md", chosen.out / TABLE]
    written[0].write_text(page(study), encoding="utf-8")
    written[1].write_text(tidy(study).to_csv(index=False, float_format="%.4g"), encoding="utf-8")
    return written + (picture(study.growths, chosen.out / "figures") if study.growths else [])


def _measured(chosen: Options) -> Study:
    from tests.studies.engines import floors, peers, results
    from tests.studies.engines.page import Study
    from tests.studies.engines.rivals import RIVALS, STARTS
    from tests.studies.engines.rows import CURVES, rows

    curves = CURVES if chosen.scaling else ()
    total = len(chosen.rows) + sum(len(curve.sizes) for curve in curves)
    total += (2 + len(RIVALS) * len(STARTS)) if chosen.rivals else 0
    machine, found = floors.rates(), []
    with counter("measurement", total) as advance:
        for name in chosen.rows:
            result = results.measure(rows()[name], chosen.limit_s, chosen.before)
            found.append(replace(result, floor_s=floors.floor(result.row, result.now.evaluations, machine)))
            advance()
        growths = [results.grow(curve, chosen.limit_s, advance) for curve in curves]
        others = peers.compare(chosen.limit_s, chosen.rival_python, advance) if chosen.rivals else []
    return Study(found, growths, others, machine, chosen.limit_s)


if __name__ == "__main__":
    sys.exit(main())
