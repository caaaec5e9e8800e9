"""A run, which needs no verb: one cell, a sweep, an experiment, or a measured record."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from bench.commands.log import LOG, verbose
from bench.errors import InputError
from bench.isolation.machine import usable_cores

USAGE = """usage: python -m bench method=<name> [field=value ...]        one cell
       python -m bench -m method=a,b snr=40,20 [...]        a sweep of all of these
       python -m bench -m experiment=table3                 the cells of a table
       python -m bench data=record.csv [method=<name>]      a measured record
       python -m bench <verb> [field=value ...]             --help for each

{verbs}

fields (defaults in brackets):
{fields}
  experiment     a sweep: {experiments}
  hydra/launcher [local] ray, submitit_slurm (extras ray, slurm), with
                 cells_per_job= and hydra.launcher.<option>=

options; the syntax of overrides is Hydra's, without its folders for runs:
  -m, --multirun   a sweep             --cfg job    print the configuration
  --info           how it is composed  -sc install=bash   completion by the shell
  -v, --verbose    every cell of a sweep, and why it is computed
  -q, --quiet      errors and results only, no progress
  --version                            -h, --help   this page"""
WIDE = 13
"""Width of the column of names on the page of help."""
FLAGS = {
    "-m": "multirun", "--multirun": "multirun", "-r": "", "--run": "", "-h": "help", "--help": "help",
    "--version": "version",
}  # fmt: skip
COMPLETION = ("-sc", "--shell-completion", "--shell_completion")
CFG, INFO = ("job", "hydra", "all"), ("all", "config", "defaults", "defaults-tree", "plugins", "searchpath")
SHOWN = {"--cfg": CFG, "-c": CFG, "--info": INFO, "-i": INFO}
"""Options by which Hydra shows a configuration, with their values; the first value is the default."""
PACKAGE, ALONE = ("-p", "--package"), ("--resolve", "--hydra-help", *COMPLETION)


@dataclass
class Options:
    """The words of a command line: options of the run, options that Hydra answers, and ``field=value``."""

    flags: set[str] = field(default_factory=set)
    shown: list[str] = field(default_factory=list)
    words: list[str] = field(default_factory=list)

    @property
    def completes(self) -> bool:
        """Return whether the shell asks for completions."""
        return bool(set(COMPLETION) & set(self.shown))


def read_options(arguments: Sequence[str]) -> Options:
    """Sort the words of a command line; raises InputError for an option that does not exist."""
    options, rest = Options(), list(arguments)
    while rest:
        word = rest.pop(0)
        name, _, value = word.partition("=") if word.startswith("--") else (word, "", "")
        if not name.startswith("-"):
            if "=" not in name and os.path.isfile(name):
                remedy = f"write data={name}, or python -m bench certify {name}"
                raise InputError("argument", name, remedy)
            options.words.append(name)
        elif name in FLAGS:
            options.flags.add(FLAGS[name])
        elif name in SHOWN:
            options.shown += [name, value or (rest.pop(0) if rest and rest[0] in SHOWN[name] else SHOWN[name][0])]
        elif name in PACKAGE:
            options.shown += [name, value or (rest.pop(0) if rest else "")]
        elif name in ALONE:
            options.shown.append(name)
        else:
            from bench.config.fields import declared

            bare = name.lstrip("-").replace("-", "_")
            near = f"; a field has no dashes: {bare}=<value>" if bare in declared() else ""
            known = "options are -m, -v, -q, --cfg, --info, --package, --resolve, -sc, --hydra-help, --version, --help"
            raise InputError("option", word, known + near)
    return options


def run(options: Options, early: bool = False) -> int:
    """Answer the options of a command line, or compute what its fields ask for; returns the exit status.

    ``early``: start the worker processes on another core while this one imports.
    """
    if "help" in options.flags or not (options.words or options.shown or options.flags):
        print(_usage())
        return 0 if "help" in options.flags else 2
    if "version" in options.flags:
        from bench import __version__

        print(__version__)
        return 0
    if options.completes:
        from bench.commands.verbs import completed
        from bench.config.inspection import ask_hydra

        offered = completed(os.environ.get("COMP_LINE", ""))
        if offered:
            print(*offered)
            return 0
        return ask_hydra(options.shown, options.words)
    from bench.config.hydra_fields import check_of_hydra, is_of_hydra
    from bench.config.overrides import read_overrides

    of_hydra = [text for text in options.words if is_of_hydra(text)]
    check_of_hydra(of_hydra)
    overrides = read_overrides([text for text in options.words if text not in of_hydra])
    if options.shown:
        from bench.config.inspection import ask_hydra, hydra_overrides

        if "multirun" in options.flags:
            raise InputError("option", "-m", f"{options.shown[0]} shows one cell; dry_run=true lists those of a sweep")
        return ask_hydra(options.shown, [*hydra_overrides(overrides), *of_hydra])
    if early and usable_cores() > 1 and not of_hydra and "dry_run" not in overrides:
        from bench.isolation.processes import start_server

        start_server()
    from bench.config.experiment import sweep  # takes half a second: a mistyped name is reported before

    if any(value is not None for value in overrides.get("data", [])):
        from bench.commands.measured_record import identify_records

        return identify_records(overrides)
    jobs = sweep(overrides, multirun="multirun" in options.flags)
    if "cells_per_job" in overrides and not of_hydra:
        raise InputError(
            "cells_per_job", overrides["cells_per_job"][0], "give it with hydra/launcher=, whose jobs have this many"
        )
    return _run(jobs, of_hydra)


def _usage() -> str:
    from bench.commands.verbs import summaries
    from bench.config.choices import GROUPS, TRACKS, choices, default_choices
    from bench.config.fields import declared
    from bench.reporting.terminal import help_page

    lines = [field.line(WIDE) for name, field in declared().items() if name not in GROUPS]
    defaults = default_choices() | {"method": "needed"}
    groups = [f"  {name:<{WIDE}}  [{defaults[name]}] {declared()[name].text}: {', '.join(choices(name))}"
              for name in declared() if name in GROUPS]  # fmt: skip
    experiments = ", ".join([*choices("experiment"), *TRACKS])
    return help_page(USAGE.format(verbs=summaries(), fields="\n".join([*groups, *lines]), experiments=experiments))


def _run(jobs: Sequence[Any], launcher: Sequence[str]) -> int:
    config, cells = jobs[0].config, [job.cell() for job in jobs]  # bad input is reported before more is imported
    from bench.engine.launch import Launch
    from bench.engine.plan import plan, read_retry
    from bench.face.results import compute
    from bench.reporting.plan_table import counted, listing
    from bench.reporting.sweep_summary import SweepSummary
    from bench.reporting.terminal_tables import cell_table, described
    from bench.store.store import open_store

    if config.dry_run:
        store = open_store(config.store, config.archive)
        planned = plan(cells, store, read_retry(config.retry))
        print(listing(planned, store, config.workers or usable_cores(), every_cell=verbose()))
        return 0

    def report(planned: Any) -> None:
        if config.format == "table" and len(jobs) > 1:
            LOG.info(counted(planned))
        for item in planned:
            where = f"{item.cell.identity[:8]} {item.cell.label} on {described(item.cell.scenario)}"
            LOG.debug("%s: %s %s", where, item.state.value, item.why)

    results = compute(cells, config, Launch(tuple(launcher), config.cells_per_job), report)
    summary = SweepSummary()
    for result in results:
        summary.add(result.cell, result.stored)
        if config.format == "json":
            print(json.dumps(result.as_dict(), allow_nan=False))
        elif len(jobs) == 1 and result.stored is not None:
            print(cell_table(result.cell, result.stored))
    if config.format == "table":
        if len(jobs) > 1:
            print(summary.text(every_cell=verbose()))
        print(_location(results.store, results.cells))
    return summary.report_failures()


def _location(store: Any, cells: Sequence[Any]) -> str:
    """Return the location of the full results; a path is never broken, however long."""
    if len(cells) == 1:
        return str(store.location(cells[0].identity))
    published = sum(not store.in_folder(cell.identity) and cell.identity in store for cell in cells)
    also = f"; {published} of the cells: {store.archive.folder}" if published else ""
    return f"full results: {store.folder}{also} (format=json prints them)"
