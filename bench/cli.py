"""The command line: one cell, a sweep, or a measured record."""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.errors import InputError

USAGE = """usage: python -m bench method=<name> [field=value ...]        one cell
       python -m bench -m method=a,b snr=40,20 [...]        a sweep of all of these
       python -m bench -m experiment=table3                 the cells of a table
       python -m bench method=<name> data=record.csv        a measured record

fields (defaults in brackets):
  method         {methods}
  system         [sdof] {systems}, or a file of your own: <path>.yaml
  snr            [20] signal-to-noise ratio in dB
  initial_state  [known] known, unknown: whether the method is told the start
  prior          [nominal] {priors}
  disturbance    [none] {disturbances}
  replicates     [20] data sets
  seed           [0] of all random streams
  timeout_s      [600] limit of one replicate
  memory_mb      [4096] limit of one fit
  workers        [one a core] processes that fit
  store          [outputs/rows] where finished cells are kept and found again
  format         [table] table, json
  retry          [none] failed, or statuses: try stored replicates again that failed
  dry_run        [false] list the cells, why each would run, and how long it may take
  data           a CSV with columns t, x and optionally a force
  nominal.<p>    what is stated of a measured system (with prior=)
  start          its displacement and velocity (with initial_state=known)
  experiment     {experiments}
  method.<setting>, system.<field>, disturbance.size
                 any setting of a method, any field of a system
  hydra/launcher [local] ray, submitit_slurm (extras ray, slurm), with
                 cells_per_job [20] and hydra.launcher.<option>

options:
  -m, --multirun   a sweep             --cfg        print the configuration
  --version                            -h, --help   this page
see also:
  python -m bench.status               what is stored, failed, stale, missing
  python -m bench.status experiment=table3 watch=true    follow a running sweep
  python -m bench.tables               the tables, from what is stored
  python -m bench.identifiability system=chain2 snr=10   what data can tell"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status: 0, 2 for bad input, 130 when interrupted."""
    from bench.terminal import guarded

    arguments = list(sys.argv[1:] if argv is None else argv)
    kept = "interrupted; finished cells are kept, the same command goes on from here"
    return guarded("bench", lambda: _main(arguments), kept)


def _main(arguments: list[str]) -> int:
    flags = {argument for argument in arguments if argument.startswith("-")}
    overrides = [argument for argument in arguments if argument not in flags]
    unknown = flags - {"-m", "--multirun", "-h", "--help", "--cfg", "--version"}
    if unknown:
        raise InputError("option", sorted(unknown)[0], _no_option(sorted(unknown)[0]))
    if flags & {"-h", "--help"} or not arguments:
        print(_usage())
        return 0 if arguments else 2
    if "--version" in flags:
        from bench import __version__

        print(__version__)
        return 0
    from bench.config import expand, of_launcher

    launcher = [text for text in overrides if of_launcher(text)]
    jobs = expand([text for text in overrides if text not in launcher], bool(flags & {"-m", "--multirun"}))
    if "--cfg" in flags:
        for job in jobs:
            print(job.config.model_dump_json(indent=2))
        return 0
    if jobs[0].config.data is not None:
        disturbance = jobs[0].config.disturbance.kind
        if disturbance != "none":
            raise InputError("disturbance", disturbance, "a measured record is taken as it is; leave it out")
        if len(jobs) > 1:
            raise InputError("data", jobs[0].config.data, "one record and one method at a time")
        return _identify(jobs[0])
    return _run(jobs, launcher)


def _no_option(text: str) -> str:
    from bench.config import FIELDS

    field = text.lstrip("-").partition("=")[0]
    written = f"; a field has no dashes: {field}=<value>" if field in FIELDS else ""
    return f"options are -m, --cfg, --version, --help{written}"


def _usage() -> str:
    from bench.config import choices
    from bench.terminal import wrapped

    names = {
        f"{group}s": ", ".join(choices(group)) for group in ("method", "system", "prior", "disturbance", "experiment")
    }
    return "\n".join(wrapped(line, " " * 17) for line in USAGE.format(**names).splitlines())


