"""Identification problem of measured records: signals, requested system and prior knowledge of the user."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bench.config.schema import Job
from bench.contract.prior import Prior
from bench.contract.problem import Channel, Force, InitialState, Problem, Record
from bench.errors import InputError
from bench.records.base_excitation import with_base_excitation
from bench.records.decimation import decimated
from bench.records.dominant_frequency import dominant_frequency
from bench.records.models import ClassComparison, smoothing_velocity
from bench.records.prepare import prepare
from bench.records.reading import Recording, read_recordings
from bench.records.request import AUTO, Request
from bench.systems import System, make_system
from bench.systems.sums import Sum, sum_from

MAX_SAMPLES = 100_000
ANGLE = "rad"
CYCLE_SAMPLES, FEWEST = 10, 200
"""Least samples per cycle, and per record, after an automatic decimation."""


@dataclass(frozen=True, eq=False)
class Measured:
    """Measured records and their identification problem.

    Attributes:
        recordings: The prepared recordings.
        problem: The problem, in the user's units.
        notes: Sentences on the preparation.
        known_mass: Mass (kg) that converts ratios to the mass into parameters, if the data do not determine it.
        comparison: Comparison of model classes.
    """

    recordings: tuple[Recording, ...]
    problem: Problem
    notes: tuple[str, ...]
    known_mass: float | None = None
    comparison: ClassComparison | None = None

    @property
    def unit(self) -> str:
        """Unit of the first channel."""
        return self.problem.records[0].channels[0].unit

    @property
    def angle(self) -> bool:
        """Whether the first channel measures a rotation."""
        return self.unit.startswith(ANGLE)

    def unit_of(self, unit: str) -> str:
        """Return the unit of a quantity; for rotations ``N·s/m`` becomes ``N·m·s/rad``, and ``kg`` ``kg·m²``."""
        return unit.replace("m", "rad").replace("N", "N·m").replace("kg", "kg·m²") if self.angle else unit


def read_measured(request: Request, recordings: Sequence[Recording] = ()) -> Measured:
    """Read the files of a request, prepare the signals and return the problem.

    Args:
        request: Files, options, system, and prior knowledge.
        recordings: Recordings that were read already, in place of the files.

    Raises:
        InputError: A file cannot be read, or the request does not fit the records.
    """
    if not recordings:
        recordings = [recording for path in request.files for recording in read_recordings(path, request.options)]
    job, state = request.job, _initial_state(request.job)
    recordings = [with_base_excitation(recording, job.config.motion) for recording in recordings]
    n_dof = _system(request, recordings[0]).n_dof
    recordings = prepare(recordings, request.options, known_state=state is not None, n_dof=n_dof)
    system = _system(request, recordings[0])
    records = tuple(_record(recording, system, state, job) for recording in recordings)
    for name, value in (("force_gain", job.config.force_gain), ("hold", job.config.hold)):
        if name in job.explicit and not any(record.forces for record in records):
            raise InputError(name, value, "the record has no force; omit it, or name the force's column by columns=")
    names, prior = ", ".join(Path(recording.source).name for recording in recordings), _prior(job, system)
    try:
        problem = Problem(system, records, prior, name=names)
    except InputError as error:
        raise InputError("data", f"{names} ({error.field} {error.value})", error.remedy) from None
    mass = job.config.fixed.get("m")
    if mass is not None and mass <= 0:
        raise InputError("fixed.m", mass, "a positive mass (kg)")
    if mass is not None and (problem.prior is not None or problem.scale_known):
        raise InputError("fixed.m", mass, "the mass is determined by the force or the prior; omit it")
    return Measured(recordings, problem, _notes(recordings), mass)


def _notes(recordings: Sequence[Recording], before: Sequence[str] = ()) -> tuple[str, ...]:
    """Return earlier notes and those of recordings, without duplicates."""
    return tuple(dict.fromkeys([*before, *(note for recording in recordings for note in recording.notes)]))


def _system(request: Request, recording: Recording) -> System:
    """Return the requested system with its known parameters; the length of a pendulum is 1 if angles are measured."""
    job = request.job
    fixed = {name: value for name, value in job.config.fixed.items() if name != "m"}
    if fixed and request.system == AUTO:
        raise InputError("fixed", fixed, "not supported with system=auto; name the system")
    if fixed and "system" in job.explicit:
        raise InputError("fixed", fixed, "supported for sums of terms only, such as system=sdof+coulomb fixed.k=0")
    if request.system == AUTO:
        return sum_from("sdof")
    if "system" in job.explicit:
        return make_system(job.config.system["kind"], job.config.system["options"])
    motions = [signal for signal in recording.signals if signal.measures != "force"]
    motion = min(motions, key=lambda signal: signal.measures != "displacement", default=None)
    velocity = 0.01 if motion is None else smoothing_velocity(motion.times, motion.values, motion.measures)
    if motion is not None and motion.unit.startswith(ANGLE) and "pendulum" in request.system.split("+"):
        fixed.setdefault("l", 1.0)
    try:
        system = sum_from(request.system, smoothing_velocity=velocity, fixed=tuple(fixed.items()))
    except InputError as error:
        raise InputError(error.field.removeprefix("system.options."), error.value, error.remedy) from None
    if system.needs_scale and len(motions) == len(recording.signals) and "prior" not in job.explicit:
        raise InputError("fixed", fixed, "only ratios to the mass are identifiable; add a force or a prior")
    return system


def _record(recording: Recording, system: System, state: InitialState | None, job: Job) -> Record:
    name = Path(recording.source).name
    offset = state is None and getattr(system, "offset_identifiable", True)
    channels, forces = [], []
    for signal in recording.signals:
        if signal.dof >= system.n_dof:
            remedy = f"the system has {system.n_dof} DOF; choose a system of more DOF, or other columns="
            raise InputError("data", f"{name} ({signal.role})", remedy)
        if signal.times.size > MAX_SAMPLES:
            remedy = f"at most {MAX_SAMPLES}; select a part by from= and to=, or use decimate="
            raise InputError("data", f"{name}, {signal.times.size} samples", remedy)
        if signal.measures == "force":
            values = job.config.force_gain * signal.values
            forces.append(Force(signal.times, values, hold=job.config.hold, dof=signal.dof))
        else:
            channels.append(
                Channel(signal.times, signal.values, signal.measures, signal.dof, unit=signal.unit, offset=offset)
            )
    if not channels:
        raise InputError("data", name, "no column is a motion; name one by columns=x:<number>")
    try:
        return Record(tuple(channels), tuple(forces), state)
    except InputError as error:
        raise InputError("data", f"{name} ({error.field} {error.value})", error.remedy) from None


def _initial_state(job: Job) -> InitialState | None:
    """Return the initial state that the user has specified; raises InputError."""
    config = job.config
    if "initial_state" not in job.explicit or config.initial_state == "unknown":
        if config.start is not None:
            raise InputError("start", config.start, "it needs initial_state=known; add that or omit start=")
        return None
    if config.start is None or len(config.start) % 2 or not config.start:
        raise InputError("start", config.start, "initial_state=known needs start=[displacement,velocity] at time 0")
    half = len(config.start) // 2
    return InitialState(np.array(config.start[:half]), np.array(config.start[half:]))


def _prior(job: Job, system: System) -> Prior | None:
    spec = job.prior_spec() if "prior" in job.explicit else None
    if spec is None:
        return None
    nominal = job.config.nominal
    if set(nominal) != set(system.names):
        needed = " ".join(f"nominal.{name}=…" for name in system.names)
        raise InputError("nominal", dict(nominal), f"a prior on a measured record needs nominal values: {needed}")
    return Prior(
        {name: nominal[name] for name in system.names},
        {p.name: spec.sd_by_kind[p.kind] for p in system.parameters},
    )


def spare_factor(problem: Problem) -> int:
    """Return the largest decimation factor that leaves enough samples of every channel; 1 if none."""
    factors = []
    for channel in (channel for record in problem.records for channel in record.channels):
        per_cycle = (channel.n - 1) / float(np.ptp(channel.times)) / dominant_frequency(channel.times, channel.values)
        factors.append(min(per_cycle / CYCLE_SAMPLES, channel.n / FEWEST))
    return max(int(min(factors)), 1)


def with_fewer_samples(measured: Measured, factor: int, job: Job) -> Measured:
    """Return the records decimated by a factor, with a note; raises InputError if they cannot be decimated."""
    if any(record.initial_state is not None for record in measured.problem.records):
        raise InputError("decimate", factor, "the initial state is known, and decimation drops the first samples")
    recordings = tuple(decimated(recording, factor) for recording in measured.recordings)
    records = tuple(_record(recording, measured.problem.system, None, job) for recording in recordings)
    problem = replace(measured.problem, records=records)
    return replace(measured, recordings=recordings, problem=problem, notes=_notes(recordings, measured.notes))


def with_system(measured: Measured, system: Sum) -> Measured:
    """Return the records with another system; offsets are estimated only if they are identifiable."""
    records = tuple(
        replace(r, channels=tuple(replace(c, offset=c.offset and system.offset_identifiable) for c in r.channels))
        for r in measured.problem.records
    )
    return replace(measured, problem=replace(measured.problem, system=system, records=records))
