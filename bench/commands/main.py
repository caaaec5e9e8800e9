"""The command line: one cell, a sweep, or a measured record."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from typing import Any

from bench.errors import InputError
from bench.isolation.cores import usable_cores
from bench.isolation.secrecy import hide_arguments

USAGE = """usage: python -m bench <verb> [field=value ...]               --help for each

{verbs}

       python -m bench method=<name> [field=value ...]        one cell
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
  archive        [that of the checkout] published cells, which are not computed
                 again: a folder, or none
  format         [table] table, json
  retry          [none] failed, or statuses: try stored replicates again that failed;
                 with failed, damaged cells are computed anew
  dry_run        [false] list the cells, why each would run, and how long it may take
  data           a measured record, or several of one rig: run1.csv,run2.csv
                 (text, xlsx, mat, npz, Parquet, UFF 58, TDMS); with it
                 system may be auto or a sum, sdof+coulomb, and method all
  columns, units where the file does not say: t:0,x:3 and t:ms,x:mm
  rate, from, to samples a second without a column of times; the part to use (s)
  decimate       [1] keep every so many-th sample, after a low-pass filter
  detrend        [false] take a drift of the displacement's sensor away
  force_gain, hold what the force is multiplied with [1], how it runs [linear]
  fixed.<p>      a parameter that is told: fixed.l=1
  nominal.<p>    what is stated of a measured system (with prior=)
  start          its displacement and velocity (with initial_state=known)
  plot           [auto] the fit in the terminal: auto, where the output is one,
                 always, never
  picture        [outputs/fits/<record>_<method>.svg] the fit as a file, or none
  experiment     {experiments}, measured, online, atlas
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
  python -m bench.design --help        the cheapest test that tells enough
  python -m bench.expect --help        what each method would do at a test
  python -m bench.check my_method.py   does a method of your own keep the contract
  python -m bench.identifiability system=chain2 snr=10   what data can tell"""

MEASURED_TRACK = "experiment=measured"
ONLINE_TRACK = "experiment=online"
ATLAS = "experiment=atlas"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status: 0, 2 for bad input, 130 when interrupted."""
    from bench.commands.guard import guarded
    from bench.commands.verbs import execute, named_verb

    arguments = list(sys.argv[1:] if argv is None else argv)
    if argv is None:
        hide_arguments()
    verb = named_verb(arguments)
    if verb is not None:
        rest = [word for place, word in enumerate(arguments) if place != arguments.index(verb)]
        return guarded("bench", lambda: execute(verb, rest))
    kept = "interrupted; finished cells are kept, the same command goes on from here"
    return guarded("bench", lambda: _main(arguments, early=argv is None and usable_cores() > 1), kept)


def _main(arguments: list[str], early: bool = False) -> int:
    """Run an experiment; ``early``: have processes prepared on another core while this one imports."""
    flags = {argument for argument in arguments if argument.startswith("-")}
    unknown = flags - {"-m", "--multirun", "-h", "--help", "--cfg", "--version"}
    if unknown:
        raise InputError("option", sorted(unknown)[0], _no_option(sorted(unknown)[0]))
    if flags & {"-h", "--help"} or not arguments:
        if ONLINE_TRACK in arguments:
            from bench.commands.online import online_usage

            print(online_usage())
            return 0
        if ATLAS in arguments:
            from bench.commands.atlas import atlas_usage

            print(atlas_usage())
            return 0
        print(_usage())
        return 0 if arguments else 2
    if "--version" in flags:
        from bench import __version__

        print(__version__)
        return 0
    if MEASURED_TRACK in arguments:
        from bench.commands.measured_track import tracked

        return tracked([text for text in arguments if text not in {*flags, MEASURED_TRACK}])
    if ONLINE_TRACK in arguments:
        from bench.commands.online import followed_online

        return followed_online([text for text in arguments if text not in {*flags, ONLINE_TRACK}])
    if ATLAS in arguments:
        from bench.commands.atlas import made_atlas

        return made_atlas([text for text in arguments if text not in {*flags, ATLAS}])
    from bench.config.launcher import check_launcher, of_launcher
    from bench.config.overrides import read_overrides

    launcher = [text for text in arguments if of_launcher(text)]
    check_launcher(launcher)
    overrides = read_overrides([text for text in arguments if text not in {*launcher, *flags}])
    if early and not launcher and "--cfg" not in flags and "dry_run" not in overrides:
        from bench.isolation.processes import start_server

        start_server()
    from bench.config.experiment import sweep  # half a second to import: a mistyped name is said before

    if any(value is not None for value in overrides.get("data", [])):
        from bench.commands.measured_record import identify_records

        return identify_records(overrides, show="--cfg" in flags)
    jobs = sweep(overrides, multirun=bool(flags & {"-m", "--multirun"}))
    if "cells_per_job" in overrides and not launcher:
        raise InputError("cells_per_job", overrides["cells_per_job"][0], "with hydra/launcher=, whose jobs it is of")
    if "--cfg" in flags:
        for job in jobs:
            print(job.config.model_dump_json(indent=2))
        return 0
    return _run(jobs, launcher)


def _no_option(text: str) -> str:
    from bench.config.overrides import settable

    field = text.lstrip("-").partition("=")[0]
    written = f"; a field has no dashes: {field}=<value>" if field in settable() else ""
    return f"options are -m, --cfg, --version, --help{written}"


def _usage() -> str:
    from bench.commands.verbs import summaries
    from bench.config.choices import GROUPS, choices
    from bench.reporting.terminal import wrapped

    names = {f"{group}s": ", ".join(choices(group)) for group in GROUPS}
    text = USAGE.format(**names, verbs=summaries())
    return "\n".join(wrapped(line, " " * 17) for line in text.splitlines())


def _run(jobs: Sequence[Any], launcher: Sequence[str]) -> int:
    config, cells = jobs[0].config, [job.cell() for job in jobs]  # what makes no sense is said before more is loaded
    from bench.face.results import compute
    from bench.reporting.plan_table import counted, listing
    from bench.reporting.terminal_tables import Closing, cell_table
    from bench.store.opening import open_store
    from bench.sweep.launch import Launch
    from bench.sweep.plan import plan, read_retry

    if config.dry_run:
        store = open_store(config.store, config.archive)
        planned = plan(cells, store, read_retry(config.retry))
        print(listing(planned, store, config.workers or usable_cores()))
        return 0

    def say(planned: Any) -> None:
        if config.format == "table" and len(jobs) > 1:
            print(f"bench: {counted(planned)}", file=sys.stderr)

    results = compute(cells, config, Launch(tuple(launcher), config.cells_per_job), say)
    closing = Closing(len(results))
    for result in results:
        if result.cell.identity not in closing.seen:  # a cell may stand in several tables
            closing.add(result.cell, result.stored, results.store)
        if config.format == "json":
            print(json.dumps(result.as_dict(), allow_nan=False))
        elif len(jobs) == 1 and result.stored is not None:
            print(cell_table(result.cell, result.stored))
    if config.format == "table":
        if len(jobs) > 1:
            print(closing.table())
        print(_whereabouts(results.store, results.cells))
    return closing.said_of_failures()


def _whereabouts(store: Any, cells: Sequence[Any]) -> str:
    """Where the full results lie. A path is never broken, however long."""
    if len(cells) == 1:
        return str(store.whereabouts(cells[0].identity))
    published = sum(not store.own(cell.identity) and store.holds(cell.identity) for cell in cells)
    also = f"; {published} of the cells: {store.archive.folder}" if published else ""
    return f"full results: {store.folder}{also} (format=json prints them)"
