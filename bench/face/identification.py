"""Measured records from Python: what a method finds in them, with intervals, residuals and how far to trust it."""

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
    """What one of several records says alone; ``left_out``: why it is no part of the joint answer, or empty."""

    trust: str
    left_out: str
    estimates: Mapping[str, StatedInterval]


@dataclass(frozen=True, eq=False)
class Identification:
    """What a method found in measured records.

    ``trust`` is ``trust``, ``use with caution`` or ``do not trust``, and ``reasons`` say why. ``estimates`` hold the
    quantities that the data tell, by name, each with the interval that the records support (``low``, ``high``) and the
    method's own, which takes the noise for white (``white_low``, ``white_high``); there are none where the answer is
    not to be trusted, and ``withdrawn`` keeps what the method said. ``status`` is ``ok``, or says with ``message`` why
    there is no answer. ``modes`` are offered where the record holds several, or an alias fits as well;
    ``runs`` hold what each of several records says alone.
    ``scale_is_free`` where nothing tells mass, damping and stiffness themselves from their ratios.
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
        """Value of every quantity."""
        return {name: interval.value for name, interval in self.estimates.items()}

    @property
    def intervals(self) -> dict[str, tuple[float, float]]:
        """95 % interval of every quantity."""
        return {name: (interval.low, interval.high) for name, interval in self.estimates.items()}

    def as_dict(self) -> dict[str, Any]:
        """Return all of it, ready for JSON: null stands for what is not finite."""
        plain: dict[str, Any] = nulls(self.plain())
        return plain

    def plain(self) -> dict[str, Any]:
        """Return all of it as plain values, of which some may not be finite."""
        plain = asdict(self)
        del plain["scale_is_free"]
        lists = {name: list(plain[name]) for name in ("reasons", "notes", "modes")}
        if self.residuals is not None:
            plain["residuals"]["values"] = self.residuals.values.tolist()
        return plain | lists

    def __repr__(self) -> str:
        return record_page(self.plain(), self.scale_is_free)

    def _repr_html_(self) -> str:
        """Return a notebook's table."""
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
    """Identify measured records with one method, in a process of its own; nothing is printed or stored.

    Args:
        data: a file, or several of one rig (text, xlsx, xls, mat, npz, Parquet, UFF 58, TDMS, wav); or the times of
            samples (s, or dates).
        displacement: the samples (m), where ``data`` are times.
        force: the force (N) at the same times, where one acts and ``data`` are times.
        method: a method; with ``modes`` a modal method, by default that of maximum likelihood.
        modes: ``"auto"`` or a number, where several modes are sought; they are in ``modes`` of the answer.
        band: lowest and highest frequency (Hz) of the modes that are sought.
        system: ``auto``, a sum of terms as ``sdof+coulomb``, or a scenario of ``conf/system`` whose system it is; by
            default m x'' + c x' + k x = f.
        columns: which column is what, where a file does not say: ``{"t": 0, "x": 3}``.
        units: in which unit, where a file does not say: ``{"t": "ms", "x": "mm"}``.
        rate: samples a second, where no column is the time.
        base: column of the ground's acceleration, which drives the motion.
        motion: with ``base``: ``relative`` to the ground, or ``absolute`` of an accelerometer on the mass.
        span: first and last time (s) to use, on the file's own clock.
        decimate: every n-th sample is kept, after a low-pass filter.
        detrend: whether the drift of a sensor is taken away; by default where it is significant.
        fixed: parameters that are told: ``{"l": 1.0}``.
        prior: how well the nominal values are known; by default nothing is.
        nominal: with a prior, what is stated of each parameter: ``{"m": 1.2, "c": 0.3, "k": 8.0}`` in SI units.
        start: displacement and velocity at time 0, where they are known; else they, and offsets, are estimated.
        seed: of the method's random stream.
        settings: settings of the method by their dotted names: ``{"method.width": 32}``.
        timeout_s: limit of the fit, in seconds.
        memory_mb: limit of the fit.

    Returns:
        Values, 95 % intervals, residuals and how far to trust them, or why there are none.

    Raises:
        InputError: for a record or setting that makes no sense, with the sentence of the command line.

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
    of_file: dict[str, Any] = {
        "data": ",".join(paths) or None,
        "columns": _written("columns", columns, "{'t': 0, 'x': 3}"),
        "units": _written("units", units, "{'t': 'ms', 'x': 'mm'}"),
    }
    if span is not None:
        of_file |= {"from": span[0], "to": span[1]}
    choices = {
        "system": system,
        "method": method if modes is not None else None,
    }  # which are checked where they are read
    overrides = {
        **overrides_of(fields, known, of_file, settings or {}),
        **{name: [choice] for name, choice in choices.items() if choice is not None},
    }
    if modes is not None:
        modal = modal_request_of(overrides)
        read = () if paths else (of_arrays(data, displacement, force, modal.options),)  # type: ignore[arg-type]
        findings = [finding for record in read_modal(modal, read) for finding in find_modes(modal, record)]
        if len(findings) > 1:
            raise InputError("data", ", ".join(paths), f"{len(findings)} answers: one record and one method at a time")
        return identified_modes(findings[0])
    request = request_of(overrides)
    if len(request.jobs) > 1:
        raise InputError("method", method, "one method at a time")
    recordings = () if paths else (of_arrays(data, displacement, force, request.options),)  # type: ignore[arg-type]
    return identified(identify_all(request, read_measured(request, recordings))[0])


def _written(field: str, pairs: Mapping[str, Any] | None, example: str) -> str | None:
    if pairs is not None and not isinstance(pairs, Mapping):
        raise InputError(field, pairs, f"a mapping, as {example}")
    return None if not pairs else ",".join(f"{role}:{value}" for role, value in pairs.items())


def _paths(
    data: str | Path | Sequence[str | Path] | ArrayLike, displacement: ArrayLike | None, force: ArrayLike | None
) -> list[str]:
    """Return the paths of the files that are given; none where arrays are."""
    paths = [data] if isinstance(data, str | Path) else data
    if isinstance(paths, list | tuple) and paths and all(isinstance(path, str | Path) for path in paths):
        if displacement is not None or force is not None:
            raise InputError("displacement", "array", "a file has it; give a file, or times and displacement")
        return [str(path) for path in paths]
    if displacement is None:
        raise InputError("displacement", None, "times need displacements; or give the path of a file")
    return []


def identified(finding: Finding) -> Identification:
    """Return a finding as users get it."""
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
    """Return the modes of a record as users get them."""
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
