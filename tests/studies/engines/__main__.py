"""Cost of a fit beside goals, an earlier checkout and other engines."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import Annotated

import pandas as pd

from bench.commands.declaration import OneOf
from bench.errors import InputError
from tests.studies.common import RESULTS, Count, Out, publish, study, tracked
from tests.studies.engines import peers, results
from tests.studies.engines.page import Study, page, tidy
from tests.studies.engines.picture import picture, stored_growths
from tests.studies.engines.rows import CURVES
from tests.studies.engines.rows import rows as known_rows

TABLE = "engines.csv"
ROWS = known_rows()


def engines(
    rows: Annotated[tuple[str, ...], OneOf((*ROWS, "none")), "rows of the table; left out: all"] = (),
    before: Annotated[Path | None, "folder of an earlier checkout, whose code takes turns with this one's"] = None,
    scaling: Annotated[bool | None, "measure the curves of growth; left out: with all rows only"] = None,
    rivals: Annotated[bool | None, "measure the other engines; left out: with all rows only"] = None,
    rival_python: Annotated[Path | None, "interpreter that has their packages; left out: this one"] = None,
    limit_s: Annotated[Count, "s of the processor, limit of a run"] = 120,
    out: Out = RESULTS,
    fit: Annotated[bool, "false: the picture alone, of the numbers in <out>/engines.csv"] = True,
) -> int:
    """Measure what a fit costs, beside goals, an earlier checkout and other engines: engines.md and .csv.

    Every row is measured in fresh processes with limits of time and memory. The picture of growth is
    figures/engines_scaling.png.
    """
    if before and not (before / "bench" / "config" / "experiment.py").is_file():
        raise InputError("before", before, "the folder of a checkout of this repository")
    if rival_python and not rival_python.is_file():
        raise InputError("rival_python", rival_python, "the path of a Python interpreter")
    if fit:
        chosen = [name for name in rows or ROWS if name != "none"]
        grown, others = (not rows if wanted is None else wanted for wanted in (scaling, rivals))
        python = str((rival_python or Path(sys.executable)).absolute()) if others else ""
        study = measured(chosen, before and before.resolve(), grown, python, limit_s)
        publish(out / "engines.md", page(study))
        publish(out / TABLE, tidy(study).to_csv(index=False, float_format="%.4g"))
        growths = study.growths
    elif (out / TABLE).is_file():
        growths = stored_growths(pd.read_csv(out / TABLE))
    else:
        raise InputError("out", out, f"a folder with {TABLE}; without fit=false it is measured")
    if growths:
        print(*picture(growths, out / "figures"), sep="\n")
    return 0


def measured(rows: list[str], before: Path | None, scaling: bool, rival_python: str, limit_s: float) -> Study:
    """Measure rows, the curves of growth, and other engines where an interpreter is given."""
    lines = [results.measure(ROWS[name], limit_s, before) for name in tracked(rows, "row")]
    growths = [results.grow(curve, limit_s) for curve in tracked(CURVES if scaling else (), "curve")]
    others = peers.compare(limit_s, rival_python) if rival_python else []
    return Study(lines, growths, others, limit_s)


main = partial(study, engines, "tests.studies.engines")

if __name__ == "__main__":
    sys.exit(main())
