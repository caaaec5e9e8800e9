"""The problem of measured records: their signals, the system that was asked for, and what the user knows of it."""

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
"""Samples of a cycle, and of a record, that a decimation that is not asked for leaves at least."""


@dataclass(frozen=True, eq=False)
class Measured:
    """Recordings and the problem that they pose; ``notes`` say what was done to them.

    ``known_mass``: the mass (kg) that the user knows, which scales the ratios where the data leave it open.
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
        """Return whether the first channel is of a rotation."""
        return self.unit.startswith(ANGLE)

    def unit_of(self, unit: str) -> str:
        """Return the unit of a quantity for what is measured: where it turns, of angles, torques and inertia.

        ``N·s/m`` is then ``N·m·s/rad``, and ``kg`` is ``kg·m²``.
        """
        return unit.replace("m", "rad").replace("N", "N·m").replace("kg", "kg·m²") if self.angle else unit


def read_measured(request: Request, recordings: Sequence[Recording] = ()) -> Measured:
    """Make the problem of a request from its files, or from what was read of them before; raises InputError."""
    if not recordings:
        recordings = [recording for path in request.files for recording in read_recordings(path, request.options)]
    job, start = request.job, _start(request.job)
    recordings = [with_base_excitation(recording, job.config.motion) for recording in recordings]
    n_dof = _system(request, recordings[0]).n_dof
    recordings = prepare(recordings, request.options, known_state=start is not None, n_dof=n_dof)
    system = _system(request, recordings[0])
    records = tuple(_record(recording, system, start, job) for recording in recordings)
    for name, value in (("force_gain", job.config.force_gain), ("hold", job.config.hold)):
        if name in job.explicit and not any(record.forces for record in records):
            raise InputError(name, value, "there is no force in the record; leave it out, or name its column: columns=")
    names, prior = ", ".join(Path(recording.source).name for recording in recordings), _prior(job, system)
    try:
        problem = Problem(system, records, prior, name=names)
    except InputError as error:
        raise InputError("data", f"{names} ({error.field} {error.value})", error.remedy) from None
    mass = job.config.fixed.get("m")
    if mass is not None and mass <= 0:
        raise InputError("fixed.m", mass, "a positive mass (kg)")
    if mass is not None and (problem.prior is not None or problem.scale_known):
        raise InputError("fixed.m", mass, "the force or the prior tells the mass already; leave it out")
    return Measured(recordings, problem, _notes(recordings), mass)


def _notes(recordings: Sequence[Recording], before: Sequence[str] = ()) -> tuple[str, ...]:
    """Return the notes of recordings after others, each of them once."""
    return tuple(dict.fromkeys([*before, *(note for recording in recordings for note in recording.notes)]))


def _system(request: Request, recording: Recording) -> System:
    """Make the system that was asked for, with the parameters that are known.

    A pendulum's length is 1 where angles are measured.
    """
    job = request.job
    fixed = {name: value for name, value in job.config.fixed.items() if name != "m"}
    if fixed and request.system == AUTO:
        raise InputError("fixed", fixed, "with system=auto nothing is told; name the system")
    if fixed and "system" in job.explicit:
        raise InputError("fixed", fixed, "it is for sums of terms, as system=sdof+coulomb fixed.k=0")
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
        raise InputError("fixed", fixed, "without a force or a prior only ratios to the mass can be told; give one")
    return system


def _record(recording: Recording, system: System, start: InitialState | None, job: Job) -> Record:
    name = Path(recording.source).name
    offset_identifiable = start is None and getattr(system, "offset_identifiable", True)
    channels, forces = [], []
    for signal in recording.signals:
        if signal.dof >= system.n_dof:
            remedy = f"the system has {system.n_dof} DOF; choose one with more masses, or columns="
            raise InputError("data", f"{name} ({signal.role})", remedy)
        if signal.times.size > MAX_SAMPLES:
            remedy = f"at most {MAX_SAMPLES}: choose a part by from= and to=, or fewer samples by decimate="
            raise InputError("data", f"{name}, {signal.times.size} samples", remedy)
        if signal.measures == "force":
            values = job.config.force_gain * signal.values
            forces.append(Force(signal.times, values, hold=job.config.hold, dof=signal.dof))
        else:
            channels.append(
                Channel(
                    signal.times,
                    signal.values,
                    signal.measures,
                    signal.dof,
                    unit=signal.unit,
                    offset=offset_identifiable,
                )
            )
    if not channels:
        raise InputError("data", name, "no column of it is a motion; name one by columns=x:<number>")
    try:
        return Record(tuple(channels), tuple(forces), start)
    except InputError as error:
        raise InputError("data", f"{name} ({error.field} {error.value})", error.remedy) from None


def _start(job: Job) -> InitialState | None:
    config = job.config
    if "initial_state" not in job.explicit or config.initial_state == "unknown":
        if config.start is not None:
            raise InputError("start", config.start, "with initial_state=known; or leave it out")
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
    """Compute by how much samples can be decimated that still describe the motion of every channel; 1: not at all."""
    factors = []
    for channel in (channel for record in problem.records for channel in record.channels):
        per_cycle = (channel.n - 1) / float(np.ptp(channel.times)) / dominant_frequency(channel.times, channel.values)
        factors.append(min(per_cycle / CYCLE_SAMPLES, channel.n / FEWEST))
    return max(int(min(factors)), 1)


def with_fewer_samples(measured: Measured, factor: int, job: Job) -> Measured:
    """Decimate the records, with what was done as a note; raises InputError where that cannot be."""
    if any(record.initial_state is not None for record in measured.problem.records):
        raise InputError("decimate", factor, "the start is told, and decimation leaves the first samples out")
    recordings = tuple(decimated(recording, factor) for recording in measured.recordings)
    records = tuple(_record(recording, measured.problem.system, None, job) for recording in recordings)
    problem = replace(measured.problem, records=records)
    return replace(measured, recordings=recordings, problem=problem, notes=_notes(recordings, measured.notes))


def with_system(measured: Measured, system: Sum) -> Measured:
    """Pose the problem of the records with another system."""
    return replace(measured, problem=of_system(measured.problem, system))


def of_system(problem: Problem, system: Sum) -> Problem:
    """Pose a problem with another system; an offset that it cannot distinguish from the motion is not estimated."""
    records = tuple(
        replace(r, channels=tuple(replace(c, offset=c.offset and system.offset_identifiable) for c in r.channels))
        for r in problem.records
    )
    return replace(problem, system=system, records=records)
