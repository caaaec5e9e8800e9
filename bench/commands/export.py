"""A scenario, posterior draws or a cell in the formats of other tools."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bench.config.experiment import sweep
from bench.config.overrides import read_overrides
from bench.errors import InputError
from bench.reporting.whole_file import check_file, check_folder, write
from bench.store.store import Store


def export_petab(scenario: Sequence[str], replicate: int, out: Path) -> int:
    """Write a replicate as a PEtab problem and print its files; raises InputError."""
    from bench.exchange.petab import petab_files

    (job,) = sweep({**read_overrides(scenario), "method": ["oracle"]}, multirun=False)
    check_folder(out)
    for name, text in petab_files(job.cell().scenario, job.config.seed, replicate).items():
        write(out / name, text, out)
        print(out / name)
    return 0


def export_arviz(identity: str, store: Store, out: Path) -> int:
    """Write the posterior draws of a stored cell as netCDF and print the file; raises InputError."""
    from bench.commands.stores import one_cell
    from bench.exchange.inference_data import inference_data

    stored = one_cell(store, identity)
    check_file(out)
    draws = inference_data(stored)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        draws.to_netcdf(str(out))
    except OSError as error:
        raise InputError("out", out, f"cannot be written ({error.strerror}); name another file") from None
    print(out)
    return 0


def export_notebook(cell: Sequence[str], out: Path) -> int:
    """Write a cell as a notebook and print the file; raises InputError."""
    from bench.exchange.notebook import notebook

    overrides = read_overrides(cell)
    (job,) = sweep(overrides, multirun=False)
    check_file(out)
    write(out, notebook(job.cell(), overrides))
    print(out)
    return 0
