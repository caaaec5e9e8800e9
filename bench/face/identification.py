"""Identification of measured records from Python: values, intervals, residuals, and a verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from bench.config.overrides import overrides_of
from bench.errors import InputError
from bench.face.results import nulls
from bench.records.finding import Finding
from bench.records.identification import identify_all
from bench.records.intervals import StatedInterval
from bench.records.modal import ModalFinding, find_modes, residuals_of_modes
from bench.records.modal_data import read_modal
from bench.records.modes import OfferedMode
from bench.records.problem import read_measured
from bench.records.reading import of_arrays
from bench.records.request import modal_request_of, request_of
from bench.records.response import ChannelResiduals, residuals_of
from bench.reporting.record_page import record_page


@dataclass(frozen=True, eq=False)
class RunAnswer:
    """The result of one of several records alone.

    Attributes:
        trust: ``trust``, ``use with caution`` or ``do not trust``.
        left_out: Why the record is not part of the joint estimate, or empty.
        estimates: Values with intervals by quantity.
    """

    trust: str
    left_out: str
    estimates: Mapping[str, StatedInterval]


@dataclass(frozen=True, eq=False)
class Identification:
    """The result of one method on measured records.

    Attributes:
        method: Name of the method.
        data: Names of the records.
        samples: Number of samples of all records.
        status: ``ok``, or the kind of failure.
        message: Why there is no estimate, or empty.
        wall_s: Time of the fit (s).
        trust: ``trust``, ``use with caution`` or ``do not trust``.
        reasons: Reasons of that verdict.
        notes: Notes of the import.
        estimates: The identifiable quantities by name, each with the interval that the records support (``low``,
            ``high``) and the interval assuming white noise (``white_low``, ``white_high``); empty where the verdict is
            ``do not trust``.
        withdrawn: The estimates where the verdict is ``do not trust``.
        modes: The modes of the record, if there are several, or aliases that fit equally well.
        residuals: Residuals of the fit, None without a fit.
        scale_is_free: Whether m, c and k are not individually identifiable, only their ratios.
        runs: Results of each of several records alone, by name.
    """

    method: str
    data: str
    samples: int
    status: str
    message: str
    wall_s: float
    trust: str
    reasons: tuple[str, ...]
    notes: tuple[str, ...]
    estimates: Mapping[str, StatedInterval]
    withdrawn: Mapping[str, StatedInterval]
    modes: tuple[OfferedMode, ...]
    residuals: ChannelResiduals | None
    scale_is_free: bool
    runs: Mapping[str, RunAnswer] = field(default_factory=dict)

    @property
    def values(self) -> dict[str, float]:
        """The value of each quantity."""
        return {name: interval.value for name, interval in self.estimates.items()}

    @property
    def intervals(self) -> dict[str, tuple[float, float]]:
        """The 95 % interval of each quantity."""
        return {name: (interval.low, interval.high) for name, interval in self.estimates.items()}

    def as_dict(self) -> dict[str, Any]:
        """Return all fields as plain values for JSON; None stands for numbers that are not finite."""
        return nulls(self.plain())  # type: ignore[no-any-return]

    def plain(self) -> dict[str, Any]:
        """Return all fields as plain values."""
        plain = asdict(self)
        del plain["scale_is_free"]
        lists = {name: list(plain[name]) for name in ("reasons", "notes", "modes")}
        if self.residuals is not None:
            plain["residuals"]["values"] = self.residuals.values.tolist()
        return plain | lists

    def __repr__(self) -> str:
        return record_page(self.plain(), self.scale_is_free)

    def _repr_html_(self) -> str:
        """Return the table that a notebook shows."""
        import pandas as pd

        shown = ["value", "low", "high", "unit"]
        rows = pd.DataFrame.from_dict({name: vars(row) for name, row in self.estimates.items()}, orient="index")
        table = rows[shown].to_html(float_format="{:.4g}".format) if self.estimates else ""
        reasons = "; ".join(self.reasons)
        return f"{table}<p>{self.method}: {self.samples} samples, {self.status}: {self.trust}. {reasons}</p>"


def identify(
    data: str | Path | Sequence[str | Path] | ArrayLike,
    displacement: ArrayLike | None = None,
    force: ArrayLike | None = None,
    *,
    method: str | None = None,
    modes: int | str | None = None,
    band: tuple[float, float] | None = None,
    system: str | None = None,
    columns: Mapping[str, int | str] | None = None,
    units: Mapping[str, str] | None = None,
    rate: float | None = None,
    base: int | str | None = None,
    motion: str | None = None,
    span: tuple[float, float] | None = None,
    decimate: int | None = None,
    detrend: bool | None = None,
    fixed: Mapping[str, float] | None = None,
    prior: str | None = None,
    nominal: Mapping[str, float] | None = None,
    start: tuple[float, float] | None = None,
    seed: int | None = None,
    settings: Mapping[str, Any] | None = None,
    timeout_s: float | None = None,
    memory_mb: float | None = None,
) -> Identification:
    """Identify measured records with one method, in a separate process; nothing is printed or stored.

    Args:
        data: A file, or several of one rig (text, xlsx, xls, mat, npz, Parquet, UFF 58, TDMS, wav); or the times of
            samples (n,), in s or as dates.
        displacement: The samples (n,) in m, if ``data`` are times.
        force: A measured force (n,) in N at the same times, if ``data`` are times.
        method: Name of a method, by default that of a certificate; with ``modes`` a modal method.
        modes: Number of modes to identify, or ``"auto"``; the result has them in ``modes``.
        band: Lowest and highest frequency (Hz) of the modes.
        system: ``auto``, a sum of terms such as ``sdof+coulomb``, or a scenario of ``conf/system`` (its equations); by
            default m x'' + c x' + k x = f.
        columns: Roles of columns that the file does not state: ``{"t": 0, "x": 3}``.
        units: Units that the file does not state: ``{"t": "ms", "x": "mm"}``.
        rate: Sampling rate (1/s), if no column is the time.
        base: Column of the acceleration of the ground, which drives the motion.
        motion: With ``base``: ``relative`` to the ground, or ``absolute`` for an accelerometer on the mass.
        span: First and last time (s) to use, in the time of the file.
        decimate: Keep every Nth sample, after a low-pass filter.
        detrend: Whether to remove linear sensor drift; by default where it is significant.
        fixed: Parameters with a known value: ``{"l": 1.0}``.
        prior: Name of a prior about the nominal values; by default there is none.
        nominal: The nominal values of a prior in SI units: ``{"m": 1.2, "c": 0.3, "k": 8.0}``.
        start: Known initial displacement (m) and velocity (m/s); by default they are estimated, with sensor offsets.
        seed: Random seed of the method.
        settings: Settings of the method by their dotted names: ``{"method.width": 32}``.
        timeout_s: Time limit of the fit (s).
        memory_mb: Memory limit of the fit (MB).

    Returns:
        Values, 95 % intervals, residuals and a verdict, or the reason why there are none.

    Raises:
        InputError: for a malformed record or field, with the message of the command line.

    Examples:
        >>> import numpy as np
        >>> import bench
        >>> times = np.linspace(0.0, 10.0, 200)
        >>> noise = 0.01 * np.random.default_rng(0).standard_normal(200)
        >>> displacement = np.exp(-0.2 * times) * np.cos(2.8 * times) + noise
        >>> answer = bench.identify(times, displacement, method="output_error")
        >>> answer.trust
        'trust'
        >>> low, high = answer.intervals["natural_frequency"]
        >>> bool(low < (2.8**2 + 0.2**2) ** 0.5 / 6.2832 < high)
        True
        >>> bench.identify("nowhere.csv", method="ls")
        Traceback (most recent call last):
        bench.errors.InputError: data=nowhere.csv: cannot be read: No such file or directory
    """
    paths = _paths(data, displacement, force)
    fields = {
        "method": method if modes is None else None, "modes": None if modes is None else str(modes),
        "band": None if band is None else ":".join(map(str, band)), "prior": prior, "nominal": nominal, "seed": seed,
        "timeout_s": timeout_s, "memory_mb": memory_mb, "rate": rate, "fixed": fixed, "decimate": decimate,
        "detrend": detrend, "base": None if base is None else str(base), "motion": motion,
    }  # fmt: skip
    known = {"start": [list(start)], "initial_state": "known"} if start is not None else {}
    file_fields: dict[str, Any] = {
        "data": ",".join(paths) or None,
        "columns": _written("columns", columns, "{'t': 0, 'x': 3}"),
        "units": _written("units", units, "{'t': 'ms', 'x': 'mm'}"),
    }
    if span is not None:
        file_fields |= {"from": span[0], "to": span[1]}
    choices = {"system": system, "method": method if modes is not None else None}  # checked where they are read
    overrides = {
        **overrides_of(fields, known, file_fields, settings or {}),
        **{name: [choice] for name, choice in choices.items() if choice is not None},
    }
    if modes is not None:
        modal = modal_request_of(overrides)
        read = () if paths else (of_arrays(data, displacement, force, modal.options),)  # type: ignore[arg-type]
        findings = [finding for record in read_modal(modal, read) for finding in find_modes(modal, record)]
        if len(findings) > 1:
            raise InputError("data", ", ".join(paths), f"{len(findings)} results; give one record and one method")
        return identified_modes(findings[0])
    request = request_of(overrides)
    if len(request.jobs) > 1:
        raise InputError("method", method, "give one method")
    recordings = () if paths else (of_arrays(data, displacement, force, request.options),)  # type: ignore[arg-type]
    return identified(identify_all(request, read_measured(request, recordings))[0])


def _written(field: str, pairs: Mapping[str, Any] | None, example: str) -> str | None:
    if pairs is not None and not isinstance(pairs, Mapping):
        raise InputError(field, pairs, f"a mapping, such as {example}")
    return None if not pairs else ",".join(f"{role}:{value}" for role, value in pairs.items())


def _paths(
    data: str | Path | Sequence[str | Path] | ArrayLike, displacement: ArrayLike | None, force: ArrayLike | None
) -> list[str]:
    """Return the paths of files; empty for arrays."""
    paths = [data] if isinstance(data, str | Path) else data
    if isinstance(paths, list | tuple) and paths and all(isinstance(path, str | Path) for path in paths):
        if displacement is not None or force is not None:
            raise InputError("displacement", "array", "give either a file, or times and displacement")
        return [str(path) for path in paths]
    if displacement is None:
        raise InputError("displacement", None, "give displacements with times, or the path of a file")
    return []


def identified(finding: Finding) -> Identification:
    """Return the result of a fit in the form for users."""
    problem = finding.problem
    alone = [run.finding for run in finding.runs] or [finding]
    return Identification(
        method=finding.method,
        data=", ".join(recording.source for run in alone for recording in run.measured.recordings),
        samples=sum(run.problem.n for run in alone),
        status=finding.estimate.status.value,
        message=finding.estimate.message,
        wall_s=finding.wall_s,
        trust=finding.trust.value,
        reasons=tuple(reason.text for reason in finding.reasons),
        notes=finding.measured.notes,
        estimates=finding.intervals,
        withdrawn=finding.withdrawn,
        modes=finding.modes,
        residuals=residuals_of(finding),
        scale_is_free=problem.prior is None and not problem.scale_known and finding.measured.known_mass is None,
        runs={r.name: RunAnswer(r.finding.trust.value, r.left_out, r.finding.intervals) for r in finding.runs},
    )


def identified_modes(finding: ModalFinding) -> Identification:
    """Return the modes of a record in the form for users."""
    estimate, record = finding.estimate, finding.record
    return Identification(
        method=finding.method,
        data=record.source,
        samples=record.samples,
        status=estimate.status.value,
        message=estimate.message,
        wall_s=finding.wall_s,
        trust=finding.trust.value,
        reasons=tuple(reason.text for reason in finding.reasons),
        notes=finding.notes,
        estimates={},
        withdrawn={},
        modes=finding.modes,
        residuals=residuals_of_modes(finding),
        scale_is_free=False,
    )
