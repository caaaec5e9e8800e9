"""Sweeps from Python: the cells that the command computes, in the same store, and their scores as a table."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.config.experiment import Experiment, sweep
from bench.config.fields import Config
from bench.config.overrides import overrides_of
from bench.engine.launch import Launch, launch, warm_up
from bench.engine.plan import Planned, plan, read_retry
from bench.engine.pool import Limits
from bench.errors import InputError
from bench.isolation.machine import usable_cores
from bench.store.cell import Cell
from bench.store.store import Store, open_store
from bench.store.stored import StoredCell

if TYPE_CHECKING:
    import pandas as pd

SCORES = ("mean", "median", "ci_low", "ci_high", "bound", "excess")
"""What is said of every metric of a cell."""
Values = Any
"""One value of a field, or a list, tuple, range or array of values to sweep over."""


@dataclass(frozen=True)
class CellResult:
    """A cell and what the store holds of it: None where it was not computed."""

    cell: Cell
    stored: StoredCell | None

    def facts(self) -> dict[str, Any]:
        """What the cell is, and how its fits went."""
        cell, scenario = self.cell, self.cell.scenario
        if self.stored is None:
            return {"cell": cell.identity, "method": cell.label, "status": "missing"}
        return {
            "cell": cell.identity,
            "method": cell.label,
            "system": scenario.label,
            "snr": scenario.snr_db,
            "replicates": cell.replicates,
            "seed": cell.seed,
            "initial_state": scenario.initial_state,
            "prior": scenario.prior.name if scenario.prior else "none",
            "disturbance": scenario.disturbance.kind if scenario.disturbance else "none",
            "n_ok": self.stored.n_ok,
            "status": self.stored.status.value,
            "message": "" if self.stored.n_ok else self.stored.rows[0].message,
            "wall_s": self.stored.wall_s,
        }

    def scores(self) -> dict[str, dict[str, float]]:
        """By metric the mean, median and its 95 % interval over the replicates, the bound, and the excess over it."""
        summary = self.stored.summary if self.stored else {}
        return {name: {key: values[key] for key in SCORES} for name, values in summary.items()}

    def as_dict(self) -> dict[str, Any]:
        """All of it, ready for JSON: null stands for what is not finite."""
        facts = self.facts()
        if self.stored is None:
            return facts
        return {**facts, "metrics": nulls(self.scores())}


@dataclass(frozen=True)
class Results(Sequence[CellResult]):
    """The results of a sweep, cell by cell in its order; they are read from the store when they are looked at."""

    cells: tuple[Cell, ...]
    store: Store

    def __len__(self) -> int:
        return len(self.cells)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return Results(self.cells[index], self.store)
        cell = self.cells[index]
        return CellResult(cell, self.store.load(cell.identity))

    def __iter__(self) -> Iterator[CellResult]:
        return (self[i] for i in range(len(self)))

    def frame(self) -> pd.DataFrame:
        """One line a cell and metric, with what the cell is; a cell without scores is one line."""
        import pandas as pd

        lines: list[dict[str, Any]] = []
        for result in self:
            facts = {key: value for key, value in result.facts().items() if key != "message"}
            own = [{**facts, "metric": metric, **scores} for metric, scores in result.scores().items()]
            lines += own or [facts]
        return pd.DataFrame(lines)

    def __repr__(self) -> str:
        methods = ", ".join(dict.fromkeys(cell.label for cell in self.cells))
        return f"<Results of {len(self)} cells in {self.store.folder}: {methods}; frame() is a table>"

    def _repr_html_(self) -> str:
        """A notebook's table: a line a cell, with the median errors."""
        frame = self.frame()
        if "metric" in frame:
            named = ["method", "system", "snr", "initial_state", "disturbance", "seed", "n_ok", "replicates"]
            errors = frame[(frame.metric == "rmse") | frame.metric.str.endswith("_error_pct", na=False)]
            frame = errors.pivot_table("median", named, "metric", sort=False).reset_index()
        return str(frame.to_html(index=False, float_format="{:.3g}".format, na_rep="-"))


