"""Scenario: system, true parameters, sampling, and what is known to methods; it generates the replicates."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import Field, dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np

from bench.contract.prior import Prior, draw_prior
from bench.contract.problem import MIN_SAMPLES, Channel, Force, InitialState, Problem, Record
from bench.errors import InputError
from bench.scenario.declaration import STRICT, Positive, Within, WrittenAs, changed, plain, validated
from bench.scenario.disturbance import Disturbance
from bench.scenario.force import ForceSpec
from bench.scenario.stream import anonymous_stream
from bench.scenario.truth import Truth, reference_response
from bench.systems import LoadedSystem, System, make_system

NOISE, NOMINAL, FORCE_AXIS, METHOD, DISTURBANCE, FORCE_NOISE = range(6)
"""Axes of the seed tree: the purposes of random streams. Streams of different axes are independent."""
SNR_SPREAD = 10.0
"""Half the range (dB) from which the SNR is drawn where the truth is."""


@dataclass(frozen=True)
class PriorSpec:
    """The width of the nominal prior, by kind of parameter, and whether its nominal values are calibrated.

    ``draws``: ``nominal`` values are drawn around a fixed truth, replicate by replicate; or the ``truth`` (and with it
    the noise level, uniform within :data:`SNR_SPREAD` dB) is drawn around fixed nominal values, as simulation-based
    calibration asks (S. Talts et al., arXiv:1804.06788).
    """

    __pydantic_config__ = STRICT
    name: Annotated[str, "name of the prior"]
    sd_by_kind: Annotated[
        Mapping[str, Positive],
        "standard deviation of a parameter's logarithm, by kind: mass, damping, stiffness, other",
    ]
    wrong: Annotated[bool, "nominal values are off by three standard deviations"] = False
    draws: Annotated[
        Literal["nominal", "truth"], "what is drawn: nominal values around the true ones, or true values around these"
    ] = "nominal"

    def to_dict(self) -> dict[str, Any]:
        """Return what a method knows of it, as JSON holds it: neither the name nor which of the two is drawn."""
        return {**plain(self, "sd_by_kind")["sd_by_kind"], "wrong": self.wrong}

    @classmethod
    def from_dict(cls, stated: Mapping[str, Any], draws: Literal["nominal", "truth"]) -> PriorSpec:
        """Return the prior of :meth:`to_dict`, without its name."""
        return cls("stored", {kind: sd for kind, sd in stated.items() if kind != "wrong"}, stated["wrong"], draws)


class InitialMotion(NamedTuple):
    """True state at time 0 as in a configuration: displacement (m) and velocity (m/s), one number per DOF."""

    displacement: tuple[float, ...]
    velocity: tuple[float, ...]


KEY = ("system", "parameters", "initial", "snr_db", "duration", "samples", "force", "options")
"""Fields that key the random streams; they stand in the identity at their defaults too, and must be given in a file."""
KNOWN, SCORED = ("initial_state", "prior"), ("dense", "forecast")
"""Fields that say what a method knows, and where it is scored; those that are not named here decide the data."""
PATHS = {"system": "system.kind", "snr_db": "snr", **{name: name for name in (*KNOWN, "disturbance")}}


def config_path(declared: Field[Any]) -> str:
    """Return where a configuration and a command line have a field: ``system.samples``, or another place."""
    return PATHS.get(declared.name, f"system.{declared.name}")


def _later(record: int) -> tuple[int, ...]:
    """Return the key of a record's random stream: none for the first, which is then as it is alone."""
    return (record,) if record else ()


