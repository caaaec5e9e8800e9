"""The verb ``design``: tests that reach a wanted accuracy, and the expected accuracy of methods at a test."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from bench.commands.certify import RECORD_FIELDS
from bench.commands.declaration import OneOf, Others, Parsed, Within, file
from bench.errors import InputError
from bench.scenario.declaration import value_of

QUANTITIES = ("k_over_m", "c_over_m", "natural_frequency", "damping_ratio")
ATLAS = Path("results/atlas.csv.gz")
Uncertain = tuple[float, float]
"""A value, and the standard deviation of its logarithm."""
Size = Annotated[float, Within(ge=1e-9, le=1e9)]
"""A positive quantity (SI units)."""


def percentage(text: str) -> float:
    """Read a percentage, as ``5%``, as a fraction."""
    if not text.endswith("%"):
        raise ValueError("a percentage, as 5%")
    return value_of(Annotated[float, Within(ge=1e-6, le=1000.0)], text[:-1], "") / 100.0  # type: ignore[no-any-return]


def wanted(text: str) -> tuple[str, float]:
    """Read a quantity and the wanted standard deviation of its logarithm: ``c_over_m:5%``."""
    quantity, _, error = text.partition(":")
    if quantity not in QUANTITIES:
        raise ValueError(f"<quantity>:<error>%, of {', '.join(QUANTITIES)}")
    return quantity, percentage(error)


def hertz(text: str) -> float:
    """Read a frequency (Hz): ``2`` or ``2Hz``."""
    return value_of(Size, text.removesuffix("Hz").rstrip(), "")  # type: ignore[no-any-return]


def ratio(text: str) -> float:
    """Read a damping ratio: ``0.02`` or ``2%``."""
    if text.endswith("%"):
        return percentage(text)
    return value_of(Annotated[float, Within(gt=0, le=100)], text, "")  # type: ignore[no-any-return]


def uncertain(read: Callable[[str], float]) -> Callable[[str], Uncertain]:
    """Return a reader of a value with or without a standard deviation: ``2`` or ``2:10%``."""

    def read_both(text: str) -> Uncertain:
        value, colon, deviation = text.partition(":")
        return read(value), percentage(deviation) if colon else 0.0

    return read_both


def length(text: str) -> float:
    """Read a length with its unit, and return it in m."""
    from bench.records.reading.units import unit_of

    parts = re.fullmatch(r"\s*([-+.\deE]+)\s*([^\d\s].*)", text)
    unit = unit_of(parts[2]) if parts else None
    if parts is None or unit is None or unit.symbol != "m":
        raise ValueError("a length with its unit, as 0.5mm; for a sensor of another quantity use given=<record>")
    return float(value_of(Size, parts[1], "")) * unit.size


def methods() -> Sequence[str]:
    """Return the names of the methods and their variants."""
    from bench.config.choices import choices

    return choices("method")


Want = Annotated[
    tuple[str, float], Parsed(wanted), f"<quantity>:<error>%, a standard deviation, of {', '.join(QUANTITIES)}"
]
Frequency = Annotated[Uncertain, Parsed(uncertain(hertz)), "natural frequency (Hz), 2 or 2:10% with its uncertainty"]
Damping = Annotated[Uncertain, Parsed(uncertain(ratio)), "damping ratio, 0.02, 2% or 2%:50% with its uncertainty"]
Noise = Annotated[float, Parsed(length), "standard deviation of a sample, as 0.5mm"]
Amplitude = Annotated[float, Parsed(length), "initial displacement, as 1cm"]
Duration = Annotated[Size, "duration (s)"]
Few = Annotated[int, Within(ge=8, le=500), "number of samples"]
Method = Annotated[str | None, OneOf(methods), "method that fits [the first that reaches the bound]"]
Verify = Annotated[int, Within(ge=0, le=100_000), "number of simulations of each proposed test"]


def design(
    want: Want,
    frequency: Frequency,
    damping: Damping,
    noise: Noise,
    amplitude: Annotated[float | None, Parsed(length), "initial displacement, as 1cm [several are tried]"] = None,
    rate: Annotated[Size | None, "sampling rate (1/s) [any]"] = None,
    samples: Annotated[int | None, Within(ge=8, le=100_000), "with duration=: samples of a given test"] = None,
    duration: Annotated[Size | None, "with samples=: duration of a given test (s)"] = None,
    method: Method = None,
    verify: Verify = 0,
) -> int:
    """Design the smallest free decay that reaches a wanted accuracy.

    With samples= and duration=: state the errors of that test.
    """
    from bench.reporting.plans import decay_page, errors_of, proposals

    request = _request(want, frequency, damping, noise, method, verify)
    start = None if amplitude is None else amplitude / noise
    if (samples is None) != (duration is None):
        name = "samples" if samples is None else "duration"
        raise InputError(name, "", f"give {name}= as well; both describe the test")
    if samples is not None and duration is not None:
        tests = errors_of(request, start, samples, duration)
    else:
        tests = proposals(request, start, rate or 0.0)
    if not tests:
        error = f"{request.title} to {100 * request.error:g} %"
        print(f"no free decay of up to 100,000 samples determines {error}; use a larger initial displacement")
        return 1
    print(decay_page(request, tests))
    return 0


def best_times(
    want: Want,
    frequency: Frequency,
    damping: Damping,
    noise: Noise,
    samples: Few,
    duration: Duration,
    amplitude: Amplitude,
    out: Annotated[Path | None, "file for the best times (s), one per line"] = None,
    method: Method = None,
    verify: Verify = 0,
) -> int:
    """Find the best sampling times of a free decay, and compare them with even ones."""
    from bench.planning.free_decay import Decay
    from bench.reporting.plans import times_page

    request = _request(want, frequency, damping, noise, method, verify, out)
    text, times = times_page(request, Decay(samples, duration, amplitude / noise))
    return _shown(text, out, "t (s)", [f"{time:.9g}" for time in times])


def best_force(
    want: Want,
    frequency: Frequency,
    damping: Damping,
    noise: Noise,
    samples: Few,
    duration: Duration,
    energy: Annotated[Size, "integral of the squared force (N² s)"],
    mass: Annotated[Size, "approximate mass (kg)"],
    out: Annotated[Path | None, "file for the best force over time"] = None,
    method: Method = None,
    verify: Verify = 0,
) -> int:
    """Find the best force of a given energy, from rest, and compare it with a blow, noise and an even multisine."""
    from bench.reporting.plans import forced_test, forces_page

    request = _request(want, frequency, damping, noise, method, verify, out)
    test, size = forced_test(request, samples, duration, energy, mass)
    text, force = forces_page(request, test, size, energy)
    rows = [f"{time:.9g},{value:.9g}" for time, value in zip(test.times, force, strict=True)]
    return _shown(text, out, "t (s),force (N)", rows)


def longer(
    given: Annotated[str, "record of a free decay"],
    record: Annotated[Sequence[str], Others(RECORD_FIELDS), "columns=, units=, ... as for python -m bench data="],
    want: Annotated[tuple[str, float] | None, Parsed(wanted), "<quantity>:<error>%"] = None,
    method: Method = None,
) -> int:
    """State what a longer record of a free decay, or a repeated one, would determine."""
    from bench.config.atlas import efficient_methods
    from bench.config.overrides import read_overrides
    from bench.planning.measured_decay import measured_decay
    from bench.reporting.plans import longer_page

    try:
        measured = measured_decay(
            read_overrides([f"data={given}", f"method={method or efficient_methods()[0]}", *record])
        )
    except InputError as error:
        raise InputError("given" if error.field == "data" else error.field, error.value, error.remedy) from None
    print(longer_page(measured, *(want or (None, 0.0))))
    return 0


def expected(
    samples: Annotated[int, Within(ge=4, le=100_000), "number of samples of the displacement, evenly spread"],
    cycles: Annotated[float, Within(gt=0, le=1e6), "undamped periods in the record"],
    damping: Annotated[float, Parsed(ratio), "damping ratio, 0.02 or 2%"],
    snr: Annotated[float, Within(gt=-100, le=300), "mean square of the clean samples over the noise's variance (dB)"],
    phase: Annotated[float, "initial phase (degrees): 0 released from rest, 90 after an impact"] = 0.0,
    initial_state: Annotated[Literal["unknown", "known"], "whether methods are given the initial state"] = "unknown",
    quantity: Annotated[Literal["k_over_m", "c_over_m"], "quantity whose errors are expected"] = "k_over_m",
    atlas: Annotated[Path, "atlas of free decays, as experiment=atlas writes it"] = ATLAS,
) -> int:
    """State the errors that each method is expected to have at a free decay, from the atlas."""
    from bench.atlas.model import ensembles
    from bench.atlas.point import FreeDecay
    from bench.reporting.plans import expected_page, read_atlas

    ensembles()  # a missing package is reported before the work
    if atlas == ATLAS and not atlas.exists():  # the working folder is not the clone
        atlas = Path(__file__).parents[2] / atlas
    file("atlas", atlas, "a file that python -m bench -m experiment=atlas has written")
    point = FreeDecay(samples, cycles, damping, snr, math.radians(phase % 180.0), initial_state == "known")
    print(expected_page(point, read_atlas(atlas, quantity), quantity))
    return 0


VARIANTS = {
    "given": longer,
    "snr": expected,
    "cycles": expected,
    "force=optimal": best_force,
    "times=optimal": best_times,
}


def _request(
    want: tuple[str, float], frequency: Uncertain, damping: Uncertain, noise: float, method: str | None, verify: int,
    out: Path | None = None,
) -> Any:  # fmt: skip
    """Return the request; raises InputError, before any work, for a bad value and a file that cannot be written."""
    from bench.config.atlas import efficient_methods
    from bench.planning.search import Likely
    from bench.reporting.plans import PlanRequest
    from bench.reporting.whole_file import check_file

    if damping[0] >= 1.0:
        raise InputError("damping", f"{damping[0]:g}", "below 1: a motion that oscillates")
    if out is not None:
        check_file(out)
    likely = Likely(frequency[0], damping[0], frequency[1], damping[1])
    return PlanRequest(*want, likely, noise, method or efficient_methods()[0], verify)


def _shown(text: str, out: Path | None, header: str, rows: Sequence[str]) -> int:
    """Print a page, and write the rows of its best test to the file that is named."""
    from bench.reporting.whole_file import write

    print(text)
    if out is not None:
        write(out, "\n".join([header, *rows, ""]))
    return 0
