"""The exports of the verb ``share``: a scenario, posterior draws or a cell in the formats of other tools."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from bench.commands.declaration import Others, Within
from bench.commands.stores import DEFAULT, ArchiveFolder, CellIdentity, StoreFolder, named_store, one_cell
from bench.errors import InputError

SCENARIO = ("system", "prior", "disturbance", "snr", "initial_state", "seed")
"""Fields that determine the data of a replicate."""
CELL = (*SCENARIO, "method", "replicates", "timeout_s", "memory_mb", "store", "workers")


def petab(
    scenario: Annotated[Sequence[str], Others(SCENARIO), "system=, snr=, initial_state=, prior=, disturbance=, seed="],
    replicate: Annotated[int, Within(ge=0, le=99_999), "number of the replicate"] = 0,
    out: Annotated[Path, "folder to write"] = Path("petab"),
) -> int:
    """Export data, equations, prior and true values of a replicate as a PEtab problem (version 1, with SBML)."""
    from bench.config.experiment import sweep
    from bench.config.overrides import read_overrides
    from bench.exchange.petab import petab_files
    from bench.reporting.whole_file import check_folder, write

    (job,) = sweep({**read_overrides(scenario), "method": ["oracle"]}, multirun=False)
    check_folder(out)
    for name, text in petab_files(job.cell().scenario, job.config.seed, replicate).items():
        write(out / name, text, out)
        print(out / name)
    return 0


def arviz(
    cell: CellIdentity,
    store: StoreFolder = DEFAULT,
    archive: ArchiveFolder = None,
    out: Annotated[Path | None, "file to write [<cell>.nc]"] = None,
) -> int:
    """Export the posterior draws of a stored cell as InferenceData (netCDF)."""
    from bench.exchange.inference_data import inference_data
    from bench.reporting.whole_file import check_file

    path = out or Path(f"{cell}.nc")
    stored = one_cell(named_store(store, archive), cell)
    check_file(path)
    draws = inference_data(stored)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        draws.to_netcdf(str(path))
    except OSError as error:
        raise InputError("out", path, f"cannot be written ({error.strerror}); name another file") from None
    print(path)
    return 0


def notebook(
    cell: Annotated[Sequence[str], Others(CELL), "method=, system=, snr=, ... as for python -m bench"],
    out: Annotated[Path, "file to write"] = Path("cell.ipynb"),
) -> int:
    """Export a cell as a Jupyter notebook."""
    from bench.config.experiment import sweep
    from bench.config.overrides import read_overrides
    from bench.exchange.notebook import notebook
    from bench.reporting.whole_file import check_file, write

    overrides = read_overrides(cell)
    (job,) = sweep(overrides, multirun=False)
    check_file(out)
    write(out, notebook(job.cell(), overrides))
    print(out)
    return 0
