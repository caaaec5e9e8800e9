"""Read a published claim from a file: its source, its setting, and the reported numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from bench.audit.equation import EquationSystem, expression
from bench.contract.problem import Force, InitialState
from bench.errors import InputError, check_name, did_you_mean
from bench.scenario.declaration import STRICT, Positive, validated

MOST_SAMPLES, MOST_DRAWS = 20_000, 10_000
DRAWN = r"^(default_rng\(\d{1,9}\)|RandomState\(\d{1,9}\)|halton|unknown seed)$"
FORCE_SAMPLES = 4001
"""Number of samples of a force that is an expression of time; a cubic spline connects them."""
Definition = Literal[
    "standard deviation", "variance", "half-width", "snr db", "snr db of the variance", "snr db of the peak",
    "percent of the rms", "percent of the standard deviation", "percent of the largest value", "none",
]  # fmt: skip
LISTED = BeforeValidator(lambda given: given if isinstance(given, list | tuple) else (given,))
Numbers = Annotated[tuple[float, ...], LISTED]
Words = Annotated[tuple[str, ...], LISTED]


class ClaimPart(BaseModel):
    """A part of a claim; unknown fields and numbers that are not finite are refused."""

    model_config = ConfigDict(**STRICT, frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _known_fields(cls, values: Any) -> Any:
        known = [field.alias or name for name, field in cls.model_fields.items()]
        for name in values if isinstance(values, Mapping) else ():
            if name not in known:
                if isinstance(name, int):  # YAML reads {value: 3,93} as a value of 3 and a field 93
                    raise InputError(str(name), "", "not a field; a number has a decimal point, not a comma")
                near = did_you_mean(name, known)
                raise InputError(str(name), values[name], f"not a field; {near}fields: {', '.join(known)}")
        return values


class Source(ClaimPart):
    """Where the claim was published."""

    authors: str
    year: Annotated[int, Field(ge=1600, le=2100)]
    title: str
    url: Annotated[str, Field(pattern=r"^https?://\S+$")]
    place: str = ""


class StatedStart(ClaimPart):
    """Displacement and velocity at time 0, one number per mass, and whether they were given to the method."""

    displacement: Numbers
    velocity: Numbers
    known: bool


class StatedTimes(ClaimPart):
    """Sample times: a list, a column of the data, uniform, or drawn at random between two times."""

    values: Numbers = ()
    column: str = ""
    first: Annotated[float | None, Field(alias="from")] = None
    last: Annotated[float | None, Field(alias="to")] = None
    n: Annotated[int | None, Field(ge=2, le=MOST_SAMPLES)] = None
    step: Positive | None = None
    drawn: Annotated[str, Field(pattern=DRAWN)] | None = None

    def samples(self, columns: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the distinct times in increasing order; raises InputError unless exactly one form is given."""
        first, last = self.first, self.last
        if self.values or self.column:
            if self.column:
                check_name("times.column", self.column, columns)
            times = columns[self.column] if self.column else np.array(self.values)
        elif first is None or last is None or not first < last or (self.n is None) == (self.step is None):
            raise InputError("times", first, "a list of times, a column, or from below to, with n or step")
        elif self.step is not None:
            times = np.arange(first, min(last, first + MOST_SAMPLES * self.step), self.step)
        else:
            times = self._drawn(first, last, self.n or 0)
        times = np.unique(times)
        if times.size < 2 or times[0] < 0 or times.size >= MOST_SAMPLES:
            raise InputError("times", times.size, f"from 2 to {MOST_SAMPLES} different times, none below 0")
        return times

    def _drawn(self, first: float, last: float, n: int) -> np.ndarray:
        if self.drawn is None:
            return np.linspace(first, last, n)
        if self.drawn == "halton":
            from scipy.stats.qmc import Halton

            return first + (last - first) * Halton(1, scramble=False).random(n)[:, 0]
        seed = int("".join(filter(str.isdigit, self.drawn)) or 0)
        generator: Any = np.random.RandomState if "RandomState" in self.drawn else np.random.default_rng
        return np.asarray(generator(seed).uniform(first, last, n))


class StatedNoise(ClaimPart):
    """Noise of the samples, by the definition of the source: one value, or one per channel."""

    definition: Definition
    value: Numbers = (0.0,)


class PublishedColumns(ClaimPart):
    """CSV file next to the claim with columns of times, samples and the noise-free solution of one channel."""

    file: Annotated[str, Field(pattern=r"^[\w .-]+$")]
    time: str
    x: str | None = None
    exact: str | None = None


