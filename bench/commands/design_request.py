"""What is asked of ``python -m bench.design``: its fields as numbers, and words that its answers share."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bench.commands.fields import number, whole
from bench.config.atlas import on_the_bound
from bench.config.choices import check_choice
from bench.contract.method import Identifier
from bench.errors import InputError
from bench.measured.reading.units import unit_of
from bench.planning.free_decay import QUANTITIES
from bench.planning.search import Likely

Simulation = Callable[[Identifier, int, Callable[[], object]], np.ndarray]
"""Errors of a simulated test by a method, so many times, and what it calls after each."""
LEAST, MOST, LEAST_SHARE, MOST_SHARE = 1e-9, 1e9, 1e-6, 1000.0
"""Of every quantity (SI units) and every percentage."""
MOST_SIMULATIONS = 100_000
TITLES = {"k_over_m": "k/m", "c_over_m": "c/m", "natural_frequency": "frequency", "damping_ratio": "damping ratio"}


@dataclass(frozen=True)
class Request:
    """A quantity wanted to an ``error`` (of its logarithm), of a likely oscillator, from samples with ``noise`` (m).

    ``simulations`` of each test that is proposed, fitted by ``method``; ``fields`` as they were given.
    """

    quantity: str
    error: float
    likely: Likely
    noise: float
    method: str
    simulations: int
    fields: Mapping[str, str]

    @property
    def title(self) -> str:
        """Of the wanted quantity."""
        return TITLES[self.quantity]

    def need(self, names: Sequence[str], what: str) -> None:
        """Raise InputError where one of some fields is not given."""
        for name in names:
            if not self.fields[name]:
                raise InputError(name, "", f"{name}=..., of the test whose {what} sought")


def request_of(fields: Mapping[str, str]) -> Request:
    """Read the fields that every plan has; raises InputError."""
    for name in ("want", "frequency", "damping", "noise"):
        if not fields[name]:
            raise InputError(name, "", f"{name}=...; see python -m bench.design --help")
    quantity, error = wanted(fields["want"])
    (frequency, frequency_sd), (damping, damping_sd) = (known(name, fields[name]) for name in ("frequency", "damping"))
    if damping >= 1.0:
        raise InputError("damping", fields["damping"], "below 1: a motion that swings")
    if fields["method"]:
        check_choice("method", fields["method"])
    return Request(
        quantity, error, Likely(frequency, damping, frequency_sd, damping_sd), length("noise", fields["noise"]),
        fields["method"] or on_the_bound()[0], whole("verify", fields["verify"], 0, MOST_SIMULATIONS), fields,
    )  # fmt: skip


def wanted(text: str) -> tuple[str, float]:
    """A quantity and the error of its logarithm."""
    quantity, _, error = text.partition(":")
    if quantity not in QUANTITIES:
        raise InputError("want", text, f"<quantity>:<error>%, of {', '.join(QUANTITIES)}")
    return quantity, share("want", error, text)


def known(field: str, text: str) -> tuple[float, float]:
    """A number and the standard deviation of its logarithm."""
    value, colon, doubt = text.partition(":")
    return positive(field, value, text), share(field, doubt, text) if colon else 0.0


def share(field: str, text: str, shown: str) -> float:
    """A percentage, as a share; an error shows it within what was given."""
    if not text.endswith("%"):
        raise InputError(field, shown, "a percentage, as 5%")
    return number(field, text[:-1], LEAST_SHARE, MOST_SHARE, f"a percentage from {LEAST_SHARE:g}", shown) / 100.0


def positive(field: str, text: str, shown: str = "") -> float:
    """A positive number; an error shows it within what was given."""
    return number(field, text, LEAST, MOST, f"a positive number from {LEAST:g}", shown or text)


def length(field: str, text: str) -> float:
    """A length with its unit, in metres."""
    parts = re.fullmatch(r"\s*([-+.\deE]+)\s*([^\d\s].*)", text)
    unit = unit_of(parts[2]) if parts else None
    if parts is None or unit is None or unit.measures != "displacement":
        raise InputError(field, text, "a length with its unit, as 0.5mm")
    return positive(field, parts[1], text) * unit.size


def percent(value: float) -> str:
    """An error in percent; a dash where there is none."""
    shown = 100 * value
    return "-" if not math.isfinite(value) else f"{shown:.0f}" if shown >= 10 else f"{shown:.2g}"


def median_words(likely: Likely) -> str:
    """What a percentage is, where more than one oscillator is likely."""
    return ", median over the likely oscillators" if likely.in_doubt else ""


def errors_of(request: Request, tests: Sequence[Simulation]) -> list[np.ndarray]:
    """Errors of each test, simulated."""
    from tqdm import tqdm

    from bench.entrants.registry import make_method

    method, number = make_method(request.method, {}), request.simulations
    with tqdm(total=number * len(tests), unit="test", file=sys.stderr) as bar:
        return [test(method, number, bar.update) for test in tests]
