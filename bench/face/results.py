"""Sweeps from Python: the same cells and store as on the command line, with the scores as a table."""

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
from bench.store.stored_cell import StoredCell

if TYPE_CHECKING:
    import pandas as pd

SCORES = ("mean", "median", "ci_low", "ci_high", "bound", "excess")
"""The statistics of each metric of a cell."""
Values = Any
"""One value of a field, or a list, tuple, range or array of values of a sweep."""


@dataclass(frozen=True)
class CellResult:
    """A cell and its stored result, None where it was not computed."""

    cell: Cell
    stored: StoredCell | None

    def facts(self) -> dict[str, Any]:
        """Return the fields of the cell and the outcome of its fits."""
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
        """Return the statistics of each metric: mean, median with its 95 % interval, bound and excess."""
        summary = self.stored.summary if self.stored else {}
        return {name: {key: values[key] for key in SCORES} for name, values in summary.items()}

    def as_dict(self) -> dict[str, Any]:
        """Return facts and scores for JSON; None stands for numbers that are not finite."""
        facts = self.facts()
        if self.stored is None:
            return facts
        return {**facts, "metrics": nulls(self.scores())}


@dataclass(frozen=True)
class Results(Sequence[CellResult]):
    """The results of a sweep in the order of its cells; each is read from the store when it is accessed.

    Attributes:
        cells: The cells of the sweep.
        store: The store that holds their results.
    """

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
        """Return a table with one row per cell and metric; a cell without scores is one row."""
        import pandas as pd

        rows: list[dict[str, Any]] = []
        for result in self:
            facts = {key: value for key, value in result.facts().items() if key != "message"}
            rows += [{**facts, "metric": name, **scores} for name, scores in result.scores().items()] or [facts]
        return pd.DataFrame(rows)

    def __repr__(self) -> str:
        methods = ", ".join(dict.fromkeys(cell.label for cell in self.cells))
        return f"<Results of {len(self)} cells in {self.store.folder}: {methods}; frame() is a table>"

    def _repr_html_(self) -> str:
        """Return the table that a notebook shows: one row per cell, with the median errors."""
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
    """Compute the cells of a sweep that the store lacks, as ``python -m bench -m`` does, and return all results.

    Defaults are those of the command line. Fields down to ``settings`` take one value or several; each combination is
    a cell.

    Args:
        method: Name of a method or one of its variants.
        experiment: Name of an experiment of ``conf/experiment``, whose fields the other arguments override.
        system: Name of a scenario of ``conf/system``, or the path of a file like those.
        snr: Signal-to-noise ratio (dB).
        initial_state: ``known`` or ``unknown``: whether the initial state is given to the method.
        prior: Name of the prior about the parameters.
        disturbance: Name of a disturbance, which violates assumptions of the methods.
        replicates: Number of data sets per cell.
        seed: Random seed.
        settings: Further fields by their dotted names: ``{"method.width": [16, 32], "system.samples": 50}``.
        store: Folder of stored cells.
        workers: Number of worker processes, by default one per core.
        timeout_s: Time limit per replicate (s).
        memory_mb: Memory limit per fit (MB).
        retry: ``failed``, or the statuses of stored replicates to try again.
        progress: Whether to show progress on the error stream.

    Returns:
        The results; ``frame()`` is a tidy table of them.

    Raises:
        InputError: for bad input, with the message of the command line, before anything runs.

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
        raise InputError("data", jobs[0].config.data, "use bench.identify for a measured record")
    return compute([job.cell() for job in jobs], jobs[0].config, Launch(progress=progress))


def experiment(name: str, **fields: Values) -> list[Cell]:
    """Return the cells of an experiment without running them.

    Args:
        name: Name of a file of ``conf/experiment``, such as ``table3``.
        **fields: Fields that override those of the experiment: ``method="ls"``, ``snr=[40, 20]``.

    Returns:
        The cells in the order of the experiment.

    Raises:
        InputError: for an unknown experiment or field.

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
    cells: Sequence[Cell], config: Config, how: Launch, report: Callable[[list[Planned]], None] | None = None
) -> Results:
    """Compute the cells that the store lacks, and return the results of all.

    Args:
        cells: The cells.
        config: Store and limits.
        how: Launcher and progress.
        report: Called with the plan before anything runs.

    Returns:
        The results.

    Raises:
        InputError: for a store that cannot be written and a launcher that is not installed.
    """
    retry = read_retry(config.retry)
    store = open_store(config.store, config.archive)
    store.prepare()
    if how.local and not all(cell.identity in store for cell in cells):
        warm_up({cell.method for cell in cells})
    limits = Limits(config.workers or usable_cores(), config.timeout_s, config.memory_mb)
    planned = plan(cells, store, retry)
    if report is not None:
        report(planned)
    launch(planned, store, limits, how)
    return Results(tuple(cells), store)


def nulls(value: Any) -> Any:
    """Return plain values for JSON: lists for arrays and tuples, None for numbers that are not finite."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: nulls(item) for key, item in value.items()}
    return [nulls(item) for item in value] if isinstance(value, list | tuple) else value
