"""The command line: one cell, a sweep, or a measured record."""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import median_high
from typing import Any

from bench.errors import InputError

USAGE = """usage: python -m bench method=<name> [field=value ...]        one cell
       python -m bench -m method=a,b snr=40,20 [...]        a sweep over any fields
       python -m bench -m experiment=table3                 the cells of a table
       python -m bench method=<name> data=record.csv        a measured record

fields (defaults in brackets):
  method         {methods}
  system         [sdof] {systems}, or a file of your own: <path>.yaml
  snr            [20] signal-to-noise ratio in dB
  initial_state  [known] known, unknown: whether the method is told the start
  prior          [nominal] {priors}
  disturbance    [none] {disturbances}
  replicates     [20] data sets      seed [0]      timeout_s [600] per replicate
  store          [results/rows] where finished cells are kept and found again
  format         [table] table, json      workers [one a core]      memory_mb [4096] per fit
  retry          [none] failed, or statuses: try stored replicates again that failed
  dry_run        [false] list the cells, why each would run, and how long it may take
  data           a CSV with columns t, x and optionally a force
  nominal.<p>, start   what is stated of a measured system (with prior=, initial_state=known)
  experiment     {experiments}
  method.<setting>, system.<field>, disturbance.size    any setting of a method, any field of a system
  hydra/launcher [local] ray, submitit_slurm (extras ray, slurm)    cells_per_job [20]    hydra.launcher.<option>

options: -m, --multirun   --cfg (print the configuration, run nothing)   --version   -h, --help
what is stored, failed, stale, missing: python -m bench.status    tables: python -m bench.tables
what the data of a scenario can tell: python -m bench.identifiability system=chain2 snr=10"""

MOST_LISTED = 100
"""Cells of a sweep that are listed one by one."""
SHOWN = ("rmse", "rmse_simulated", "rmse_forecast")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status: 0, 2 for bad input, 130 when interrupted."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    try:
        return _main(arguments)
    except InputError as error:
        print(f"bench: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\nbench: interrupted; finished cells are kept, the same command goes on from here", file=sys.stderr)
        return 130
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141


def _main(arguments: list[str]) -> int:
    flags = {argument for argument in arguments if argument.startswith("-")}
    overrides = [argument for argument in arguments if argument not in flags]
    unknown = flags - {"-m", "--multirun", "-h", "--help", "--cfg", "--version"}
    if unknown:
        raise InputError("option", sorted(unknown)[0], "options are -m, --cfg, --version, --help")
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


def _usage() -> str:
    from bench.config import choices

    names = {
        f"{group}s": ", ".join(choices(group)) for group in ("method", "system", "prior", "disturbance", "experiment")
    }
    return USAGE.format(**names)


def _run(jobs: Sequence[Any], launcher: Sequence[str]) -> int:
    from bench.config import jobs_to_cells
    from bench.launch import Launch, launch, warm_up
    from bench.plan import plan, read_retry
    from bench.slots import Limits
    from bench.store import Store

    config = jobs[0].config
    retry = read_retry(config.retry)
    cells = jobs_to_cells(jobs)
    store = Store(config.store)
    if config.dry_run:
        print(listing(plan(cells, store, retry), store, config.workers or os.cpu_count() or 1))
        return 0
    store.prepare()
    how = Launch(tuple(launcher), config.cells_per_job)
    if how.local and not all(store.path(cell.identity).exists() for cell in cells):
        warm_up({cell.method for cell in cells})
    limits = Limits(config.workers or os.cpu_count() or 1, config.timeout_s, config.memory_mb)
    planned = plan(cells, store, retry)
    if config.format == "table" and len(jobs) > 1:
        print(f"bench: {_counted(planned)}", file=sys.stderr)
    launch(planned, store, limits, how)
    closing = Closing(len(cells))
    for job, cell in zip(jobs, cells, strict=True):
        result = store.load(cell.identity)
        if cell.identity not in closing.seen:  # a cell may stand in several tables
            closing.add(cell, result, store)
        if config.format == "json":
            print(json.dumps(_as_json(job, cell, result), allow_nan=False))
        elif len(jobs) == 1 and result is not None:
            print(_cell_table(cell, result))
    if config.format == "table":
        if len(jobs) > 1:
            print(closing.table())
        print(f"rows: {store.folder}" + (f"/{cells[0].identity}.json" if len(cells) == 1 else ""))
    return closing.said_of_failures()


def _counted(planned: Sequence[Any]) -> str:
    """How many of a plan's cells are there already, and why the others are to be computed."""
    counts: dict[str, int] = {}
    for one in planned:
        state = f"{one.state.value}{'' if one.run or one.state.value == 'done' else ' (kept; retry=failed)'}"
        counts[state] = counts.get(state, 0) + 1
    return f"{len(planned)} cells: " + ", ".join(f"{n} {state}" for state, n in counts.items())


