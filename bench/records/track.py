"""Measured track: every sibling of every set, fitted by every method and stored as rows of Table 11.

A fit is stored under a digest of its inputs: definition of the set, bytes of the file, system, part of the record, and
method with its settings.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from bench.config.schema import Job
from bench.entrants.registry import GROUP
from bench.errors import InputError
from bench.records.identification import identify_all
from bench.records.intervals import StatedInterval
from bench.records.prediction import held_out_fit
from bench.records.problem import Measured, read_measured, with_system
from bench.records.reading import Recording, Signal, read_recording
from bench.records.request import Request, request_of
from bench.records.sets import MeasuredSet
from bench.records.verdict import Trust
from bench.store.results import read_result, write_result
from bench.store.table_versions import version_text
from bench.systems.sums import Sum

ROWS = 1
"""Version of the stored rows; to be raised if :meth:`MeasuredFit.rows` changes."""
ANALYSES, ANALYSIS_S = 50.0, 3600.0
"""Time limit of a fit with its diagnostics: a multiple of that of the fit alone, plus a constant (s)."""
Row = dict[str, Any]
"""Row of the table: a quantity of a fit with its intervals, or a failed fit."""


@dataclass(frozen=True, eq=False)
class MeasuredFit:
    """Task of the engine: the fit of a sibling of a set by a method.

    Attributes:
        name: Name of the set.
        measured_set: The set.
        request: The request that reads the sibling.
        job: The method and its settings.
        sibling: Name of the sibling.
        recording: The sibling's signals.
        timeout_s: Time limit of the fit (s).
        size: Number of fits.
    """

    name: str
    measured_set: MeasuredSet
    request: Request
    job: Job
    sibling: str
    recording: Recording
    timeout_s: float
    size: int = 1

    @cached_property
    def key(self) -> str:
        """Digest of all inputs of the fit except its time limit."""
        settings = {name: str(value) for name, value in self.job.settings().items()}
        method = self.job.config.method["name"]
        parts = [
            ROWS, [field.name for field in fields(StatedInterval)], self.name, self.measured_set.definition(),
            self.request.system, self.sibling, self.recording.sha256, method, version_text(GROUP, method), settings,
            self.job.config.seed,
        ]  # fmt: skip
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:20]

    @property
    def kind(self) -> tuple[str, str]:
        """The method and the sibling."""
        return self.job.label, f"{self.name} {self.request.system}, {self.sibling}"

    @property
    def used(self) -> set[tuple[str, str]]:
        """The method."""
        return {(GROUP, self.job.config.method["name"])}

    @property
    def limit_s(self) -> float:
        """Time limit (s) of the fit with its diagnostics."""
        return ANALYSES * self.timeout_s + ANALYSIS_S

    @property
    def head(self) -> Row:
        """Columns that all rows of the fit share."""
        system, method = self.request.system, self.job.label
        return {"set": self.name, "system": system, "sibling": self.sibling, "method": method}

    def read(self, folder: Path) -> list[Row] | None:
        """Return the stored rows; None if there are none, or the fit exceeded a time limit that is now longer."""
        content = read_result(folder, self.key)
        rows: list[Row] | None = None if content is None else json.loads(content)
        late = rows is not None and rows[0]["status"] == "timeout" and rows[0]["timeout_s"] < self.timeout_s
        return None if late else rows

    def stored(self, folder: Path) -> bool:
        """Return whether :meth:`read` has rows."""
        return self.read(folder) is not None

    def compute(self, folder: Path) -> None:
        """Fit the sibling and store the rows; raises InputError if the folder is not writable."""
        write_result(folder, self.key, json.dumps(self.rows()).encode())

    def measured(self) -> Measured:
        """Return the sibling as a problem."""
        return problem_of_set(self.measured_set, self.request, self.recording)

    def rows(self) -> list[Row]:
        """Fit the sibling; return a row per quantity, or a single row with the reason of the failure."""
        head = {**self.head, "timeout_s": self.timeout_s}
        try:
            (finding,) = identify_all(replace(self.request, jobs=(self.job,)), self.measured())
        except InputError as error:
            return [{**head, "status": "refused", "message": str(error), "trust": Trust.NO.value, "withdrawn": 0}]
        fit, estimate, held_out, offset = finding.fit, finding.estimate, math.nan, math.nan
        if fit is not None:
            with np.errstate(all="ignore"):
                held_out = held_out_fit(fit)
            offset = finding.channel_size * float(fit.model.offsets(fit.theta)[0])
        head |= {
            "status": estimate.status.value,
            "trust": finding.trust.value,
            "withdrawn": int(bool(finding.withdrawn)),
        }
        head |= {"held_out": held_out, "offset": offset, "wall_s": finding.wall_s}
        stated = finding.intervals or finding.withdrawn
        quantities: list[Row] = [{"quantity": name, **asdict(interval)} for name, interval in stated.items()]
        return [{**head, **quantity} for quantity in quantities or [{"message": estimate.message}]]


def problem_of_set(measured_set: MeasuredSet, request: Request, recording: Recording) -> Measured:
    """Return a recording of a set as a problem; raises InputError."""
    measured = read_measured(request, (recording,))
    system = measured.problem.system
    if isinstance(system, Sum) and measured_set.bias_sign != system.bias_sign:
        return with_system(measured, replace(system, bias_sign=measured_set.bias_sign))
    return measured


def tasks(
    name: str, measured_set: MeasuredSet, methods: Sequence[str], data_root: Path | None, timeout_s: float
) -> Iterator[MeasuredFit]:
    """Yield the fits of a set, sibling by sibling; none if a file is missing.

    Args:
        name: Name of the set.
        measured_set: The set.
        methods: Names of the methods.
        data_root: Folder of data that are not part of the package.
        timeout_s: Time limit of a fit (s).

    Raises:
        InputError: A file cannot be read.
    """
    for system in measured_set.systems:
        for path in measured_set.paths(data_root):
            request = request_of(measured_set.overrides(system, methods, path, timeout_s))
            for i, piece in enumerate(pieces(read_recording(path, request.options), measured_set), 1):
                for job in request.jobs:
                    sibling = f"{path.name} {i}/{measured_set.parts}"
                    yield MeasuredFit(name, measured_set, request, job, sibling, piece, timeout_s)


def pieces(recording: Recording, measured_set: MeasuredSet) -> list[Recording]:
    """Cut a recording of a set into its parts, thinned, with times that begin at 0."""
    end = measured_set.time_scale * max(float(signal.times[-1]) for signal in recording.signals)
    edges = np.linspace(0.0, end * (1.0 + 1e-12), measured_set.parts + 1)
    edges[-1] = np.inf
    cut = []
    for low, high in pairwise(edges):
        part = []
        for signal in recording.signals:
            times = signal.times * measured_set.time_scale
            inside = (times >= low) & (times < high)
            part.append(replace(signal, times=times[inside], values=signal.values[inside]))
        start = min(float(signal.times[0]) for signal in part)
        thinned = (_thin(replace(signal, times=signal.times - start), measured_set) for signal in part)
        cut.append(replace(recording, signals=tuple(thinned)))
    return cut


def _thin(signal: Signal, measured_set: MeasuredSet) -> Signal:
    """Keep every ``thin``-th sample of a motion; average ``thin_force`` samples of a force, but keep its ends."""
    step, block = measured_set.thin, measured_set.thin_force
    if signal.measures != "force":
        return replace(signal, times=signal.times[::step], values=signal.values[::step])
    n = signal.values.size // block * block
    if block == 1 or n == 0:
        return signal
    times, values = (
        np.concatenate([samples[:1], samples[:n].reshape(-1, block).mean(axis=1), samples[-1:]])
        for samples in (signal.times, signal.values)
    )
    return replace(signal, times=times, values=values)
