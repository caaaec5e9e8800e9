"""A tracking session: samples are read, estimates are written as JSON lines and displayed, the state is saved."""

from __future__ import annotations

import itertools
import json
import math
import sys
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TextIO

from bench.contract.online import OnlineIdentifier, Sample, Tracker, TrackerOutput
from bench.errors import InputError
from bench.online.follow import moments
from bench.online.score import Z95
from bench.twin.filtering import Filter
from bench.twin.pressure import Intake, report
from bench.twin.state import save

WIDEST = 20.0
"""Estimates whose logarithm has at least this standard deviation are not shown."""


LINE = json.JSONEncoder(allow_nan=False, separators=(",", ":"))


class Display(Protocol):
    """Display of the reports of a session, in the terminal or on a page."""

    def add(self, report: dict[str, Any]) -> None: ...
    def close(self) -> None: ...


def interval_of(samples: Iterable[Sample | None], columns: str) -> float:
    """Return the median interval (s) of samples; raises InputError, which names the columns, for fewer than two."""
    times = sorted({sample.time for sample in samples if sample is not None})
    steps = sorted(b - a for a, b in itertools.pairwise(times))
    if not steps:
        raise InputError(
            "stream", f"{len(times)} sample(s)", f"at least two of the form {columns} are needed, or rate="
        )
    return float(steps[len(steps) // 2])


@dataclass
class Session:
    """A tracker applied to a stream; the state is saved every ``save_every`` samples and at the end, if it has a
    file."""

    method: OnlineIdentifier
    tracker: Tracker
    intake: Intake
    filter: Filter
    alarm: float | None
    state: Path | None
    save_every: int
    displays: Sequence[Display] = ()

    def follow(self, output: Output) -> None:
        """Process samples until the stream ends or is interrupted; samples that were processed before are skipped."""
        tracker, last, again = self.tracker, self.filter.last or self.tracker.last, 0
        try:
            while (sample := self.intake.get()) is not None:
                if last is not None and sample.time <= last:
                    again += 1
                    continue
                taken = sample if tracker.is_far(sample.time) else self.filter.take(sample)
                if taken is None:
                    continue
                state = self.report(taken, tracker.update(taken))
                output.write(LINE.encode(state), at_once=not self.intake.waiting)
                for display in self.displays:
                    display.add(state)
                if self.state and tracker.samples % self.save_every == 0:
                    output.flush()
                    save(self.state, self.method, tracker, self.filter)
        finally:
            if self.state:
                save(self.state, self.method, tracker, self.filter)
            for display in self.displays:
                display.close()
            if again:
                report(f"{again} sample(s) used before are ignored")

    def report(self, sample: Sample, standing: TrackerOutput) -> dict[str, Any]:
        """Return the estimates after a sample as plain values for JSON; unknown values are null."""
        layout = self.tracker.layout
        means, sds = moments(standing, layout)
        quantities = {
            q.name: {
                "value": _number(math.exp(m)), "low": _number(math.exp(m - Z95 * s)),
                "high": _number(math.exp(m + Z95 * s)), "unit": q.unit,
            }
            for q, m, s in zip(layout.quantities, means.tolist(), sds.tolist(), strict=True)
            if math.isfinite(m) and s < WIDEST
        }  # fmt: skip
        predicted = () if standing.prediction is None else standing.prediction.tolist()
        return {
            "sample": self.tracker.samples,
            "t": _number(sample.time),
            "status": standing.status.value,
            "message": standing.message,
            "quantities": quantities,
            "measured": _numbers(sample.values),
            "prediction": _numbers(predicted),
            "prediction_sd": _numbers(() if standing.prediction_sd is None else standing.prediction_sd.tolist()),
            "residual": _numbers(y - h for y, h in zip(sample.values, predicted, strict=False)),
            "alarm": _number(standing.alarm),
            "ringing": self.alarm is not None and standing.alarm > self.alarm,
            "waiting": self.intake.waiting,
            "decimated": self.intake.decimated,
            "unreadable": self.intake.unreadable,
        }


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _numbers(values: Iterable[float]) -> list[float | None]:
    return [_number(value) for value in values]


class Output:
    """Destination of the JSON lines: a file, ``-`` for standard output, or ``none``.

    A resumed session keeps the lines of the ``n_samples`` samples that its state includes.
    """

    def __init__(self, place: str, path: Path, n_samples: int | None) -> None:
        self.file: TextIO | None = sys.stdout if place == "-" else None
        self.closes = place not in ("-", "none")
        if self.closes:
            try:
                before = [] if n_samples is None else _until(path, n_samples)
                self.file = path.open("w", encoding="utf-8")
                self.file.writelines(before)
            except OSError as error:
                raise InputError("out", place, f"cannot be written: {error.strerror}") from None

    def write(self, text: str, at_once: bool = True) -> None:
        """Write a line."""
        if self.file is not None:
            self.file.write(text + "\n")
            if at_once:
                self.file.flush()

    def flush(self) -> None:
        """Write all buffered lines to the file."""
        if self.file is not None:
            self.file.flush()

    def __enter__(self) -> Output:
        return self

    def __exit__(self, *_: object) -> None:
        self.flush()
        if self.closes and self.file is not None:
            self.file.close()


def _until(place: Path, n_samples: int) -> list[str]:
    """Return the lines of an earlier session up to the sample of its saved state."""
    kept = []
    for text in place.read_text(encoding="utf-8").splitlines(keepends=True) if place.is_file() else []:
        with suppress(ValueError, KeyError):  # an incomplete line of a killed session
            if json.loads(text)["sample"] <= n_samples:
                kept.append(text)
    return kept