def listing(planned: Sequence[Any], store: Any, workers: int) -> str:
    """A plan as a table, with an estimate of the time from what stored cells of each method took."""
    from tabulate import tabulate

    from bench.durations import fit_seconds

    seconds, total, unknown, rows = fit_seconds(store), 0.0, set(), []
    for one in planned:
        cell, scenario = one.cell, one.cell.scenario
        each = seconds.get(cell.label)
        takes = "" if not one.run else "?" if each is None else f"{each * cell.replicates:.1f}"
        if one.run and each is None:
            unknown.add(cell.label)
        total += each * cell.replicates if one.run and each is not None else 0.0
        what = f"{scenario.label} {scenario.snr_db:g} dB {scenario.told}"
        rows.append([cell.identity[:8], cell.label, what, cell.replicates, one.state.value, takes, one.why[:60]])
    table = tabulate(rows, headers=["cell", "method", "scenario", "fits", "state", "s", "why"], disable_numparse=True)
    wanted = [one for one in planned if one.run]
    lines = [table, "", f"{_counted(planned)}; {len(wanted)} to run"]
    if wanted:
        about = f"about {duration(total / workers)} on {workers} worker(s), as stored cells of the same methods took"
        lines.append(about + (f"; nothing known of {', '.join(sorted(unknown))}" if unknown else ""))
    return "\n".join(lines)


def duration(seconds: float) -> str:
    """A time in the unit that suits it."""
    for size, unit in ((86400.0, "d"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 1.5 * size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.0f} s"


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


def read_folders(arguments: Sequence[str], defaults: dict[str, str]) -> dict[str, Path]:
    """Folders given as ``field=path``, over the defaults; raises InputError for anything else."""
    folders = dict(defaults)
    for argument in arguments:
        key, _, value = argument.partition("=")
        if key not in folders or not value:
            wanted = " or ".join(f"{field}=<folder>" for field in defaults)
            raise InputError("argument", argument, f"write {wanted}")
        folders[key] = value
    return {key: Path(value) for key, value in folders.items()}


def number(value: float) -> str:
    """Three significant digits, or what stands for a number that is not there."""
    if math.isnan(value):
        return "-"
    if math.isinf(value):
        return "failed"
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.3e}"


def _cell_table(cell: Any, result: Any) -> str:
    from tabulate import tabulate

    scenario = cell.scenario
    quantities = scenario.make_system().quantities
    labels = {f"{q.name}_error_pct": f"{q.name.replace('_over_', '/')} error %" for q in quantities}
    labels |= {"rmse": "displacement RMSE m", "rmse_simulated": "simulated RMSE m", "rmse_forecast": "forecast RMSE m"}
    rows = []
    gauge_note: list[str] = []
    for name, label in labels.items():
        if name not in result.summary:
            continue
        s = result.summary[name]
        coverage = result.summary.get(name.replace("_error_pct", "_coverage_95"), {}).get("mean", math.nan)
        if not result.identifiable.get(name.removesuffix("_error_pct"), True):
            label += " *"
            gauge_note = ["* not identifiable from these data: the prior sets the scale"]
        interval = f"{number(s['ci_low'])} to {number(s['ci_high'])}"
        cells = [number(s["median"]), interval, number(s["bound"]), number(s["excess"])]
        rows.append([label, *cells, "-" if math.isnan(coverage) or name in SHOWN else f"{100 * coverage:.0f}"])
    seconds = [row.wall_s for row in result.rows if math.isfinite(row.wall_s)]
    head = (
        f"{cell.label} on {scenario.label}, {scenario.snr_db:g} dB, initial state {scenario.told}, "
        f"{f'disturbance {_disturbance(scenario)}, ' if scenario.disturbance else ''}"
        f"{result.n_ok}/{len(result.rows)} ok"
    )
    headers = ["", "median", "95 % interval", "bound", "excess", "cover %"]
    table = tabulate(rows, headers=headers, disable_numparse=True)
    lines = [head, "", table, ""]
    lines += [f"  {n} x {status}: {message}" for (status, message), n in _failures(result).items()]
    if seconds:
        lines.append(f"median {number(sorted(seconds)[len(seconds) // 2])} s a fit")
    lines.append("median over replicates; bound on the root mean square; excess = root mean square / bound")
    lines += gauge_note
    return "\n".join(lines)


def _disturbance(scenario: Any) -> str:
    return f"{scenario.disturbance.kind} {scenario.disturbance.size:g}" if scenario.disturbance else "none"


def _failures(result: Any) -> dict[tuple[str, str], int]:
    counts: dict[tuple[str, str], int] = {}
    for row in result.rows:
        if row.status.value != "ok":
            key = (row.status.value, row.message[:120])
            counts[key] = counts.get(key, 0) + 1
    return counts


