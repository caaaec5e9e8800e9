"""``python -m bench.export``: a scenario, posterior draws or a cell in the forms of other tools.

``petab``: a replicate's data, equations and prior as a PEtab problem (version 1, with SBML), and the truth beside it.
``arviz``: the posterior draws of a stored cell as InferenceData (netCDF). ``notebook``: a cell as a Jupyter notebook.
Needs the extra ``exchange``.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from bench.commands.fields import path_of, read_fields, whole
from bench.commands.guard import command
from bench.commands.stores import FIELDS, store_of
from bench.config.fields import MOST_REPLICATES
from bench.config.schema import SCENARIO
from bench.errors import InputError
from bench.reporting.whole_file import check_file, check_folder, write
from bench.store.opening import DEFAULT_STORE

USAGE = f"""usage: python -m bench.export petab [system=sdof snr=20 ...] [replicate=0] [out=petab]
       python -m bench.export arviz <cell> [store={DEFAULT_STORE}] [archive=<folder>|none] [out=<cell>.nc]
       python -m bench.export notebook method=<name> [snr=20 ...] [out=cell.ipynb]

<cell>: an identity, or the start of one. Other fields: as for python -m bench, those of
a measured record apart\n\n"""
OF_DATA = (*SCENARIO, "snr", "initial_state", "seed")
"""Fields, or groups of them, that the data of a replicate hang on."""


def main(argv: Sequence[str] | None = None) -> int:
    """Print the files written; exit status 2 for bad input."""
    return command("bench.export", USAGE + str(__doc__), argv, _main)


def _main(arguments: Sequence[str]) -> int:
    kinds = {"petab": _petab, "arviz": _arviz, "notebook": _notebook}
    kind = arguments[0] if arguments else ""
    if kind not in kinds:
        raise InputError("export", kind, f"one of {', '.join(kinds)}")
    for path in kinds[kind](arguments[1:]):
        print(path)
    return 0


def _parted(arguments: Sequence[str], own: dict[str, str]) -> tuple[dict[str, str], list[str]]:
    """The fields of this command, and what describes a cell."""
    mine = [argument for argument in arguments if argument.partition("=")[0] in own]
    return read_fields(mine, own), [argument for argument in arguments if argument not in mine]


def _petab(arguments: Sequence[str]) -> list[Path]:
    from bench.config.experiment import sweep
    from bench.config.overrides import read_overrides
    from bench.exchange.petab import petab_files

    fields, described = _parted(arguments, {"replicate": "0", "out": "petab"})
    replicate, out = whole("replicate", fields["replicate"], 0, MOST_REPLICATES - 1), path_of(fields["out"])
    overrides = read_overrides(described)
    for name, values in overrides.items():
        if name.partition(".")[0] not in OF_DATA:
            raise InputError(name, values[0], f"left out: the data hang on {', '.join(OF_DATA)} alone")
    (job,) = sweep({**overrides, "method": ["oracle"]}, multirun=False)
    check_folder(out)
    files = petab_files(job.cell().scenario, job.config.seed, replicate)
    return [_written(out / name, text.encode(), out) for name, text in files.items()]


def _arviz(arguments: Sequence[str]) -> list[Path]:
    from bench.commands.reproduce import find
    from bench.exchange.inference_data import inference_data

    fields, names = _parted(arguments, {**FIELDS, "out": ""})
    if len(names) != 1 or not names[0] or set(names[0]) - set("0123456789abcdef"):
        raise InputError("cell", " ".join(names), "give one identity, or the start of one")
    store = store_of(fields)
    stored = find(store, names[0])
    path = path_of(fields["out"] or f"{names[0]}.nc")
    check_file(path)
    found = inference_data(stored, store.arrays(stored))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        found.to_netcdf(str(path))
    except OSError as error:
        raise InputError("out", path, f"cannot be written ({error.strerror}); name another file") from None
    return [path]


def _notebook(arguments: Sequence[str]) -> list[Path]:
    from bench.config.experiment import sweep
    from bench.config.overrides import read_overrides
    from bench.exchange.notebook import notebook

    fields, described = _parted(arguments, {"out": "cell.ipynb"})
    overrides = read_overrides(described)
    if any(value is not None for value in overrides.get("data", [])):
        raise InputError("data", overrides["data"][0], "left out: a cell is of simulated data")
    (job,) = sweep(overrides, multirun=False)
    path = path_of(fields["out"])
    check_file(path)
    return [_written(path, notebook(job.cell(), overrides).encode())]


def _written(path: Path, content: bytes, folder: Path | None = None) -> Path:
    write(path, content, folder)
    return path


if __name__ == "__main__":
    sys.exit(main())
