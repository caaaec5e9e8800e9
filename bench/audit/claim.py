"""A published claim as a file states it: the source's facts, what was known, what was reported."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import pandas as pd
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from bench.audit.equation import EquationSystem, PartlyKnown, expression
from bench.contract.problem import Force, InitialState
from bench.errors import InputError, check_name, did_you_mean
from bench.scenario.declaration import STRICT, Positive, validated
from bench.systems import System, make_system

MOST_SAMPLES, MOST_DRAWS = 20_000, 10_000
DRAWN = re.compile(r"(default_rng|RandomState)\((\d{1,9})\)|halton|unknown seed")
CHANNEL = re.compile(r"([xv])(\d*)")
FORCE_SAMPLES = 4001
"""Samples by which an expression of time is given to the equation, joined by a cubic spline."""
Definition = Literal[
    "standard deviation", "variance", "half-width", "snr db", "snr db of the variance", "snr db of the peak",
    "percent of the rms", "percent of the standard deviation", "percent of the largest value", "none",
]  # fmt: skip
Form = Literal["value", "percent error", "absolute error", "rmse"]
Numbers = Annotated[tuple[float, ...], BeforeValidator(lambda v: v if isinstance(v, list | tuple) else (v,))]
Words = Annotated[tuple[str, ...], BeforeValidator(lambda v: v if isinstance(v, list | tuple) else (v,))]


class ClaimPart(BaseModel):
    """A part of a claim, of known fields and finite numbers only."""

    model_config = ConfigDict(**STRICT, frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _known_fields(cls, values: Any) -> Any:
        known = [field.alias or name for name, field in cls.model_fields.items()]
        if not isinstance(values, Mapping):
            raise ValueError(f"fields are wanted: {', '.join(known)}")
        for name in values:
            if name not in known:
                raise ValueError(f"no field {name}; {did_you_mean(name, known)}there are {', '.join(known)}")
        return values


class Source(ClaimPart):
    """Where the claim was published."""

    authors: str
    year: Annotated[int, Field(ge=1600, le=2100)]
    title: str
    url: Annotated[str, Field(pattern=r"^https?://\S+$")]
    place: str = ""


class Start(ClaimPart):
    """Displacement and velocity at time 0, one number a mass, and whether the method knew them."""

    displacement: Numbers
    velocity: Numbers
    known: bool


class Push(ClaimPart):
    """A known force: an expression of t, on a mass (from 1)."""

    expression: str
    on: Annotated[int, Field(ge=1)] = 1


class StatedTimes(ClaimPart):
    """Sample times: listed, a column, uniform, or drawn between two."""

    values: tuple[float, ...] | None = None
    column: str | None = None
    first: Annotated[float | None, Field(alias="from")] = None
    last: Annotated[float | None, Field(alias="to")] = None
    n: Annotated[int | None, Field(ge=2, le=MOST_SAMPLES)] = None
    step: Positive | None = None
    drawn: str | None = None

    @model_validator(mode="after")
    def _complete(self) -> Self:
        span, count = (self.first, self.last), (self.n, self.step)
        ways = [self.values is not None, self.column is not None, None not in span and count.count(None) == 1]
        if sum(ways) != 1 or (not ways[2] and any(v is not None for v in (*span, *count, self.drawn))):
            raise ValueError("a list of times, or from, to and n (or step), or column")
        if self.drawn is not None and (self.n is None or not DRAWN.fullmatch(self.drawn)):
            raise ValueError("drawn is default_rng(1), RandomState(1), halton or unknown seed, with from, to and n")
        if ways[2] and not (self.first < self.last and (self.step is None or self.steps <= MOST_SAMPLES)):  # type: ignore[operator]
            raise ValueError(f"from is below to, with {MOST_SAMPLES} samples at most")
        return self

    @property
    def steps(self) -> float:
        return (self.last - self.first) / self.step  # type: ignore[operator]


class StatedNoise(ClaimPart):
    """The noise of the samples, by the source's definition; one value, or one a channel."""

    definition: Definition
    value: Numbers = (0.0,)