class StatedPrior(ClaimPart):
    """Standard deviation of a prior, in the unit of the parameter or in percent of the stated value."""

    value: float | None = None
    sd: Positive | None = None
    percent: Positive | None = None


class Given(ClaimPart):
    """Priors and initial guesses that were given to the method."""

    prior: Mapping[str, StatedPrior] = {}
    starting_value: Mapping[str, float] = {}


class Setting(ClaimPart):
    """Setting of a case: data and prior knowledge."""

    parameters: Mapping[str, float]
    initial_state: StatedStart
    times: Annotated[StatedTimes, BeforeValidator(lambda v: {"values": v} if isinstance(v, list) else v)]
    noise: StatedNoise
    known: tuple[str, ...] = ()
    force: str | None = None
    measured: Words = ()
    given: Given = Given()
    data: PublishedColumns | None = None


class Reported(ClaimPart):
    """A reported number, from one or several draws of the noise; ``value`` is None for a number not reported."""

    method: str
    quantity: str
    value: float | None = None
    form: Literal["value", "percent error", "absolute error", "rmse"] = "value"
    draws: Annotated[int, Field(ge=1, le=MOST_DRAWS)] = 1
    sd: Positive | None = None
    precision: Positive | None = None
    case: str = ""
    place: str = ""

    @property
    def half_digit(self) -> float:
        """Half a unit of the last printed digit."""
        value = self.value or 0.0
        return self.precision or 0.5 * 10.0 ** (0 if value == int(value) else int(Decimal(repr(value)).as_tuple()[2]))


class Claim(Setting):
    """A claim: its setting, changes per case and per reading of what the source does not state, and its numbers."""

    source: Source
    equation: Words
    reported: tuple[Reported, ...] = ()
    cases: Mapping[str, Mapping[str, Any]] = {}
    readings: Mapping[str, Mapping[str, Any]] = {}
    assumed: Words = ()
    missing: Words = ()


@dataclass(frozen=True, eq=False)
class Situation:
    """A setting with its equation, which together determine the Fisher information.

    Attributes:
        setting: The setting.
        system: System of the unknown parameters; of all parameters, if all are known.
        p: Absolute values of the parameters of ``system``.
        start: Initial state.
        times: Sample times (s).
        forces: Forces.
        rows: Components of the state with a sensor, displacements before velocities.
        columns: Columns of the published data.
        decided: Whether all parameters are known.
    """

    setting: Setting
    system: EquationSystem
    p: Mapping[str, float]
    start: InitialState
    times: np.ndarray
    forces: tuple[Force, ...]
    rows: tuple[int, ...]
    columns: Mapping[str, np.ndarray]
    decided: bool

    def value(self, quantity: str, sizes: Mapping[str, float] | None = None) -> float:
        """Return a quantity at the stated parameters, or at other absolute values of the unknown ones."""
        signed = {n: -v if n in self.system.negative else v for n, v in (sizes or {}).items()}
        p = {name: np.float64(v) for name, v in {**self.setting.parameters, **signed}.items()}  # 1/0 is infinite
        with np.errstate(all="ignore"):
            return float(expression(quantity, list(p), "quantity")(p))


@dataclass(frozen=True, eq=False)
class StatedClaim:
    """A claim with its situations by case ("" for none) and reading ("" for the stated one)."""

    name: str
    claim: Claim
    situations: Mapping[tuple[str, str], Situation]


def read_claim(name: str, content: Mapping[str, Any], folder: Path) -> StatedClaim:
    """Read the content of a claim's file; ``folder`` has its data. Raises InputError before any computation."""
    claim, situations = validated(Claim, content), {}
    common = {key: content[key] for key in Setting.model_fields if key in content}
    for case, changes in {"": {}, **claim.cases}.items():
        for reading, other in {"": {}, **claim.readings}.items():
            whole = _merged(_merged(common, changes), other)
            place = f"readings.{reading}" if reading else f"cases.{case}" if case else ""
            situations[case, reading] = _situation(claim.equation, validated(Setting, whole, place), folder)
    for i, row in enumerate(claim.reported):
        if row.case:
            check_name(f"reported.{i}.case", row.case, claim.cases)
        _check_reported(f"reported.{i}", row, situations[row.case, ""])
    return StatedClaim(name, claim, situations)


