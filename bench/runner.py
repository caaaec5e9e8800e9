"""From cells to stored rows: make the replicates, have them fitted elsewhere, score them here, store each cell whole.

The process that scores is the only one that holds both a truth and an estimate; a fit sees problems alone.
"""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from bench.bound import Bound, load_bounds
from bench.cell import Cell
from bench.combine import combine_with_prior
from bench.estimate import Estimate, Status
from bench.identifier import Identifier
from bench.problem import Problem
from bench.reference import REFERENCES
from bench.registry import make_method, missing_package
from bench.scenario import METHOD
from bench.score import score
from bench.statistics import summarise
from bench.store import Row, Store, StoredCell
from bench.truth import Truth
from bench.workers import Outcome, Task, perform, single_threaded

LARGEST_TASK = 5
PACKAGES = ("numpy", "scipy", "jax", "torch", "casadi", "pysindy", "emcee", "vibration-bench")


Progress = Callable[[Cell, int, bool], None]


@dataclass(frozen=True)
class ReferenceFit:
    """A reference row as a worker runs it: its payloads are pairs of problem and truth."""

    name: str

    def __call__(
        self, payloads: Sequence[tuple[Problem, Truth]], rngs: Sequence[np.random.Generator]
    ) -> list[Estimate]:
        return [REFERENCES[self.name](problem, truth) for problem, truth in payloads]