def _flat(columns: Any) -> Any:
    """Collect the columns of channels, which stand beside the other fields in a file."""
    if not isinstance(columns, Mapping):
        return columns
    channels = {name: column for name, column in columns.items() if CHANNEL.fullmatch(str(name))}
    return {**{name: column for name, column in columns.items() if name not in channels}, "channels": channels}


class PublishedColumns(ClaimPart):
    """Published samples in a CSV file beside the claim: columns by channel, and of the noise-free solution."""

    file: str
    time: str
    exact: str | None = None
    channels: Mapping[str, str] = {}


class Believed(ClaimPart):
    """A prior's mean and standard deviation, in the parameter's unit."""

    value: float
    sd: Positive


class Given(ClaimPart):
    """What the method was given beside the data."""

    prior: Mapping[str, Believed] = {}
    starting_value: Mapping[str, float] = {}


class Setting(ClaimPart):
    """What decides the data and what is known, as a file states it."""

    parameters: Mapping[str, float]
    initial_state: Start
    times: Annotated[StatedTimes, BeforeValidator(lambda v: {"values": v} if isinstance(v, list) else v)]
    noise: Annotated[StatedNoise, BeforeValidator(lambda v: {"definition": "none"} if v == "none" else v)]
    known: tuple[str, ...] = ()
    force: Annotated[Push | None, BeforeValidator(lambda v: {"expression": v} if isinstance(v, str) else v)] = None
    measured: Words = ()
    given: Given = Given()
    data: Annotated[PublishedColumns | None, BeforeValidator(_flat)] = None


class Reported(ClaimPart):
    """A number as it was reported, of one draw or of ``draws``; without a value, one that was not reported."""

    method: str
    quantity: str
    value: float | None = None
    form: Form = "value"
    draws: Annotated[int, Field(ge=1, le=MOST_DRAWS)] = 1
    sd: Positive | None = None
    precision: Positive | None = None
    case: str = ""
    place: str = ""

    @property
    def half_digit(self) -> float:
        """Half of the last digit that is printed."""
        value = self.value or 0.0
        return self.precision or 0.5 * 10.0 ** (0 if value == int(value) else int(Decimal(repr(value)).as_tuple()[2]))


class Claim(ClaimPart):
    """A claim without its settings."""

    source: Source
    equation: Words = ()
    system: str = ""
    options: Mapping[str, Any] = {}
    reported: tuple[Reported, ...] = ()
    assumed: Words = ()
    missing: Words = ()


@dataclass(frozen=True, eq=False)
class Situation:
    """A setting with its equation: all that decides what the data allow.

    ``system`` has the unknown parameters, whose sizes are ``p``; where all are known (``decided``), it has all.
    """

    setting: Setting
    full: System
    system: PartlyKnown
    p: Mapping[str, float]
    start: InitialState
    times: np.ndarray
    forces: tuple[Force, ...]
    channels: Mapping[str, int]
    columns: Mapping[str, np.ndarray]
    decided: bool

    def value(self, quantity: str, sizes: Mapping[str, float] | None = None) -> float:
        """Return a quantity at the stated parameters, or at other sizes of the unknown ones."""
        signed = {n: -v if n in self.system.negative else v for n, v in (sizes or {}).items()}
        return float(expression(quantity, self.setting.parameters, "quantity")({**self.setting.parameters, **signed}))


@dataclass(frozen=True, eq=False)
class Stated:
    """A claim that has been read: its situations by case ("" without one) and reading ("" as stated)."""

    name: str
    claim: Claim
    situations: Mapping[tuple[str, str], Situation]

    @property
    def readings(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(reading for _, reading in self.situations))


