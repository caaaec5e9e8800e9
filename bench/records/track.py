"""The measured track: every set, sibling and method fitted once, and stored as rows of Table 11.

A fit is stored under a digest of all that it depends on: the definition of its set, the bytes of its file, the system,
the part of the record, and the method with all its settings.
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
from bench.entrants.registry import load_method
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
from bench.systems.sums import Sum

ROWS = 1
"""Version of the stored rows; what :meth:`MeasuredFit.rows` returns counts it up."""
ANALYSES, ANALYSIS_S = 50.0, 3600.0
"""Limit of a fit with all its diagnostics: so many times the limit of the fit alone, and so many seconds more."""
Row = dict[str, Any]
"""A row of the table: a quantity of a fit with its intervals; of a fit without an answer there is one."""


@dataclass(frozen=True, eq=False)
class MeasuredFit:
    """A task of the engine: the fit of a sibling of a set by a method, within ``timeout_s``."""

    name: str
    of: MeasuredSet
    request: Request
    job: Job
    sibling: str
    recording: Recording
    timeout_s: float
    size: int = 1

    @cached_property
    def key(self) -> str:
        """Return a digest of all that the fit depends on but its limit of time."""
        settings = {name: str(value) for name, value in self.job.settings().items()}
        method = self.job.config.method["name"]
        parts = [
            ROWS, [field.name for field in fields(StatedInterval)], self.name, self.of.definition(),
            self.request.system, self.sibling, self.recording.sha256, method, load_method(method).version, settings,
            self.job.config.seed,
        ]  # fmt: skip
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:20]

    @property
    def kind(self) -> tuple[str, str]:
        """Return the method and the set."""
        return self.job.label, f"{self.name} {self.request.system}, {self.sibling}"

    @property
    def limit_s(self) -> float:
        """Return the limit of the fit with all its diagnostics, whose fits of replicas have limits of their own."""
        return ANALYSES * self.timeout_s + ANALYSIS_S

    @property
    def head(self) -> Row:
        """Return what every row of the fit states."""
        system, method = self.request.system, self.job.label
        return {"set": self.name, "system": system, "sibling": self.sibling, "method": method}

    def read(self, folder: Path) -> list[Row] | None:
        """Return the stored rows; None where there are none, or the fit ran out of a shorter time than is allowed."""
        content = read_result(folder, self.key)
        rows: list[Row] | None = None if content is None else json.loads(content)
        late = rows is not None and rows[0]["status"] == "timeout" and rows[0]["timeout_s"] < self.timeout_s
        return None if late else rows

    def stored(self, folder: Path) -> bool:
        """Return whether the rows are stored whole."""
        return self.read(folder) is not None

    def compute(self, folder: Path) -> None:
        """Fit and store; raises InputError where the folder cannot be written."""
        write_result(folder, self.key, json.dumps(self.rows()).encode())

    def measured(self) -> Measured:
        """Return the sibling as a problem."""
        return described(self.of, self.request, self.recording)

    def rows(self) -> list[Row]:
        """Fit the sibling; return a row for each quantity, or one that says why there is none."""
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


def described(of: MeasuredSet, request: Request, recording: Recording) -> Measured:
    """Return a recording as a problem of a set; raises InputError."""
    measured = read_measured(request, (recording,))
    system = measured.problem.system
    if isinstance(system, Sum) and of.bias_sign != system.bias_sign:
        return with_system(measured, replace(system, bias_sign=of.bias_sign))
    return measured


def tasks(
    name: str, of: MeasuredSet, methods: Sequence[str], data_root: Path | None, timeout_s: float
) -> Iterator[MeasuredFit]:
    """Yield the fits of a set, sibling by sibling; none where its files are not there. Raises InputError."""
    for system in of.systems:
        for path in of.paths(data_root):
            request = request_of(of.overrides(system, methods, path, timeout_s))
            for i, piece in enumerate(pieces(read_recording(path, request.options), of), 1):
                for job in request.jobs:
                    sibling = f"{path.name} {i}/{of.parts}"
                    yield MeasuredFit(name, of, request, job, sibling, piece, timeout_s)


def pieces(recording: Recording, of: MeasuredSet) -> list[Recording]:
    """Cut a recording of a set into its parts, thinned, each from time 0."""
    end = of.time_scale * max(float(signal.times[-1]) for signal in recording.signals)
    edges = np.linspace(0.0, end * (1.0 + 1e-12), of.parts + 1)
    edges[-1] = np.inf
    cut = []
    for low, high in pairwise(edges):
        part = []
        for signal in recording.signals:
            times = signal.times * of.time_scale
            inside = (times >= low) & (times < high)
            part.append(replace(signal, times=times[inside], values=signal.values[inside]))
        start = min(float(signal.times[0]) for signal in part)
        thinned = (_thinned(replace(signal, times=signal.times - start), of) for signal in part)
        cut.append(replace(recording, signals=tuple(thinned)))
    return cut


def _thinned(signal: Signal, of: MeasuredSet) -> Signal:
    """Keep some samples of a motion, means of some of a force and its ends."""
    if signal.measures != "force":
        return replace(signal, times=signal.times[:: of.thin], values=signal.values[:: of.thin])
    n = signal.values.size // of.thin_force * of.thin_force
    if of.thin_force == 1 or n == 0:
        return signal
    times, values = (
        np.concatenate([samples[:1], samples[:n].reshape(-1, of.thin_force).mean(axis=1), samples[-1:]])
        for samples in (signal.times, signal.values)
    )
    return replace(signal, times=times, values=values)