def _merged(common: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return fields with changes applied, also within nested fields."""
    both = {key: _merged(common[key], part) for key, part in changes.items()
            if isinstance(part, Mapping) and isinstance(common.get(key), Mapping)}  # fmt: skip
    return {**common, **changes, **both}


def _check_reported(field: str, row: Reported, situation: Situation) -> None:
    if row.quantity == "x":
        if row.form != "rmse":
            raise InputError(f"{field}.form", row.form, "rmse, the only form for a displacement")
    else:
        expression(row.quantity, list(situation.setting.parameters), f"{field}.quantity")
        if not np.isfinite(value := situation.value(row.quantity)) or value == 0:
            raise InputError(f"{field}.quantity", row.quantity, f"not {value:g} at the stated parameters")
    if row.form != "value" and (row.value or 0.0) < 0:
        raise InputError(f"{field}.value", row.value, f"a {row.form} is not negative")


def _situation(equations: tuple[str, ...], setting: Setting, folder: Path) -> Situation:
    """Return a setting with its equation, times and forces; raises InputError if they are inconsistent."""
    p, given = setting.parameters, setting.given
    for field, names in {"known": setting.known, "prior": given.prior, "starting_value": given.starting_value}.items():
        for name in names:
            check_name(field if field == "known" else f"given.{field}", name, p)
    unknown = tuple(name for name in p if name not in setting.known)
    decided, free = not unknown, unknown or tuple(p)
    known = tuple((name, p[name]) for name in p if name not in free)
    if (decided and not setting.initial_state.known) or not p:
        raise InputError("known", ", ".join(setting.known), "leave out the parameters that were identified")
    if zero := [name for name in free if p[name] == 0]:
        raise InputError(f"parameters.{zero[0]}", 0, "not zero if it is unknown: errors are relative to it")
    system = EquationSystem(equations, free, known, tuple(name for name in free if p[name] < 0))
    n, state = system.n_dof, setting.initial_state
    if not len(state.displacement) == len(state.velocity) == n:
        raise InputError("initial_state", len(state.displacement), f"{n} number(s) each, one per mass")
    channels = [f"{letter}{i + 1 if n > 1 else ''}" for letter in "xv" for i in range(n)]
    for name in setting.measured:
        check_name("measured", name, channels)
    rows = tuple(map(channels.index, setting.measured or channels[:n]))
    if len(setting.noise.value) not in (1, len(rows)) or min(setting.noise.value) < 0:
        raise InputError("noise.value", setting.noise.value, f"one number, or {len(rows)}, none negative")
    columns = _columns(setting.data, folder)
    times = setting.times.samples(columns)
    forces = _forces(setting.force, float(times[-1]))
    if not forces and not any((*state.displacement, *state.velocity)):
        raise InputError("initial_state", 0, "a state away from rest, or a force")
    start = InitialState(np.array(state.displacement), np.array(state.velocity))
    sizes = {name: abs(p[name]) for name in free}
    return Situation(setting, system, sizes, start, times, forces, rows, columns, decided)


def _forces(text: str | None, last: float) -> tuple[Force, ...]:
    """Return the force on the first mass from an expression of t."""
    if text is None:
        return ()
    times = np.linspace(0.0, last, FORCE_SAMPLES)
    with np.errstate(all="ignore"):
        values = expression(text, ["t"], "force")({"t": times}) + 0.0 * times
    if not np.all(np.isfinite(values)):
        raise InputError("force", text, "not finite at every time of the record")
    ends = [0, -1] if np.ptp(values) == 0 else slice(None)
    return (Force(times[ends], values[ends], "linear" if np.ptp(values) == 0 else "cubic"),)


def _columns(data: PublishedColumns | None, folder: Path) -> dict[str, np.ndarray]:
    """Return the columns of the published data by heading."""
    if data is None:
        return {}
    try:
        table = pd.read_csv(folder / data.file, comment="#")
    except (OSError, ValueError) as error:  # pandas' own errors are values', too
        raise InputError("data.file", data.file, f"a CSV file next to the claim is required: {error}") from None
    columns = {heading: pd.to_numeric(table[heading], errors="coerce").to_numpy(float) for heading in table}
    for heading in filter(None, [data.time, data.x, data.exact]):
        check_name("data", heading, columns)
        if not np.all(np.isfinite(columns[heading])):
            raise InputError("data", heading, "a column of finite numbers")
    return columns