class Closing:
    """What is said at the end of a sweep, gathered cell by cell so that no more than a line of each is held.

    Up to :data:`MOST_LISTED` cells are listed; of more, one line stands for all that differ by seed or settings only,
    with the medians over them.
    """

    def __init__(self, n: int) -> None:
        self.listed = n <= MOST_LISTED
        self.lines: dict[tuple[Any, ...], list[tuple[int, int, list[float]]]] = {}
        self.kinds: dict[tuple[str, str, str], tuple[int, Path]] = {}
        self.seen: set[str] = set()
        self.lost = 0
        self.group = ""

    def add(self, cell: Any, result: Any, store: Any) -> None:
        """One cell's result; None where there is none."""
        self.seen.add(cell.identity)
        if result is None:
            self.lost += 1
            return
        scenario = cell.scenario
        self.group = scenario.make_system().groups[0].name
        parts = [result.summary.get(name, {}) for name in (f"{self.group}_error_pct", "rmse")]
        values = [part.get(key, math.nan) for part in parts for key in ("median", "excess")]
        key = (cell.label, scenario.label, f"{scenario.snr_db:g}", scenario.told, _disturbance(scenario))
        own = self.lines.setdefault((*key, cell.identity) if self.listed else key, [])
        own.append((result.n_ok, len(result.rows), values))
        for (status, message), n in _failures(result).items():
            kind = (cell.label, status, message)
            before, path = self.kinds.get(kind, (0, store.errors(cell.identity)))
            self.kinds[kind] = before + n, path

    def table(self) -> str:
        """The sweep as a table."""
        from tabulate import tabulate

        disturbed = any(key[4] != "none" for key in self.lines)
        rows = []
        for key, own in self.lines.items():
            columns = ([v[i] for _, _, v in own if not math.isnan(v[i])] for i in range(4))  # NaN: a metric it lacks
            medians = [median_high(column) if column else math.nan for column in columns]
            ok = f"{sum(n_ok for n_ok, _, _ in own)}/{sum(n for _, n, _ in own)}"
            cells = [] if self.listed else [str(len(own))]
            rows.append([*key[: 5 if disturbed else 4], *cells, ok, *map(number, medians)])
        by = ["disturbance"] if disturbed else []
        many = [] if self.listed else ["cells"]
        name = self.group.replace("_over_", "/")
        headers = ["method", "system", "dB", "start", *by, *many, "ok", f"{name} %", "excess", "RMSE m", "excess"]
        return tabulate(rows, headers=headers, disable_numparse=True)

    def said_of_failures(self) -> int:
        """Say on the error stream what failed, once a kind, and where a traceback is; the exit status, 0 or 1.

        1 where a cell is not there at all: what ran elsewhere may be lost with its node.
        """
        if len(self.lines) > 1:
            for (label, status, message), (n, errors) in self.kinds.items():
                where = f" (traceback: {errors})" if errors.exists() else ""
                print(f"bench: {label}: {n} x {status}: {message}{where}", file=sys.stderr)
        if self.lost:
            print(f"bench: {self.lost} cells were not computed; the same command computes them", file=sys.stderr)
        return 1 if self.lost else 0


def _identify(job: Any) -> int:
    from tabulate import tabulate

    from bench.measured import identify_record, report

    problem, outcome = identify_record(job)
    result = {"method": job.label, "data": str(job.config.data), **report(problem, outcome)}
    if job.config.format == "json":
        print(json.dumps(_nulls(result), allow_nan=False))
        return 0
    print(f"{job.label} on {job.config.data}: {problem.n} samples, {result['status']}")
    if result["message"]:
        print(f"  {result['message']}")
    if result["estimates"]:
        rows = [
            [name.replace("_over_", "/"), f"{e['value']:.6g}", f"{e['low']:.6g}", f"{e['high']:.6g}", e["unit"]]
            for name, e in result["estimates"].items()
        ]
        print(tabulate(rows, headers=["", "value", "95 % low", "95 % high", "unit"], disable_numparse=True))
        if problem.prior is None and not problem.forced:
            print("free vibration without a prior: m, c and k themselves cannot be told, only their ratios")
    r = result["residuals"]
    if r:
        print(
            f"residuals: rms {number(r['rms'])} {r['unit']} ({100 * r['part_of_signal']:.2g} % of the signal), "
            f"lag-1 autocorrelation {r['lag1_autocorrelation']:.2f}, offset {number(r['offset'])} {r['unit']}"
        )
    return 0


def _nulls(value: Any) -> Any:
    """The same with null for numbers that JSON cannot hold."""
    if isinstance(value, float):
        return _finite(value)
    if isinstance(value, dict):
        return {key: _nulls(item) for key, item in value.items()}
    return [_nulls(item) for item in value] if isinstance(value, list) else value
