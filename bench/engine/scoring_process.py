"""The scoring process: it simulates the data of a cell, scores the estimates of a method, and stores the cell.

It knows the true values and never runs code of a method. The method's process receives problems and returns plain
numbers, as bytes that the driver passes on without unpickling them.
"""

from __future__ import annotations

import hashlib
import math
import pickle
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from bench.contract.distribution import Draws, Normal
from bench.contract.estimate import Estimate, Status
from bench.contract.problem import Problem
from bench.engine.method_process import FitTask, outcomes
from bench.engine.wire import unpack
from bench.entrants.reference import REFERENCES
from bench.information.fisher import Bound
from bench.isolation.failure import one_line, traceback_text, without_folders
from bench.isolation.secrecy import close_memory
from bench.scenario.scenario import METHOD
from bench.scenario.truth import Truth
from bench.scoring.combination import combine_with_prior
from bench.scoring.row import NUMBERS, Row, Rows, score_columns
from bench.scoring.score import scores
from bench.scoring.summary import summarise
from bench.scoring.traces import trace_scores
from bench.store.bounds import load_bounds
from bench.store.cell import Cell
from bench.store.store import Store
from bench.store.stored_cell import StoredCell

KEPT_DRAWS = 500
"""Largest number of posterior samples stored with a cell; more are thinned evenly."""
NO_BOUND = Bound((), {}, {}, {}, math.inf, math.inf, ())
"""Placeholder for a bound that cannot be computed."""
KEPT = 0
"""The replicate whose record, reconstruction and traces are stored for figures."""


Pair = tuple[Problem, Truth]


@dataclass
class ScoredRows:
    """Scored replicates of a cell.

    Attributes:
        rows: The replicates, by column.
        tracebacks: Tracebacks by failed replicate.
        arrays: Arrays of the replicate :data:`KEPT`.
        facts: Noise of the data, see :func:`facts`.
    """

    rows: Rows = field(default_factory=lambda: Rows.from_rows(()))
    tracebacks: dict[int, str] = field(default_factory=dict)
    arrays: dict[str, np.ndarray] = field(default_factory=dict)
    facts: dict[str, Any] = field(default_factory=dict)

    def add(self, other: ScoredRows) -> None:
        """Add rows of the same cell."""
        self.rows += other.rows
        self.tracebacks |= other.tracebacks
        self.arrays |= other.arrays
        self.facts = self.facts or other.facts


@dataclass(frozen=True)
class Failure:
    """A fit without an answer, since its process died or exceeded a limit; ``best`` is its last report, packed."""

    status: Status
    message: str
    log: str = ""
    best: bytes | None = None


def serve(connection: Connection) -> None:
    """Call methods of a :class:`Scorer` on request, and send their results or exceptions, until disconnected."""
    close_memory()
    scorer = Scorer()
    connection.send_bytes(b"ready")
    while True:
        request, *arguments = pickle.loads(connection.recv_bytes())
        try:
            answer = True, getattr(scorer, request)(*arguments)
        except Exception as error:
            answer = False, (one_line(error), traceback_text())
        connection.send_bytes(pickle.dumps(answer))