@dataclass(frozen=True)
class MethodFit:
    """A method as a worker runs it, past its own objection to a problem."""

    method: Identifier

    def __call__(self, payloads: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        objections = [self.method.objection(problem) for problem in payloads]
        taken = [i for i, objection in enumerate(objections) if objection is None]
        found = self.method.identify_many([payloads[i] for i in taken], [rngs[i] for i in taken]) if taken else []
        answers = dict(zip(taken, found, strict=True))
        return [
            answers[i] if objection is None else Estimate.failed(payloads[i].system, Status.UNSUPPORTED, objection)
            for i, objection in enumerate(objections)
        ]


@dataclass
class _Pending:
    """A cell under way: its replicates, its bound, the rows so far."""

    cell: Cell
    bound: Bound
    pairs: list[tuple[Problem, Truth]]
    rows: list[Row]
    started: float


def run_cells(
    cells: Sequence[Cell], store: Store, workers: int, on_progress: Progress = lambda cell, n, stored: None
) -> list[StoredCell]:
    """Run what the store lacks of the cells, store each as it is done, and return all of them in order.

    ``on_progress(cell, n, stored)`` is called when ``n`` more replicates of a cell are done, or were found stored.
    """
    single_threaded()
    done: dict[str, StoredCell] = {}
    missing: dict[str, Cell] = {}
    for cell in cells:
        stored = store.load(cell.identity)
        if stored is None or _can_now_run(stored):
            missing.setdefault(cell.identity, cell)
        else:
            done[cell.identity] = stored
            on_progress(cell, cell.replicates, True)
    todo = list(missing.values())
    bounds = load_bounds([(cell.scenario, cell.seed) for cell in todo], store.bounds) if todo else []
    # cells of one method go together, in workers of their own: memory peaks then belong to that method
    for method in dict.fromkeys(cell.method for cell in todo):
        group = [(cell, bound) for cell, bound in zip(todo, bounds, strict=True) if cell.method == method]
        for stored in _run_group(group, store, workers, on_progress):
            done[stored.identity] = stored
    return [done[cell.identity] for cell in cells]


def _can_now_run(stored: StoredCell) -> bool:
    """Whether a cell was stored for want of a package that is there now."""
    return stored.status is Status.MISSING_DEPENDENCY and missing_package(stored.cell["method"]) is None


def _run_group(
    group: Sequence[tuple[Cell, Bound]], store: Store, workers: int, on_progress: Progress
) -> list[StoredCell]:
    pending: dict[str, _Pending] = {}
    tasks: list[Task] = []
    results = []
    for cell, bound in group:
        pairs = cell.scenario.replicates(cell.seed, cell.replicates)
        state = _Pending(cell, bound, pairs, [], time.perf_counter())
        pending[cell.identity] = state
        lacking = missing_package(cell.method)
        if lacking:
            state.rows = [Row(i, Status.MISSING_DEPENDENCY, lacking) for i in range(cell.replicates)]
            on_progress(cell, cell.replicates, False)
            results.append(_finish(pending.pop(cell.identity), store))
        else:
            tasks += _tasks(cell, pairs, workers)
    for task, outcomes in perform(tasks, workers):
        state = pending[task.key]
        state.rows += [_row(outcome, state.pairs[outcome.replicate]) for outcome in outcomes]
        on_progress(state.cell, len(outcomes), False)
        if len(state.rows) == state.cell.replicates:
            results.append(_finish(pending.pop(task.key), store))
    return results


def _tasks(cell: Cell, pairs: Sequence[tuple[Problem, Truth]], workers: int) -> list[Task]:
    if cell.method in REFERENCES:
        fit: Any = ReferenceFit(cell.method)
        payloads: list[Any] = list(pairs)
    else:
        fit = MethodFit(make_method(cell.method, dict(cell.settings)))
        payloads = [problem for problem, _ in pairs]
    name = int.from_bytes(cell.method.encode(), "big") % 2**32
    rngs = [cell.scenario.stream(METHOD, cell.seed, i, name) for i in range(len(pairs))]
    size = max(1, min(LARGEST_TASK, len(pairs) // (4 * workers)))
    return [
        Task(
            key=cell.identity,
            replicates=tuple(range(i, min(i + size, len(pairs)))),
            fit=fit,
            payloads=tuple(payloads[i : i + size]),
            rngs=tuple(rngs[i : i + size]),
            timeout_s=cell.timeout_s,
        )
        for i in range(0, len(pairs), size)
    ]


def _row(outcome: Outcome, pair: tuple[Problem, Truth]) -> Row:
    """The scored row of one replicate."""
    problem, truth = pair
    status, message, scores, evaluations = outcome.status, outcome.message, {}, 0
    if outcome.estimate is not None:
        evaluations = outcome.estimate.cost.evaluations
        try:
            with np.errstate(all="ignore"):
                estimate = combine_with_prior(outcome.estimate, problem.prior).checked()
                scores = score(estimate, problem, truth)
            status, message = estimate.status, estimate.message
        except Exception as error:  # names, shapes or a reconstruction that the contract does not allow
            text = f"the estimate cannot be scored: {type(error).__name__}: {error}"
            status, message = Status.INVALID, " ".join(text.split())[:300]
        if status is Status.OK:
            scores["realised_snr_db"] = truth.realised_snr_db
    return Row(
        replicate=outcome.replicate,
        status=status,
        message=message,
        scores=scores,
        wall_s=outcome.wall_s,
        cpu_s=outcome.cpu_s,
        peak_memory_mb=outcome.peak_memory_mb,
        evaluations=evaluations,
    )


def _finish(state: _Pending, store: Store) -> StoredCell:
    rows = tuple(sorted(state.rows, key=lambda row: row.replicate))
    cell, truth = state.cell, state.pairs[0][1]
    described = {
        **cell.description(),
        "label": cell.label,
        "system": cell.scenario.label,
        "snr_db": cell.scenario.snr_db,
        "initial_state": cell.scenario.told,
        "sigma": list(truth.sigma),
        "sigma_over_peak": truth.sigma_over_peak,
    }
    stored = StoredCell(
        identity=cell.identity,
        cell=described,
        rows=rows,
        summary={name: asdict(summary) for name, summary in summarise(rows, state.bound).items()},
        prior_share=state.bound.prior_share,
        identifiable=state.bound.identifiable,
        wall_s=time.perf_counter() - state.started,
        provenance=provenance(),
    )
    store.save(stored)
    return store.load(cell.identity) or stored  # as stored, so that a second run prints the very same


@cache
def provenance() -> dict[str, Any]:
    """Versions and machine, for every stored cell."""
    found = {}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return {
        "python": platform.python_version(),
        "packages": found,
        "machine": platform.machine(),
        "cores": os.cpu_count(),
        "threads_per_fit": 1,
    }