def _run(jobs: Sequence[Any], launcher: Sequence[str]) -> int:
    from bench.config import jobs_to_cells
    from bench.launch import Launch, launch, warm_up
    from bench.listing import counted, listing
    from bench.plan import plan, read_retry
    from bench.score_tables import Closing, cell_table
    from bench.slots import Limits
    from bench.store_archive.opening import open_store

    config = jobs[0].config
    retry = read_retry(config.retry)
    cells = jobs_to_cells(jobs)
    store = open_store(config.store, config.archive)
    if config.dry_run:
        print(listing(plan(cells, store, retry), store, config.workers or os.cpu_count() or 1))
        return 0
    store.prepare()
    how = Launch(tuple(launcher), config.cells_per_job)
    if how.local and not all(store.holds(cell.identity) for cell in cells):
        warm_up({cell.method for cell in cells})
    limits = Limits(config.workers or os.cpu_count() or 1, config.timeout_s, config.memory_mb)
    planned = plan(cells, store, retry)
    if config.format == "table" and len(jobs) > 1:
        print(f"bench: {counted(planned)}", file=sys.stderr)
    launch(planned, store, limits, how)
    closing = Closing(len(cells))
    for job, cell in zip(jobs, cells, strict=True):
        result = store.load(cell.identity)
        if cell.identity not in closing.seen:  # a cell may stand in several tables
            closing.add(cell, result, store)
        if config.format == "json":
            print(json.dumps(_as_json(job, cell, result), allow_nan=False))
        elif len(jobs) == 1 and result is not None:
            print(cell_table(cell, result))
    if config.format == "table":
        if len(jobs) > 1:
            print(closing.table())
        print(_whereabouts(store, cells))
    return closing.said_of_failures()


def _whereabouts(store: Any, cells: Sequence[Any]) -> str:
    """Where the full results lie. A path is never broken, however long."""
    if len(cells) == 1:
        return str(store.whereabouts(cells[0].identity))
    published = sum(not store.own(cell.identity) and store.holds(cell.identity) for cell in cells)
    also = f"; {published} of the cells: {store.archive.folder}" if published else ""
    return f"full results: {store.folder}{also} (format=json prints them)"


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _as_json(job: Any, cell: Any, result: Any) -> dict[str, Any]:
    keys = ("mean", "median", "ci_low", "ci_high", "bound", "excess")
    if result is None:
        return {"cell": cell.identity, "method": cell.label, "status": "missing"}
    return {
        "cell": cell.identity,
        "method": cell.label,
        "system": cell.scenario.label,
        "snr": cell.scenario.snr_db,
        "replicates": cell.replicates,
        "seed": cell.seed,
        "initial_state": cell.scenario.told,
        "prior": job.config.prior.name,
        "disturbance": job.config.disturbance.kind,
        "n_ok": result.n_ok,
        "status": result.status.value,
        "message": "" if result.n_ok else result.rows[0].message,
        "wall_s": result.wall_s,
        "metrics": {name: {key: _finite(values[key]) for key in keys} for name, values in result.summary.items()},
    }


def read_fields(arguments: Sequence[str], defaults: Mapping[str, str], wanted: str = "") -> dict[str, str]:
    """Values given as ``field=value``, over the defaults; raises InputError, which says what is ``wanted`` instead."""
    fields = dict(defaults)
    for argument in arguments:
        key, _, value = argument.partition("=")
        if key not in fields or not value:
            raise InputError("argument", argument, wanted or f"write one of {', '.join(f'{k}=' for k in defaults)}")
        fields[key] = value
    return fields


def whole(field: str, text: str, least: int = 1, most: int | None = None) -> int:
    """A whole number within limits; raises InputError."""
    if not text.isdecimal() or int(text) < least or (most is not None and int(text) > most):
        within = f"of at least {least}" if most is None else f"from {least} to {most}"
        raise InputError(field, text, f"a whole number {within}")
    return int(text)


def read_folders(arguments: Sequence[str], defaults: Mapping[str, str]) -> dict[str, Path]:
    """Folders given as ``field=path``, over the defaults; raises InputError for anything else."""
    wanted = f"write {' or '.join(f'{field}=<folder>' for field in defaults)}"
    return {key: Path(value) for key, value in read_fields(arguments, defaults, wanted).items()}


def _identify(job: Any) -> int:
    from bench.measured import identify_record, report
    from bench.score_tables import record_page

    problem, outcome = identify_record(job)
    result = {"method": job.label, "data": str(job.config.data), **report(problem, outcome)}
    if job.config.format == "json":
        print(json.dumps(_nulls(result), allow_nan=False))
        return 0
    print(record_page(job.label, job.config.data, result, problem.prior is None and not problem.forced))
    print("nothing of a measured record is stored: format=json prints all, with residuals")
    return 0


def _nulls(value: Any) -> Any:
    """The same with null for numbers that JSON cannot hold."""
    if isinstance(value, float):
        return _finite(value)
    if isinstance(value, dict):
        return {key: _nulls(item) for key, item in value.items()}
    return [_nulls(item) for item in value] if isinstance(value, list) else value