def read_claim(name: str, content: Mapping[str, Any], folder: Path) -> Stated:
    """Read the content of a claim's file; ``folder`` has its data. Raises InputError before any work."""
    content, changes = dict(content), {}
    for key in ("cases", "readings"):
        changes[key] = content.pop(key, {})
        named = isinstance(changes[key], Mapping) and all(isinstance(v, Mapping) for v in changes[key].values())
        if not named or not all(isinstance(k, str) and k for k in changes[key]):
            raise InputError(key, changes[key], "names, each with the fields that differ")
    common = {key: content.pop(key) for key in list(Setting.model_fields) if key in content}
    known = [*Claim.model_fields, *Setting.model_fields, "cases", "readings"]
    for key in content:
        if key not in known:
            raise InputError(
                key, content[key], f"no such field; {did_you_mean(key, known)}there are {', '.join(known)}"
            )
    claim = validated(Claim, content)
    if bool(claim.equation) == bool(claim.system):
        raise InputError("equation", claim.system, "give an equation, or the name of a system; not both")
    situations = {}
    for case, own in {"": {}, **changes["cases"]}.items():
        for reading, other in {"": {}, **changes["readings"]}.items():
            places = {f"readings.{reading}": other, f"cases.{case}": own}
            paths = {
                key: next((f"{p}.{key}" for p, part in places.items() if key in part), key)
                for key in (*common, *own, *other)
            }
            stated = validated(
                Setting,
                _merged(_merged(common, own), other),
                paths | {"": ".".join(filter(None, [case, reading])) or "claim"},
            )
            situations[case, reading] = _situation(claim, stated, folder)
    for i, row in enumerate(claim.reported):
        _check_reported(f"reported.{i}", row, situations)
    return Stated(name, claim, situations)


