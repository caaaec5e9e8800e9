"""A measured record from Python: what a method finds in it, with intervals and residuals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bench.config.experiment import sweep
from bench.config.overrides import overrides_of
from bench.config.schema import Job
from bench.errors import InputError
from bench.face.results import nulls
from bench.measured.record import Table, identify_record, report, table_of
from bench.reporting.terminal_tables import record_page


@dataclass(frozen=True)
class IntervalEstimate:
    """What was found of one quantity: its value and 95 % interval, in ``unit``."""

    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True, eq=False)
class Residuals:
    """Measured minus identified displacement in ``unit``: all ``values`` and what they amount to."""

    values: np.ndarray
    rms: float
    part_of_signal: float
    lag1_autocorrelation: float
    offset: float
    unit: str


@dataclass(frozen=True, eq=False)
class Identification:
    """What a method found in a measured record.

    ``estimates`` hold the quantities that the data tell, by name; ``status`` is ``ok``, or says with ``message`` why
    there are none. ``scale_is_free`` where nothing tells mass, damping and stiffness themselves from their ratios.
    """

    method: str
    data: str
    samples: int
    status: str
    message: str
    wall_s: float
    estimates: Mapping[str, IntervalEstimate]
    residuals: Residuals | None
    scale_is_free: bool

    @property
    def values(self) -> dict[str, float]:
        """Value of every quantity."""
        return {name: found.value for name, found in self.estimates.items()}

    @property
    def intervals(self) -> dict[str, tuple[float, float]]:
        """95 % interval of every quantity."""
        return {name: (found.low, found.high) for name, found in self.estimates.items()}

    def as_dict(self) -> dict[str, Any]:
        """All of it, ready for JSON: null stands for what is not finite."""
        found: dict[str, Any] = nulls(self._plain())
        return found

    def _plain(self) -> dict[str, Any]:
        named = ("method", "data", "samples", "status", "message", "wall_s")
        r = self.residuals
        return {
            **{name: getattr(self, name) for name in named},
            "estimates": {name: vars(found) for name, found in self.estimates.items()},
            "residuals": None if r is None else {**vars(r), "values": r.values.tolist()},
        }

    def __repr__(self) -> str:
        return record_page(self.method, Path(self.data), self._plain(), self.scale_is_free)

    def _repr_html_(self) -> str:
        """A notebook's table."""
        import pandas as pd

        lines = {name: vars(found) for name, found in self.estimates.items()}
        table = pd.DataFrame.from_dict(lines, orient="index").to_html(float_format="{:.4g}".format) if lines else ""
        return f"{table}<p>{self.method}: {self.samples} samples, {self.status}. {self.message}</p>"


def identify(
    data: str | Path | ArrayLike,
    displacement: ArrayLike | None = None,
    force: ArrayLike | None = None,
    *,
    method: str,
    system: str | None = None,
    prior: str | None = None,
    nominal: Mapping[str, float] | None = None,
    start: tuple[float, float] | None = None,
    seed: int | None = None,
    settings: Mapping[str, Any] | None = None,
    timeout_s: float | None = None,
    memory_mb: float | None = None,
) -> Identification:
    """Identify a measured record with one method, in a process of its own; nothing is printed or stored.

    Args:
        data: a CSV file with columns t, x and optionally a force; or the times (s) of the samples, increasing.
        displacement: the samples (m), where ``data`` are times.
        force: the force (N) at the same times, where one acts and ``data`` are times.
        method: a method.
        system: a scenario of ``conf/system`` whose system it is, of one DOF; by default m x'' + c x' + k x = f.
        prior: how well the nominal values are known; by default nothing is.
        nominal: with a prior, what is stated of each parameter: ``{"m": 1.2, "c": 0.3, "k": 8.0}`` in SI units.
        start: displacement and velocity at time 0, where they are known; else they, and an offset, are estimated.
        seed: of the method's random stream.
        settings: settings of the method by their dotted names: ``{"method.width": 32}``.
        timeout_s: limit of the fit, in seconds.
        memory_mb: limit of the fit.

    Returns:
        Values, 95 % intervals and residuals, or why there are none.

    Raises:
        InputError: for a record or setting that makes no sense, with the sentence of the command line.

    >>> import numpy as np
    >>> import bench
    >>> times = np.linspace(0.0, 10.0, 200)
    >>> displacement = np.exp(-0.2 * times) * np.cos(2.8 * times)
    >>> answer = bench.identify(times, displacement, method="ls")
    >>> answer.status
    'ok'
    >>> low, high = answer.intervals["natural_frequency"]
    >>> bool(low < answer.values["natural_frequency"] < high)
    True
    >>> bench.identify("nowhere.csv", method="ls")
    Traceback (most recent call last):
    bench.errors.InputError: data=nowhere.csv: cannot be read: No such file or directory
    """
    table, path = _record(data, displacement, force)
    fields = {
        "method": method, "system": system, "prior": prior, "nominal": nominal, "seed": seed, "timeout_s": timeout_s,
        "memory_mb": memory_mb, "data": path,
    }  # fmt: skip
    known = {"start": [list(start)], "initial_state": "known"} if start is not None else {}
    jobs = sweep(overrides_of(fields, known, settings or {}))
    if len(jobs) > 1:
        raise InputError("data", path or "times", "one record and one method at a time")
    return identification(jobs[0], table)


def _record(
    data: str | Path | ArrayLike, displacement: ArrayLike | None, force: ArrayLike | None
) -> tuple[Table | None, str | None]:
    """The record as it was given: a table, or the path of a file."""
    if isinstance(data, str | Path):
        if displacement is not None or force is not None:
            raise InputError("displacement", "array", "a file has it; give a file, or times and displacement")
        return None, str(data)
    if displacement is None:
        raise InputError("displacement", None, "times need displacements; or give the path of a CSV file")
    return table_of(data, displacement, force), None


def identification(job: Job, table: Table | None = None) -> Identification:
    """Identify the record of a job, or the one given; raises InputError."""
    problem, outcome = identify_record(job, table)
    found = report(problem, outcome)
    residuals = found["residuals"]
    return Identification(
        method=job.label,
        data=problem.name if job.config.data is None else str(job.config.data),
        samples=found["samples"],
        status=found["status"],
        message=found["message"],
        wall_s=found["wall_s"],
        estimates={name: IntervalEstimate(**own) for name, own in found["estimates"].items()},
        residuals=None if residuals is None else Residuals(**{**residuals, "values": np.array(residuals["values"])}),
        scale_is_free=problem.prior is None and not problem.forced,
    )
