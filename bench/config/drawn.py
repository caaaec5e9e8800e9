"""Scenarios drawn at random from stated ranges, by a seed that names a release: the open split.

An experiment whose file has ``draw`` describes them; ``open_007`` is the seventh of ``conf/experiment/open.yaml``. Each
is one mass in free or forced vibration. A scenario depends on the release and its number alone, and its numbers are
rounded, so that the last digit of a logarithm does not change which cell it is.
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
"""Significant digits of what is drawn."""
SHAPES = ("multisine", "swept_sine", "step", "impulse")
"""The forces that are drawn from, equally likely."""
HOLDS = ("zero_order", "linear", "cubic")
BAND = (0.2, 2.0)
"""Lowest and highest frequency of a multisine and a sweep, over the natural frequency."""
PULSE = 0.3
"""Length of a pulse in natural periods, where it is not more than a quarter of the record."""
FORCE_SAMPLES = 1000
"""As many as there are times at which displacement is scored: on one grid the true response costs a tenth."""
RANGES = ("cycles", "damping_ratio", "samples", "snr", "frequency_hz", "mass", "amplitude")


@dataclass(frozen=True)
class Drawn:
    """A drawn scenario: its ``system`` as a file of ``conf/system`` would write it, and its other fields."""

    name: str
    system: Mapping[str, Any]
    snr: float
    initial_state: str
    disturbance: str

    def block(self) -> dict[str, list[Any]]:
        """Return the sweep of this scenario alone."""
        names = {"snr": self.snr, "initial_state": self.initial_state, "disturbance": self.disturbance}
        return {"system": [self.name], **{name: [value] for name, value in names.items()}}


@cache
def drawn_scenario(name: str) -> Drawn | None:
    """Return the drawn scenario of a name such as ``open_007``; None where no experiment draws one of that name."""
    match = re.fullmatch(r"([a-z]\w*)_(\d{3,})", name)
    if not match or match[1] not in file_names("experiment"):
        return None
    return next((scenario for scenario in drawn_scenarios(match[1]) if scenario.name == name), None)


@cache
def drawn_scenarios(experiment: str) -> tuple[Drawn, ...]:
    """Return the scenarios that an experiment draws, in order; none where its file has no ``draw``."""
    stated = read_yaml("experiment", experiment).get("draw")
    return draw(experiment, stated) if stated else ()


def drawn_ranges() -> list[str]:
    """Return the names of drawn scenarios in words: ``open_001 to open_200``, one an experiment that draws any."""
    drawn = [drawn_scenarios(experiment) for experiment in file_names("experiment")]
    return [f"{scenarios[0].name} to {scenarios[-1].name}" for scenarios in drawn if scenarios]


def draw(experiment: str, stated: Mapping[str, Any]) -> tuple[Drawn, ...]:
    """Draw scenarios.

    Args:
        experiment: names them, ``<experiment>_001`` and so on.
        stated: ``release``, whose name is the seed; ``scenarios``, their number; and of each of :data:`RANGES` its two
            ends: SNR in dB, uniform; the number of samples, cycles in the record, damping ratio, natural frequency
            (Hz), mass (kg) and amplitude (m) uniform in the logarithm.

    Raises:
        InputError: for a range that is missing, unknown or empty.
    """
    ranges = {name: ends for name, ends in stated.items() if name not in ("release", "scenarios")}
    for name in {*RANGES, *ranges}:
        ends = ranges.get(name, ())
        if name not in RANGES or len(ends) != 2 or not ends[0] <= ends[1]:
            raise InputError(f"draw.{name}", ends, f"two ends, the lower first, of each of {', '.join(RANGES)}")
    digest = hashlib.sha256(str(stated["release"]).encode()).digest()
    seeds = np.random.SeedSequence(int.from_bytes(digest[:16], "big")).spawn(int(stated["scenarios"]))
    return tuple(
        one_mass(f"{experiment}_{i:03d}", ranges, np.random.default_rng(seed)) for i, seed in enumerate(seeds, 1)
    )


def one_mass(
    name: str, ranges: Mapping[str, tuple[float, float]], rng: Any, digits: int = DIGITS, misjudged: float = 0.0
) -> Drawn:
    """Draw one mass in free or forced vibration.

    Args:
        name: Its label.
        ranges: The two ends of each of :data:`RANGES`.
        rng: What draws: ``random``, ``uniform`` and ``choice`` as numpy's generators have them.
        digits: Significant digits of what is drawn.
        misjudged: The force is made for a natural frequency that is off by a factor between exp(-misjudged) and
            exp(misjudged); at 0 its band states the natural frequency.
    """

    def rounded(value: float) -> float:
        return float(f"{value:.{digits}g}")

    snr = rounded(rng.uniform(*ranges["snr"]))
    known, irregular, forced = (bool(rng.random() < 0.5) for _ in range(3))
    size = {key: float(np.exp(rng.uniform(*np.log(ranges[key])))) for key in RANGES if key != "snr"}
    rate, phase = 2 * math.pi * size["frequency_hz"], rng.uniform(0.0, 2 * math.pi)
    mass, duration = size["mass"], rounded(size["cycles"] / size["frequency_hz"])
    start = (0.0, 0.0) if forced else (size["amplitude"] * math.cos(phase), -size["amplitude"] * rate * math.sin(phase))
    parameters = {"m": mass, "c": 2 * size["damping_ratio"] * mass * rate, "k": mass * rate**2}
    hertz = size["frequency_hz"] * (math.exp(rng.uniform(-misjudged, misjudged)) if misjudged else 1.0)
    push = rounded(parameters["k"] * size["amplitude"])
    system = {
        "label": name,
        "kind": "sdof",
        "options": {},
        "parameters": {key: rounded(value) for key, value in parameters.items()},
        "initial": {"displacement": [rounded(start[0])], "velocity": [rounded(start[1])]},
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
    """Return a known force for a natural frequency (Hz), fine enough for its own highest frequency."""
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