def _merged(common: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a claim with those of a case or a reading; parameters and what is given are joined."""
    joined = {key: {**common[key], **own[key]} for key in ("parameters", "given")
              if isinstance(common.get(key), Mapping) and isinstance(own.get(key), Mapping)}  # fmt: skip
    return {**common, **own, **joined}


def _check_reported(field: str, row: Reported, situations: Mapping[tuple[str, str], Situation]) -> None:
    check_name(f"{field}.case", row.case, list(dict.fromkeys(case for case, _ in situations)))
    situation = situations[row.case, ""]
    if row.quantity == "x":
        if row.form != "rmse":
            raise InputError(f"{field}.form", row.form, "rmse: the displacement is scored by nothing else")
    else:
        expression(row.quantity, situation.setting.parameters, f"{field}.quantity")
        if not np.isfinite(value := situation.value(row.quantity)) or value == 0:
            raise InputError(
                f"{field}.quantity", row.quantity, f"{value:g} at the stated parameters; errors are relative to it"
            )
    if row.form != "value" and row.value is not None and row.value < 0:
        raise InputError(f"{field}.value", row.value, f"a {row.form} is not negative")


def _situation(claim: Claim, setting: Setting, folder: Path) -> Situation:
    """Return a setting with its equation, times and forces; raises InputError where they do not fit each other."""
    p = setting.parameters
    full = make_system(claim.system, claim.options) if claim.system else EquationSystem(claim.equation, tuple(p))
    if set(p) != set(full.names):
        raise InputError("parameters", ", ".join(p), f"needed: {', '.join(full.names)}")
    for field in ("known", "given.prior", "given.starting_value"):
        check = setting.known if field == "known" else getattr(setting.given, field.partition(".")[2])
        for name in check:
            check_name(field, name, p)
    unknown = [name for name in full.names if name not in setting.known] or list(full.names)
    decided = len(setting.known) == len(full.names)
    if decided and not setting.initial_state.known:
        raise InputError("known", ", ".join(setting.known), "leave out what was identified")
    for name in unknown:
        if p[name] == 0:
            raise InputError(f"parameters.{name}", 0, "not zero where it is unknown: errors are relative to it")
    n, state = full.n_dof, setting.initial_state
    if not len(state.displacement) == len(state.velocity) == n:
        raise InputError("initial_state", len(state.displacement), f"{n} number(s) each, one a mass")
    columns = _columns(setting.data, folder)
    times = np.unique(_times(setting.times, columns))
    if times.size < 2 or times[0] < 0 or times[-1] == 0 or times.size > MOST_SAMPLES:
        raise InputError("times", times.size, f"2 to {MOST_SAMPLES} different times, none below 0")
    forces = _forces(setting.force, n, float(times[-1]))
    if not forces and not any((*state.displacement, *state.velocity)):
        raise InputError("initial_state", 0, "a state away from rest, or a force")
    start = InitialState(np.array(state.displacement), np.array(state.velocity))
    known = tuple((name, p[name]) for name in full.names if name not in unknown)
    system = PartlyKnown(full, known, tuple(name for name in unknown if p[name] < 0))
    channels = _channels(setting.measured, n)
    if len(setting.noise.value) not in (1, len(channels)) or min(setting.noise.value) < 0:
        raise InputError("noise.value", setting.noise.value, f"one number, or {len(channels)}, none negative")
    sizes = {name: abs(p[name]) for name in unknown}
    return Situation(setting, full, system, sizes, start, times, forces, channels, columns, decided)


def _channels(measured: tuple[str, ...], n: int) -> dict[str, int]:
    """Return the rows of the state, displacements before velocities, that have a sensor."""
    numbers = [""] if n == 1 else [str(i + 1) for i in range(n)]
    rows = {f"{letter}{i}": row for row, (letter, i) in enumerate((a, b) for a in "xv" for b in numbers)}
    for name in measured:
        check_name("measured", name, rows)
    return {name: rows[name] for name in measured or [name for name in rows if name[0] == "x"]}


def _times(times: StatedTimes, columns: Mapping[str, np.ndarray]) -> np.ndarray:
    if times.values is not None:
        return np.array(times.values)
    if times.column is not None:
        check_name("times.column", times.column, columns)
        return columns[times.column]
    assert times.first is not None
    assert times.last is not None
    if times.step is not None:
        return np.arange(times.first, times.last, times.step)
    assert times.n is not None
    if times.drawn is None:
        return np.linspace(times.first, times.last, times.n)
    match = DRAWN.fullmatch(times.drawn)
    assert match
    if times.drawn == "halton":
        from scipy.stats.qmc import Halton

        unit = Halton(1, scramble=False).random(times.n)[:, 0]
        return times.first + (times.last - times.first) * unit
    makers: Mapping[str | None, Any] = {"RandomState": np.random.RandomState, "default_rng": np.random.default_rng}
    return np.asarray(makers[match[1] or "default_rng"](int(match[2] or 0)).uniform(times.first, times.last, times.n))


def _forces(push: Push | None, n: int, last: float) -> tuple[Force, ...]:
    if push is None:
        return ()
    if push.on > n:
        raise InputError("force.on", push.on, f"a mass from 1 to {n}")
    times = np.linspace(0.0, last, FORCE_SAMPLES)
    with np.errstate(all="ignore"):
        values = expression(push.expression, ("t",), "force")({"t": times}) + 0.0 * times
    if not np.all(np.isfinite(values)):
        raise InputError("force", push.expression, "not finite at every time of the record")
    return (Force(times, values, "cubic", push.on - 1),)


def _columns(data: PublishedColumns | None, folder: Path) -> dict[str, np.ndarray]:
    """Return the columns of the published samples by their headings."""
    if data is None:
        return {}
    try:
        table = pd.read_csv(folder / data.file, comment="#")
    except (OSError, ValueError) as error:  # pandas' own errors are values' too
        raise InputError("data.file", data.file, f"a CSV file beside the claim is wanted: {error}") from None
    for heading in (data.time, *filter(None, [data.exact]), *data.channels.values()):
        check_name("data", heading, list(table))
        if not np.all(np.isfinite(pd.to_numeric(table[heading], errors="coerce"))):
            raise InputError("data", heading, "a column of finite numbers")
    return {heading: table[heading].to_numpy(float) for heading in table if table[heading].dtype.kind in "fi"}