class Scorer:
    """Simulates and scores the replicates of one cell at a time."""

    def __init__(self) -> None:
        self.cell: Cell | None = None
        self.make: Callable[[int], Pair] | None = None
        self.pairs: dict[int, Pair] = {}
        self.bounds: dict[str, Bound] = {}

    def _pair(self, cell: Cell, replicate: int) -> Pair:
        if self.make is None or self.cell != cell:
            self.cell, self.pairs, self.make = cell, {}, cell.scenario.maker(cell.seed)
        if replicate not in self.pairs:
            self.pairs[replicate] = self.make(replicate)
        return self.pairs[replicate]

    def open(self, cell: Cell, fit: bytes, replicates: Sequence[int], timeout_s: float) -> bytes:
        """Return the pickled :class:`FitTask` of some replicates."""
        pairs = [self._pair(cell, i) for i in replicates]
        name = int.from_bytes(cell.method.encode(), "big") % 2**32
        task = FitTask(
            fit=fit,
            replicates=tuple(replicates),
            payloads=tuple(pairs) if cell.method in REFERENCES else tuple(problem for problem, _ in pairs),
            rngs=tuple(cell.scenario.stream(METHOD, cell.seed, i, name) for i in replicates),
            times=tuple(truth.dense_times for _, truth in pairs),
            timeout_s=timeout_s,
        )
        return pickle.dumps(task)

    def score(self, cell: Cell, answers: bytes) -> ScoredRows:
        """Return the scored rows of the answers of a method's process."""
        return self._scored(cell, outcomes(answers))

    def fail(self, cell: Cell, replicate: int, failure: Failure, wall_s: float) -> ScoredRows:
        """Return the row of a failed replicate, with the scores of its last report if there is one."""
        problem, truth = self._pair(cell, replicate)
        scores: Mapping[str, float] = {}
        if failure.best is not None:
            scores = self._scored(cell, [unpack(failure.best)]).rows[0].scores
        row = Row(replicate, failure.status, failure.message, scores, wall_s=wall_s, data=data_digest(problem))
        return ScoredRows(Rows.from_rows([row]), {replicate: failure.log}, facts=facts(truth))

    def _scored(self, cell: Cell, answered: Sequence[Mapping[str, Any]]) -> ScoredRows:
        """Score replicates together, or one by one if that raises an exception."""
        pairs = [self._pair(cell, outcome["replicate"]) for outcome in answered]
        estimates = [_estimate(outcome, problem) for outcome, (problem, _) in zip(answered, pairs, strict=True)]
        try:
            with np.errstate(all="ignore"):
                estimates, columns = _judged(estimates, pairs)
        except Exception as error:  # names or shapes that violate the contract
            scored = ScoredRows()
            if len(answered) > 1:
                for outcome in answered:
                    scored.add(self._scored(cell, [outcome]))
                return scored
            message = f"the estimate cannot be scored: {one_line(error)}"
            estimates = [Estimate.failed(estimates[0].system, Status.INVALID, message, estimates[0].cost)]
            columns = {}
        plain = {name: [outcome.get(name, math.nan) for outcome in answered] for name in ("replicate", *NUMBERS)}
        plain |= {
            "message": [estimate.message for estimate in estimates],
            "evaluations": [estimate.cost.evaluations for estimate in estimates],
            "data": [data_digest(problem) for problem, _ in pairs],
        }
        scored = ScoredRows(Rows.from_columns([e.status for e in estimates], plain, columns), facts=facts(pairs[0][1]))
        for outcome, estimate, pair in zip(answered, estimates, pairs, strict=True):
            if "answer" not in outcome:
                scored.tracebacks[outcome["replicate"]] = outcome["traceback"]
            elif outcome["replicate"] == KEPT and estimate.status is Status.OK:
                scored.arrays = kept_arrays(estimate, *pair)
        return scored

    def finish(
        self,
        cell: Cell,
        store: Store,
        scored: ScoredRows,
        bounded: bool,
        version: dict[str, Any],
        provenance: Mapping[str, Any],
    ) -> str:
        """Summarise and store a cell; returns the reason if it cannot be written, otherwise an empty string.

        Without a bound (``bounded`` is False) there are no scores, and the data may be impossible to simulate.
        """
        rows, bound, known = scored.rows.sorted(), NO_BOUND, scored.facts
        if bounded:
            if cell.bound_identity not in self.bounds:
                self.bounds = {cell.bound_identity: load_bounds([cell], store.bounds)[0]}
            bound, known = self.bounds[cell.bound_identity], known or facts(self._pair(cell, 0)[1])
        tracebacks = sorted((i, text.rstrip()) for i, text in scored.tracebacks.items() if text.strip())
        scenario = {"snr_db": cell.scenario.snr_db, "initial_state": cell.scenario.initial_state}
        stored = StoredCell(
            identity=cell.identity,
            cell={**cell.full_description(), **scenario, **known},
            rows=rows,
            summary=summarise(rows, bound),
            prior_share=bound.prior_share,
            identifiable=bound.identifiable,
            wall_s=float(np.nansum(rows.numbers("wall_s"))),
            version=version,
            provenance={**provenance, "data": hashlib.sha256(" ".join(rows.plain("data")).encode()).hexdigest()[:16]},
            arrays=scored.arrays,
            tracebacks=without_folders("\n".join(f"replicate {i}\n{text}\n" for i, text in tracebacks)),
        )
        try:
            store.save(stored)
        except OSError as error:
            return error.strerror or str(error)
        return ""


