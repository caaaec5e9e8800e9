"""Random scenarios (the open split), drawn from the ranges in the ``draw`` section of an experiment's file.

``open_007`` is the seventh scenario of ``conf/experiment/open.yaml``. Each is a single mass in free or forced
vibration. The name of the release is the seed. The drawn numbers are rounded, so that the identity of a cell does not
depend on the rounding errors of a platform's logarithm.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from bench.config.files import file_names, read_yaml
from bench.errors import InputError

DIGITS = 5
"""Significant digits of the drawn numbers."""
SHAPES = ("multisine", "swept_sine", "step", "impulse")
"""Kinds of force, drawn with equal probability."""
HOLDS = ("zero_order", "linear", "cubic")
BAND = (0.2, 2.0)
"""Lowest and highest frequency of a multisine or sweep, over the natural frequency."""
PULSE = 0.3
"""Duration of an impulse in natural periods; at most a quarter of the record."""
FORCE_SAMPLES = 1000
"""Samples of the force: the number of times at which displacement is scored, since the simulation is ten times faster
on a common grid."""
MISJUDGED = 0.4
"""A force is designed for a natural frequency whose logarithm is wrong by at most this, so that its band and length do
not reveal the true one."""
SAMPLES_PER_CYCLE = 0.6
"""Fewest samples per natural cycle. Beyond the Nyquist frequency (2) an alias can fit as well; far beyond it nothing
would be compared but the prior."""
RANGES = ("cycles", "damping_ratio", "samples", "snr", "frequency_hz", "mass", "amplitude")


@dataclass(frozen=True)
class Drawn:
    """A drawn scenario: the ``system`` in the form of a file of ``conf/system``, and the other fields."""

    name: str
    system: Mapping[str, Any]
    snr: float
    initial_state: str
    disturbance: str

    def block(self) -> dict[str, list[Any]]:
        """Return a sweep that consists of this scenario only."""
        names = {"snr": self.snr, "initial_state": self.initial_state, "disturbance": self.disturbance}
        return {"system": [self.name], **{name: [value] for name, value in names.items()}}


@cache
def drawn_scenario(name: str) -> Drawn | None:
    """Return the drawn scenario of a name such as ``open_007``; None if there is none of that name."""
    match = re.fullmatch(r"([a-z]\w*)_(\d{3,})", name)
    if not match or match[1] not in file_names("experiment"):
        return None
    return next((scenario for scenario in drawn_scenarios(match[1]) if scenario.name == name), None)


@cache
def drawn_scenarios(experiment: str) -> tuple[Drawn, ...]:
    """Return the scenarios that an experiment draws, in order; empty if its file has no ``draw``."""
    stated = read_yaml("experiment", experiment).get("draw")
    return draw(experiment, stated) if stated else ()


def drawn_ranges() -> list[str]:
    """Return the ranges of names of drawn scenarios, such as ``open_001 to open_500``, one per experiment."""
    drawn = [drawn_scenarios(experiment) for experiment in file_names("experiment")]
    return [f"{scenarios[0].name} to {scenarios[-1].name}" for scenarios in drawn if scenarios]


def draw(experiment: str, stated: Mapping[str, Any]) -> tuple[Drawn, ...]:
    """Draw the scenarios of an experiment.

    Args:
        experiment: Prefix of the names: ``<experiment>_001`` and so on.
        stated: ``release``, whose name is the seed with that of the experiment; ``scenarios``, their number; and the
            two ends of each of :data:`RANGES`. The SNR (dB) is uniform; cycles in the record, damping ratio, number of
            samples, natural frequency (Hz), mass (kg) and amplitude (m) are uniform in the logarithm; the number of
            samples is at least :data:`SAMPLES_PER_CYCLE` times that of cycles.

    Raises:
        InputError: A range is missing, unknown or empty.
    """
    ranges = {name: ends for name, ends in stated.items() if name not in ("release", "scenarios")}
    for name in {*RANGES, *ranges}:
        ends = ranges.get(name, ())
        if name not in RANGES or len(ends) != 2 or not ends[0] <= ends[1]:
            raise InputError(f"draw.{name}", ends, f"two ends, the lower first, of each of {', '.join(RANGES)}")
    digest = hashlib.sha256(f"{experiment} {stated['release']}".encode()).digest()
    seeds = np.random.SeedSequence(int.from_bytes(digest[:16], "big")).spawn(int(stated["scenarios"]))
    return tuple(
        one_mass(f"{experiment}_{i:03d}", ranges, np.random.default_rng(seed)) for i, seed in enumerate(seeds, 1)
    )


def one_mass(name: str, ranges: Mapping[str, tuple[float, float]], rng: Any, digits: int = DIGITS) -> Drawn:
    """Draw a single mass in free or forced vibration.

    Args:
        name: Label of the scenario.
        ranges: The two ends of each of :data:`RANGES`.
        rng: Random generator with numpy's ``random``, ``uniform`` and ``choice``.
        digits: Significant digits of the drawn numbers.
    """

    def rounded(value: float) -> float:
        return float(f"{value:.{digits}g}")

    snr = rounded(rng.uniform(*ranges["snr"]))
    known, irregular, forced = (bool(rng.random() < 0.5) for _ in range(3))
    size = dict[str, float]()
    for key in RANGES:
        low, high = ranges[key]
        if key == "samples":
            low = min(max(low, SAMPLES_PER_CYCLE * size["cycles"]), high)
        if key != "snr":
            size[key] = float(np.exp(rng.uniform(*np.log((low, high)))))
    rate, phase = 2 * math.pi * size["frequency_hz"], rng.uniform(0.0, 2 * math.pi)
    mass, duration = size["mass"], rounded(size["cycles"] / size["frequency_hz"])
    initial = (
        (0.0, 0.0) if forced else (size["amplitude"] * math.cos(phase), -size["amplitude"] * rate * math.sin(phase))
    )
    parameters = {"m": mass, "c": 2 * size["damping_ratio"] * mass * rate, "k": mass * rate**2}
    hertz = size["frequency_hz"] * math.exp(rng.uniform(-MISJUDGED, MISJUDGED))
    push = rounded(parameters["k"] * size["amplitude"])
    system = {
        "label": name,
        "kind": "sdof",
        "options": {},
        "parameters": {key: rounded(value) for key, value in parameters.items()},
        "initial": {"displacement": [rounded(initial[0])], "velocity": [rounded(initial[1])]},
        "duration": duration,
        "samples": round(size["samples"]),
        "force": _force(push, hertz, duration, rng, rounded) if forced else None,
        "forecast": duration,
        **({"default_prior": "none"} if forced else {}),
    }
    return Drawn(name, system, snr, "known" if known else "unknown", "irregular" if irregular else "none")


def _force(
    amplitude: float, hertz: float, duration: float, rng: Any, rounded: Callable[[float], float]
) -> dict[str, Any]:
    """Draw a force for a natural frequency (Hz)."""
    kind, hold = str(rng.choice(SHAPES)), str(rng.choice(HOLDS))
    force: dict[str, Any] = {
        "kind": kind, "amplitude": amplitude, "samples": FORCE_SAMPLES,
        "hold": "zero_order" if kind == "step" else hold, "dof": 0,
    }  # fmt: skip
    if kind in ("multisine", "swept_sine"):
        force |= {"low_hz": rounded(BAND[0] * hertz), "high_hz": rounded(BAND[1] * hertz)}
    if kind == "impulse":
        force["length_s"] = rounded(min(PULSE / hertz, duration / 4))
    return force