def run(
    method: Values = None,
    *,
    experiment: Values = None,
    system: Values = None,
    snr: Values = None,
    initial_state: Values = None,
    prior: Values = None,
    disturbance: Values = None,
    replicates: Values = None,
    seed: Values = None,
    settings: Mapping[str, Values] | None = None,
    store: str | Path | None = None,
    workers: int | None = None,
    timeout_s: float | None = None,
    memory_mb: float | None = None,
    retry: str | None = None,
    progress: bool = False,
) -> Results:
    """Compute what a store lacks of a sweep, as ``python -m bench -m`` does, and return the results.

    What is not given is as on the command line. Cells that are stored already are not computed again.

    Args:
        method: a method, or several; so for all fields down to ``settings``, whose every combination is a cell.
        experiment: an experiment of ``conf/experiment``; the other fields override what it says.
        system: a scenario of ``conf/system``, or the path of a file of one's own.
        snr: signal-to-noise ratio in dB.
        initial_state: ``known`` or ``unknown``: whether the method is told the start.
        prior: what is told of the parameters beforehand.
        disturbance: what breaks the assumptions of the methods.
        replicates: data sets a cell.
        seed: of all random streams.
        settings: further fields by their dotted names, such as ``{"method.width": [16, 32], "system.samples": 50}``.
        store: the folder of the cells.
        workers: processes that fit; by default one a core.
        timeout_s: limit of one replicate, in seconds.
        memory_mb: limit of one fit.
        retry: ``failed``, or statuses: stored replicates that failed are tried again.
        progress: whether a bar shows how far it is; nothing is printed otherwise.

    Returns:
        The results; ``frame()`` is a tidy table of them.

    Raises:
        InputError: for what the command line refuses, with the same sentence, before anything runs.

    Examples:
        >>> import tempfile
        >>> import bench
        >>> folder = tempfile.TemporaryDirectory()
        >>> methods, store = ["ls", "matrix_pencil"], folder.name
        >>> results = bench.run(method=methods, snr=[40, 20], replicates=2, workers=1, store=store)
        >>> [(result.cell.label, result.cell.scenario.snr_db, result.stored.n_ok) for result in results]
        [('ls', 40.0, 2), ('ls', 20.0, 2), ('matrix_pencil', 40.0, 2), ('matrix_pencil', 20.0, 2)]
        >>> medians = results.frame().query("metric == 'k_over_m_error_pct'").set_index(["method", "snr"])["median"]
        >>> bool(medians["matrix_pencil", 40.0] < medians["matrix_pencil", 20.0])
        True
        >>> bench.run(method="ls", snr="loud")
        Traceback (most recent call last):
        bench.errors.InputError: snr=loud: input should be a valid number, unable to parse string as a number
        >>> folder.cleanup()
    """
    swept = {
        "experiment": experiment, "method": method, "system": system, "snr": snr, "initial_state": initial_state,
        "prior": prior, "disturbance": disturbance, "replicates": replicates, "seed": seed,
    }  # fmt: skip
    single = {"store": store, "workers": workers, "timeout_s": timeout_s, "memory_mb": memory_mb, "retry": retry}
    jobs = sweep(overrides_of(swept, settings or {}, single))
    if jobs[0].config.data is not None:
        raise InputError("data", jobs[0].config.data, "a measured record is for bench.identify")
    return compute([job.cell() for job in jobs], jobs[0].config, Launch(progress=progress))


def experiment(name: str, **fields: Values) -> list[Cell]:
    """Return the cells of an experiment of ``conf/experiment``, in order; nothing runs.

    Args:
        name: such as ``table3``.
        **fields: what overrides it: ``method="ls"``, ``snr=[40, 20]``.

    Raises:
        InputError: for an unknown experiment or field, as on the command line.

    Examples:
        >>> import bench
        >>> cells = bench.experiment("table3", method=["ls", "shooting"])
        >>> [(cell.method, cell.scenario.initial_state, cell.replicates) for cell in cells]
        [('ls', 'known', 100), ('shooting', 'known', 100), ('ls', 'unknown', 100), ('shooting', 'unknown', 100)]
        >>> bench.experiment("table99")
        Traceback (most recent call last):
        bench.errors.InputError: experiment=table99: did you mean table5? known: calibration, development, ...
    """
    return Experiment(name).cells(overrides_of(fields))


def compute(
    cells: Sequence[Cell], config: Config, how: Launch, say: Callable[[list[Planned]], None] | None = None
) -> Results:
    """Have what the store lacks of some cells computed, and return the results; raises InputError.

    The configuration says where and within what limits; ``say`` is called with the plan before anything runs.
    """
    retry = read_retry(config.retry)
    store = open_store(config.store, config.archive)
    store.prepare()
    if how.local and not all(store.holds(cell.identity) for cell in cells):
        warm_up({cell.method for cell in cells})
    limits = Limits(config.workers or usable_cores(), config.timeout_s, config.memory_mb)
    planned = plan(cells, store, retry)
    if say is not None:
        say(planned)
    launch(planned, store, limits, how)
    return Results(tuple(cells), store)


def nulls(value: Any) -> Any:
    """Return the same for JSON: lists in place of arrays and tuples, None for every number that it cannot hold."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: nulls(item) for key, item in value.items()}
    return [nulls(item) for item in value] if isinstance(value, list | tuple) else value