@dataclass(frozen=True)
class Scenario:
    """All that decides the data, and what is known of them; SI units.

    ``initial`` is the true displacement and velocity of each DOF at time 0, ``initial_state`` whether a method knows
    it. ``dense`` and ``forecast`` say where displacement is scored: at so many times, and so long (s) after the record.
    ``samples`` uniform displacement samples of every ``measured`` DOF (from 0; None: all) over ``duration``, both ends
    included; noise at ``snr_db``, DOF by DOF. Hidden states start at 0. Displacement errors and their bound are over
    the measured DOFs: the estimate of a mass without a sensor may be arbitrarily bad.
    ``added_mass`` (kg, one a DOF) asks for a second record, of the rig with these known masses added, from the same
    initial state under the same force; displacements are scored on the first.
    ``disturbance`` breaks what methods assume of the data; noise draw, noise level, nominal values and bound stay those
    of the undisturbed scenario.

    A field that is added here is read from the files of ``conf/system`` and from ``system.<field>=`` on a command line,
    within the limits of its type; it decides the data, so it stands in the identity unless it is at its default; and it
    is restored from a stored cell. Nothing else has to know of it but what makes the data.
    """

    __pydantic_config__ = STRICT
    system: Annotated[str, "equation: an entry point of the group bench.systems"]
    parameters: Annotated[Mapping[str, Positive], "true values, hidden from all methods"]
    initial: Annotated[
        tuple[tuple[float, ...], tuple[float, ...]],
        WrittenAs(InitialMotion),
        "true displacement and velocity of each degree of freedom (DOF) at time 0",
    ]
    snr_db: Annotated[float, Within(ge=-40, le=300), "signal-to-noise ratio (dB)"]
    duration: Annotated[Positive, "record length (s)"] = 10.0
    samples: Annotated[
        int, Within(ge=MIN_SAMPLES, le=100_000), "displacement samples per measured DOF, both ends included"
    ] = 25
    initial_state: Annotated[Literal["known", "unknown"], "whether the initial state is given to a method"] = "known"
    prior: Annotated[PriorSpec | None, "prior distribution of the parameters"] = None
    force: Annotated[ForceSpec | None, "known force; its fields are listed below"] = None
    options: Annotated[Mapping[str, Any], "arguments of the equation, such as {n: 3} for a chain"] = field(
        default_factory=dict
    )
    dense: Annotated[int, Within(ge=2, le=100_000), "number of times at which displacement is scored"] = 1000
    forecast: Annotated[Positive, "length of the scored forecast after the record (s)"] = 10.0
    label: Annotated[str, "name in tables"] = ""
    disturbance: Annotated[Disturbance | None, "violated assumption of the methods"] = None
    measured: Annotated[
        tuple[Annotated[int, Within(ge=0)], ...] | None, "DOFs with a sensor, counted from 0; unset: all"
    ] = None
    added_mass: Annotated[
        tuple[Annotated[float, Within(ge=0)], ...] | None, "kg per DOF: a second record with these masses added"
    ] = None

    def __post_init__(self) -> None:
        system = self.make_system()
        n = system.n_dof
        if set(self.parameters) != set(system.names):
            raise InputError("system.parameters", sorted(self.parameters), f"needed: {', '.join(system.names)}")
        # in the system's order, however they were written: what is drawn around them is drawn in this order
        object.__setattr__(self, "parameters", {name: self.parameters[name] for name in system.names})
        for part in self.initial:
            if len(part) != n:
                raise InputError("system.initial", list(part), f"{n} finite number(s), one a DOF")
        if not np.any(np.asarray(self.initial)) and self.force is None:
            raise InputError("system.initial", list(map(list, self.initial)), "a start away from rest, or a force")
        if self.disturbance is not None:
            self.disturbance.check(system, self.duration, self.force is not None)
        if self.measured is not None and (
            not self.measured or sorted(set(self.measured) & set(range(n))) != list(self.measured)
        ):
            remedy = f"DOFs with a sensor, increasing, of 0 to {n - 1}"
            raise InputError("system.measured", list(self.measured), remedy)
        if self.added_mass is not None and (len(self.added_mass) != n or not any(self.added_mass)):
            remedy = f"{n} mass(es) in kg, one a DOF, none negative and not all zero"
            raise InputError("system.added_mass", list(self.added_mass), remedy)
        if self.force is not None:
            if self.force.dof >= n:
                raise InputError("system.force.dof", self.force.dof, f"one of 0 to {n - 1}")
            self.force.draw(self.duration, np.random.default_rng(0))  # raises where its samples cannot show its shape

    def make_system(self) -> System:
        return make_system(self.system, self.options)

    def to_dict(self) -> dict[str, Any]:
        """Return the scenario as JSON holds it: what decides the ``data``, what is ``told``, and where it is scored.

        This is what an identity is made of: the label has no part in it, nor has an optional field at its default.
        """
        return {"data": self.data_identity(), "told": self.told_identity(), **plain(self, *SCORED)}

    @classmethod
    def from_dict(cls, stated: Mapping[str, Any], label: str = "") -> Scenario:
        """Return the scenario of :meth:`to_dict`; raises InputError where this version states it differently."""
        values = {**stated["data"], **stated["told"], **{name: stated[name] for name in SCORED}, "label": label}
        draws: Literal["nominal", "truth"] = "truth" if values.pop("truth", "") == "drawn" else "nominal"
        readers: dict[str, Callable[[Any], Any]] = {
            "prior": lambda prior: PriorSpec.from_dict(prior, draws),
            "force": lambda force: ForceSpec(**force),
            "disturbance": Disturbance.from_dict,
        }
        return validated(cls, {k: readers[k](v) if k in readers and v is not None else v for k, v in values.items()})

    def data_identity(self) -> dict[str, Any]:
        """Return what decides the data, and nothing else: neither the label nor what is known of them."""
        optional = [name for name in changed(self) if name not in (*KNOWN, *SCORED, "label")]
        return plain(self, *KEY, *optional) | ({"truth": "drawn"} if self.truth_drawn else {})

    def told_identity(self) -> dict[str, Any]:
        """Return what a method knows beyond the data."""
        return plain(self, *KNOWN)

    def stream(self, axis: int, seed: int, replicate: int, *key: int) -> np.random.Generator:
        """Return the random stream of one axis, replicate and scenario, independent of every other, without its seed.

        A disturbed scenario has the streams of the undisturbed one: they differ by the disturbance alone. So have those
        that differ in an optional field, as in which DOFs are measured, or in how well the force is.
        """
        return anonymous_stream(seed, (axis, *self._key, replicate, *key))

    @cached_property
    def _key(self) -> tuple[int, ...]:
        stated = plain(self, *KEY)
        if stated["force"]:
            stated["force"].pop("noise_db", None)
        digest = hashlib.sha256(json.dumps(stated, sort_keys=True).encode()).digest()
        return tuple(int.from_bytes(digest[i : i + 4], "big") for i in (0, 4))

    @property
    def truth_drawn(self) -> bool:
        """Return True if the true values differ between replicates."""
        return self.prior is not None and self.prior.draws == "truth"

    @cached_property
    def undisturbed(self) -> Scenario:
        """The same scenario without its disturbance."""
        return self if self.disturbance is None else replace(self, disturbance=None)

    @cached_property
    def times(self) -> np.ndarray:
        """Uniform sample times (s), shape (samples,)."""
        return np.linspace(0.0, self.duration, self.samples)

    @cached_property
    def dense_times(self) -> np.ndarray:
        """Times (s) on which the displacement is scored, shape (dense,)."""
        return np.linspace(0.0, self.duration, self.dense)

    @cached_property
    def forecast_times(self) -> np.ndarray:
        """Times (s) after the record on which the forecast is scored, shape (dense,)."""
        return self.duration + np.linspace(0.0, self.forecast, self.dense + 1)[1:]

    @cached_property
    def start(self) -> InitialState:
        """Initial state of the motion, as given to methods if it is known."""
        return InitialState(np.array(self.initial[0]), np.array(self.initial[1]))

    def rigs(self) -> tuple[System, ...]:
        """Return the system of each record: as it is, and with the added mass where one is."""
        system = self.make_system()
        return (
            (system,) if self.added_mass is None else (system, LoadedSystem(system, tuple(map(float, self.added_mass))))
        )

    @property
    def measured_dofs(self) -> tuple[int, ...]:
        """The DOFs that have a sensor."""
        return tuple(range(len(self.initial[0]))) if self.measured is None else self.measured

    def forces(self, seed: int) -> tuple[Force, ...]:
        """Return the forces that act: one draw a scenario and seed, the same for every replicate and noise level."""
        if self.force is None:
            return ()
        return (self.force.draw(self.duration, replace(self, snr_db=0.0).stream(FORCE_AXIS, seed, 0)),)

    def _response(self, times: np.ndarray, seed: int, record: int = 0) -> np.ndarray:
        """Return the true displacement at times of a record, by the integrator or the delay of its disturbance."""
        response = self.disturbance.response if self.disturbance else reference_response
        return response(self.rigs()[record], self.parameters, self.start, times, self.forces(seed))

    def replicates(self, seed: int, n: int) -> list[tuple[Problem, Truth]]:
        """Return the first ``n`` replicates of a seed: the same noise and nominal values for every method."""
        return list(map(self.maker(seed), range(n)))

    def maker(self, seed: int) -> Callable[[int], tuple[Problem, Truth]]:
        """Return a function that makes a replicate by its number; what all share is computed once, here."""
        if self.truth_drawn:
            return lambda i: self._drawn(seed, i)
        clean, dense = self._response(self.times, seed), self._response(self.dense_times, seed)
        forecast, sigma = self._response(self.forecast_times, seed), self.sigmas(seed)
        return lambda i: self._replicate(seed, i, clean, dense, forecast, sigma)

    def _drawn(self, seed: int, index: int) -> tuple[Problem, Truth]:
        """Return a replicate whose truth is drawn around the nominal values, which are this scenario's parameters."""
        assert self.prior is not None
        system, rng = self.make_system(), self.stream(NOMINAL, seed, index)
        drawn = draw_prior(system, self.parameters, self.prior.sd_by_kind, rng)
        snr = self.snr_db + rng.uniform(-SNR_SPREAD, SNR_SPREAD)
        true = replace(self, parameters=drawn.nominal, snr_db=snr, prior=replace(self.prior, draws="nominal"))
        problem, truth = true.maker(seed)(index)
        return replace(problem, prior=Prior(dict(self.parameters), drawn.log_sd)), truth

    def sigmas(self, seed: int, record: int = 0) -> np.ndarray:
        """Return the standard deviation of each sensor's noise (m): mean square of clean samples over 10^(SNR/10)."""
        clean = self.undisturbed._response(self.times, seed, record)
        return np.asarray(np.sqrt(np.mean(clean**2, axis=1) / 10.0 ** (self.snr_db / 10.0)))

    def _replicate(
        self, seed: int, index: int, clean: np.ndarray, dense: np.ndarray, forecast: np.ndarray, sigma: np.ndarray
    ) -> tuple[Problem, Truth]:
        system = self.make_system()
        measured = list(self.measured_dofs)
        records, ideals, errors, levels = [], [], [], []
        for number in range(len(self.rigs())):
            if number:
                clean, sigma = self._response(self.times, seed, number), self.sigmas(seed, number)
            times, ideal, error = self._samples(seed, index, clean, sigma, number)
            ideal, error = ideal[measured], error[measured]
            records.append(self._record(seed, index, number, times, ideal + error))
            ideals.append(ideal)
            errors.append(error)
            levels.append(sigma[measured])
        problem = Problem(system, tuple(records), self.draw_prior(system, seed, index))
        truth = Truth(
            parameters=dict(self.parameters),
            initial_state=self._true_start,
            dense_times=self.dense_times,
            dense_displacement=dense,
            forecast_times=self.forecast_times,
            forecast_displacement=forecast,
            sigma=tuple(map(float, np.concatenate(levels))),
            realised_snr_db=float(10 * np.log10(np.sum(np.square(ideals)) / np.sum(np.square(errors)))),
            sigma_over_peak=float(np.max(levels[0] / np.max(np.abs(dense[measured]), axis=1))),
            measured=self.measured,
        )
        return problem, truth

    def example(self, seed: int) -> Problem:
        """Return replicate 0 with noise in place of the motion, which takes no simulation: what objections look at."""
        records = []
        for number in range(len(self.rigs())):
            rng = self.stream(DISTURBANCE, seed, 0, *_later(number))
            times = self.disturbance.sampling(self.times, rng)[0] if self.disturbance else self.times
            noise = self.stream(NOISE, seed, 0, *_later(number)).standard_normal((len(self.measured_dofs), times.size))
            records.append(self._record(seed, 0, number, times, noise))
        system = self.make_system()
        return Problem(system, tuple(records), self.draw_prior(system, seed, 0))

    def _record(self, seed: int, index: int, number: int, times: np.ndarray, values: np.ndarray) -> Record:
        """Return what methods see of a record whose sensors read ``values`` (measured, n)."""
        rig = self.rigs()[number]
        channels = tuple(Channel(times, own, dof=i) for i, own in zip(self.measured_dofs, values, strict=True))
        added = np.array(rig.added) if isinstance(rig, LoadedSystem) else None
        forces = []
        if self.force is not None:
            rng = self.stream(FORCE_NOISE, seed, index, *_later(number))
            forces = [self.force.measured(force, rng) for force in self.forces(seed)]
        return Record(channels, tuple(forces), self.start if self.initial_state == "known" else None, added)

    def _samples(
        self, seed: int, index: int, clean: np.ndarray, sigma: np.ndarray, record: int = 0
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return stated times, the true displacement at them, and the error of the samples: noise and disturbance."""
        base = self.stream(NOISE, seed, index, *_later(record)).standard_normal(clean.shape)
        if self.disturbance is None:
            return self.times, clean, sigma[:, None] * base
        rng = self.stream(DISTURBANCE, seed, index, *_later(record))
        stated, actual = self.disturbance.sampling(self.times, rng)
        ideal = clean if stated is self.times else self._response(stated, seed, record)
        taken = ideal if actual is stated else self._response(actual, seed, record)
        rms = sigma * 10.0 ** (self.snr_db / 20.0)  # of the clean samples, by the definition of the SNR
        systematic = rms[:, None] * self.disturbance.reading_error(stated)
        return stated, ideal, taken - ideal + systematic + sigma[:, None] * self.disturbance.noise(base, rng)

    @cached_property
    def _true_start(self) -> InitialState:
        """The true state at time 0 of the record."""
        if self.disturbance is None:
            return self.start
        return self.disturbance.start(self.make_system(), self.parameters, self.start)

    def draw_prior(self, system: System, seed: int, index: int) -> Prior | None:
        """Return the nominal prior of one replicate, drawn around the truth."""
        if self.prior is None:
            return None
        rng = self.stream(NOMINAL, seed, index)
        return draw_prior(system, self.parameters, self.prior.sd_by_kind, rng, self.prior.wrong)
