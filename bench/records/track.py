"""The measured track: every set, sibling and method fitted once, and stored as a file.

A fit is stored under a digest of all that it depends on: the definition of its set, the bytes of its file, the system,
the part of the record, and the method with all its settings.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path

import numpy as np

from bench.config.records import primary_method
from bench.config.schema import Job
from bench.entrants.registry import load_method
from bench.errors import InputError
from bench.records.find import find
from bench.records.finding import Finding
from bench.records.held_out import held_out_fit
from bench.records.intervals import StatedInterval
from bench.records.problem import Measured, read_measured, with_system
from bench.records.reading import Recording, read_recording
from bench.records.request import Request, request_of
from bench.records.sets import MeasuredSet
from bench.records.siblings import pieces
from bench.store.results import read_result, write_result
from bench.systems.sums import Sum

ANALYSES, ANALYSIS_S = 50.0, 3600.0
"""Limit of a fit with all its diagnostics: so many times the limit of the fit alone, and so many seconds more."""


@dataclass(frozen=True)
class TrackFit:
    """One finished fit: what it is of, what was found, and how far to trust it.

    ``estimates`` stand; ``withdrawn`` are those of an answer that is not to be trusted. ``held_out``: the fit (%) of
    the last 40 % predicted from the first 60; ``offset``: of the sensor.
    """

    key: str
    set: str
    system: str
    sibling: str
    method: str
    status: str
    message: str
    trust: str
    reasons: tuple[str, ...]
    wall_s: float
    timeout_s: float
    samples: int
    estimates: Mapping[str, StatedInterval] = field(default_factory=dict)
    withdrawn: Mapping[str, StatedInterval] = field(default_factory=dict)
    held_out: float = math.nan
    offset: float = math.nan

    def as_json(self) -> str:
        """Return the fit as JSON, with NaN as Python writes it."""
        return json.dumps(asdict(self), sort_keys=True)

    @staticmethod
    def of_json(text: str | bytes) -> TrackFit:
        """Return the fit of such a text."""
        content = json.loads(text)
        for name in ("estimates", "withdrawn"):
            content[name] = {quantity: StatedInterval(**interval) for quantity, interval in content[name].items()}
        return TrackFit(**{**content, "reasons": tuple(content["reasons"])})


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

    @property
    def key(self) -> str:
        """Return a digest of all that the fit depends on but its limit of time."""
        settings = {name: str(value) for name, value in self.job.settings().items()}
        parts = [
            self.name, self.of.definition(), self.request.system, self.sibling, self.recording.sha256,
            self.job.config.method["name"], load_method(self.job.config.method["name"]).version, settings,
            self.job.config.seed, [field.name for field in fields(StatedInterval)],
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

    def stored(self, folder: Path) -> bool:
        """Return whether the fit is stored, and has not run out of a shorter time than is allowed now."""
        fit = read_fit(folder, self.key)
        return fit is not None and not (fit.status == "timeout" and fit.timeout_s < self.timeout_s)

    def compute(self, folder: Path) -> None:
        """Fit and store; raises InputError where the folder cannot be written."""
        write_result(folder, self.key, fitted(self).as_json().encode())

    def measured(self) -> Measured:
        """Return the sibling as a problem."""
        return described(self.of, self.request, self.recording)


def described(of: MeasuredSet, request: Request, recording: Recording) -> Measured:
    """A recording as a problem of a set; raises InputError."""
    measured = read_measured(request, (recording,))
    system = measured.problem.system
    if isinstance(system, Sum) and of.bias_sign != system.bias_sign:
        return with_system(measured, replace(system, bias_sign=of.bias_sign))
    return measured


def tasks(
    name: str, of: MeasuredSet, methods: Sequence[str], data_root: Path | None, timeout_s: float
) -> Iterator[MeasuredFit]:
    """The fits of a set, sibling by sibling; none where its files are not there. Raises InputError."""
    siblings: list[tuple[str, Path, Recording]] = []
    for path in of.paths(data_root):
        options = request_of(of.overrides(of.systems[0], [primary_method()], path, timeout_s)).options
        cut = pieces(read_recording(path, options), of)
        siblings += [(f"{path.name} {i}/{len(cut)}", path, piece) for i, piece in enumerate(cut, 1)]
    for system in of.systems:
        for label, path, recording in siblings:
            request = request_of(of.overrides(system, list(methods), path, timeout_s))
            for job in request.jobs:
                yield MeasuredFit(name, of, request, job, label, recording, timeout_s)


def read_fit(folder: Path, key: str) -> TrackFit | None:
    """Return a stored fit; None where there is none, or it is damaged."""
    content = read_result(folder, key)
    return None if content is None else TrackFit.of_json(content)


def fitted(task: MeasuredFit) -> TrackFit:
    """Fit a sibling."""
    head = {
        "key": task.key, "set": task.name, "system": task.request.system, "sibling": task.sibling,
        "method": task.job.label, "timeout_s": task.timeout_s,
    }  # fmt: skip
    try:
        finding = find(task.job, task.measured())
    except InputError as error:
        nothing = {"reasons": (), "wall_s": math.nan, "samples": 0}
        return TrackFit(**head, status="refused", message=str(error), trust="do not trust", **nothing)  # type: ignore[arg-type]
    with np.errstate(all="ignore"):
        held_out = math.nan if finding.fit is None else held_out_fit(finding.fit)
    return TrackFit(
        **head,  # type: ignore[arg-type]
        status=finding.outcome.status.value,
        message=finding.outcome.message,
        trust=finding.trust.value,
        reasons=tuple(reason.text for reason in finding.reasons),
        wall_s=finding.outcome.wall_s,
        samples=finding.problem.n,
        estimates=dict(finding.intervals),
        withdrawn=dict(finding.withdrawn),
        held_out=held_out,
        offset=_offset(finding),
    )


def _offset(finding: Finding) -> float:
    """Of the first channel, in the user's units."""
    at = finding.fit
    if at is None:
        return math.nan
    return finding.channel_size * float(at.model.offsets(at.theta)[0])