def _estimate(outcome: Mapping[str, Any], problem: Problem) -> Estimate:
    """Return the estimate of an outcome, or a failed estimate with the reason."""
    if "answer" in outcome:
        answer: Estimate = outcome["answer"]
        alternatives = tuple(replace(other, system=problem.system) for other in answer.alternatives)
        return replace(answer, system=problem.system, alternatives=alternatives)
    return Estimate.failed(problem.system, Status(outcome["status"]), outcome["message"])


def _judged(estimates: Sequence[Estimate], pairs: Sequence[Pair]) -> tuple[list[Estimate], dict[str, np.ndarray]]:
    """Combine estimates with the prior and score them; exceptions due to an invalid estimate are passed on."""
    problems, truths = [problem for problem, _ in pairs], [truth for _, truth in pairs]
    without_covariance = [
        i for i, estimate in enumerate(estimates) if estimate.groups is not None and estimate.groups.covariance is None
    ]
    combined = [
        combine_with_prior(estimate.checked(), problem.prior).checked()
        for estimate, problem in zip(estimates, problems, strict=True)
    ]
    columns = scores(combined, problems, truths)
    columns |= score_columns([trace_scores(*judged) for judged in zip(combined, truths, strict=True)])
    good = [estimate.status is Status.OK for estimate in combined]
    columns["realised_snr_db"] = np.where(good, [truth.realised_snr_db for truth in truths], np.nan)
    for name in filter(scores_uncertainty, columns):  # the uncertainty of these estimates is that of the prior alone
        columns[name][without_covariance] = np.nan
    return combined, columns


def scores_uncertainty(name: str) -> bool:
    """Return whether a score rates the estimated uncertainty rather than the estimate itself."""
    return any(mark in name for mark in ("_coverage_", "_pit", "_interval_score_pct", "_crps_pct"))


def facts(truth: Truth) -> dict[str, Any]:
    """Return the noise level of each channel, and the noise level over the largest displacement."""
    return {"sigma": list(truth.sigma), "sigma_over_peak": truth.sigma_over_peak}


def data_digest(problem: Problem) -> str:
    """Return a digest of the data given to a method: samples, forces, initial state, prior."""
    digest = hashlib.sha256()
    for record in problem.records:
        for channel in record.channels:
            digest.update(np.ascontiguousarray(channel.times).tobytes())
            digest.update(np.ascontiguousarray(channel.values).tobytes())
        for force in record.forces:
            digest.update(np.ascontiguousarray(force.times).tobytes())
            digest.update(np.ascontiguousarray(force.values).tobytes())
        initial_state = record.initial_state
        if initial_state is not None:
            digest.update(np.concatenate([initial_state.displacement, initial_state.velocity]).tobytes())
    if problem.prior is not None:
        digest.update(repr([sorted(problem.prior.nominal.items()), sorted(problem.prior.log_sd.items())]).encode())
    return digest.hexdigest()[:12]


def kept_arrays(estimate: Estimate, problem: Problem, truth: Truth) -> dict[str, np.ndarray]:
    """Return the record, truth, reconstruction, band, distribution and traces of one replicate, for figures."""
    record = problem.records[0]
    arrays = {
        "sample_times": np.concatenate([c.times for c in record.channels]),
        "sample_values": np.concatenate([c.values for c in record.channels]),
        "sample_dof": np.concatenate([np.full(c.times.size, c.dof) for c in record.channels]),
        "dense_times": truth.dense_times,
        "true_displacement": truth.dense_displacement,
    }
    if estimate.reconstructions:
        arrays["displacement"] = estimate.reconstructions[0](truth.dense_times)
    if estimate.bands:
        arrays["displacement_sd"] = estimate.bands[0](truth.dense_times)
    distribution = estimate.distribution
    if isinstance(distribution, Draws):
        step = max(1, len(distribution.samples) // KEPT_DRAWS)
        arrays["draws"] = distribution.samples[::step][:KEPT_DRAWS]
    elif isinstance(distribution, Normal):
        arrays["mean"] = distribution.mean
        if distribution.covariance is not None:
            arrays["covariance"] = distribution.covariance
    return arrays | {f"trace_{name}": values for name, values in estimate.traces.items()}
